"""Makes all kinds of meshes on any number of ranks, and prints what must not depend on them.

One JSON object on the first rank: by the name of a mesh its cells, its area, the length of every
wall, and the areas and mean heights of its regions.
"""

import json
import sys

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from meshes.box import PLANE_WALLS, section_mesh
from meshes.refine import adapted_mesh, refined_mesh
from meshes.section import MeshingError, fitted_mesh
from meshes.split import barycentric_mesh
from restoration.environment import use_jit_cache

COMM = MPI.COMM_WORLD
X = np.linspace(0, 4000, 201)
SURFACE = np.column_stack([X, 50 * np.sin(X / 300)])
BASE = np.array([[0, -1000], [4000, -1000.0]])
ANGLE = np.linspace(0, 2 * np.pi, 721) % (2 * np.pi)
CIRCLE = np.column_stack([1000 + 200 * np.cos(ANGLE), -500 + 200 * np.sin(ANGLE)])
FAULT = np.array([[2500, 0], [3000, -600.0]])


def measures(section):
    """Return measures of a section from its forms and from its arrays, a list of numbers."""
    ds = ufl.Measure("ds", section.mesh, subdomain_data=section.facet_tags)
    one = fem.Constant(section.mesh, 1.0)
    walls = [
        COMM.allreduce(fem.assemble_scalar(fem.form(one * ds(tag))))
        for tag in section.wall_tags.values()
    ]
    total = COMM.allreduce(fem.assemble_scalar(fem.form(one * ufl.dx(section.mesh))))
    assert section.wall_tags.keys() == set(PLANE_WALLS)
    numbers = [section.cell_count, section.area, total, *walls]
    if section.regions is not None:
        assert len(section.regions) == len(section.areas)
        numbers += of_regions(section)
    return numbers


def of_regions(section):
    """Return the areas of all regions, m^2, then the mean heights of their cells, m."""
    regions, areas = section.regions[: section.owned], section.areas[: section.owned]
    heights = section.corners[: section.owned, :, 1].mean(axis=1)
    count = COMM.allreduce(int(section.regions.max()), op=MPI.MAX) + 1
    area = COMM.allreduce(np.bincount(regions, areas, minlength=count))
    moment = COMM.allreduce(np.bincount(regions, areas * heights, minlength=count))
    return [*area, *(moment / area)]


def ring(x):
    """Return the cell size wanted around the circle, m."""
    return 10 + 0.3 * np.abs(np.hypot(x[:, 0] - 1000, x[:, 1] + 500) - 200)


def main():
    """Print the numbers of every mesh by name, as JSON, on the first rank."""
    use_jit_cache()
    fitted, points = fitted_mesh(SURFACE, BASE, [CIRCLE, FAULT], 100, 40)
    box = section_mesh(SURFACE, BASE, (16, 4))
    found = {"points in the regions": points.ravel().tolist()}
    for name, section in (("box", box), ("fitted", fitted)):
        right = section.corners[:, :, 0].mean(axis=1) > 2000
        made = {
            name: section,
            f"{name}, refined": refined_mesh(section, right),
            f"{name}, adapted": adapted_mesh(section, ring, 3),
            f"{name}, split": barycentric_mesh(section),
            f"{name}, adapted and split": barycentric_mesh(adapted_mesh(section, ring, 2)),
        }
        found |= {of: [float(n) for n in measures(mesh)] for of, mesh in made.items()}
    told = 0
    try:
        fitted_mesh(SURFACE, SURFACE, [], 100)
    except MeshingError:
        told = 1
    found["share of ranks told of an error"] = [COMM.allreduce(told) / COMM.size]
    if COMM.rank == 0:
        json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()

"""Prints areas and wall lengths of all kinds of meshes; they are the same on any number of ranks.

mpirun --oversubscribe --allow-run-as-root -n 2 .venv/bin/python tests/meshes/mpi_meshes.py
"""

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from meshes.box import section_mesh
from meshes.refine import adapted_mesh, refined_mesh
from meshes.section import MeshingError, fitted_mesh
from meshes.split import barycentric_mesh

COMM = MPI.COMM_WORLD
X = np.linspace(0, 4000, 201)
SURFACE = np.column_stack([X, 50 * np.sin(X / 300)])
BASE = np.array([[0, -1000], [4000, -1000.0]])
ANGLE = np.linspace(0, 2 * np.pi, 721) % (2 * np.pi)
CIRCLE = np.column_stack([1000 + 200 * np.cos(ANGLE), -500 + 200 * np.sin(ANGLE)])
FAULT = np.array([[2500, 0], [3000, -600.0]])


def tell(name, section):
    """Print the measures of a section from its forms and from its arrays."""
    ds = ufl.Measure("ds", section.mesh, subdomain_data=section.facet_tags)
    walls = {
        wall: COMM.allreduce(
            fem.assemble_scalar(fem.form(fem.Constant(section.mesh, 1.0) * ds(tag)))
        )
        for wall, tag in section.wall_tags.items()
    }
    owned = section.mesh.topology.index_map(2).size_local
    total = COMM.allreduce(section.areas[:owned].sum())
    regions = None
    if section.regions is not None:
        count = COMM.allreduce(int(section.regions.max()), op=MPI.MAX) + 1
        local = np.bincount(section.regions[:owned], section.areas[:owned], minlength=count)
        regions = COMM.allreduce(local)
        assert len(section.regions) == len(section.areas)
    cells = COMM.allreduce(owned)
    if COMM.rank == 0:
        lengths = " ".join(f"{wall} {length:.6f}" for wall, length in walls.items())
        print(f"{name}: {cells} cells, area {total:.6f}, {lengths}, regions {regions}", flush=True)


def ring(x):
    """Return the cell size wanted around the circle, m."""
    return 10 + 0.3 * np.abs(np.hypot(x[:, 0] - 1000, x[:, 1] + 500) - 200)


def main():
    """Build the meshes and tell of them."""
    fitted, _ = fitted_mesh(SURFACE, BASE, [CIRCLE, FAULT], 100, 40)
    box = section_mesh(SURFACE, BASE, (16, 4))
    tell("box", box)
    tell("fitted", fitted)
    for name, section in (("box", box), ("fitted", fitted)):
        right = section.corners[:, :, 0].mean(axis=1) > 2000
        tell(f"{name} refined", refined_mesh(section, right))
        tell(f"{name} adapted", adapted_mesh(section, ring, 3))
        tell(f"{name} split", barycentric_mesh(section))
        tell(f"{name} adapted and split", barycentric_mesh(adapted_mesh(section, ring, 2)))
    try:
        fitted_mesh(SURFACE, SURFACE, [], 100)
    except MeshingError as error:
        print(f"rank {COMM.rank} was told: {error}")
    else:
        raise AssertionError("a section without area was meshed")


if __name__ == "__main__":
    main()

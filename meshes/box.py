"""Structured meshes of sections with vertical sides, flat or with a relief."""

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI

from meshes.data import SectionMesh

WALL_TAGS = {"left": 1, "right": 2, "base": 3, "surface": 4}


def section_mesh(surface, base, cells):
    """Return a mesh of columns between two lines; every square is split into four triangles.

    The crossed pattern has no preferred diagonal, so a mirrored section gets a mirrored answer.

    Args:
        surface: top line, shape (n, 2), x ascending, m.
        base: bottom line over the same x range, shape (m, 2), m.
        cells: columns and rows of squares.
    """
    left, right = surface[0, 0], surface[-1, 0]
    mesh = dmesh.create_rectangle(
        MPI.COMM_WORLD,
        [np.array([left, 0.0]), np.array([right, 1.0])],
        list(cells),
        dmesh.CellType.triangle,
        diagonal=dmesh.DiagonalType.crossed,
    )
    mesh.topology.create_connectivity(1, 2)
    facet_tags = _tag_walls(mesh, left, right)
    x = mesh.geometry.x
    top = np.interp(x[:, 0], surface[:, 0], surface[:, 1])
    bottom = np.interp(x[:, 0], base[:, 0], base[:, 1])
    x[:, 1] = bottom + x[:, 1] * (top - bottom)
    lines = {"surface": surface, "base": base}
    level = {name for name, line in lines.items() if np.ptp(line[:, 1]) == 0}
    return SectionMesh(mesh, facet_tags, dict(WALL_TAGS), frozenset({"left", "right"} | level))


def _tag_walls(mesh, left, right):
    """Return the wall tags of a mesh whose rows still run from z = 0 to 1."""
    near = 1e-9
    at = {
        "left": lambda x: x[0] <= left + near * (right - left),
        "right": lambda x: x[0] >= right - near * (right - left),
        "base": lambda x: x[1] <= near,
        "surface": lambda x: x[1] >= 1 - near,
    }
    facets = {name: dmesh.locate_entities_boundary(mesh, 1, inside) for name, inside in at.items()}
    index = np.concatenate(list(facets.values()))
    value = np.concatenate([np.full(len(f), WALL_TAGS[n], np.int32) for n, f in facets.items()])
    order = np.argsort(index)
    return dmesh.meshtags(mesh, 1, index[order], value[order])

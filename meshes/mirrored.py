"""Boxes of tetrahedra without a preferred diagonal."""

from itertools import permutations

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI

from meshes.box import GHOSTS, WALL_TAGS, tag_walls
from meshes.data import SectionMesh


def mirrored_box_mesh(low, high, cells):
    """Return a mesh of a box in which every cube is the mirror image of its neighbours.

    Each cube is six tetrahedra around one of its diagonals, as in `box.box_mesh`; there all
    diagonals are parallel, and rock on slopes that face them moves otherwise than on those that do
    not. Here the mesh is its own image in every plane of nodes: with even numbers of cubes a
    mirrored box gets a mirrored answer. (The triangulation J1 of Todd 1976, Lect. Notes Econ. Math.
    Syst. 124.)

    Args:
        low, high: opposite corners, shape (3,), m.
        cells: cubes along x, y and z.
    """
    comm, low, high = MPI.COMM_WORLD, np.asarray(low, float), np.asarray(high, float)
    x, tetrahedra = np.empty((0, 3)), np.empty((0, 4), np.int64)
    if comm.rank == 0:
        counts = np.array(cells) + 1
        nodes = np.stack(np.unravel_index(np.arange(counts.prod()), counts), axis=1)
        x = low + nodes / cells * (high - low)
        tetrahedra = _tetrahedra(np.asarray(cells))
    domain = dmesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1).ufl_domain()  # straight tetrahedra
    mesh = dmesh.create_mesh(comm, tetrahedra, x, domain, ghost_mode=GHOSTS)
    return SectionMesh(mesh, tag_walls(mesh, low, high), dict(WALL_TAGS), frozenset(WALL_TAGS))


def _tetrahedra(cells):
    """Return the nodes of the tetrahedra, rows of four; z counts first, then y, then x."""
    cubes = np.stack(np.unravel_index(np.arange(cells.prod()), cells), axis=1)
    paths = np.array(
        [
            np.cumsum([np.zeros(3, int), *np.eye(3, dtype=int)[list(way)]], axis=0)
            for way in permutations(range(3))
        ]
    )  # from one corner of a cube to the opposite one, along three edges
    odd = (cubes % 2 == 1)[:, None, None]
    corners = cubes[:, None, None] + np.where(odd, 1 - paths, paths)
    return np.ravel_multi_index(tuple(np.moveaxis(corners, -1, 0)), cells + 1).reshape(-1, 4)

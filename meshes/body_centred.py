"""Boxes of tetrahedra without a preferred diagonal."""

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI

from meshes.box import GHOSTS, WALL_TAGS, tag_walls
from meshes.data import SectionMesh

# Corners of a face in turn, by what they add to its lowest corner along the axes in it.
ROUND = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])


def body_centred_mesh(low, high, cells, comm=MPI.COMM_WORLD):
    """Return a mesh of a box whose nodes are the corners and the centres of cubes.

    The centres of two cubes and an edge of the face between them make a tetrahedron, twelve of
    them for each cube, all alike; at a wall the centre of the face stands for the other cube.
    Every plane of corners or centres is a mirror, and all inner nodes are alike: a mirrored box
    gets a mirrored answer, and what coarse cells do to a level horizon they do to it everywhere.
    Around the diagonals of cubes, as in `box.box_mesh`, the first is missed; with those of
    neighbours mirrored the second.

    Args:
        low, high: opposite corners, shape (3,), m.
        cells: cubes along x, y and z.
        comm: MPI communicator of the ranks that share it.
    """
    low, high = np.asarray(low, float), np.asarray(high, float)
    x, tetrahedra = np.empty((0, 3)), np.empty((0, 4), np.int64)
    if comm.rank == 0:
        nodes, tetrahedra = _tetrahedra(np.asarray(cells))
        x = low + nodes / cells * (high - low)
    domain = dmesh.create_unit_cube(MPI.COMM_SELF, 1, 1, 1).ufl_domain()  # straight tetrahedra
    mesh = dmesh.create_mesh(comm, tetrahedra, x, domain, ghost_mode=GHOSTS)
    return SectionMesh(mesh, tag_walls(mesh, low, high), dict(WALL_TAGS), frozenset(WALL_TAGS))


def _tetrahedra(cells):
    """Return the nodes in units of cubes, shape (n, 3), and the tetrahedra, rows of four."""
    corners, cubes = (
        np.stack(np.unravel_index(np.arange(np.prod(n)), n), axis=1) for n in (cells + 1, cells)
    )
    nodes, tetrahedra = [corners, cubes + 0.5], []
    known = len(corners) + len(cubes)
    for axis in range(3):
        step = np.eye(3, dtype=int)[axis]
        faces = np.stack(np.unravel_index(np.arange(np.prod(cells + step)), cells + step), axis=1)
        ends = [
            _numbers(beside, cells, len(corners))
            for beside in (np.maximum(faces - step, 0), np.minimum(faces, cells - 1))
        ]
        wall = (faces[:, axis] == 0) | (faces[:, axis] == cells[axis])
        ends[1][wall] = known + np.arange(wall.sum())
        known += wall.sum()
        nodes.append(faces[wall] + (1 - step) / 2)
        turn = np.zeros((4, 3), int)
        turn[:, [a for a in range(3) if a != axis]] = ROUND
        around = _numbers(faces[:, None] + turn, cells + 1, 0)
        for a in range(4):
            b = (a + 1) % 4
            tetrahedra.append(np.column_stack([*ends, around[:, a], around[:, b]]))
    return np.concatenate(nodes), np.concatenate(tetrahedra).astype(np.int64)


def _numbers(places, counts, first):
    """Return the numbers of places (..., 3) in a lattice whose first node has a number."""
    return first + np.ravel_multi_index(tuple(np.moveaxis(places, -1, 0)), counts)

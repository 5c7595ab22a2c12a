"""Structured meshes: sections with vertical sides, flat or with a relief, and boxes."""

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI

from meshes.data import CORNERS, SectionMesh

WALL_TAGS = {"left": 1, "right": 2, "base": 3, "surface": 4, "front": 5, "back": 6}
PLANE_WALLS = ("left", "right", "base", "surface")
ROCK, AIR = 0, 1  # regions of a mesh with air
NEAR = 1e-9  # of a width, a point this near to a wall is on it
# Ghosts on the other side of every facet that two ranks share: walls weakly held and adaption
# need none, and a bare mesh has none.
GHOSTS = dmesh.GhostMode.shared_facet


def section_mesh(surface, base, cells, cell="triangle", air=None, comm=MPI.COMM_WORLD):
    """Return a mesh of columns between two lines, and of the air above them if it is wanted.

    Every square is split into four triangles, or is one quadrilateral. The crossed pattern has no
    preferred diagonal, so a mirrored section gets a mirrored answer.

    Args:
        surface: top line, shape (n, 2), x ascending, m.
        base: bottom line over the same x range, shape (m, 2), m.
        cells: columns and rows of squares between the lines.
        cell: ``triangle`` or ``quadrilateral``.
        air: (height of the level top of the air, m, rows of squares in it), or None; the mesh then
            has the regions `ROCK` and `AIR`, and its wall ``surface`` is the top of the air.
        comm: MPI communicator of the ranks that share it.
    """
    rows = cells[1] + (air[1] if air else 0)
    left, right = surface[0, 0], surface[-1, 0]
    mesh = dmesh.create_rectangle(
        comm,
        [np.array([left, 0.0]), np.array([right, 1.0])],
        [cells[0], rows],
        getattr(dmesh.CellType, cell),
        ghost_mode=GHOSTS,
        diagonal=dmesh.DiagonalType.crossed,
    )
    facet_tags = tag_walls(mesh, np.array([left, 0.0]), np.array([right, 1.0]))
    x = mesh.geometry.x
    top = np.interp(x[:, 0], surface[:, 0], surface[:, 1])
    bottom = np.interp(x[:, 0], base[:, 0], base[:, 1])
    row = x[:, 1] * rows
    x[:, 1] = bottom + row / cells[1] * (top - bottom)
    lines, regions = {"surface": surface, "base": base}, None
    if air:
        share = (row - cells[1]) / air[1]
        x[:, 1] = np.where(share > 0, top + share * (air[0] - top), x[:, 1])
        lines["surface"] = np.array([[left, air[0]], [right, air[0]]])
        dofs = mesh.geometry.dofmap.array.reshape(-1, CORNERS[cell])
        regions = np.where(row[dofs].mean(axis=1) > cells[1], AIR, ROCK).astype(np.int32)
    level = {name for name, line in lines.items() if np.ptp(line[:, 1]) == 0}
    tags = {name: WALL_TAGS[name] for name in PLANE_WALLS}
    return SectionMesh(mesh, facet_tags, tags, frozenset({"left", "right"} | level), regions)


def box_mesh(low, high, cells, cell="tetrahedron", comm=MPI.COMM_WORLD):
    """Return a mesh of a box in three dimensions; z is up, y from front to back.

    Args:
        low, high: opposite corners, shape (3,), m.
        cells: cubes along x, y and z; each is one hexahedron or six tetrahedra.
        cell: ``tetrahedron`` or ``hexahedron``.
        comm: MPI communicator of the ranks that share it.
    """
    low, high = np.asarray(low, float), np.asarray(high, float)
    mesh = dmesh.create_box(
        comm,
        [low, high],
        list(cells),
        getattr(dmesh.CellType, cell),
        ghost_mode=GHOSTS,
    )
    return SectionMesh(mesh, tag_walls(mesh, low, high), dict(WALL_TAGS), frozenset(WALL_TAGS))


def tag_walls(mesh, low, high):
    """Return the tags of the walls of a box."""
    dim = mesh.topology.dim
    mesh.topology.create_connectivity(dim - 1, dim)
    axes = {"left": 0, "right": 0, "base": dim - 1, "surface": dim - 1}
    if dim == 3:
        axes |= {"front": 1, "back": 1}
    index, value = [], []
    for name, axis in axes.items():
        at = (low if name in ("left", "base", "front") else high)[axis]
        slack = NEAR * (high - low)[axis]
        facets = dmesh.locate_entities_boundary(
            mesh, dim - 1, lambda x, axis=axis, at=at, slack=slack: np.abs(x[axis] - at) <= slack
        )
        index.append(facets)
        value.append(np.full(len(facets), WALL_TAGS[name], np.int32))
    index, value = np.concatenate(index), np.concatenate(value)
    order = np.argsort(index)
    return dmesh.meshtags(mesh, dim - 1, index[order], value[order])

"""Local refinement of triangle meshes by newest-vertex bisection.

Column 0 of the cells is the newest corner; the edge opposite is the next to be cut. That keeps the
angles of all descendants of a triangle in a small set (Mitchell 1988, https://doi.org/10.1145/50063.214337).
"""

from dataclasses import fields, replace

import numpy as np
from mpi4py import MPI

from meshes.arrays import Arrays, arrays_of, assembled, nothing


def refined_mesh(section, marked):
    """Return the mesh with the marked triangles in four, and neighbours cut so that edges meet.

    Args:
        section: `SectionMesh` of triangles.
        marked: whether to split a cell, shape (cells,), bool; ghosts at the end may be left out.
    """
    marked = np.asarray(marked, dtype=bool)[: section.mesh.topology.index_map(2).size_local]
    chosen = np.concatenate(section.mesh.comm.allgather(marked))
    return _dealt(_bisected(_whole(section), chosen), section)


def adapted_mesh(base_section, size_wanted, levels):
    """Return a base mesh refined where smaller cells are wanted; begun anew, it coarsens too.

    A pass splits the cells whose size, the square root of twice the area, is above the wanted one;
    no cell becomes smaller than its ancestor in the base mesh divided by ``2**levels``.

    Args:
        base_section: `SectionMesh` of triangles.
        size_wanted: maps centres, shape (n, 2), m, to sizes, shape (n,), m. Every rank asks for the
            same centres, those of the whole mesh, and the least answer of all ranks counts.
        levels: greatest number of passes.
    """
    arrays = _whole(base_section)
    for _ in range(levels):
        corners = arrays.x[arrays.cells]
        wanted = np.array(size_wanted(corners.mean(axis=1)), dtype=float)
        base_section.mesh.comm.Allreduce(MPI.IN_PLACE, wanted, op=MPI.MIN)
        a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        chosen = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) > wanted**2
        if not chosen.any():
            break
        arrays = _bisected(arrays, chosen)
    return _dealt(arrays, base_section)


def _whole(section):
    """Return the `Arrays` of all ranks together, each cell beginning opposite its longest edge."""
    parts = section.mesh.comm.allgather(arrays_of(section))
    whole = Arrays(*(np.concatenate([getattr(p, f.name) for p in parts]) for f in fields(Arrays)))
    corners = whole.x[whole.cells]
    edges = np.roll(corners, -1, axis=1) - np.roll(corners, 1, axis=1)
    first = np.argmax(np.round(np.log2((edges**2).sum(axis=2)), 9), axis=1)  # 9: ties are ties
    turned = (first[:, None] + np.arange(3)) % 3
    return replace(whole, cells=np.take_along_axis(whole.cells, turned, axis=1))


def _dealt(arrays, like):
    """Return the `SectionMesh` of arrays that every rank holds whole."""
    comm, with_regions = like.mesh.comm, like.regions is not None
    here = nothing() if comm.rank else arrays
    return assembled(here, like.wall_tags, like.flat, comm, with_regions)


def _bisected(arrays, chosen):
    """Return the arrays with all edges of the chosen cells cut, and whatever else has to be."""
    x, cells = arrays.x, arrays.cells
    keys, edges = np.unique(_keys(cells[:, [1, 2, 0]], cells[:, [2, 0, 1]]), return_inverse=True)
    edges = edges.reshape(-1, 3)  # column i is opposite corner i
    cut = np.zeros(len(keys), dtype=bool)
    cut[edges[chosen]] = True
    open_cells = edges
    while len(open_cells):
        open_cells = open_cells[~cut[open_cells[:, 0]]]
        hit = cut[open_cells[:, 1]] | cut[open_cells[:, 2]]
        if not hit.any():
            break
        cut[open_cells[hit, 0]] = True
    middle = np.cumsum(cut) - 1 + len(x)
    ends = np.column_stack([keys[cut] >> 32, keys[cut] & 0xFFFFFFFF])
    new_cells, parent = _children(cells, cut[edges], middle[edges])
    wall = np.searchsorted(keys, _keys(*arrays.walls.T))
    whole, halved = ~cut[wall], cut[wall]
    halves = [np.column_stack([arrays.walls[halved, i], middle[wall[halved]]]) for i in (0, 1)]
    return Arrays(
        x=np.concatenate([x, x[ends].mean(axis=1)]),
        cells=new_cells,
        regions=arrays.regions[parent],
        walls=np.concatenate([arrays.walls[whole], *halves]),
        tags=np.concatenate([arrays.tags[rows] for rows in (whole, halved, halved)]),
    )


def _keys(a, b):
    """Return one integer for every edge between nodes, whichever comes first."""
    return (np.minimum(a, b) << 32) | np.maximum(a, b)


def _children(cells, cut, middle):
    """Return the cells after the cuts, newest corner first, and the row each comes from.

    Args:
        cells: shape (n, 3).
        cut: whether the edge opposite each corner is cut, shape (n, 3); the first if any.
        middle: node in the middle of that edge, shape (n, 3).
    """
    (a, b, c), (m, mb, mc) = cells.T, middle.T
    once, at_b, at_c = cut.T
    parts = [
        (~once, (a, b, c)),
        (once & ~at_c, (m, a, b)),
        (once & at_c, (mc, m, a)),
        (once & at_c, (mc, b, m)),
        (once & ~at_b, (m, c, a)),
        (once & at_b, (mb, m, c)),
        (once & at_b, (mb, a, m)),
    ]
    rows = [np.flatnonzero(where) for where, _ in parts]
    new = [
        np.column_stack([node[row] for node in nodes])
        for row, (_, nodes) in zip(rows, parts, strict=True)
    ]
    return np.concatenate(new), np.concatenate(rows)

"""A mesh as plain arrays, from which a finer, split or dealt one is assembled."""

from dataclasses import dataclass

import numpy as np
from dolfinx import cpp
from dolfinx import mesh as dmesh
from dolfinx.graph import create_adjacencylist
from mpi4py import MPI

from meshes.box import GHOSTS
from meshes.data import CORNERS, SectionMesh

DIM = {"triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 3}
ENDS = {"triangle": 2, "quadrilateral": 2, "tetrahedron": 3, "hexahedron": 4}  # of a facet


@dataclass(frozen=True, eq=False)
class Arrays:
    """What a rank holds of a mesh; nodes are numbered through all ranks.

    Attributes:
        x: nodes of this rank, shape (n, dim), m; the first follows the last of the rank before.
        cells: nodes of every cell, shape (cells, corners), int64.
        regions: region of every cell, shape (cells,), int32.
        walls: nodes of every wall facet, shape (facets, ends), int64.
        tags: tag of every wall facet, shape (facets,), int32.
    """

    x: np.ndarray
    cells: np.ndarray
    regions: np.ndarray
    walls: np.ndarray
    tags: np.ndarray


def nothing(cell="triangle"):
    """Return the `Arrays` of a rank that holds no cell."""
    return Arrays(
        x=np.empty((0, DIM[cell])),
        cells=np.empty((0, CORNERS[cell]), dtype=np.int64),
        regions=np.empty(0, dtype=np.int32),
        walls=np.empty((0, ENDS[cell]), dtype=np.int64),
        tags=np.empty(0, dtype=np.int32),
    )


def arrays_of(section):
    """Return the `Arrays` of a `SectionMesh`, without ghosts."""
    mesh, dim = section.mesh, section.dim
    numbering = mesh.geometry.index_map()
    nodes = numbering.local_to_global(
        np.arange(numbering.size_local + numbering.num_ghosts, dtype=np.int32)
    )
    owned = section.owned
    facets, tags = section.facet_tags.indices, section.facet_tags.values
    here = facets < mesh.topology.index_map(dim - 1).size_local
    for pair in ((dim - 1, dim), (dim, dim - 1), (dim - 1, 0), (dim, 0)):
        mesh.topology.create_connectivity(*pair)
    ends = cpp.mesh.entities_to_geometry(mesh._mesh, dim - 1, facets[here], False)
    no_regions = np.zeros(owned, dtype=np.int32)
    return Arrays(
        x=mesh.geometry.x[: numbering.size_local, :dim].copy(),
        cells=nodes[section.corner_vertices[:owned]],
        regions=no_regions if section.regions is None else section.regions[:owned],
        walls=nodes[ends].reshape(-1, ENDS[section.cell]),
        tags=tags[here],
    )


def assembled(arrays, wall_tags, flat, comm, with_regions=True, cell="triangle"):
    """Return the `SectionMesh` of what the ranks hold; the cells are dealt out anew.

    Args:
        arrays: `Arrays` of this rank, or `nothing`; one rank may have all.
        wall_tags: wall name to tag.
        flat: walls that are straight and along an axis.
        comm: MPI communicator.
        with_regions: whether the cells have regions.
        cell: name of the cells.
    """
    dim, kind = DIM[cell], getattr(dmesh.CellType, cell)
    make = dmesh.create_unit_square if dim == 2 else dmesh.create_unit_cube
    domain = make(MPI.COMM_SELF, *[1] * dim, kind).ufl_domain()  # straight cells
    mesh = dmesh.create_mesh(comm, arrays.cells, arrays.x, domain, ghost_mode=GHOSTS)
    mesh.topology.create_connectivity(dim - 1, dim)
    facets, tags = cpp.io.distribute_entity_data(mesh._mesh, dim - 1, arrays.walls, arrays.tags)
    facet_tags = dmesh.meshtags_from_entities(mesh, dim - 1, create_adjacencylist(facets), tags)
    regions = None
    if with_regions:
        regions = np.concatenate(comm.allgather(arrays.regions))[mesh.topology.original_cell_index]
    return SectionMesh(mesh, facet_tags, wall_tags, flat, regions, arrays)

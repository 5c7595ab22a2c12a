"""A triangle mesh as plain arrays, from which a finer or split one is assembled."""

from dataclasses import dataclass

import numpy as np
from dolfinx import cpp
from dolfinx import mesh as dmesh
from dolfinx.graph import create_adjacencylist
from mpi4py import MPI

from meshes.box import GHOSTS
from meshes.data import SectionMesh


@dataclass(frozen=True, eq=False)
class Arrays:
    """What a rank holds of a triangle mesh; nodes are numbered through all ranks.

    Attributes:
        x: nodes of this rank, shape (n, 2), m; the first follows the last of the rank before.
        cells: nodes of every cell, shape (cells, 3), int64.
        regions: region of every cell, shape (cells,), int32.
        walls: nodes of every wall facet, shape (facets, 2), int64.
        tags: tag of every wall facet, shape (facets,), int32.
    """

    x: np.ndarray
    cells: np.ndarray
    regions: np.ndarray
    walls: np.ndarray
    tags: np.ndarray


NOTHING = Arrays(
    x=np.empty((0, 2)),
    cells=np.empty((0, 3), dtype=np.int64),
    regions=np.empty(0, dtype=np.int32),
    walls=np.empty((0, 2), dtype=np.int64),
    tags=np.empty(0, dtype=np.int32),
)


def arrays_of(section):
    """Return the `Arrays` of a `SectionMesh` of triangles, without ghosts."""
    mesh = section.mesh
    numbering = mesh.geometry.index_map()
    nodes = numbering.local_to_global(
        np.arange(numbering.size_local + numbering.num_ghosts, dtype=np.int32)
    )
    owned = mesh.topology.index_map(2).size_local
    facets, tags = section.facet_tags.indices, section.facet_tags.values
    here = facets < mesh.topology.index_map(1).size_local
    for pair in ((1, 2), (2, 1), (1, 0), (2, 0)):
        mesh.topology.create_connectivity(*pair)
    ends = cpp.mesh.entities_to_geometry(mesh._mesh, 1, facets[here], False)
    no_regions = np.zeros(owned, dtype=np.int32)
    return Arrays(
        x=mesh.geometry.x[: numbering.size_local, :2].copy(),
        cells=nodes[section.corner_vertices[:owned]],
        regions=no_regions if section.regions is None else section.regions[:owned],
        walls=nodes[ends].reshape(-1, 2),
        tags=tags[here],
    )


def assembled(arrays, wall_tags, flat, comm, with_regions=True):
    """Return the `SectionMesh` of what the ranks hold; the cells are dealt out anew.

    Args:
        arrays: `Arrays` of this rank, or `NOTHING`; one rank may have all.
        wall_tags: wall name to tag.
        flat: walls that are straight and along an axis.
        comm: MPI communicator.
        with_regions: whether the cells have regions.
    """
    domain = dmesh.create_unit_square(MPI.COMM_SELF, 1, 1).ufl_domain()  # straight triangles
    mesh = dmesh.create_mesh(comm, arrays.cells, arrays.x, domain, ghost_mode=GHOSTS)
    mesh.topology.create_connectivity(1, 2)
    facets, tags = cpp.io.distribute_entity_data(mesh._mesh, 1, arrays.walls, arrays.tags)
    facet_tags = dmesh.meshtags_from_entities(mesh, 1, create_adjacencylist(facets), tags)
    regions = None
    if with_regions:
        regions = np.concatenate(comm.allgather(arrays.regions))[mesh.topology.original_cell_index]
    return SectionMesh(mesh, facet_tags, wall_tags, flat, regions)

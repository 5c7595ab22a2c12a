"""A whole mesh of one rank, dealt out to several."""

from dataclasses import dataclass

import numpy as np
from mpi4py import MPI

from meshes.arrays import arrays_of, assembled, nothing
from meshes.data import SectionMesh
from meshes.noding import MeshingError


@dataclass(frozen=True, eq=False)
class Dealt:
    """The part of a whole mesh that a rank has, with ghosts.

    Attributes:
        section: the mesh dealt out.
        cells: cell of the whole mesh of every cell of this rank, shape (cells,).
        nodes: geometry node of the whole mesh of every node of this rank, shape (nodes,).
    """

    section: SectionMesh
    cells: np.ndarray
    nodes: np.ndarray


def dealt(section, comm):
    """Return a whole mesh, which every rank holds, dealt out to the ranks.

    Args:
        section: `SectionMesh` of one rank, the same on all.
        comm: MPI communicator.

    Raises:
        MeshingError: a rank would have no cell; on all ranks.
    """
    arrays = arrays_of(section) if comm.rank == 0 else nothing(section.cell)
    shared = assembled(
        arrays, section.wall_tags, section.flat, comm, section.regions is not None, section.cell
    )
    if comm.allreduce(shared.owned, op=MPI.MIN) == 0:
        raise MeshingError(
            f"{comm.size} ranks have too few cells, of {shared.cell_count}, to go round; take fewer"
        )
    cells = np.asarray(shared.mesh.topology.original_cell_index)
    nodes = np.empty(len(shared.mesh.geometry.x), np.int64)
    nodes[shared.corner_vertices] = section.corner_vertices[cells]
    return Dealt(shared, cells, nodes)

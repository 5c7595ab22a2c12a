"""The mesh of a section with names for its walls."""

from dataclasses import dataclass

import numpy as np
from dolfinx import mesh as dmesh
from mpi4py import MPI

CORNERS = {"triangle": 3, "quadrilateral": 4, "tetrahedron": 4, "hexahedron": 8}
FACETS = {"triangle": 3, "quadrilateral": 4, "tetrahedron": 4, "hexahedron": 6}


@dataclass(frozen=True, eq=False)
class SectionMesh:
    """A mesh and the names of its walls; arrays by cell hold the ghosts of this rank last.

    Attributes:
        mesh: triangles or quadrilaterals, m; in three dimensions tetrahedra or hexahedra.
        facet_tags: tag of every wall facet.
        wall_tags: wall name to tag.
        flat: walls that are straight and along an axis.
        regions: number of the region that mesh lines have each cell in, shape (cells,), int32: of
            a fitted mesh, or rock and air; None where no mesh lines part anything.
        made_from: `meshes.arrays.Arrays` that it was assembled from; None of a structured mesh.
    """

    mesh: dmesh.Mesh
    facet_tags: dmesh.MeshTagsMetaClass
    wall_tags: dict[str, int]
    flat: frozenset[str]
    regions: np.ndarray | None = None
    made_from: object | None = None

    @property
    def dim(self):
        """Dimensions, 2 or 3."""
        return self.mesh.topology.dim

    @property
    def cell(self):
        """Name of the cells: triangle, quadrilateral, tetrahedron or hexahedron."""
        return self.mesh.topology.cell_type.name

    @property
    def owned(self):
        """Number of cells of this rank without ghosts."""
        return self.mesh.topology.index_map(self.dim).size_local

    @property
    def corners(self):
        """Corner coordinates of every cell, shape (cells, corners, dim), m; a copy."""
        return self.mesh.geometry.x[:, : self.dim][self.corner_vertices]

    @property
    def corner_vertices(self):
        """Geometry nodes of every cell, shape (cells, corners), int32."""
        return self.mesh.geometry.dofmap.array.reshape(-1, CORNERS[self.cell])

    @property
    def areas(self):
        """Area of every cell, or its volume in three dimensions, shape (cells,), m^dim.

        Hexahedra count as parallelepipeds.
        """
        corners = self.corners
        if self.cell == "quadrilateral":
            a, b = corners[:, 3] - corners[:, 0], corners[:, 2] - corners[:, 1]  # the diagonals
            return 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
        axes = {"triangle": (1, 2), "tetrahedron": (1, 2, 3), "hexahedron": (1, 2, 4)}[self.cell]
        share = {"triangle": 1 / 2, "tetrahedron": 1 / 6, "hexahedron": 1.0}[self.cell]
        edges = corners[:, list(axes)] - corners[:, :1]
        return share * np.abs(np.linalg.det(edges))

    @property
    def area(self):
        """Area of the whole section, or its volume, on all ranks, m^dim; collective."""
        return self.mesh.comm.allreduce(float(self.areas[: self.owned].sum()), op=MPI.SUM)

    @property
    def cell_count(self):
        """Number of cells on all ranks."""
        return self.mesh.topology.index_map(self.dim).size_global

    @property
    def neighbours(self):
        """Cell across every facet of a cell, shape (cells, facets), int32; -1 on a wall.

        Facets come in the order of the reference cell: those of a triangle by opposite corner.
        """
        topology, dim = self.mesh.topology, self.dim
        topology.create_connectivity(dim, dim - 1)
        topology.create_connectivity(dim - 1, dim)
        facets = topology.connectivity(dim, dim - 1).array.reshape(-1, FACETS[self.cell])
        cells = topology.connectivity(dim - 1, dim)
        across = np.full((len(cells.offsets) - 1, 2), -1, dtype=np.int32)
        starts = cells.offsets
        across[:, 0] = cells.array[starts[:-1]]
        inner = np.flatnonzero(np.diff(starts) == 2)
        across[inner, 1] = cells.array[starts[inner] + 1]
        here = np.arange(len(facets))[:, None]
        pair = across[facets]
        return np.where(pair[..., 0] == here, pair[..., 1], pair[..., 0]).astype(np.int32)

"""The mesh of a section with names for its walls."""

from dataclasses import dataclass

import numpy as np
from dolfinx import mesh as dmesh


@dataclass(frozen=True, eq=False)
class SectionMesh:
    """A mesh and the names of its walls.

    Attributes:
        mesh: the triangles, m.
        facet_tags: tag of every wall facet.
        wall_tags: wall name to tag.
        flat: walls that are straight and along an axis.
    """

    mesh: dmesh.Mesh
    facet_tags: dmesh.MeshTagsMetaClass
    wall_tags: dict[str, int]
    flat: frozenset[str]

    @property
    def corners(self):
        """Corner coordinates of every triangle, shape (cells, 3, 2), m; a copy."""
        x = self.mesh.geometry.x[:, :2]
        return x[self.corner_vertices]

    @property
    def corner_vertices(self):
        """Geometry nodes of every triangle, shape (cells, 3), int32."""
        return self.mesh.geometry.dofmap.array.reshape(-1, 3)

    @property
    def areas(self):
        """Area of every triangle, shape (cells,), m^2."""
        a, b = self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0]
        return 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])

    @property
    def neighbours(self):
        """Cell across the facet opposite each corner, shape (cells, 3), int32; -1 on a wall."""
        topology = self.mesh.topology
        topology.create_connectivity(2, 1)
        topology.create_connectivity(1, 2)
        facets = topology.connectivity(2, 1).array.reshape(-1, 3)
        cells = topology.connectivity(1, 2)
        across = np.full((topology.index_map(1).size_local, 2), -1, dtype=np.int32)
        starts = cells.offsets
        across[:, 0] = cells.array[starts[:-1]]
        inner = np.flatnonzero(np.diff(starts) == 2)
        across[inner, 1] = cells.array[starts[inner] + 1]
        here = np.arange(len(facets))[:, None]
        pair = across[facets]
        return np.where(pair[..., 0] == here, pair[..., 1], pair[..., 0]).astype(np.int32)

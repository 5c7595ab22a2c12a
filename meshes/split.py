"""Barycentric splits."""

from dataclasses import replace

import numpy as np

from meshes.arrays import arrays_of, assembled


def barycentric_mesh(section):
    """Return the mesh with every triangle split at its centroid into three.

    On such a mesh quadratic velocity and discontinuous linear pressure are a stable pair
    (Alfeld or Clough-Tocher split).

    Args:
        section: `SectionMesh` of triangles.
    """
    arrays = arrays_of(section)
    comm = section.mesh.comm
    nodes, owned = len(arrays.x), len(arrays.cells)
    counts = np.array(comm.allgather((nodes, owned)))
    node_ends, cell_ends = np.cumsum(counts, axis=0).T
    before = np.concatenate([[0], cell_ends[:-1]])  # centroids of the ranks below

    def moved(node):
        return node + before[np.searchsorted(node_ends, node, side="right")]

    corners = moved(arrays.cells)
    centre = np.broadcast_to(
        (node_ends[comm.rank] + before[comm.rank] + np.arange(owned))[:, None], (owned, 1)
    )
    thirds = [np.hstack([corners[:, [a, b]], centre]) for a, b in ((0, 1), (1, 2), (2, 0))]
    centroids = section.corners[:owned].mean(axis=1)
    parts = replace(
        arrays,
        x=np.concatenate([arrays.x, centroids]),
        cells=np.stack(thirds, axis=1).reshape(-1, 3),
        regions=np.repeat(arrays.regions, 3),
        walls=moved(arrays.walls),
    )
    with_regions = section.regions is not None
    return assembled(parts, section.wall_tags, section.flat, comm, with_regions)

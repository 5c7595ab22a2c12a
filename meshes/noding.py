"""Lines made to meet, and cut where they do."""

from itertools import pairwise

import numpy as np
import shapely
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree


class MeshingError(Exception):
    """Lines between which no mesh can be made; the message says where."""


def joined_pieces(walls, lines, outline, snap):
    """Return the lines and walls cut at ends, corners and junctions, a list of (n, 2) arrays, m."""
    strings = _met(walls + lines, len(walls), snap)
    noded = shapely.get_parts(shapely.union_all(strings, grid_size=snap / 10))
    middles = shapely.line_interpolate_point(noded, 0.5, normalized=True)
    noded = noded[shapely.dwithin(middles, outline, 0.3 * snap)]
    exact = shapely.get_coordinates(strings)
    at = shapely.get_coordinates(noded)
    off, row = cKDTree(exact).query(at)
    at = np.where((off < snap / 5)[:, None], exact[row], at)
    for side in walls[:2]:
        at[np.abs(at[:, 0] - side[0, 0]) < snap, 0] = side[0, 0]
    noded = shapely.set_coordinates(noded, at)
    merged = shapely.get_parts(shapely.line_merge(shapely.multilinestrings(noded)))
    ends = np.vstack([shapely.get_coordinates(shapely.get_point(strings, end)) for end in (0, -1)])
    pieces = []
    for points in map(shapely.get_coordinates, merged):
        cuts = np.flatnonzero(np.isin(points @ [1, 1j], ends @ [1, 1j]))
        rows = np.unique(np.concatenate([[0], cuts, [len(points) - 1]]))
        pieces += [points[a : b + 1] for a, b in pairwise(rows)]
    return pieces


def cleaned(line):
    """Return a line without repeated points."""
    line = np.asarray(line, dtype=float).reshape(-1, 2)
    if not np.isfinite(line).all():
        raise MeshingError("a line has points that are not finite")
    keep = np.ones(len(line), dtype=bool)
    keep[1:] = (np.diff(line, axis=0) != 0).any(axis=1)
    return line[keep]


def _met(lines, walls, snap):
    """Return the lines with what is nearer than ``snap`` made to meet; the first ``walls`` stay.

    Near vertices become one, vertices near a wall move onto it, and a line gets every vertex that
    is near it, so that lines that run along each other share all their vertices.
    """
    line = np.repeat(np.arange(len(lines)), [len(points) for points in lines])
    points = np.vstack(lines)
    near = cKDTree(points).query_pairs(snap, output_type="ndarray")
    graph = coo_array((np.ones(len(near)), near.T), shape=(len(points),) * 2)
    label = connected_components(graph, directed=False)[1]
    points = points[np.unique(label, return_index=True)[1][label]]  # the first of each group
    start, vertex, along = _touching(points, line, snap)
    moved = (line[start] < walls) & (line[vertex] >= walls)
    start, vertex, along = start[moved], vertex[moved], along[moved, None]
    points[vertex] = points[start] + along * (points[start + 1] - points[start])
    start, vertex, along = _touching(points, line, snap)
    order = np.argsort(np.append(np.arange(len(line)), start + along), kind="stable")
    points = np.vstack([points, points[vertex]])[order]
    line = np.append(line, line[start])[order]
    groups = np.split(points, np.flatnonzero(np.diff(line)) + 1)
    kept = [part for part in map(cleaned, groups) if len(part) > 1]
    return np.array([shapely.LineString(part) for part in kept])


def _touching(points, line, snap):
    """Return segments (first rows), vertices (rows) near them but not at an end, and fractions."""
    start = np.flatnonzero((line[:-1] == line[1:]) & (points[:-1] != points[1:]).any(axis=1))
    segments = shapely.linestrings(np.stack([points[start], points[start + 1]], axis=1))
    vertex, hit = shapely.STRtree(segments).query(
        shapely.points(points), predicate="dwithin", distance=snap
    )
    start = start[hit]
    end = (points[vertex, None] == points[start[:, None] + [0, 1]]).all(axis=2).any(axis=1)
    start, vertex, hit = start[~end], vertex[~end], hit[~end]
    along = shapely.line_locate_point(
        segments[hit], shapely.points(points[vertex]), normalized=True
    )
    return start, vertex, np.clip(along, 1e-12, 1 - 1e-12)


def place(point):
    """Return a point as messages name it."""
    return f"({point[0]:.6g}, {point[1]:.6g})"

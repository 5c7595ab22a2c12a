"""Nodes and edges along lines that meet only at their ends."""

import numpy as np
import shapely
from scipy.spatial import cKDTree

from meshes.box import PLANE_WALLS, WALL_TAGS
from meshes.noding import MeshingError, place

CORNER = np.radians(30)  # sharper turns of a line are nodes
BEND = np.radians(45)  # greatest turn of a line along one edge where it is short
SLENDER = 0.25  # edges with another line nearer than this part of their length are halved
SHORTEST = 1 / 8  # of the edge length on lines: no edge is halved for its shape below this
FINEST = 1 / 32  # of the edge length on lines: the least that is asked for elsewhere
MOST_PASSES = 40


def edges_along(pieces, walls, lines, sizes, snap):
    """Return the nodes on all pieces, the edges between them, and their walls.

    Args:
        pieces: of lines and walls, cut where they meet.
        walls, lines: arrays (n, 2), m.
        sizes: edge length away from lines, m; on each line, shape (lines,), m; grading.
        snap: what is nearer than this meets, m.

    Returns:
        Nodes, shape (n, 2), m; edges, rows of nodes in order, shape (k, 2); tag of the wall that
        each edge is of, 0 inside, shape (k,), int32.
    """
    size, near, grading = sizes
    strings = np.array([shapely.LineString(piece) for piece in pieces])
    middles = shapely.line_interpolate_point(strings, 0.5, normalized=True)
    wanted = np.full(len(pieces), np.inf)  # on lines, the shortest of those that coincide
    for h in np.unique(near):
        of_size = [line for line, own in zip(lines, near, strict=True) if own == h]
        on = shapely.dwithin(middles, shapely.MultiLineString(of_size), 3 * snap)
        wanted[on] = np.minimum(wanted[on], h)
    curves = [Curve(piece) for piece in pieces]
    chains, least = [], near.min(initial=size)
    for h in np.unique(wanted):  # the fine ones first, the walls last
        here = [curve for curve, own in zip(curves, wanted, strict=True) if own == h]
        most = h if np.isfinite(h) else size
        h_at = SizeField(chains, (most, least, grading))
        for curve in here:
            curve.sample(most, h_at)
        chains += [curve.x for curve in here]
    shortest = SHORTEST * np.where(np.isfinite(wanted), wanted, least)
    for _ in range(MOST_PASSES):
        nodes, edges, of = _numbered(curves)
        bad = _bad_edges(nodes, edges, shortest[of], snap)
        if not bad.any():
            break
        for row in np.unique(of[bad]):
            curves[row].halve(bad[of == row])
    else:
        raise _too_near(nodes[edges[bad][0]])
    middles = shapely.points(np.vstack([c.at(0.5 * (c.t[:-1] + c.t[1:])) for c in curves]))
    tags = np.zeros(len(edges), dtype=np.int32)
    for name, wall in zip(PLANE_WALLS, walls, strict=True):
        tags[shapely.dwithin(middles, shapely.LineString(wall), 0.3 * snap)] = WALL_TAGS[name]
    order = np.argsort(-tags, kind="stable")  # of edges that coincide the one on a wall
    edges, first = np.unique(np.sort(edges[order], axis=1), axis=0, return_index=True)
    tags = tags[order][first]
    odd = np.bincount(edges[tags > 0].ravel(), minlength=len(nodes)) % 2 > 0
    if odd.any():
        raise MeshingError(f"a line cannot be told from a wall near {place(nodes[odd][0])}")
    return nodes, edges, tags


def _numbered(curves):
    """Return the nodes of all curves, their edges as rows of nodes, and the curve of each edge."""
    x = np.vstack([curve.x for curve in curves])
    curve = np.repeat(np.arange(len(curves)), [len(curve.t) for curve in curves])
    nodes, row = np.unique(x, axis=0, return_inverse=True)
    first = np.flatnonzero(curve[:-1] == curve[1:])
    return nodes, np.column_stack([row[first], row[first + 1]]), curve[first]


def _bad_edges(nodes, edges, shortest, snap):
    """Return which edges cross or lie on another, or are long for the gap to another.

    Args:
        nodes: shape (n, 2), m.
        edges: rows of nodes, shape (k, 2).
        shortest: least length of an edge that was halved for its shape, shape (k,), m.
        snap: edges below this that cross are beyond help, m.
    """
    ends = nodes[edges]
    segments = shapely.linestrings(ends)
    length = shapely.length(segments)
    one, other = shapely.STRtree(segments).query(
        segments, predicate="dwithin", distance=SLENDER * length
    )
    same = edges[one][:, :, None] == edges[other][:, None, :]
    shared = same.any(axis=2).sum(axis=1)
    apart = shared == 0
    bad = np.zeros(len(edges), dtype=bool)
    bad[one[apart & (length[one] > 1.5 * shortest[one])]] = True
    a, b = one[apart], other[apart]
    crossing = shapely.dwithin(segments[a], segments[b], 1e-3 * snap)
    bad[a[crossing]] = True
    hinged = np.flatnonzero(shared == 1)
    a, b = one[hinged], other[hinged]
    far = shapely.points(ends[b][~same[hinged].any(axis=1)])
    on = shapely.dwithin(far, segments[a], 1e-3 * snap)
    bad[a[on]] = True
    hopeless = bad & (length < snap)
    if hopeless.any():
        raise _too_near(ends[hopeless][0])
    return bad


def _too_near(ends):
    """Return the error for an edge, shape (2, 2), m, that cannot be parted from another."""
    where = place(ends.mean(axis=0))
    return MeshingError(f"lines cannot be told apart near {where}; join them, or raise snap")


class Curve:
    """A line from junction to junction with nodes on it.

    Attributes:
        points: vertices, shape (m, 2), m.
        s: arc length at every vertex, shape (m,), m.
        t: arc length at every node, shape (n,), m.
    """

    def __init__(self, points):
        self.points = points
        steps = np.diff(points, axis=0)
        self.steps = np.hypot(*steps.T)
        self.s = np.concatenate([[0], np.cumsum(self.steps)])
        self.turn = np.zeros(len(points))
        self.turn[1:-1] = _turn(steps[:-1], steps[1:])
        self.t = self.s[[0, -1]]

    @property
    def x(self):
        """Nodes, shape (n, 2), m."""
        return self.at(self.t)

    def at(self, s):
        """Return the points at arc lengths, shape (n, 2), m."""
        return np.column_stack([np.interp(s, self.s, column) for column in self.points.T])

    def corners(self, h):
        """Return the rows of vertices that become nodes where the edges are about ``h`` long."""
        keep = np.zeros(len(self.s), dtype=bool)
        keep[[0, -1]] = True
        rows = 1 + np.flatnonzero(self.turn[1:-1] > CORNER)
        here = self.at(self.s[rows])
        before = here - self.at(self.s[rows] - h / 4)
        after = self.at(self.s[rows] + h / 4) - here
        keep[rows[_turn(before, after) > CORNER]] = True  # not the steps of a fine stair
        straight = np.minimum(self.steps[:-1], self.steps[1:]) >= h / 2
        keep[1:-1] |= straight & (self.turn[1:-1] > 1e-6)
        return np.flatnonzero(keep)

    def sample(self, h, h_at):
        """Place nodes a distance ``h_at(x)``, at most about ``h``, apart."""
        rows = self.corners(h)
        fine = np.union1d(self.s, np.linspace(0, self.s[-1], 2 + int(3 * self.s[-1] / h)))
        rate = 1 / h_at(self.at(fine))
        steps = 0.5 * (rate[1:] + rate[:-1]) * np.diff(fine)
        count = np.concatenate([[0], np.cumsum(steps)])  # edges up to here
        marks = np.interp(self.s[rows], fine, count)
        turned = np.cumsum(self.turn)
        bend = turned[rows[1:] - 1] - turned[rows[:-1]]
        edges = np.maximum(np.rint(np.diff(marks)), np.clip(np.ceil(bend / BEND - 1e-9), 1, 8))
        edges = edges.astype(int)
        start = np.repeat(np.cumsum(edges) - edges, edges)
        part = (np.arange(edges.sum()) - start) / np.repeat(edges, edges)
        wanted = np.repeat(marks[:-1], edges) + part * np.repeat(np.diff(marks), edges)
        t = np.append(np.interp(wanted, count, fine), self.s[-1])
        t[np.append(part == 0, True)] = self.s[rows]
        self.t = self._on_vertices(t)

    def halve(self, chosen):
        """Put a node into the middle of the chosen edges, shape (n - 1,), bool."""
        middle = 0.5 * (self.t[:-1] + self.t[1:])
        spots = np.sort(np.concatenate([self.t, middle[chosen]]))
        self.t = self._on_vertices(spots)

    def _on_vertices(self, t):
        """Return arc lengths with those near a vertex moved onto it."""
        right = np.clip(np.searchsorted(self.s, t), 1, len(self.s) - 1)
        left = right - 1
        nearest = np.where(t - self.s[left] < self.s[right] - t, self.s[left], self.s[right])
        gap = np.diff(t)
        room = 0.3 * np.minimum(np.append(gap, np.inf), np.insert(gap, 0, np.inf))
        return np.where(np.abs(nearest - t) < room, nearest, t)


def _turn(a, b):
    """Return the angle between vectors, shape (n, 2) each."""
    cross, dot = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1)
    return np.abs(np.arctan2(cross, dot))


class SizeField:
    """Edge length that grows with the distance from lines; called with points (n, 2), m."""

    def __init__(self, chains, sizes):
        self.size, near, self.grading = sizes
        self.least, self.tree = FINEST * near, None
        if len(chains):
            ends = np.vstack([np.hstack([x[:-1], x[1:]]) for x in chains])
            x = np.vstack([ends[:, :2], ends[:, 2:], 0.5 * (ends[:, :2] + ends[:, 2:])])
            self.length = np.tile(np.hypot(*(ends[:, 2:] - ends[:, :2]).T), 3)
            self.tree = cKDTree(x)

    def __call__(self, x):
        """Return the edge length, shape (n,), m."""
        if self.tree is None:
            return np.full(len(x), float(self.size))
        far, row = self.tree.query(x, k=min(8, len(self.length)))
        wanted = self.length[row] + self.grading * far
        return np.clip(wanted.reshape(len(x), -1).min(axis=1), self.least, self.size)

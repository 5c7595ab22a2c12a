"""Triangle meshes of sections whose edges lie on given lines."""

import signal
import threading
from itertools import pairwise

import numpy as np
import shapely
from mpi4py import MPI
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, cKDTree

from meshes.box import PLANE_WALLS, WALL_TAGS
from meshes.split import NOTHING, Arrays, assembled

SNAP = 1e-6  # of the height: what is nearer than this meets
CORNER = np.radians(30)  # sharper turns of a line are nodes
BEND = np.radians(45)  # greatest turn of a line along one edge where it is short
SLENDER = 0.25  # edges with another line nearer than this part of their length are halved
SHORTEST = 1 / 8  # of the edge length on lines: no edge is halved for its shape below this
FINEST = 1 / 32  # of the edge length on lines: the least that is asked for elsewhere
MOST_PASSES = 40
FLAT = 1e-9  # area per squared edges of a cell that is none
GMSH = {
    "General.Terminal": 0,
    "General.Verbosity": 0,
    "Mesh.Algorithm": 6,  # frontal Delaunay
    "Mesh.MeshSizeExtendFromBoundary": 0,
    "Mesh.MeshSizeFromPoints": 0,
}


class MeshingError(Exception):
    """Lines between which no mesh can be made; the message says where."""


def fitted_mesh(surface, base, lines, size, near=None, grading=0.3, snap=None):
    """Return a mesh of a section with edges along all lines.

    Lines may end on walls, on each other or inside, cross, close and coincide in part; what lies
    outside of the section is cut off. Corners, ends and junctions become nodes, and so do corners
    between long straight pieces; the other nodes lie on the lines about ``near`` apart, less where
    lines come close. A wall is meshed at ``size`` unless it is among the lines too.

    Args:
        surface: top line, shape (n, 2), x ascending, m.
        base: bottom line over the same x range, shape (m, 2), m.
        lines: polylines, each of shape (k, 2), m; the first point of a closed one is its last too.
        size: edge length away from the lines, m.
        near: edge length on the lines, m; ``size`` if None.
        grading: growth of the edge length per distance from the lines.
        snap: what is nearer than this is made to meet, m; a millionth of the height if None, at
            most a hundredth of ``near``.

    Returns:
        (`SectionMesh`, points), with the regions between the lines numbered in
        ``SectionMesh.regions`` and a point inside each region, shape (regions, 2), m.

    Raises:
        MeshingError: on all ranks.
    """
    comm, near = MPI.COMM_WORLD, near or size
    surface, base = np.asarray(surface, dtype=float), np.asarray(base, dtype=float)
    snap = min(snap or SNAP * np.ptp(np.vstack([surface, base])[:, 1]), near / 100)
    result = None
    if comm.rank == 0:
        try:
            result = _arrays(surface, base, lines, (size, near, grading), snap)
        except (MeshingError, shapely.errors.GEOSException) as error:
            result = MeshingError(str(error))
    failed = comm.bcast(result if isinstance(result, MeshingError) else None)
    if failed:
        raise failed
    arrays, points = result or (NOTHING, None)
    level = {name for name, y in (("surface", surface), ("base", base)) if np.ptp(y[:, 1]) == 0}
    tags = {name: WALL_TAGS[name] for name in PLANE_WALLS}
    section = assembled(arrays, tags, frozenset({"left", "right"} | level), comm)
    return section, comm.bcast(points)


def _arrays(surface, base, lines, sizes, snap):
    """Return the `Arrays` of the whole mesh and the points in its regions."""
    ring = np.vstack([surface, base[::-1]])
    outline = shapely.Polygon(ring)
    if not (outline.is_valid and outline.area > 0):
        raise MeshingError(f"surface and base cross: {shapely.is_valid_reason(outline)}")
    sides = [np.vstack([base[end], surface[end]]) for end in (0, -1)]
    walls = [*sides, base, surface]
    given = [line for line in map(_cleaned, lines) if len(line) > 1]
    pieces = _pieces(walls, given, outline, snap)
    nodes, edges, tags = _edges(pieces, walls, given, sizes, snap)
    x, cells = _triangulated(nodes, edges, tags, sizes)
    return _labelled(x, cells, edges, tags)


def _cleaned(line):
    """Return a line without repeated points."""
    line = np.asarray(line, dtype=float).reshape(-1, 2)
    if not np.isfinite(line).all():
        raise MeshingError("a line has points that are not finite")
    keep = np.ones(len(line), dtype=bool)
    keep[1:] = (np.diff(line, axis=0) != 0).any(axis=1)
    return line[keep]


def _pieces(walls, lines, outline, snap):
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
    cleaned = [part for part in map(_cleaned, groups) if len(part) > 1]
    return np.array([shapely.LineString(part) for part in cleaned])


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


def _edges(pieces, walls, lines, sizes, snap):
    """Return the nodes on all pieces, the edges between them, and their walls.

    Returns:
        Nodes, shape (n, 2), m; edges, rows of nodes in order, shape (k, 2); tag of the wall that
        each edge is of, 0 inside, shape (k,), int32.
    """
    size, near, _ = sizes
    strings = np.array([shapely.LineString(piece) for piece in pieces])
    middles = shapely.line_interpolate_point(strings, 0.5, normalized=True)
    inner = np.zeros(len(pieces), dtype=bool)
    if lines:
        inner = shapely.dwithin(middles, shapely.MultiLineString(lines), 3 * snap)
    curves = [Curve(piece) for piece in pieces]
    on_lines = [curve for curve, chosen in zip(curves, inner, strict=True) if chosen]
    for curve in on_lines:
        curve.sample(near, lambda x: np.full(len(x), near))
    h_at = SizeField([curve.x for curve in on_lines], sizes)
    for curve, chosen in zip(curves, inner, strict=True):
        if not chosen:
            curve.sample(size, h_at)
    for _ in range(MOST_PASSES):
        nodes, edges, of = _numbered(curves)
        bad = _bad_edges(nodes, edges, SHORTEST * near, snap)
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
        raise MeshingError(f"a line cannot be told from a wall near {_place(nodes[odd][0])}")
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
        shortest: least length of an edge that was halved for its shape, m.
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
    bad[one[apart & (length[one] > 1.5 * shortest)]] = True
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


def _triangulated(nodes, edges, tags, sizes):
    """Return the nodes, the given ones first, and the cells that gmsh makes between edges."""
    import gmsh  # slow to load, and it takes the interrupt signal until finalize

    main = threading.current_thread() is threading.main_thread()
    handler = signal.getsignal(signal.SIGINT)
    try:
        gmsh.initialize([], False)
        return _meshed(gmsh, nodes, edges, tags, sizes)
    except MeshingError:
        raise
    except Exception as error:  # gmsh raises nothing narrower
        raise MeshingError(f"gmsh: {error}") from error
    finally:
        gmsh.finalize()
        if main:
            signal.signal(signal.SIGINT, handler)


def _meshed(gmsh, nodes, edges, tags, sizes):
    """Return what `_triangulated` does, in a gmsh that runs."""
    for name, value in GMSH.items():
        gmsh.option.setNumber(name, value)
    for row, (x, z) in enumerate(nodes.tolist(), start=1):
        gmsh.model.geo.addPoint(x, z, 0, tag=row)
    for row, (a, b) in enumerate((edges + 1).tolist(), start=1):
        gmsh.model.geo.addLine(a, b, row)
    gmsh.model.geo.addCurveLoop((1 + np.flatnonzero(tags)).tolist(), 1, reorient=True)
    gmsh.model.geo.addPlaneSurface([1], 1)
    gmsh.model.geo.synchronize()
    if not tags.all():
        gmsh.model.mesh.embed(1, (1 + np.flatnonzero(tags == 0)).tolist(), 2, 1)
    for row in range(1, len(edges) + 1):
        gmsh.model.mesh.setTransfiniteCurve(row, 2)
    gmsh.model.mesh.field.setAsBackgroundMesh(_field(gmsh, nodes, edges, sizes))
    gmsh.model.mesh.generate(2)
    tags, x, _ = gmsh.model.mesh.getNodes()
    cells = gmsh.model.mesh.getElementsByType(2)[1].reshape(-1, 3).astype(np.int64)
    row_of = np.zeros(int(tags.max()) + 1, dtype=np.int64)
    row_of[tags] = np.arange(len(tags))
    return x.reshape(-1, 3)[:, :2].copy(), row_of[cells]


def _field(gmsh, nodes, edges, sizes):
    """Return the gmsh field of edge lengths: linear between the nodes and a grid."""
    size = sizes[0]
    h_at = SizeField(nodes[edges], sizes)
    low, high = nodes.min(axis=0) - size, nodes.max(axis=0) + size
    axes = [np.linspace(a, b, 2 + int((b - a) / size)) for a, b in zip(low, high, strict=True)]
    x = np.vstack([nodes, np.stack(np.meshgrid(*axes), axis=-1).reshape(-1, 2)])
    h = h_at(x)
    corners = Delaunay(x).simplices
    flat = np.zeros((len(corners), 12))
    flat[:, :3], flat[:, 3:6], flat[:, 9:] = x[corners, 0], x[corners, 1], h[corners]
    view = gmsh.view.add("h")
    gmsh.view.addListData(view, "ST", len(corners), flat.ravel())
    field = gmsh.model.mesh.field.add("PostView")
    gmsh.model.mesh.field.setNumber(field, "ViewTag", view)
    return field


def _labelled(x, cells, edges, tags):
    """Return the `Arrays` of a mesh with its regions numbered, and a point in each region."""
    corners = x[cells]
    sides = np.roll(corners, -1, axis=1) - corners
    area = 0.5 * (sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    slender = np.abs(area) / (sides**2).sum(axis=(1, 2))
    if slender.min() < FLAT:
        where = corners[np.argmin(slender)].mean(axis=0)
        raise MeshingError(f"flat cells near {_place(where)}")
    ends = np.sort(np.stack([cells, np.roll(cells, -1, axis=1)], axis=2), axis=2).reshape(-1, 2)
    keys, key_of = np.unique(ends[:, 0] << 32 | ends[:, 1], return_inverse=True)
    line_keys = edges[:, 0] << 32 | edges[:, 1]
    lost = edges[~np.isin(line_keys, keys)]
    if len(lost):
        raise MeshingError(f"a line was lost near {_place(x[lost[0]].mean(axis=0))}")
    order = np.argsort(key_of, kind="stable")
    twin = np.flatnonzero(key_of[order[:-1]] == key_of[order[1:]])
    free = twin[~np.isin(keys[key_of[order[twin]]], line_keys)]
    pairs = order[free] // 3, order[free + 1] // 3
    graph = coo_array((np.ones(len(free)), pairs), shape=(len(cells),) * 2)
    count, region = connected_components(graph, directed=False)
    roundness = np.abs(area) / np.hypot(sides[..., 0], sides[..., 1]).sum(axis=1)
    best = np.lexsort((-roundness, region))
    points = corners.mean(axis=1)[best[np.searchsorted(region[best], np.arange(count))]]
    used, cells = np.unique(cells, return_inverse=True)
    wall = tags > 0
    walls = np.searchsorted(used, edges[wall])
    regions = region.astype(np.int32)
    return Arrays(x[used], cells.reshape(-1, 3), regions, walls, tags[wall]), points


def _too_near(ends):
    """Return the error for an edge, shape (2, 2), m, that cannot be parted from another."""
    where = _place(ends.mean(axis=0))
    return MeshingError(f"lines cannot be told apart near {where}; join them, or raise snap")


def _place(point):
    """Return a point as messages name it."""
    return f"({point[0]:.6g}, {point[1]:.6g})"

"""Drawn polygons as one exact arrangement of faces: gaps, overlaps and contacts.

All boundaries are cut where they meet, on a fine grid, and each face between them is given to one
polygon. Faces of no polygon are gaps, faces of several are overlaps; narrow ones are closed.
"""

from dataclasses import dataclass
from math import floor, log10

import numpy as np
import shapely

from restoration.geojson import place
from restoration.units import number
from restoration.words import counted, listed, quoted

MOST_FLAWS = 10  # gaps and overlaps that are named one by one
FINEST = 1e-6  # grid on which boundaries meet, part of the height


@dataclass(frozen=True, eq=False)
class Flaw:
    """A gap or an overlap.

    Attributes:
        gap: whether it is a gap.
        shape: shapely Polygon.
        patches: rows of the polygons that overlap; empty for a gap.
    """

    gap: bool
    shape: object
    patches: tuple[int, ...]

    @property
    def width(self):
        """Diameter of the greatest circle in it, m."""
        narrow = 2 * self.shape.area / self.shape.length
        radius = shapely.maximum_inscribed_circle(self.shape, tolerance=0.02 * narrow)
        return max(2 * radius.length, narrow)

    @property
    def at(self):
        """A point in it, as messages name it."""
        return place(self.shape.representative_point().coords[0])


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Faces that fill a section without gap or overlap, where no flaws are left.

    Attributes:
        faces: shapely Polygons, shape (n,).
        owner: row of the polygon each face belongs to, shape (n,).
        flaws: gaps and overlaps that are too wide to be closed, the greatest first.
        closed: those that were closed.
        whole: union of all faces.
        grid: spacing on which boundaries were cut, m.
    """

    faces: np.ndarray
    owner: np.ndarray
    flaws: list
    closed: list
    whole: object
    grid: float


def arrange(shapes, tolerance):
    """Return the `Arrangement` of polygons.

    Args:
        shapes: valid shapely polygons, m; shape (n,).
        tolerance: gaps and overlaps narrower than this are closed, m.
    """
    shapes = np.asarray(shapes, dtype=object)
    x0, z0, x1, z1 = shapely.total_bounds(shapes)
    grid = 10.0 ** floor(log10(FINEST * max(z1 - z0, 1e-3 * (x1 - x0), 1e-6)))
    tolerance = max(tolerance, 10 * grid)
    tree = shapely.STRtree(shapes)
    notches = _notches(shapes, tree, tolerance, grid)
    borders = shapely.boundary(np.append(shapes, notches))
    noded = shapely.union_all(borders, grid_size=grid)
    faces = shapely.get_parts(shapely.polygonize([noded]))
    points = shapely.point_on_surface(faces)
    face, patch = _within(points, shapes, tree)
    count = np.bincount(face, minlength=len(faces))
    owner = np.full(len(faces), -1)
    owner[face[::-1]] = patch[::-1]  # of several the first
    empty = count == 0
    flaws = _flaws(faces, empty, face, patch, count)
    wide = _wider(flaws, tolerance)
    wide_ones = set(map(id, wide))
    closed = [flaw for flaw in _wider(flaws, 4 * grid) if id(flaw) not in wide_ones]
    if empty.any():
        owner[empty] = _nearest(points[empty], shapes)
    return Arrangement(
        faces,
        owner,
        sorted(wide, key=lambda flaw: -flaw.shape.area),
        closed,
        shapely.coverage_union_all(faces),
        grid,
    )


def _notches(shapes, tree, tolerance, grid):
    """Return the narrow gaps between polygons that are open to the outside."""
    whole = shapely.union_all(shapes, grid_size=grid)
    parts = shapely.get_parts(whole)
    filled = shapely.union_all([shapely.Polygon(part.exterior) for part in parts])
    sharp = {"join_style": "mitre", "mitre_limit": 20}
    wider = shapely.buffer(filled, 0.5 * tolerance, **sharp)
    closed = shapely.buffer(wider, -0.5 * tolerance, **sharp)
    notches = shapely.get_parts(shapely.difference(closed, filled))
    notches = notches[~shapely.is_empty(shapely.buffer(notches, -2 * grid))]
    near = [len(tree.query(notch, "dwithin", 2 * grid)) for notch in notches]
    return notches[np.array(near, dtype=int) > 1]


def _within(points, shapes, tree):
    """Return rows of points, ascending, and rows of the shapes each is in, ascending."""
    point, shape = tree.query(points)
    shapely.prepare(shapes)
    inside = shapely.intersects_xy(
        shapes[shape], shapely.get_x(points)[point], shapely.get_y(points)[point]
    )
    point, shape = point[inside], shape[inside]
    order = np.lexsort((shape, point))
    return point[order], shape[order]


def _nearest(points, shapes):
    """Return the row of the shape nearest to each point; by their edges, which are small boxes."""
    parts, shape = shapely.get_parts(shapes, return_index=True)
    rings, part = shapely.get_rings(parts, return_index=True)
    coords, ring = shapely.get_coordinates(rings, return_index=True)
    inside = ring[:-1] == ring[1:]
    edges = shapely.linestrings(np.stack([coords[:-1], coords[1:]], axis=1)[inside])
    nearest = shapely.STRtree(edges).query_nearest(points, all_matches=False)[1]
    return shape[part[ring[:-1][inside][nearest]]]


def _flaws(faces, empty, face, patch, count):
    """Return a `Flaw` for every connected set of empty faces, and of faces with the same owners."""
    groups = {}
    for row in np.flatnonzero(count > 1):
        start, stop = np.searchsorted(face, [row, row + 1])
        groups.setdefault(tuple(patch[start:stop].tolist()), []).append(row)
    flaws = [Flaw(True, part, ()) for part in _connected(faces[empty])]
    for owners, rows in groups.items():
        flaws += [Flaw(False, part, owners) for part in _connected(faces[rows])]
    return flaws


def _wider(flaws, width):
    """Return the flaws that hold a circle of a diameter, m."""
    shapes = np.array([flaw.shape for flaw in flaws], dtype=object)
    left = ~shapely.is_empty(shapely.buffer(shapes, -0.5 * width))
    return [flaw for flaw, wide in zip(flaws, left, strict=True) if wide]


def _connected(faces):
    """Return the connected parts of faces."""
    return shapely.get_parts(shapely.coverage_union_all(faces)) if len(faces) else []


def contacts(arrangement, unit, shortest):
    """Return the lines between faces of different units.

    Args:
        arrangement: an `Arrangement` without flaws.
        unit: row of the unit of every face, shape (faces,).
        shortest: pieces shorter than this are left out, m.

    Returns:
        {(lower row, higher row): list of points (n, 2), m}.
    """
    rings, face = shapely.get_rings(arrangement.faces, return_index=True)
    coords, ring = shapely.get_coordinates(rings, return_index=True)
    nodes, node = np.unique(coords, axis=0, return_inverse=True)
    inside = ring[:-1] == ring[1:]
    ends = np.sort(np.column_stack([node[:-1], node[1:]])[inside], axis=1)
    sides = unit[face[ring[:-1]]][inside]
    order = np.lexsort((ends[:, 1], ends[:, 0]))
    ends, sides = ends[order], sides[order]
    twin = np.flatnonzero((ends[:-1] == ends[1:]).all(axis=1) & (sides[:-1] != sides[1:]))
    pairs = np.sort(np.column_stack([sides[twin], sides[twin + 1]]), axis=1)
    names, which = np.unique(pairs, axis=0, return_inverse=True)
    found = {}
    for pair, chosen in zip(names, grouped(which, len(names)), strict=True):
        merged = shapely.line_merge(shapely.multilinestrings(nodes[ends[twin[chosen]]]))
        pieces = [part for part in shapely.get_parts(merged) if part.length > shortest]
        found[tuple(pair.tolist())] = [shapely.get_coordinates(piece) for piece in pieces]
    return found


def grouped(which, count):
    """Return the rows of every group, a list of ``count`` arrays, from the group of every row."""
    sizes = np.bincount(which, minlength=count)
    return np.split(np.argsort(which, kind="stable"), np.cumsum(sizes)[:-1])[:count]


class UnitAt:
    """Maps points to units; a point in no polygon belongs to the nearest one.

    Args:
        shapes: shapely Polygons that do not overlap, shape (n,).
        rows: unit of each, shape (n,).
    """

    def __init__(self, shapes, rows):
        self.shapes, self.rows = shapes, np.asarray(rows, dtype=np.int16)
        self.bounds = shapely.bounds(shapes)
        self.tree = shapely.STRtree(shapes)
        shapely.prepare(shapes)

    def __call__(self, points):
        """Return the unit of points (n, 2), m, as rows, shape (n,), int16."""
        points = np.asarray(points, dtype=float).reshape(-1, 2)
        order = np.argsort(points[:, 0], kind="stable")
        x, z = points[order].T
        found = np.full(len(points), -1, dtype=np.int16)
        starts = np.searchsorted(x, self.bounds[:, 0], "left")
        stops = np.searchsorted(x, self.bounds[:, 2], "right")
        for shape, row, (_, low, _, high), start, stop in zip(
            self.shapes, self.rows, self.bounds, starts, stops, strict=True
        ):
            span = slice(start, stop)
            near = start + np.flatnonzero((found[span] < 0) & (z[span] >= low) & (z[span] <= high))
            found[near[shapely.intersects_xy(shape, x[near], z[near])]] = row
        lost = np.flatnonzero(found < 0)
        if len(lost):
            beyond = shapely.points(x[lost], z[lost])
            pairs = self.tree.query_nearest(beyond, all_matches=False)
            found[lost[pairs[0]]] = self.rows[pairs[1]]
        result = np.empty_like(found)
        result[order] = found
        return result


def tell_flaws(drawing, arrangement, tolerance):
    """Take down gaps and overlaps in a `Drawing`, the greatest first, and the slivers closed."""
    told = 0
    for flaw in arrangement.flaws:
        patches = [drawing.patches[row] for row in flaw.patches]
        if not flaw.gap and len({patch.unit for patch in patches}) == 1:
            names = listed([patch.entry for patch in patches], "and")
            unit = quoted(patches[0].unit)
            drawing.notes.append(f"{names} overlap near {flaw.at}; both are {unit}")
            continue
        told += 1
        if told <= MOST_FLAWS:
            drawing.refuse(*_flaw_message(drawing, flaw, patches, tolerance))
    if told > MOST_FLAWS:
        more = told - MOST_FLAWS
        what = "gap or overlap" if more == 1 else "gaps or overlaps"
        drawing.refuse("", f"and {more} smaller {what}")
    if arrangement.closed:
        what = f"{counted(len(arrangement.closed), 'sliver')} between polygons"
        total = area_text(sum(flaw.shape.area for flaw in arrangement.closed))
        narrow = f"narrower than {number(tolerance, 2)} m"
        drawing.notes.append(f"{what}, {narrow}, closed ({total})")


def _flaw_message(drawing, flaw, patches, tolerance):
    """Return the entry and the message of a gap or an overlap."""
    if flaw.gap:
        patches = [patch for patch in drawing.patches if patch.shape.dwithin(flaw.shape, tolerance)]
    named = [f"{patch.entry} {quoted(patch.unit)}" for patch in patches]
    width = f"{number(flaw.width, 2)} m"
    size = f"near {flaw.at} ({area_text(flaw.shape.area)}, up to {width} wide)"
    enough = number(1.1 * flaw.width, 2)
    fill = f" (tolerance: {enough} m would close it)" if flaw.width < 20 * tolerance else ""
    if flaw.gap and len(patches) > 1:
        return "", f"gap {size} between {listed(named, 'and')}: extend one of them over it{fill}"
    if flaw.gap:
        return "", f"gap {size} in {listed(named)}: draw a polygon that fills it{fill}"
    if patches[0].shape.equals(patches[1].shape):
        message = f"{quoted(patches[1].unit)} is the same polygon as {named[0]}: delete one of them"
        return patches[1].entry, message
    message = f"overlap {size} of {listed(named, 'and')}: cut one of them there{fill}"
    return patches[-1].entry, message


def tell_pieces(drawing, pieces):
    """Take down in a `Drawing` that its polygons, in several pieces, make no single section."""
    pieces = sorted(pieces, key=lambda piece: -piece.area)
    for piece in pieces[1 : MOST_FLAWS + 1]:
        off = min(piece.distance(other) for other in pieces if other is not piece)
        away = f"{number(off, 2)} m from the rest" if off else "touching the rest at a point only"
        near = place(piece.representative_point().coords[0])
        drawing.refuse(
            "",
            f"is not in one piece: {area_text(piece.area)} near {near} lie apart, {away}; fill "
            "the space between with polygons, or keep one section in a file",
        )


def area_text(area):
    """Return an area, m^2, as messages give it."""
    return f"{number(area / 1e6)} km^2" if area >= 1e4 else f"{number(area)} m^2"

"""Bands of rock along faults: where they are as they move, and what a mesh follows of them.

The outline of a band in the section is a closed `scene.Line` of the kind ``edge`` with the name of
its fault. It moves with the rock; where it lies on a wall it stays there. Where bands cross, the
later one of a scene is on top.
"""

import numpy as np
import shapely
from scipy.spatial import cKDTree

from restoration.lines import spaced

EXTENSION = 6.0  # widths by which a line that ends at a wall goes on beyond it
MITRE = 2.0  # half widths to which a band goes at sharp bends
EDGE = 0.4  # widths: the most that an edge of a cell along a band may be
NEAR = 0.2  # of that: what is nearer to a band becomes one with it
RAY = 4.0  # times that: how far a line that was cut short looks for the band ahead
CORNER = np.radians(30)  # sharper turns of the edge of a band are corners


def section_of(outline):
    """Return the polygon of an outline."""
    return shapely.Polygon(np.vstack([outline.surface, outline.base[::-1]]))


def widened(points, width, section):
    """Return the band along a line, which goes on beyond the walls that the line reaches.

    Args:
        points: of the line, shape (n, 2), m.
        width: of the band, m.
        section: polygon.
    """
    for _ in range(2):  # both ends
        step = points[-1] - points[-2]
        step *= width / np.hypot(*step)
        if not section.contains(shapely.Point(points[-1] + step)):
            points = np.vstack([points, points[-1] + EXTENSION * step])
        points = points[::-1]
    line = shapely.LineString(points)
    return line.buffer(width / 2, cap_style="flat", join_style="mitre", mitre_limit=MITRE)


def rings(area):
    """Return the closed outlines of polygons, outer and inner, a list of arrays (n, 2), m."""
    parts = [part for part in shapely.get_parts(area) if part.geom_type == "Polygon"]
    return [
        shapely.get_coordinates(ring) for part in parts for ring in (part.exterior, *part.interiors)
    ]


def areas(lines):
    """Return the polygons of the bands, by the name of the fault, in the order of the lines."""
    found = {}
    for line in lines:
        if line.kind == "edge":
            ring = shapely.make_valid(shapely.Polygon(line.points), method="structure")
            before = found.get(line.name)
            # an inner ring takes away what the outer one holds
            found[line.name] = ring if before is None else before.symmetric_difference(ring)
    return {name: area for name, area in found.items() if area.area > 0}


def distance_to(area, spacing):
    """Return a function of points (n, 2) that gives their distances from the edge of a polygon, m.

    Those inside are negative.

    Args:
        area: polygon.
        spacing: of the vertices to which it is measured, m.
    """
    edges = cKDTree(np.concatenate([spaced(ring, spacing) for ring in rings(area)]))
    shapely.prepare(area)
    return lambda x: np.where(shapely.contains_xy(area, *x.T), -1, 1) * edges.query(x)[0]


def mesh_lines(lines, bands, section, near):
    """Return what a mesh follows: lines cut at the bands, and the edges of bands in the section.

    A line within a small part of an edge length of a band is cut there and led onto its edge, so
    that no slivers remain between the two; and so is an edge at the wall of the section.

    Args:
        lines: horizons and faults without a width, each of shape (n, 2), m.
        bands: polygon and width, m, of every band, the uppermost last.
        section: polygon.
        near: edge length wanted on lines, m.

    Returns:
        List of (points, edge length): that of a band is at most `EDGE` of its width, m.
    """
    found, above, around = [], shapely.Polygon(), shapely.Polygon()
    reach, target = 0.0, None
    for area, width in reversed(bands):
        size = min(near, EDGE * width)
        frame = section.exterior.buffer(NEAR * size), _Target(section, NEAR * size)
        for ring in rings(area):
            for edge in _cut(ring, *frame):
                found += [(piece, size) for piece in _cut(edge, around, target)]
        reach, above = max(reach, NEAR * size), above.union(area)
        around = around.union(area.buffer(NEAR * size, join_style="mitre", mitre_limit=MITRE))
        target = _Target(above, reach)
    for line in lines:
        found += [(piece, near) for piece in _cut(line, around, target)]
    return found


class _Target:
    """The edge of polygons, where lines end that are cut within ``reach`` of it, m."""

    def __init__(self, area, reach):
        self.line, self.reach = area.boundary, reach
        turns = []
        for ring in rings(area):
            step = np.diff(ring, axis=0)
            before = np.roll(step, 1, axis=0)
            cross = before[:, 0] * step[:, 1] - before[:, 1] * step[:, 0]
            turn = np.abs(np.arctan2(cross, (before * step).sum(axis=1)))
            turns.append(ring[:-1][turn > CORNER])
        self.corners = shapely.MultiPoint(np.vstack([*turns, np.empty((0, 2))]))

    def end(self, segment):
        """Return where a line that ends with a segment goes: ahead or beside it, or to a corner."""
        step = segment[1] - segment[0]
        step *= RAY * self.reach / (np.hypot(*step) or 1.0)
        hit = shapely.LineString([segment[1], segment[1] + step]).intersection(self.line)
        end = _nearest(self.line if hit.is_empty else hit, shapely.Point(segment[1]))
        if self.corners.is_empty or self.corners.distance(end) > self.reach:
            return shapely.get_coordinates(end)
        return shapely.get_coordinates(_nearest(self.corners, end))


def _nearest(shape, point):
    """Return the point of a shape that is nearest to another."""
    return shapely.get_point(shapely.shortest_line(shape, point), 0)


def _cut(points, mask, target):
    """Return the pieces of a line outside of a mask; where they are cut they go on to the target.

    Args:
        points: shape (n, 2), m.
        mask: polygon around the target.
        target: `_Target` of it.
    """
    line = shapely.LineString(points)
    if not line.intersects(mask):
        return [points]
    ends, pieces, reach = points[[0, -1]], [], target.reach
    parts = shapely.get_parts(shapely.line_merge(line.difference(mask)))
    for piece in parts[shapely.length(parts) > reach]:
        piece = shapely.get_coordinates(piece)
        for _ in range(2):
            if np.abs(piece[-1] - ends).max(axis=1).min() > 1e-6 * reach:
                piece = np.vstack([piece, target.end(piece[-2:])])
            piece = piece[::-1]
        pieces.append(piece)
    return pieces

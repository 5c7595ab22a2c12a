"""Welds: where a layer is thinner than what is resolved, so that nothing can restore it."""

from dataclasses import dataclass

import numpy as np
import shapely

from restoration.bands import section_of
from restoration.lines import surface_of
from restoration.scene import Outline

REACH = 0.1  # thicknesses: an end of a line this near to the frame meets it
MITRE = 1.5  # corners down to 84 degrees count as reached
SLIVER = 0.02  # thicknesses: narrower parts are rounding


@dataclass(frozen=True, eq=False)
class Welds:
    """Where layers are thinner than a thickness.

    Attributes:
        thickness: m.
        area: of all welds, m^2.
        share: of the section.
        by_rock: area of the welds of each rock by its name, m^2, and the share of that rock.
        shape: polygons of all welds.
    """

    thickness: float
    area: float
    share: float
    by_rock: dict
    shape: object

    def holds(self, points):
        """Return which of the points (n, 2), m, are in a weld or on its edge, bool (n,)."""
        if self.shape.is_empty:
            return np.zeros(len(points), bool)
        near = self.shape.buffer(SLIVER * self.thickness)
        shapely.prepare(near)
        return shapely.contains_xy(near, *np.asarray(points).T)


def welds(scene, lines, thickness, particles=None):
    """Return where the layers between lines are thinner than a thickness, as `Welds`.

    Of every layer what a disc of that width cannot reach is thin; corners count as reached (an
    opening with mitred joins). Neighbours of one rock are one layer, and bands of faults are thin
    by design: they are left out.

    Args:
        scene: `scene.Scene`.
        lines: `scene.Line`s at that moment.
        thickness: m.
        particles: `Particles` at that moment, which know the rocks; None where the rock is where
            the scene has it.
    """
    faces = _faces(scene, lines, thickness)
    rock = _rocks(scene, faces, particles)
    thin, by_rock = [], {}
    for row, name in enumerate(rock.name for rock in scene.rocks):
        layer = shapely.union_all(faces[rock == row])
        part = thin_part(layer, thickness)
        thin.append(part)
        share = part.area / layer.area if layer.area else 0.0
        by_rock[name] = {"area_m2": float(part.area), "share": float(share)}
    shape, whole = shapely.union_all(thin), float(shapely.area(faces).sum())
    area = float(sum(part.area for part in thin))
    return Welds(thickness, area, area / whole, by_rock, shape)


def thin_part(shape, thickness):
    """Return the parts of a shape that are thinner than a thickness, m."""
    if shape.is_empty:
        return shape
    bent = {"join_style": "mitre", "mitre_limit": MITRE}
    shape = shape.simplify(SLIVER / 2 * thickness)  # its finest folds decide nothing, and cost most
    opened = shape.buffer(-thickness / 2, **bent).buffer(thickness / 2 * (1 + 1e-6), **bent)
    left = shape.difference(opened)
    sliver = SLIVER * thickness
    return left.buffer(-sliver / 2).buffer(sliver / 2).intersection(shape)


def _faces(scene, lines, thickness):
    """Return the polygons into which lines and frame divide a section."""
    surface = surface_of(lines)
    frame = scene.outline if surface is None else Outline(surface.points, scene.outline.base)
    section = shapely.make_valid(section_of(frame))
    cuts = [section.boundary]
    for line in lines:
        if line.kind == "horizon":
            points = _to_frame(line.points, section.boundary, REACH * thickness)
            cuts.append(shapely.LineString(points))
    faces = shapely.get_parts(shapely.polygonize([shapely.union_all(cuts)]))
    inside = shapely.covers(section.buffer(1e-6 * thickness), shapely.point_on_surface(faces))
    return faces[inside]


def _to_frame(points, frame, reach):
    """Return a line that goes on through the frame where its ends are near."""
    for _ in range(2):
        end = shapely.Point(points[-1])
        if end.distance(frame) < reach:
            nearest = shapely.get_coordinates(shapely.shortest_line(end, frame))[1]
            step = points[-1] - points[-2]
            beyond = nearest + 1e-3 * reach * step / (np.hypot(*step) or 1.0)
            points = np.vstack([points, nearest, beyond])
        points = points[::-1]
    return points


def _rocks(scene, faces, particles):
    """Return the row of the rock of every face, -1 of bands of faults; by most of its particles."""
    of_unit = np.array([unit.rock for unit in scene.units])
    of_unit[[fault.unit for fault in scene.faults]] = -1
    middle = shapely.get_coordinates(shapely.point_on_surface(faces))
    if particles is None:
        return of_unit[scene.unit_at(middle)]
    x, unit = particles.x[particles.inside], particles.unit[particles.inside]
    area = particles.area[particles.inside]
    face, point = shapely.STRtree(shapely.points(x)).query(faces, predicate="contains")
    votes = np.zeros((len(faces), len(scene.units)))
    np.add.at(votes, (face, unit[point]), area[point])
    found = votes.argmax(axis=1)
    empty = votes.sum(axis=1) == 0
    if empty.any():
        from scipy.spatial import cKDTree

        found[empty] = unit[cKDTree(x).query(middle[empty])[1]]
    return of_unit[found]

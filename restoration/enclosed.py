"""Areas that horizons part a section into: between closed walls rock neither leaves nor enters.

Steps of finite length, chords between vertices and vertices that come and go change them by a
little, which moving the horizon as a whole along its normals sets right.
"""

from dataclasses import replace

import numpy as np

ON_WALL = 1e-6  # of the width or height: an end this near to a wall is on it
PASSES = 8  # of the correction, each far smaller than the last


def kept(before, after, outline, free):
    """Return lines after a step with the areas that they enclosed before it, and how far they went.

    It is for horizons that go from one side of the section to the other, or to base or surface
    where these are walls, and for closed ones; no wall may be crossed by rock.

    Args:
        before, after: `lines.MovingLine`s, the same ones.
        outline: `scene.Outline` of the frame.
        free: whether the surface is free: what ends on it encloses nothing.

    Returns:
        The lines, and the greatest shift of any, m.
    """
    found, most = [], 0.0
    for was, line in zip(before, after, strict=True):
        if line.kind == "horizon":
            walls = _walls(was.points, outline, free), _walls(line.points, outline, free)
            if walls[0] is not None and walls[0] == walls[1]:
                points, shift = _with_area(
                    line.points, _area(was.points, outline, walls[0]), outline, walls[0]
                )
                line, most = replace(line, points=points), max(most, abs(shift))
        found.append(line)
    return tuple(found), most


def _walls(points, outline, free):
    """Return the walls that both ends are on, ``closed`` for a closed line, None for other ones."""
    if np.array_equal(points[0], points[-1]):
        return ("closed", "closed")
    left, right = outline.surface[[0, -1], 0]
    near_x, near_z = ON_WALL * outline.width, ON_WALL * outline.height
    found = []
    for x, z in points[[0, -1]]:
        if min(abs(x - left), abs(x - right)) <= near_x:
            found.append("side")
        elif abs(z - np.interp(x, *outline.base.T)) <= near_z:
            found.append("base")
        elif not free and abs(z - np.interp(x, *outline.surface.T)) <= near_z:
            found.append("surface")
        else:
            return None
    return tuple(found)


def _area(points, outline, walls):
    """Return the area to one side of a line, but for one that never changes, m^2."""
    x, z = points.T
    area = float(np.trapz(z, x))
    for end, wall in zip((0, -1), walls, strict=True):
        if wall in ("base", "surface"):
            line = getattr(outline, wall)
            below = np.r_[line[line[:, 0] < x[end]], [[x[end], np.interp(x[end], *line.T)]]]
            area += (1 if end == 0 else -1) * float(np.trapz(below[:, 1], below[:, 0]))
    return area


def _with_area(points, area, outline, walls):
    """Return the vertices of a line moved along its normals to an area, and how far, m."""
    shift = 0.0
    for _ in range(PASSES):
        step = np.r_[
            points[1:2] - points[:1], points[2:] - points[:-2], points[-1:] - points[-2:-1]
        ]
        if walls[0] == "closed":
            step[[0, -1]] = points[1] - points[-2]
        up = np.column_stack([-step[:, 1], step[:, 0]])
        length = np.hypot(*step.T)
        normal = np.divide(up, length[:, None], out=np.zeros_like(up), where=length[:, None] > 0)
        for end, wall in zip((0, -1), walls, strict=True):
            if wall == "side":
                normal[end] = 0.0, np.sign(up[end, 1])
            elif wall != "closed":
                normal[end] = 0.0
        gain = float((normal * up).sum()) / 2
        if not gain > 0:
            break
        by = (area - _area(points, outline, walls)) / gain
        points, shift = points + by * normal, shift + by
    return points, shift

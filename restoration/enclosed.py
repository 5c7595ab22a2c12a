"""Areas that horizons part a section into: between closed walls rock neither leaves nor enters.

Steps of finite length, chords between vertices and vertices that come and go change them by a
little, which moving the horizon as a whole along its normals sets right.
"""

from dataclasses import replace

import numpy as np

ON_WALL = 1e-6  # of the width or height: an end this near to a wall is on it
PASSES = 8  # of the correction, each far smaller than the last


def kept(before, after, outline, free, contacts=()):
    """Return lines after a step with the areas that they enclosed before it, and how far they went.

    It is for horizons that go from one side of the section to the other, or to base or surface
    where these are walls, and for closed ones; no wall may be crossed by rock. Contacts of rocks
    that meet end to end, two at a point, count as one: salt below layers of one other rock.

    Args:
        before, after: `lines.MovingLine`s, the same ones.
        outline: `scene.Outline` of the frame.
        free: whether the surface is free: what ends on it encloses nothing.
        contacts: names of the lines that part rocks.

    Returns:
        The lines, and the greatest shift of any, m.
    """
    found, most = list(after), 0.0
    for path in _paths(before, contacts):
        was, now = (_joined(lines, path) for lines in (before, after))
        walls = _walls(was, outline, free), _walls(now, outline, free)
        if walls[0] is None or walls[0] != walls[1]:
            continue
        points, shift = _with_area(now, _area(was, outline, walls[0]), outline, walls[0])
        most, begin = max(most, abs(shift)), 0
        for row, way in path:
            end = begin + len(after[row].points)
            found[row] = replace(after[row], points=points[begin:end][::way])
            begin = end - 1  # where it meets the next
    return _met(after, found), most


def _paths(lines, contacts):
    """Return the horizons, those of contacts that meet end to end in one path.

    Returns:
        A list for each path, of rows of lines and the way, 1 or -1, in which they are gone.
    """
    rows = [i for i, line in enumerate(lines) if line.kind == "horizon"]
    ends = {}
    for row in rows:
        closed = np.array_equal(lines[row].points[0], lines[row].points[-1])
        if lines[row].name in contacts and not closed:
            for end in (0, -1):
                ends.setdefault(tuple(lines[row].points[end]), []).append((row, end))
    beside = {}
    for pair in ends.values():
        if len(pair) == 2:
            beside[pair[0]], beside[pair[1]] = pair[1], pair[0]
    paths, seen = [], set()
    # paths begin at ends that meet no other, and what is left goes round
    for row, end in [(r, e) for r in rows for e in (0, -1) if (r, e) not in beside] + [
        (r, 0) for r in rows
    ]:
        path, at = [], (row, end)
        while at is not None and at[0] not in seen:
            seen.add(at[0])
            path.append((at[0], 1 if at[1] == 0 else -1))
            at = beside.get((at[0], -1 - at[1]))
        if path:
            paths.append(path)
    return paths


def _joined(lines, path):
    """Return the vertices of a path, those where lines meet once, shape (n, 2), m."""
    parts = [lines[row].points[::way] for row, way in path]
    return np.concatenate([parts[0], *[part[1:] for part in parts[1:]]])


def _met(after, found):
    """Return moved lines, and others led along where their ends met the ends of those."""
    to = {}
    for was, line in zip(after, found, strict=True):
        if line is not was:
            to |= {tuple(was.points[end]): line.points[end] for end in (0, -1)}
    lines = []
    for was, line in zip(after, found, strict=True):
        if line is was and any(tuple(was.points[end]) in to for end in (0, -1)):
            points = was.points.copy()
            for end in (0, -1):
                points[end] = to.get(tuple(was.points[end]), points[end])
            line = replace(line, points=points)
        lines.append(line)
    return tuple(lines)


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

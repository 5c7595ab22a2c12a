"""Rock that crosses walls: what flows out leaves, what flows in is particles and line ends anew.

Nothing here remembers earlier steps: what a strip behind a wall lacks is seen from the particles in
front of it, so that many small steps fill it as a few large ones do.
"""

from dataclasses import replace

import numpy as np

from restoration.errors import ParticleError
from restoration.lines import with_rows
from restoration.particles import NONE_LEFT, OUTSIDE, Particles, nearest, subset
from restoration.ranks import ALONE
from restoration.scene import WALLS

ALMOST = 0.95  # of a spacing that a row lacks before a particle is born there
NEAREST = 0.6  # spacings from a particle to one born beside it, at least
DEEPEST = 1.5  # spacings that may be without particles in front of what flowed in
ON_WALL = 1e-9  # of the width: an end of a line this near to a side is on it
ACROSS = 0.1  # weight of the distance across the wall when the layer of new rock is looked for


def wall_points(name, outline, spacing):
    """Return points along a wall from one end to the other, about ``spacing`` apart, (n, 2), m."""
    count = 2 + int(_length(name, outline) / spacing)
    along = np.linspace(0, _length(name, outline), count)
    return _place(name, outline, np.zeros(count), along)


def cast_off(particles, outline, walls=WALLS):
    """Remove the particles that have left through open walls.

    Args:
        particles: `Particles`.
        outline: `scene.Outline` of the section as it is now.
        walls: names of the walls that are open.

    Returns:
        The particles kept, and by name how many left through each open wall.
    """
    out = dict.fromkeys(walls, 0)
    left = np.zeros(len(particles.x), bool)
    for name in sorted(walls, key=WALLS.index):  # beyond a side counts as through the side
        gone = (_depth(particles.x, name, outline) < 0) & ~left
        out[name] = int(np.count_nonzero(gone))
        left |= gone
    return (subset(particles, ~left) if left.any() else particles), out


def flowed_in(particles, name, outline, moved, spacing, ranks=ALONE):
    """Return new particles of the rock that flowed in through a wall in a step.

    The strip is cut into rows across the wall, a spacing wide. What a row lacks reaches from the
    share of its first particle to the wall: from there on a particle is born for every whole
    spacing, and the rest at the wall waits for the next step. The layers flow in as they stand: a
    newborn has the unit of the particles at its height (at its place along the base or the surface)
    behind the strip.

    Args:
        particles: `Particles` after the step, those that left cast off.
        name: of the wall.
        outline: `scene.Outline` after the step.
        moved: where points that stood close together on the wall before the step are now, shape
            (m, 2), m, in order along the wall.
        spacing: of the particles, m.
        ranks: `ranks.Ranks`; every one has some of the particles, and gets all of the newborn.

    Returns:
        The newborn `Particles`, in no cell yet and with a ``start`` of NaN; None of no one.

    Raises:
        ParticleError: no particle is left that could tell the rock.
    """
    length = _length(name, outline)
    rows = max(1, round(length / spacing))
    width = length / rows
    middle = (np.arange(rows) + 0.5) * width
    thickness = ranks.same(_thickness(name, outline, moved, middle))
    if not (thickness > 0).any():
        return None
    if not ranks.any(len(particles.x)):
        raise ParticleError(NONE_LEFT)
    lack = ranks.least(_lack(particles, name, outline, rows, width, spacing))
    lack = np.where(thickness > 0, np.minimum(lack, thickness + DEEPEST * spacing), 0.0)
    count = np.maximum(0, np.floor(lack / spacing + 1 - ALMOST)).astype(int)
    size = np.minimum(spacing, lack / np.maximum(count, 1))
    row = np.repeat(np.arange(rows), count)
    number = np.arange(len(row)) - np.repeat(np.r_[0, np.cumsum(count)[:-1]], count)
    x = _place(name, outline, lack[row] - (number + 0.5) * size[row], middle[row])
    near = ranks.least(nearest(particles.x, x)[0])
    inside = np.all([_depth(x, wall, outline) > 0 for wall in WALLS], axis=0)
    born = (near >= NEAREST * spacing) & inside
    x, row = x[born], row[born]
    if not len(x):
        return None
    share = (count / np.maximum(1, np.bincount(row, minlength=rows)))[row]  # of those not born too
    area = share * size[row] * width * _stretch(x, name, outline)
    nowhere = np.full(len(x), OUTSIDE, np.int32)
    unit = _layer(particles, name, x, ranks)
    return Particles(x, unit, area, np.full_like(x, np.nan), nowhere)


def with_ends(before, lines, edges, walls, spacing):
    """Return lines cut at the open sides where they have left, and drawn on where they lack.

    Args:
        before: the lines before a step.
        lines: the same after it.
        edges: x of the left and the right side, m.
        walls: names of the walls that are open.
        spacing: of new vertices, m.
    """
    left, right = (
        x if name in walls else sign * np.inf
        for name, x, sign in zip(("left", "right"), edges, (-1, 1), strict=True)
    )
    kept = []
    for was, line in zip(before, lines, strict=True):
        ends = touching(was, left, right, ON_WALL * np.ptp(edges))
        inside = cut(line, left, right)
        if inside is not None:
            kept.append(extended(inside, ends, spacing))
    return tuple(kept)


def _layer(particles, name, x, ranks):
    """Return the unit of every point: that of the nearest particle, near across the wall or not."""
    scale = (ACROSS, 1.0) if name in ("left", "right") else (1.0, ACROSS)
    distance, row = nearest(particles.x * scale, x * scale)
    unit = particles.unit[row] if len(particles.x) else np.zeros(len(x), particles.unit.dtype)
    return ranks.of_least(distance, unit)[1]


def _ends(x, outline):
    """Return the heights of base and surface at points, shape (n,) each."""
    return np.interp(x[:, 0], *outline.base.T), np.interp(x[:, 0], *outline.surface.T)


def _depth(x, name, outline):
    """Return how far points are inside of a wall, m; negative beyond it."""
    base, surface = _ends(x, outline)
    return {
        "left": x[:, 0] - outline.surface[0, 0],
        "right": outline.surface[-1, 0] - x[:, 0],
        "base": x[:, 1] - base,
        "surface": surface - x[:, 1],
    }[name]


def _length(name, outline):
    """Return the length of a wall along z or x, m."""
    if name in ("base", "surface"):
        return outline.width
    end = 0 if name == "left" else -1
    return float(outline.surface[end, 1] - outline.base[end, 1])


def _along(x, name, outline):
    """Return where points are along a wall, from 0 to its `_length`, m.

    Along the sides it is the part of the height above the base, so that rows follow a relief.
    """
    if name in ("base", "surface"):
        return x[:, 0] - outline.surface[0, 0]
    base, surface = _ends(x, outline)
    return (x[:, 1] - base) / (surface - base) * _length(name, outline)


def _place(name, outline, depth, along):
    """Return the points at depths inside of a wall and places along it, shape (n, 2), m."""
    if name in ("base", "surface"):
        x = np.column_stack([outline.surface[0, 0] + along, np.zeros(len(along))])
        base, surface = _ends(x, outline)
        return np.column_stack([x[:, 0], base + depth if name == "base" else surface - depth])
    end, sign = (0, 1) if name == "left" else (-1, -1)
    x = np.column_stack([outline.surface[end, 0] + sign * depth, np.zeros(len(depth))])
    base, surface = _ends(x, outline)
    return np.column_stack([x[:, 0], base + along / _length(name, outline) * (surface - base)])


def _thickness(name, outline, moved, middle):
    """Return how far the rock that stood on a wall has moved inward, in every row, m."""
    along = _along(moved, name, outline)
    order = np.argsort(along, kind="stable")
    return np.interp(middle, along[order], _depth(moved, name, outline)[order])


def _lack(particles, name, outline, rows, width, spacing):
    """Return how far from a wall the share of the first particle begins, in every row, m."""
    depth = _depth(particles.x, name, outline)
    row = np.floor(_along(particles.x, name, outline) / width).astype(int)
    inside = np.flatnonzero((depth >= 0) & (row >= 0) & (row < rows))
    reach = np.minimum(particles.area[inside] / width, spacing) / 2
    lack = np.full(rows, np.inf)
    np.minimum.at(lack, row[inside], depth[inside] - reach)
    return lack


def _stretch(x, name, outline):
    """Return how much wider the rows are at points than at the wall, shape (n,)."""
    if name in ("base", "surface"):
        return np.ones(len(x))
    base, surface = _ends(x, outline)
    return (surface - base) / _length(name, outline)


def touching(line, left, right, slack):
    """Return the x of the side wall that the first and the last vertex of a line are on, or None.

    Args:
        line: `scene.Line`.
        left, right: x of the side walls, m.
        slack: how near is on it, m.
    """

    def wall(x):
        return next((at for at in (left, right) if abs(x - at) <= slack), None)

    return wall(line.points[0, 0]), wall(line.points[-1, 0])


def cut(line, left, right):
    """Return a line without the ends that are beyond the side walls; None where nothing is left.

    The vertex made on the wall counts as drawn. What bulges through a wall between two ends inside
    is pressed onto it.

    Args:
        line: `lines.MovingLine`.
        left, right: x of the walls, m; infinite where a side is closed.
    """
    x = line.points[:, 0]
    inside = np.flatnonzero((x >= left) & (x <= right))
    if not len(inside):
        return None
    if len(inside) == len(x):
        return line
    first, last = inside[0], inside[-1]
    new = with_rows(line, slice(first, last + 1))
    if last + 1 < len(x):
        new = _ended(new, _crossing(line.points[last], line.points[last + 1], left, right), -1)
    if first > 0:
        new = _ended(new, _crossing(line.points[first], line.points[first - 1], left, right), 0)
    if len(new.points) < 2:
        return None
    points = np.column_stack([np.clip(new.points[:, 0], left, right), new.points[:, 1]])
    return replace(new, points=points)


def extended(line, walls, spacing):
    """Return a line drawn on to the walls that its ends stood on before a step carried them inward.

    It goes on horizontally: what flows in has the layers that stand there. The vertex on the wall
    counts as drawn. The one that was there before stays only where the next is a spacing away, so
    that small steps do not heap up vertices.

    Args:
        line: `lines.MovingLine` after the step.
        walls: x of the wall of its first and its last vertex, m, or None, see `touching`.
        spacing: least distance of the vertices at the wall, m.
    """
    for end, inner, x in ((0, 1, walls[0]), (-1, -2, walls[1])):
        if x is None or line.points[end, 0] == x:
            continue
        target = np.array([x, line.points[end, 1]])
        if len(line.points) > 2 and np.linalg.norm(line.points[inner] - target) < spacing:
            line = with_rows(line, slice(1, None) if end == 0 else slice(None, -1))
        line = _ended(line, target, end)
    return line


def _ended(line, point, end):
    """Return a line with one more vertex, that counts as drawn, at its first (0) or last end."""
    at = 0 if end == 0 else len(line.points)
    return replace(
        line,
        points=np.insert(line.points, at, point, axis=0),
        added=np.insert(line.added, at, np.nan),
        way=np.insert(line.way, at, 0),
    )


def _crossing(inner, outer, left, right):
    """Return where a segment from inside to outside crosses a side wall."""
    x = left if outer[0] < left else right
    part = (x - inner[0]) / (outer[0] - inner[0])
    return np.array([x, inner[1] + part * (outer[1] - inner[1])])

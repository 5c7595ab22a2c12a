"""Horizons and faults in motion: points in one array, and more of them where they stretch."""

from dataclasses import dataclass, replace

import numpy as np

from restoration.scene import Line

# A segment is halved where the line turns by more than this at one of its ends, rad.
SHARP_TURN = 0.2
# A cubic is trusted where its four vertices are no more uneven than this, and where it leaves the
# chord by no more than this part of it (a half circle leaves it by 0.5, a turn of 1 rad by 0.12).
MOST_UNEVEN = 5.0
MOST_SAGITTA = 0.15
LEAST_LENGTH = 1e-6  # m, of a segment, where its length divides
# A line that needs more vertices is folded finer than cells can tell: cells that are too large, or
# steps that are too long, stir it without end, and its vertices would double every few steps.
MOST_VERTICES, MOST_VERTICES_PER_CELL = 20_000, 5


@dataclass(frozen=True, eq=False)
class MovingLine(Line):
    """A line with the vertices it was drawn with, and those added where it stretched.

    Attributes:
        added: model time at which a vertex was added, shape (n,), s; NaN of a drawn one.
        way: sign of the step that added it, shape (n,), int8; 0 of a drawn one.
    """

    added: np.ndarray
    way: np.ndarray


def surface_of(lines):
    """Return the surface among moving lines, or None."""
    return next((line for line in lines if line.kind == "surface"), None)


def begin(lines, longest):
    """Return drawn lines ready to move, with vertices at most ``longest`` apart, m.

    The vertices that makes necessary lie on the straight segments that were drawn.
    """
    ready = []
    for line in lines:
        points = spaced(line.points, longest)
        n = len(points)
        ready.append(
            MovingLine(line.name, line.kind, points, np.full(n, np.nan), np.zeros(n, np.int8))
        )
    return tuple(ready)


def spaced(points, longest):
    """Return a polyline with vertices at most ``longest`` apart, m, on its segments."""
    length = np.linalg.norm(np.diff(points, axis=0), axis=1)
    parts = np.maximum(1, np.ceil(length / longest)).astype(int)
    segment = np.repeat(np.arange(len(parts)), parts)
    number = np.arange(len(segment)) - np.repeat(np.r_[0, np.cumsum(parts)[:-1]], parts)
    at = np.r_[segment + number / parts[segment], len(parts)]
    return np.column_stack([np.interp(at, np.arange(len(points)), axis) for axis in points.T])


def memory_of(lines):
    """Return lines as arrays and names, for a checkpoint; see `from_memory`."""
    return {
        "names": [line.name for line in lines],
        "kinds": [line.kind for line in lines],
        "counts": [len(line.points) for line in lines],
        "points": points_of(lines),
        "added": np.concatenate([np.empty(0), *(line.added for line in lines)]),
        "way": np.concatenate([np.empty(0, np.int8), *(line.way for line in lines)]),
    }


def from_memory(memory):
    """Return the `MovingLine`s that `memory_of` was asked of."""
    ends = np.cumsum(memory["counts"])[:-1]
    columns = (np.split(memory[name], ends) for name in ("points", "added", "way"))
    if not memory["names"]:
        return ()
    return tuple(map(MovingLine, memory["names"], memory["kinds"], *columns))


def points_of(lines):
    """Return the vertices of all lines, or points of all sheets, in one array, (n, dim), m."""
    return np.concatenate([line.points for line in lines]) if lines else np.empty((0, 2))


def with_points(lines, points):
    """Return the lines with their vertices replaced from one array."""
    counts = np.cumsum([len(line.points) for line in lines])[:-1]
    moved = np.split(points, counts) if lines else []
    return tuple(replace(line, points=part) for line, part in zip(lines, moved, strict=True))


def with_rows(line, rows):
    """Return a line with some of its vertices."""
    return replace(line, points=line.points[rows], added=line.added[rows], way=line.way[rows])


def most_vertices(cells):
    """Return how many vertices a line may have in a mesh of so many cells."""
    return min(MOST_VERTICES, MOST_VERTICES_PER_CELL * cells)


def refined(lines, longest, shortest, time, dt, most=MOST_VERTICES):
    """Return the lines with vertices added where they are long or turn, and removed again.

    A new vertex lies on the cubic through the four vertices around its segment, by chord length: a
    straight chord would be off by curvature times length squared, and the way back stretches that
    error as much as the way there stretched the line. Where the four are too uneven for a cubic, or
    it leaves the chord as only a corner does, the vertex goes on the chord. A vertex goes when time
    turns and passes the moment that added it: before it, the line was well without. Those added
    beside it on the way back go with it. Where a line comes to the most, its longest segments are
    halved first, and the others wait.

    Args:
        lines: `MovingLine`s.
        longest: segments above this are halved once, m.
        shortest: segments below this are left alone, m.
        time: model time that the lines have reached, s.
        dt: the signed step that brought them there, s.
        most: vertices of a line.
    """
    way = np.int8(np.sign(dt))
    return tuple(
        _refined(_undone(line, time), longest, shortest, time, way, most) for line in lines
    )


def as_drawn(lines):
    """Return the lines with the vertices they were drawn with, and no others."""
    return tuple(Line(line.name, line.kind, line.points[line.way == 0]) for line in lines)


def _undone(line, time):
    keep = (line.way == 0) | (line.way * (time - line.added) >= 0)
    return replace(line, points=line.points[keep], added=line.added[keep], way=line.way[keep])


def _refined(line, longest, shortest, time, way, most):
    step = np.diff(line.points, axis=0)
    length = np.hypot(*step.T)
    direction = np.arctan2(step[:, 1], step[:, 0])
    turn = np.abs((np.diff(direction) + np.pi) % (2 * np.pi) - np.pi)
    sharp = np.maximum(np.r_[0, turn], np.r_[turn, 0]) > SHARP_TURN
    halved = np.flatnonzero((length > longest) | (sharp & (length > 2 * shortest)))
    room = max(0, most - len(line.points))
    if len(halved) > room:
        halved = np.sort(halved[np.argsort(-length[halved], kind="stable")[:room]])
    middles = _middles(line.points, length, halved)
    added, ways = _descent(line, halved, time, way)
    return replace(
        line,
        points=np.insert(line.points, halved + 1, middles, axis=0),
        added=np.insert(line.added, halved + 1, added),
        way=np.insert(line.way, halved + 1, ways),
    )


def _descent(line, segments, time, way):
    """Return when new vertices count as added, and by which way.

    Beside a vertex of the other way, which will go soon, a new one goes with it: it is as wrong.
    """
    ends = np.stack([segments, segments + 1])
    other = line.way[ends] == -way
    soonest = np.where(other, -way * line.added[ends], -np.inf).max(axis=0, initial=-np.inf)
    goes = other.any(axis=0)
    return np.where(goes, -way * soonest, time), np.where(goes, -way, way).astype(np.int8)


def _middles(points, length, segments):
    """Return the middles of segments, on cubics where they can be trusted."""
    chord = (points[segments] + points[segments + 1]) / 2
    if len(points) < 4:
        return chord
    first = np.clip(segments - 1, 0, len(points) - 4)
    near = first[:, None] + np.arange(4)
    s = np.r_[0, np.cumsum(np.maximum(length, LEAST_LENGTH))]
    at = (s[segments] + s[segments + 1]) / 2
    weight = np.ones(near.shape)
    for j in range(4):
        for m in range(4):
            if m != j:
                weight[:, j] *= (at - s[near[:, m]]) / (s[near[:, j]] - s[near[:, m]])
    cubic = np.einsum("nk,nkd->nd", weight, points[near])
    around = length[near[:, :3]]
    uneven = around.max(axis=1) > MOST_UNEVEN * around.min(axis=1)
    off = np.linalg.norm(cubic - chord, axis=1) > MOST_SAGITTA * length[segments]
    return np.where((uneven | off)[:, None], chord, cubic)

"""Horizons and faults in motion: points in one array, and more of them where they stretch."""

import numpy as np

from restoration.scene import Line

# A segment is halved where the line turns by more than this at one of its ends, rad.
SHARP_TURN = 0.2
# A cubic is trusted where its four vertices are no more uneven than this, and where it leaves the
# chord by no more than this part of it (a half circle leaves it by 0.5, a turn of 1 rad by 0.12).
MOST_UNEVEN = 5.0
MOST_SAGITTA = 0.15


def points_of(lines):
    """Return the vertices of all lines in one array, shape (n, 2), m."""
    return np.concatenate([line.points for line in lines]) if lines else np.empty((0, 2))


def with_points(lines, points):
    """Return the lines with their vertices replaced from one array."""
    counts = np.cumsum([len(line.points) for line in lines])[:-1]
    moved = np.split(points, counts) if lines else []
    return tuple(Line(line.name, line.kind, p) for line, p in zip(lines, moved, strict=True))


def spaced(lines, longest):
    """Return drawn lines with vertices at most ``longest`` apart, m, on their straight segments."""
    return tuple(Line(line.name, line.kind, _spaced(line.points, longest)) for line in lines)


def _spaced(points, longest):
    parts = np.maximum(1, np.ceil(np.linalg.norm(np.diff(points, axis=0), axis=1) / longest))
    at = np.r_[np.repeat(np.arange(len(parts)), parts.astype(int)), len(parts)].astype(float)
    first = np.r_[0, np.cumsum(parts)[:-1]].astype(int)
    at[:-1] += (np.arange(len(at) - 1) - np.repeat(first, parts.astype(int))) / np.repeat(
        parts, parts.astype(int)
    )
    old = np.arange(len(points))
    return np.column_stack([np.interp(at, old, axis) for axis in points.T])


def refined(lines, longest, shortest):
    """Return the lines with long segments, and those at sharp turns, halved once.

    The new vertex lies on the cubic through the four vertices around the segment, by chord length:
    a straight chord would be off by curvature times length squared, and the way back stretches that
    error as much as the way there stretched the line. Where the four are too uneven for a cubic, or
    it leaves the chord as only a corner does, the vertex goes on the chord.

    Args:
        lines: `scene.Line`s.
        longest: segments above this are halved, m.
        shortest: segments below this are left alone, m.
    """
    return tuple(
        Line(line.name, line.kind, _refined(line.points, longest, shortest)) for line in lines
    )


def _refined(points, longest, shortest):
    step = np.diff(points, axis=0)
    length = np.hypot(*step.T)
    direction = np.arctan2(step[:, 1], step[:, 0])
    turn = np.abs((np.diff(direction) + np.pi) % (2 * np.pi) - np.pi)
    sharp = np.maximum(np.r_[0, turn], np.r_[turn, 0]) > SHARP_TURN
    halved = np.flatnonzero((length > longest) | (sharp & (length > 2 * shortest)))
    return np.insert(points, halved + 1, _middles(points, length, halved), axis=0)


def _middles(points, length, segments):
    """Return the middles of segments, on cubics where they can be trusted."""
    chord = (points[segments] + points[segments + 1]) / 2
    if len(points) < 4:
        return chord
    first = np.clip(segments - 1, 0, len(points) - 4)
    near = first[:, None] + np.arange(4)
    s = np.r_[0, np.cumsum(np.maximum(length, 1e-12))]
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

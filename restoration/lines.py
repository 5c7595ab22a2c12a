"""Horizons and faults in motion: points in one array, and more of them where they stretch."""

import numpy as np

from restoration.scene import Line

# A segment is halved where the line turns by more than this at one of its ends, rad.
SHARP_TURN = 0.2


def points_of(lines):
    """Return the vertices of all lines in one array, shape (n, 2), m."""
    return np.concatenate([line.points for line in lines]) if lines else np.empty((0, 2))


def with_points(lines, points):
    """Return the lines with their vertices replaced from one array."""
    counts = np.cumsum([len(line.points) for line in lines])[:-1]
    moved = np.split(points, counts) if lines else []
    return tuple(Line(line.name, line.kind, p) for line, p in zip(lines, moved, strict=True))


def refined(lines, longest, shortest):
    """Return the lines with long segments, and those at sharp turns, halved once.

    The new vertex lies on the cubic through the four vertices around the segment, by chord length:
    a straight chord would be off by curvature times length squared, and the way back stretches that
    error as much as the way there stretched the line.

    Args:
        lines: `scene.Line`s.
        longest: segments above this are halved, m.
        shortest: segments below this are left alone, m.
    """
    return tuple(
        Line(line.name, line.kind, _refined(line.points, longest, shortest)) for line in lines
    )


def _refined(points, longest, shortest):
    if len(points) < 3:
        return points
    step = np.diff(points, axis=0)
    length = np.hypot(*step.T)
    direction = np.arctan2(step[:, 1], step[:, 0])
    turn = np.abs((np.diff(direction) + np.pi) % (2 * np.pi) - np.pi)
    sharp = np.maximum(np.r_[0, turn], np.r_[turn, 0]) > SHARP_TURN
    halved = np.flatnonzero((length > longest) | (sharp & (length > 2 * shortest)))
    return np.insert(points, halved + 1, _cubic_middles(points, length, halved), axis=0)


def _cubic_middles(points, length, segments):
    """Return the middles of segments on the cubics through the four vertices around them."""
    s = np.r_[0, np.cumsum(np.maximum(length, 1e-12))]
    first = np.clip(segments - 1, 0, len(points) - min(4, len(points)))
    near = first[:, None] + np.arange(min(4, len(points)))
    at = (s[segments] + s[segments + 1]) / 2
    weight = np.ones(near.shape)
    for j in range(near.shape[1]):
        for m in range(near.shape[1]):
            if m != j:
                weight[:, j] *= (at - s[near[:, m]]) / (s[near[:, j]] - s[near[:, m]])
    return np.einsum("nk,nkd->nd", weight, points[near])

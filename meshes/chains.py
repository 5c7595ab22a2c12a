"""Chains of mesh nodes along lines, and where their nodes follow a finer line best."""

import numpy as np
from scipy.linalg import solveh_banded

CLOSINGS = 3  # corrections of the area beside a chain, each some hundred times smaller


def chains(edges, ends):
    """Return the nodes of the chains that edges make, from one junction or end to the next.

    Args:
        edges: pairs of nodes, shape (k, 2).
        ends: nodes at which chains end although they go on.

    Returns:
        List of arrays of nodes in order; the first node of a ring is its last too.
    """
    beside = {}
    for row, (a, b) in enumerate(edges.tolist()):
        beside.setdefault(a, []).append((b, row))
        beside.setdefault(b, []).append((a, row))
    ends, left = set(ends), np.ones(len(edges), bool)
    junctions = [node for node, others in beside.items() if len(others) != 2 or node in ends]
    stops, found = set(junctions), []
    for node in [*junctions, *beside]:  # what is left after the junctions are rings
        for other, row in beside[node]:
            if not left[row]:
                continue
            chain, at = [node], other
            left[row] = False
            while True:
                chain.append(at)
                onward = [(b, r) for b, r in beside[at] if left[r]]
                if at in stops or not onward:
                    break
                at, row = onward[0]
                left[row] = False
            found.append(np.array(chain))
    return found


def along(line, s):
    """Return the points at arc lengths of a polyline, shape (n, 2), m."""
    at = arc_lengths(line)
    return np.column_stack([np.interp(s, at, axis) for axis in line.T])


def arc_lengths(line):
    """Return the arc length at every vertex of a polyline, shape (n,), m."""
    return np.r_[0, np.cumsum(np.hypot(*np.diff(line, axis=0).T))]


def best_nodes(x, line, s, ends=(None, None), across=None):
    """Return the nodes of the chain with the least distance to a line, the area beside it kept.

    Nodes on a line make chords, which cut off its bends: an area in the order of the square of
    their length. These are moved off the line, along normals, to the projection onto hats along the
    chain; then all alike by the little that makes the area on both sides that of the line.

    Args:
        x: nodes, shape (n, 2), m; the first and the last stand.
        line: polyline, shape (m, 2), m.
        s: arc length of the line at every node, ascending, shape (n,), m.
        ends: direction along which the first and the last node may slide, or None.
        across: direction of all moves; None for the normals.
    """
    x = x.copy()
    at = arc_lengths(line)
    inner = at[(at > s[0]) & (at < s[-1])]
    spots = np.unique(np.concatenate([s, inner]))
    dense = np.column_stack([np.interp(spots, at, axis) for axis in line.T])
    chord = np.diff(x, axis=0)
    length = np.hypot(*chord.T)
    cell = np.clip(np.searchsorted(s, (spots[1:] + spots[:-1]) / 2) - 1, 0, len(length) - 1)
    tangent = chord[cell] / length[cell, None]
    a, b = (dense[part] - x[cell] for part in (slice(None, -1), slice(1, None)))
    run_a, run_b = ((v * tangent).sum(axis=1) / length[cell] for v in (a, b))
    off_a, off_b = (tangent[:, 0] * v[:, 1] - tangent[:, 1] * v[:, 0] for v in (a, b))
    load = np.zeros(len(x))
    weight = (run_b - run_a) * length[cell] / 6
    for end in (0, 1):
        first, last = (run if end else 1 - run for run in (run_a, run_b))
        part = 2 * off_a * first + off_a * last + off_b * first + 2 * off_b * last
        np.add.at(load, cell + end, weight * part)
    width = np.r_[length, 0] + np.r_[0, length]
    direction, free = _directions(x, width, ends, across)
    if not free.any():
        return x
    rows = np.flatnonzero(free)
    mass = np.zeros((2, len(rows)))
    mass[1] = width[rows] / 3
    mass[0, 1:] = np.where(np.diff(rows) == 1, length[rows[:-1]] / 6, 0)
    off = solveh_banded(mass if len(rows) > 1 else mass[1:], load[rows])
    x[rows] += off[:, None] * direction[rows]
    gain = width[rows].sum() / 2
    for _ in range(CLOSINGS):
        x[rows] += _beside(x, dense) / gain * direction[rows]
    return x


def _directions(x, width, ends, across):
    """Return the moves of the nodes that add the area of half their edges each, and which move."""
    step = np.zeros_like(x)
    step[1:-1] = x[2:] - x[:-2]
    step[0], step[-1] = x[1] - x[0], x[-1] - x[-2]
    left = np.column_stack([-step[:, 1], step[:, 0]])
    direction = left.copy() if across is None else np.broadcast_to(across, x.shape).copy()
    free = np.ones(len(x), bool)
    for end, along_wall in zip((0, -1), ends, strict=True):
        free[end] = along_wall is not None
        if along_wall is not None:
            direction[end] = along_wall
    gain = (direction * left).sum(axis=1)
    free &= np.abs(gain) > 0.2 * np.hypot(*direction.T) * np.hypot(*left.T)
    scale = np.divide(width, gain, out=np.zeros(len(x)), where=free)
    return direction * scale[:, None], free


def _beside(x, line):
    """Return the area to the left of a chain and to the right of a line, m^2."""
    ring = np.vstack([x, line[::-1], x[:1]]) - x[0]
    a, b = ring[:-1], ring[1:]
    return 0.5 * float((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum())

"""Displacements of a section: put in, read off from particles that are known again, and random."""

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from restoration.errors import MeshError
from restoration.lines import points_of, surface_of, with_points
from restoration.scene import Outline

WAVES = 12  # half-waves across and up at most, of what moves the given section
ON_SIDE = 1e-9  # of the width: this near to a side of the section is on it
NEIGHBOURS = 6  # particles from which a displacement is read


def displaced(state, off, within=None):
    """Return a state with its particles displaced, and its lines with them.

    Args:
        state: `State`.
        off: displacement of its particles, shape (n, 2), m.
        within: maps points (n, 2) into the section; None lets them be.

    What of the lines is on a side of the section stays on it.
    """
    within = within or (lambda x: x)
    particles = replace(state.particles, x=within(state.particles.x + off))
    points = points_of(state.lines)
    if len(points):
        sides, x = (points[:, 0].min(), points[:, 0].max()), points[:, 0]
        off = read(state.particles.x, off, points)
        on_side = np.abs(x[:, None] - sides).min(axis=1) <= ON_SIDE * np.ptp(sides)
        off[on_side, 0] = 0.0
        points = within(points + off)
    return replace(
        state, particles=particles, lines=with_points(state.lines, points), flow=None, grid=None
    )


def read(x, values, points):
    """Return values at points by the weighted mean of the particles around, shape (n, 2)."""
    distance, near = cKDTree(x).query(points, NEIGHBOURS)
    weight = 1 / np.maximum(distance, 1e-6 * (distance.max() or 1.0)) ** 2
    return np.einsum("nk,nkd->nd", weight, values[near]) / weight.sum(axis=1)[:, None]


def matched(particles, others):
    """Return the rows of the same particles among others, -1 of those that are not there.

    A particle is known by where it was seeded; those born later are not known again.
    """
    keys, wanted = (p.start[:, 0] + 1j * p.start[:, 1] for p in (others, particles))
    order = np.argsort(keys)
    at = order[np.minimum(np.searchsorted(keys[order], wanted), len(keys) - 1)]
    there = (keys[at] == wanted) & others.inside[at] & particles.inside
    return np.where(there, at, -1)


def offset(state, other):
    """Return how far the particles of one state are from the same ones of another, (n, 2), m.

    Those that are not known again move as the known one nearest to them.

    Args:
        state: `State` of the run.
        other: `State` at the same time; `offset` is its position minus that of ``state``.

    Raises:
        MeshError: no particle is known again.
    """
    x, rows = state.particles.x, matched(state.particles, other.particles)
    known = rows >= 0
    if not known.any():
        raise MeshError("no particle of the given section is left")
    off = np.zeros_like(x)
    off[known] = other.particles.x[rows[known]] - x[known]
    if not known.all():
        off[~known] = off[known][cKDTree(x[known]).query(x[~known])[1]]
    return off


class Perturbation:
    """A smooth displacement of a section without divergence, of random waves.

    It has a stream function ``psi = sum a_mn sin(m pi xi) sin(n pi zeta)`` in the relative place
    (xi, zeta) between the walls, so that nothing moves across them; below a free surface the waves
    up are quarter-waves longer, and it moves too. Every octave of wave lengths has the same share.

    Args:
        state: `State` of the given section.
        scene: `scene.Scene`.
        rms: root mean square of the displacement over the section, m.
        shortest: wave length, m.
        seed: of the random numbers.
    """

    def __init__(self, state, scene, rms, shortest, seed):
        surface = surface_of(state.lines)
        frame = scene.outline
        self._frame = frame if surface is None else Outline(surface.points, frame.base)
        self._left, self._width = frame.surface[0, 0], frame.width
        counts = [
            int(np.clip(2 * size / shortest, 2, WAVES)) for size in (frame.width, frame.height)
        ]
        shift = 0.0 if surface is None else 0.5
        self._m = np.pi * np.arange(1, counts[0] + 1)
        self._n = np.pi * (np.arange(1, counts[1] + 1) - shift)
        k2 = (self._m[:, None] / frame.width) ** 2 + (self._n / frame.height) ** 2
        self._amplitude = np.random.default_rng(seed).standard_normal(k2.shape) / k2
        u, area = self(state.particles.x), state.particles.area
        self._amplitude *= rms / np.sqrt(np.average((u**2).sum(axis=1), weights=area))

    def __call__(self, points):
        """Return the displacement at points (n, 2), m."""
        xi = np.clip((points[:, 0] - self._left) / self._width, 0, 1)
        x = points[:, 0]
        lines = self._frame.base, self._frame.surface
        low, high = (np.interp(x, *line.T) for line in lines)
        low_slope, high_slope = (_slope(line, x) for line in lines)
        height = high - low
        zeta = np.clip((points[:, 1] - low) / height, 0, 1)
        a, b = self._m * xi[:, None], self._n * zeta[:, None]
        sin_a, sin_b = np.sin(a), np.sin(b)
        by_xi = np.einsum("pm,mn,pn->p", self._m * np.cos(a), self._amplitude, sin_b, optimize=True)
        by_zeta = np.einsum(
            "pm,mn,pn->p", sin_a, self._amplitude, self._n * np.cos(b), optimize=True
        )
        zeta_x = -(low_slope + zeta * (high_slope - low_slope)) / height
        return np.column_stack([-by_zeta / height, by_xi / self._width + by_zeta * zeta_x])


def _slope(line, x):
    """Return the slope of a polyline at places along x."""
    piece = np.clip(np.searchsorted(line[:, 0], x, side="right") - 1, 0, len(line) - 2)
    run, rise = np.diff(line, axis=0).T
    return rise[piece] / np.where(run > 0, run, 1.0)[piece]


def deformation(before, after, near=9):
    """Return the greatest stretch of the rock around particles, by least squares, (n,).

    Args:
        before, after: positions of the same particles, shape (n, 2), m; NaN where they are gone.
        near: number of neighbours.
    """
    there = np.isfinite(before).all(axis=1) & np.isfinite(after).all(axis=1)
    stretch = np.full(len(before), np.nan)
    if np.count_nonzero(there) <= near:
        return stretch
    x, y = before[there], after[there]
    neighbours = cKDTree(x).query(x, near)[1]
    dx, dy = (a[neighbours] - a[neighbours].mean(axis=1, keepdims=True) for a in (x, y))
    gradient = np.einsum("nki,nkj->nij", dy, dx) @ np.linalg.pinv(np.einsum("nki,nkj->nij", dx, dx))
    stretch[there] = np.linalg.svd(gradient, compute_uv=False)[:, 0]
    return stretch

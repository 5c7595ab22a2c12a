"""Particles carry the rock: seeding, finding their cell, filling cells that run empty."""

from dataclasses import dataclass, replace

import numba
import numpy as np
from scipy.spatial import cKDTree

from restoration.errors import ParticleError

OUTSIDE = -1
# Barycentric slack of a point on a facet; far above rounding, far below any visible distance.
ON_FACET = 1e-10


@dataclass(frozen=True, eq=False)
class Particles:
    """A particle cloud, one array per property and one row per particle.

    Attributes:
        x: position, shape (n, 2), m.
        unit: row of the unit table, shape (n,), int16.
        area: part of the section it stands for, shape (n,), m^2.
        start: where it was seeded, shape (n, 2), m; NaN for those born later to fill a cell.
        cell: cell that holds it, shape (n,), int32; OUTSIDE if none.
    """

    x: np.ndarray
    unit: np.ndarray
    area: np.ndarray
    start: np.ndarray
    cell: np.ndarray

    @property
    def lost(self):
        """Number of particles that are outside the mesh."""
        return int(np.count_nonzero(self.cell == OUTSIDE))

    @property
    def born(self):
        """Which particles were born to fill an empty cell, shape (n,), bool."""
        return np.isnan(self.start[:, 0])


class CellIndex:
    """Finds the cell and the barycentric coordinates of points by walking through the mesh.

    Args:
        corners: corner coordinates, shape (cells, 3, 2), m.
        neighbours: cell opposite each corner, shape (cells, 3); -1 on a wall.
    """

    def __init__(self, corners, neighbours):
        self.corners = np.ascontiguousarray(corners)
        self.neighbours = np.ascontiguousarray(neighbours)
        self._tree = cKDTree(corners.mean(axis=1))
        edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        self.area = 0.5 * np.abs(edge1[:, 0] * edge2[:, 1] - edge1[:, 1] * edge2[:, 0])

    def guess(self, x):
        """Return the cell with the nearest centre for every point, shape (n,), int32."""
        return self._tree.query(x)[1].astype(np.int32)

    def locate(self, x, guess):
        """Return the cell of every point and its barycentric coordinates in it.

        Args:
            x: points, shape (n, 2), m.
            guess: cell to start from, shape (n,); OUTSIDE where none is known.

        Returns:
            cell (n,) int32, OUTSIDE where the point is in no cell, and (n, 3) coordinates.
        """
        start = np.array(guess, dtype=np.int32)
        unknown = np.flatnonzero(start < 0)
        if unknown.size:
            start[unknown] = self.guess(x[unknown])
        cell, weights = _walk(x, start, self.corners, self.neighbours)
        stuck = np.flatnonzero(cell == OUTSIDE)
        if stuck.size:  # a walk can end at a concave wall although the point is inside
            near = self._tree.query(x[stuck], k=min(24, len(self.corners)))[1]
            for column in near.reshape(stuck.size, -1).T:
                left = np.flatnonzero(cell[stuck] == OUTSIDE)
                if not left.size:
                    break
                rows = stuck[left]
                cell[rows], weights[rows] = _walk(
                    x[rows], column[left].astype(np.int32), self.corners, self.neighbours
                )
        return cell, weights


@numba.njit(cache=True)
def _walk(x, start, corners, neighbours):
    n = len(x)
    cell = np.empty(n, np.int32)
    weights = np.zeros((n, 3))
    most = 2 * len(corners) + 8
    for i in range(n):
        c = start[i]
        for step in range(most):
            x0, z0 = corners[c, 0, 0], corners[c, 0, 1]
            ax, az = corners[c, 1, 0] - x0, corners[c, 1, 1] - z0
            bx, bz = corners[c, 2, 0] - x0, corners[c, 2, 1] - z0
            px, pz = x[i, 0] - x0, x[i, 1] - z0
            det = ax * bz - az * bx
            w1 = (px * bz - pz * bx) / det
            w2 = (ax * pz - az * px) / det
            w0 = 1.0 - w1 - w2
            k = 0
            least = w0
            if w1 < least:
                k, least = 1, w1
            if w2 < least:
                k, least = 2, w2
            if least >= -ON_FACET:
                weights[i, 0], weights[i, 1], weights[i, 2] = w0, w1, w2
                break
            c = neighbours[c, k]
            if c < 0:
                break
            if step == most - 1:
                c = -1
        cell[i] = c
    return cell, weights


def seed(outline, cells, lines, plan, unit_at):
    """Seed particles on a lattice that is denser near the lines.

    The lattice follows the columns of the outline. A lattice square within one mesh cell of a line
    holds ``densify`` particles of low discrepancy instead of one (paper, sect. 3.4), each
    standing for its share of the square.

    Args:
        outline: `scene.Outline`.
        cells: mesh columns and rows.
        lines: `scene.Line`s to densify around.
        plan: `scene.ParticlePlan`.
        unit_at: maps points (n, 2), m, to rows of the unit table.

    Returns:
        `Particles` that no cell holds yet (see `relocate`).
    """
    rng = np.random.default_rng(plan.seed)
    count = 4 * cells[0] * cells[1] * plan.per_cell
    across = max(cells[0], round(np.sqrt(count * outline.width / outline.height)))
    up = max(cells[1], round(count / across))
    i, k = (index.ravel() for index in np.meshgrid(np.arange(across), np.arange(up)))
    centre = np.column_stack([(i + 0.5) / across, (k + 0.5) / up])
    reach = max(outline.width / cells[0], outline.height / cells[1])
    dense = _near(_to_section(outline, centre)[0], lines, reach) & (plan.densify > 1)
    share = np.where(dense, plan.densify, 1)
    square = np.repeat(np.arange(len(centre)), share)
    within = np.where(dense[square, None], _r2_sequence(share, square), 0.5)
    spread = plan.jitter / np.sqrt(share[square])[:, None]
    within = np.clip(within + spread * (rng.random((len(square), 2)) - 0.5), 0, 1 - 1e-9)
    fraction = (np.column_stack([i, k])[square] + within) / (across, up)
    x, height = _to_section(outline, fraction)
    area = outline.width / across * height / up / share[square]
    nowhere = np.full(len(x), OUTSIDE, np.int32)
    return Particles(x, unit_at(x).astype(np.int16), area, x.copy(), nowhere)


def _to_section(outline, fraction):
    """Return the points at fractions (n, 2) of width and height, and the height there."""
    x = outline.surface[0, 0] + fraction[:, 0] * outline.width
    top = np.interp(x, *outline.surface.T)
    bottom = np.interp(x, *outline.base.T)
    return np.column_stack([x, bottom + fraction[:, 1] * (top - bottom)]), top - bottom


def _near(x, lines, reach):
    """Return which points lie within ``reach`` of a line."""
    if not lines:
        return np.zeros(len(x), bool)
    points = np.concatenate([spaced(line.points, reach / 4) for line in lines])
    return cKDTree(points).query(x, distance_upper_bound=reach)[0] < reach


def spaced(points, spacing):
    """Return the vertices of a polyline with more between them, at most ``spacing`` apart."""
    length = np.r_[0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))]
    s = np.union1d(length, np.linspace(0, length[-1], int(length[-1] / spacing) + 2))
    return np.column_stack([np.interp(s, length, points[:, 0]), np.interp(s, length, points[:, 1])])


def _r2_sequence(share, square):
    """Return points of low discrepancy in the unit square, numbered from 0 in every square.

    Source: the additive recurrence with the plastic number, the two-dimensional analogue of the
    golden ratio.
    """
    first = np.r_[0, np.cumsum(share)[:-1]]
    number = np.arange(len(square)) - first[square]
    plastic = 1.324717957244746
    return (0.5 + (number[:, None] + 1) * np.array([1 / plastic, 1 / plastic**2])) % 1


def relocate(particles, index, x=None):
    """Return the particles with their cells found again, at ``x`` if it is given."""
    x = particles.x if x is None else x
    cell, _ = index.locate(x, particles.cell)
    return replace(particles, x=x, cell=cell)


def empty_cells(particles, n_cells):
    """Return the cells that hold no particle, int32."""
    inside = particles.cell[particles.cell != OUTSIDE]
    return np.flatnonzero(np.bincount(inside, minlength=n_cells) == 0).astype(np.int32)


def fill_cells(particles, index, cells):
    """Give every one of ``cells`` a particle with the unit of the nearest particle.

    Args:
        particles: located `Particles`.
        index: `CellIndex`.
        cells: cells to fill, int32.

    Returns:
        The particles, the new ones at the end.

    Raises:
        ParticleError: no particle is left in the mesh.
    """
    if not len(cells):
        return particles
    inside = np.flatnonzero(particles.cell != OUTSIDE)
    if not inside.size:
        raise ParticleError("no particle is left inside the section; check the boundary velocities")
    centre = index.corners[cells].mean(axis=1)
    nearest = inside[cKDTree(particles.x[inside]).query(centre)[1]]
    nowhere = np.full_like(centre, np.nan)
    born = Particles(centre, particles.unit[nearest], index.area[cells], nowhere, cells)
    return joined(particles, born)


def joined(one, two):
    """Return the particles of two clouds in one, in order."""
    names = Particles.__dataclass_fields__
    return Particles(*(np.concatenate([getattr(one, n), getattr(two, n)]) for n in names))


def from_cloud(cloud, outline):
    """Return the particles of a given cloud, each standing for the same area."""
    n = len(cloud.x)
    area = np.full(n, outline.area / n)
    return Particles(
        cloud.x.copy(),
        cloud.unit.astype(np.int16),
        area,
        cloud.x.copy(),
        np.full(n, OUTSIDE, np.int32),
    )

"""Particles carry the rock: seeding, finding their cell, filling cells that run empty."""

from dataclasses import dataclass, replace

import numba
import numpy as np
from scipy.spatial import cKDTree

from restoration.errors import ParticleError
from restoration.ranks import ALONE
from restoration.seeding import seed_points
from restoration.tetra import walk as walk_tetrahedra

OUTSIDE = -1
# Barycentric slack of a point on a facet; far above rounding, far below any visible distance.
ON_FACET = 1e-10
NONE_LEFT = "no particle is left inside the section; check the boundary velocities"


@dataclass(frozen=True, eq=False)
class Particles:
    """A particle cloud, one array per property and one row per particle.

    Attributes:
        x: position, shape (n, 2), m.
        unit: row of the unit table, shape (n,), int16.
        area: part of the section it stands for, shape (n,), m^2.
        start: where it was seeded, shape (n, 2), m; NaN for those born later to fill a cell.
        cell: cell that holds it, shape (n,), int32; OUTSIDE if none.
        number: its number in the whole cloud, shape (n,), ascending, where ranks share a cloud;
            None where this is the whole of it.
    """

    x: np.ndarray
    unit: np.ndarray
    area: np.ndarray
    start: np.ndarray
    cell: np.ndarray
    number: np.ndarray | None = None

    @property
    def inside(self):
        """Which particles are in the mesh, shape (n,), bool."""
        return self.cell != OUTSIDE

    @property
    def lost(self):
        """Number of particles that are outside the mesh."""
        return int(np.count_nonzero(self.cell == OUTSIDE))

    @property
    def born(self):
        """Which particles were born to fill an empty cell, shape (n,), bool."""
        return np.isnan(self.start[:, 0])


class CellIndex:
    """Finds the cell of points and their hats in it by walking through the mesh.

    The hats of a point are the values of the hat functions of the corners there: barycentric
    coordinates in a triangle or tetrahedron, bilinear ones in a quadrilateral.

    Args:
        section: `meshes.data.SectionMesh`.

    Attributes:
        corners: corner coordinates of every cell, shape (cells, k, dim), m; k is 3 or 4.
        neighbours: cell across every facet, shape (cells, k); -1 on a wall.
        area: of every cell, or its volume, shape (cells,), m^dim.
        lid: nodes of the mesh along a free surface, shape (m, 2), m; None where there is none. A
            point above belongs to the rock right below: the mesh is straight between its nodes,
            the surface is not.
    """

    def __init__(self, section):
        walks = {"triangle": _walk, "quadrilateral": _walk_squares, "tetrahedron": walk_tetrahedra}
        self._walk = walks[section.cell]
        self._section = section
        self.neighbours = np.ascontiguousarray(section.neighbours)
        self.lid = None
        self.moved()

    def moved(self, lid=None):
        """Take the nodes of the mesh from where they are now; ``lid`` as above."""
        self.corners = np.ascontiguousarray(self._section.corners)
        self.area = self._section.areas
        self._centres = None  # made when a point is looked for that no cell is known of
        self.lid = lid

    @property
    def _tree(self):
        if self._centres is None:
            self._centres = cKDTree(self.corners.mean(axis=1))
        return self._centres

    def guess(self, x):
        """Return the cell with the nearest centre for every point, shape (n,), int32."""
        return self._nearest(x, 1)

    def _nearest(self, x, count):
        """Return the cells with the nearest centres; any for points that are not finite."""
        found = self._tree.query(x, k=count)[1].astype(np.int32)
        return np.minimum(found, np.int32(len(self.corners) - 1))

    def locate(self, x, guess):
        """Return the cell of every point and its hats in it.

        Args:
            x: points, shape (n, 2), m.
            guess: cell to start from, shape (n,); OUTSIDE where none is known. One of another mesh
                is as good as any.

        Returns:
            cell (n,) int32, OUTSIDE where the point is in no cell, and hats (n, k).
        """
        if self.lid is not None:
            top = np.interp(x[:, 0], *self.lid.T) - ON_FACET * np.ptp(self.corners[..., 1])
            x = np.column_stack([x[:, 0], np.minimum(x[:, 1], top)])
        guess = start = np.asarray(guess, np.int32)
        unknown = np.flatnonzero((guess < 0) | (guess >= len(self.corners)))
        if unknown.size:
            start = guess.copy()
            start[unknown] = self.guess(x[unknown])
        cell, weights = self._walk(x, start, self.corners, self.neighbours)
        stuck = np.flatnonzero(cell == OUTSIDE)
        if stuck.size:  # a walk can end at a concave wall although the point is inside
            near = self._nearest(x[stuck], min(24, len(self.corners)))
            for column in near.reshape(stuck.size, -1).T:
                left = np.flatnonzero(cell[stuck] == OUTSIDE)
                if not left.size:
                    break
                rows = stuck[left]
                cell[rows], weights[rows] = self._walk(
                    x[rows], column[left].astype(np.int32), self.corners, self.neighbours
                )
        return cell, weights


def held_inside(x, outline, held):
    """Return points with those beyond walls set back onto them, and how many there were.

    Args:
        x: points, shape (n, 2), m.
        outline: `scene.Outline`.
        held: for each of the four walls by name, whether it holds points.
    """
    left, right = outline.surface[[0, -1], 0]
    low = left if held["left"] else -np.inf
    high = right if held["right"] else np.inf
    lines = outline.base, outline.surface
    return _held_inside(x, low, high, *lines, held["base"], held["surface"])


@numba.njit(parallel=True, cache=True)
def _held_inside(x, low, high, base, surface, above_base, below_surface):
    inside, count = np.empty_like(x), 0
    for i in numba.prange(len(x)):
        across = min(max(x[i, 0], low), high)
        z = x[i, 1]
        if below_surface:
            z = min(z, _height(surface, across))
        if above_base:
            z = max(z, _height(base, across))
        inside[i, 0], inside[i, 1] = across, z
        if across != x[i, 0] or z != x[i, 1]:
            count += 1
    return inside, count


@numba.njit(cache=True)
def _height(line, x):
    """Return the height of a line, shape (n, 2), x ascending, as `numpy.interp` has it."""
    first, last = 0, len(line) - 1
    if x <= line[first, 0]:
        return line[first, 1]
    if x >= line[last, 0]:
        return line[last, 1]
    while last - first > 1:
        middle = (first + last) // 2
        if line[middle, 0] <= x:
            first = middle
        else:
            last = middle
    share = (x - line[first, 0]) / (line[last, 0] - line[first, 0])
    return line[first, 1] + share * (line[last, 1] - line[first, 1])


@numba.njit(parallel=True, cache=True)
def _walk(x, start, corners, neighbours):
    n = len(x)
    cell = np.empty(n, np.int32)
    weights = np.empty((n, 3))
    most = 2 * len(corners) + 8
    for i in numba.prange(n):
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
            if step == most - 1:
                c = -1
            if c < 0:
                weights[i] = 0.0
                break
        cell[i] = c
    return cell, weights


@numba.njit(parallel=True, cache=True)
def _walk_squares(x, start, corners, neighbours):
    n = len(x)
    cell = np.empty(n, np.int32)
    weights = np.empty((n, 4))
    most = 2 * len(corners) + 8
    for i in numba.prange(n):
        c = start[i]
        for step in range(most):
            r, s = _in_square(x[i], corners[c])
            # The facets of the reference square: s = 0, r = 0, r = 1, s = 1.
            k, least = 0, s
            if r < least:
                k, least = 1, r
            if 1.0 - r < least:
                k, least = 2, 1.0 - r
            if 1.0 - s < least:
                k, least = 3, 1.0 - s
            if least >= -ON_FACET:
                weights[i, 0], weights[i, 1] = (1 - r) * (1 - s), r * (1 - s)
                weights[i, 2], weights[i, 3] = (1 - r) * s, r * s
                break
            c = neighbours[c, k]
            if step == most - 1:
                c = -1
            if c < 0:
                weights[i] = 0.0
                break
        cell[i] = c
    return cell, weights


@numba.njit(cache=True)
def _in_square(point, corner):
    """Return the reference coordinates of a point by Newton's method for the bilinear map."""
    r, s = 0.5, 0.5
    for _ in range(20):
        fx, fz, jxr, jxs, jzr, jzs = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(4):
            hr, dr = (r, 1.0) if k % 2 else (1 - r, -1.0)
            hs, ds = (s, 1.0) if k // 2 else (1 - s, -1.0)
            fx += hr * hs * corner[k, 0]
            fz += hr * hs * corner[k, 1]
            jxr += dr * hs * corner[k, 0]
            jxs += hr * ds * corner[k, 0]
            jzr += dr * hs * corner[k, 1]
            jzs += hr * ds * corner[k, 1]
        fx, fz = point[0] - fx, point[1] - fz
        det = jxr * jzs - jxs * jzr
        if det == 0.0:
            break
        step_r, step_s = (fx * jzs - fz * jxs) / det, (jxr * fz - jzr * fx) / det
        r, s = r + step_r, s + step_s
        # far outside the map may fold over: stay where it still tells the direction
        r, s = min(max(r, -4.0), 5.0), min(max(s, -4.0), 5.0)
        if abs(step_r) + abs(step_s) < 1e-13:
            break
    return r, s


def seed(scene):
    """Return the particles of a scene, that no cell holds yet (see `relocate`).

    Args:
        scene: `scene.Scene`; a cloud of its own is taken as it is, each particle standing for the
            same area.
    """
    if scene.cloud is not None:
        x, unit = scene.cloud.x.copy(), scene.cloud.unit
        area = np.full(len(x), scene.outline.area / len(x))
    else:
        x, unit, area = seed_points(scene)
    nowhere = np.full(len(x), OUTSIDE, np.int32)
    return Particles(x, unit.astype(np.int16), area, x.copy(), nowhere)


def relocate(particles, index, x=None):
    """Return the particles with their cells found again, at ``x`` if it is given."""
    x = particles.x if x is None else x
    cell, _ = index.locate(x, particles.cell)
    return replace(particles, x=x, cell=cell)


def empty_cells(particles, n_cells, ranks=ALONE):
    """Return the cells that hold no particle of any rank, int32."""
    inside = particles.cell[particles.cell != OUTSIDE]
    counts = ranks.sum(np.bincount(inside, minlength=n_cells))
    return np.flatnonzero(counts == 0).astype(np.int32)


def born_in(cells, particles, index, ranks=ALONE):
    """Return new particles in ``cells``, with the unit of the nearest particle of any rank.

    Args:
        cells: cells to fill, int32.
        particles: located `Particles` of this rank.
        index: `CellIndex`.
        ranks: `ranks.Ranks`.

    Raises:
        ParticleError: no particle is left in the mesh.
    """
    centre = index.corners[cells].mean(axis=1)
    inside = np.flatnonzero(particles.inside)
    distance, near = nearest(particles.x[inside], centre)
    unit = particles.unit[inside][near] if inside.size else np.zeros(len(centre), np.int16)
    distance, unit = ranks.of_least(distance, unit)
    if np.isinf(distance).any():
        raise ParticleError(NONE_LEFT)
    return Particles(centre, unit, index.area[cells], np.full_like(centre, np.nan), cells)


def nearest(x, points):
    """Return distance and row of the nearest of ``x`` for every point; infinite where x is empty.

    Args:
        x, points: shapes (n, dim) and (m, dim), m.
    """
    if not len(x):
        return np.full(len(points), np.inf), np.zeros(len(points), int)
    return cKDTree(x).query(points)


def joined(*clouds):
    """Return the particles of some clouds in one, in order."""
    columns = ([getattr(cloud, n) for cloud in clouds] for n in Particles.__dataclass_fields__)
    return Particles(*(None if parts[0] is None else np.concatenate(parts) for parts in columns))


def subset(particles, rows):
    """Return some of the particles.

    Args:
        particles: `Particles`.
        rows: of those, numbers or a mask.
    """
    columns = {n: getattr(particles, n) for n in Particles.__dataclass_fields__}
    return Particles(**{n: None if v is None else v[rows] for n, v in columns.items()})

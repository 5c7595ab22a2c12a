"""Between particles and mesh: averages of the rock, and the velocity at points.

The ``hat`` projection weighs every particle by the linear hat functions of the vertices around
it, so the field is continuous in the particle positions; high order in time needs that. The means
per cell and around quadrature points are those of the paper (sect. 3.4).
"""

import basix
import numba
import numpy as np
from dolfinx import fem
from scipy.sparse import csr_matrix

from forms.rheology import VISCOSITY_OF_MEAN
from restoration.particles import OUTSIDE
from restoration.spaces import QUADRATURE_DEGREE

# Weight of the particles of neighbouring vertices in a hat mean, for every cell they share. It
# keeps the field smooth where a vertex loses the last particle of its own: see docs/accuracy.md.
BACKGROUND = 0.1

# f of `forms.rheology`, for the values of the particles.
AVERAGED = {
    "arithmetic": lambda eta: eta,
    "geometric": np.log,
    "harmonic": lambda eta: 1 / eta,
}


class RockFields:
    """Density and viscosity on the mesh, filled from particles.

    Args:
        spaces: `Spaces`.
        index: `CellIndex` of the same mesh.
        density: of every unit, shape (units,), kg/m^3.
        viscosity: of every unit over the reference viscosity, shape (units,).
        transfer: `scene.Transfer`.

    Attributes:
        rho: density, a Function, kg/m^3.
        eta: viscosity over the reference, a UFL expression.
    """

    def __init__(self, spaces, index, density, viscosity, transfer):
        self.spaces, self.index, self.transfer = spaces, index, transfer
        self._density = np.asarray(density, float)
        self._mean = AVERAGED[transfer.mean](np.asarray(viscosity, float))
        space = {"hat": spaces.Q, "cell": spaces.D, "quadrature": spaces.P}
        self.rho = fem.Function(space[transfer.density], name="density")
        self.theta = fem.Function(space[transfer.viscosity], name="theta")
        self.eta = VISCOSITY_OF_MEAN[transfer.mean](self.theta)
        self._points, _ = basix.make_quadrature(basix.CellType.triangle, QUADRATURE_DEGREE)
        self._around = None
        self._vertices = int(spaces.q_nodes.max()) + 1
        self._hats = np.full((self._vertices, 2), np.nan)

    def fill(self, x, cell, weights, unit, area):
        """Fill the fields from particles.

        Args:
            x: positions, shape (n, 2), m.
            cell: their cells, shape (n,); those OUTSIDE do not count.
            weights: barycentric coordinates, shape (n, 3).
            unit: row of the unit table, shape (n,).
            area: weight of each particle, shape (n,).
        """
        hats = self.hat_means(np.stack([self._density, self._mean], 1), cell, weights, unit, area)
        # Inside a step, before particles can be born there, such a vertex keeps what it had.
        hats = np.where(np.isnan(hats), self._hats, hats)
        self._hats = hats
        self.rho.x.array[:] = self._values(self.transfer.density, 0, hats, x, cell, unit, area)
        self.theta.x.array[:] = self._values(self.transfer.viscosity, 1, hats, x, cell, unit, area)

    def hat_means(self, table, cell, weights, unit, area):
        """Return the hat-weighted means at the vertices, shape (vertices, properties).

        NaN where no particle is within two cells.

        Args:
            table: values of every unit, shape (units, properties).
            cell, weights, unit, area: as in `fill`.
        """
        nodes = self.spaces.q_nodes
        return _hat_means(table, cell, weights, unit, area, nodes, self._vertices, BACKGROUND)

    def _values(self, kind, column, hats, x, cell, unit, area):
        if kind == "hat":
            return hats[:, column]
        table = (self._density, self._mean)[column]
        fallback = hats[self.spaces.q_nodes, column].mean(axis=1)
        if kind == "cell":
            return _cell_means(table[unit], cell, area, fallback)
        return self._around_points(table[unit], x, cell, area, fallback)

    def _around_points(self, values, x, cell, area, fallback):
        """Return arithmetic means within a radius of every quadrature point (paper, sect. 3.4)."""
        corners = self.index.corners
        if self._around is None:
            self._around = _cells_around(self.spaces.q_nodes)
        lam = np.column_stack([1 - self._points.sum(axis=1), self._points])
        radius = np.sqrt(self.index.area.min())
        inside = np.flatnonzero(cell != OUTSIDE)
        order = inside[np.argsort(cell[inside], kind="stable")]
        first = np.searchsorted(cell[order], np.arange(len(corners) + 1))
        points = np.einsum("qk,ckd->cqd", lam, corners)
        means = _point_means(
            points, radius, x[order], values[order], area[order], first, *self._around, fallback
        )
        return means.ravel()


@numba.njit(cache=True)
def _hat_means(table, cell, weights, unit, area, nodes, n_nodes, background):
    properties = table.shape[1]
    total = np.zeros((n_nodes, properties))
    weight = np.zeros(n_nodes)
    for i in range(len(cell)):
        c = cell[i]
        if c < 0:
            continue
        for k in range(3):
            w = weights[i, k] * area[i]
            weight[nodes[c, k]] += w
            for j in range(properties):
                total[nodes[c, k], j] += w * table[unit[i], j]
    near_total = np.zeros((n_nodes, properties))
    near_weight = np.zeros(n_nodes)
    for c in range(len(nodes)):
        for k in range(3):
            for m in range(3):
                near_weight[nodes[c, k]] += weight[nodes[c, m]]
                for j in range(properties):
                    near_total[nodes[c, k], j] += total[nodes[c, m], j]
    mean = np.empty((n_nodes, properties))
    for v in range(n_nodes):
        for j in range(properties):
            given = weight[v] + background * near_weight[v]
            mean[v, j] = (total[v, j] + background * near_total[v, j]) / given if given else np.nan
    return mean


@numba.njit(cache=True)
def _cell_means(values, cell, area, fallback):
    total = np.zeros(len(fallback))
    weight = np.zeros(len(fallback))
    for i in range(len(cell)):
        if cell[i] >= 0:
            total[cell[i]] += area[i] * values[i]
            weight[cell[i]] += area[i]
    for c in range(len(fallback)):
        total[c] = total[c] / weight[c] if weight[c] > 0 else fallback[c]
    return total


def _cells_around(nodes):
    """Return, for every cell, the cells that share a vertex with it: offsets and list."""
    cells = np.repeat(np.arange(len(nodes)), 3)
    incidence = csr_matrix((np.ones(nodes.size), (cells, nodes.ravel())))
    shared = (incidence @ incidence.T).tocsr()
    return shared.indptr, shared.indices


@numba.njit(cache=True)
def _point_means(points, radius, x, values, area, first, offsets, around, fallback):
    n_cells, n_points, _ = points.shape
    mean = np.empty((n_cells, n_points))
    for c in range(n_cells):
        for q in range(n_points):
            total = 0.0
            weight = 0.0
            for a in range(offsets[c], offsets[c + 1]):
                for i in range(first[around[a]], first[around[a] + 1]):
                    dx = x[i, 0] - points[c, q, 0]
                    dz = x[i, 1] - points[c, q, 1]
                    if dx * dx + dz * dz < radius * radius:
                        total += area[i] * values[i]
                        weight += area[i]
            mean[c, q] = total / weight if weight > 0 else fallback[c]
    return mean


def velocity_at(nodes, values, cell, weights):
    """Return the P2 velocity at points.

    Args:
        nodes: velocity nodes of every cell, shape (cells, 6).
        values: velocity at the nodes, shape (nodes, 2), m/s.
        cell: cells of the points, shape (n,); OUTSIDE gives zero.
        weights: barycentric coordinates, shape (n, 3).

    Returns:
        Velocity, shape (n, 2), m/s.
    """
    return _velocity_at(nodes, values, cell, weights)


@numba.njit(cache=True)
def _velocity_at(nodes, values, cell, weights):
    u = np.zeros((len(cell), 2))
    for i in range(len(cell)):
        c = cell[i]
        if c < 0:
            continue
        a, b, d = weights[i, 0], weights[i, 1], weights[i, 2]
        shape = (
            a * (2 * a - 1),
            b * (2 * b - 1),
            d * (2 * d - 1),
            4 * b * d,
            4 * a * d,
            4 * a * b,
        )
        for k in range(6):
            u[i, 0] += shape[k] * values[nodes[c, k], 0]
            u[i, 1] += shape[k] * values[nodes[c, k], 1]
    return u

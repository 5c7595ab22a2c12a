"""From rock to fields on the mesh: averages of particles, or the rock of every cell.

The ``hat`` projection weighs every particle by the linear hat functions of the vertices around
it, so the field is continuous in the particle positions; high order in time needs that. The means
per cell and around quadrature points are those of the paper (sect. 3.4). A ``linear`` one fits a
plane to the particles of every cell. The ``projection`` takes the smoothing of the hat means back,
so that its moments against the hats are those of the particles; it overshoots beside a jump, which
a density bears and a viscosity does not. With ``lines`` the moments are those of the rock between
the lines, exactly (see `line_rock`). Where mesh lines follow the rock nothing is averaged.
"""

import basix
import numba
import numpy as np
from dolfinx import fem
from scipy.sparse import coo_matrix, csr_matrix, identity
from scipy.sparse.linalg import splu

from forms.rheology import VISCOSITY_OF_MEAN
from meshes.box import AIR
from restoration.particles import OUTSIDE
from restoration.ranks import ALONE
from restoration.spaces import nodes

# Weight of the particles of neighbouring vertices in a hat mean, for every cell they share. It
# keeps the field smooth where a vertex loses the last particle of its own: see docs/accuracy.md.
BACKGROUND = 0.1
MOST_CHUNKS, CHUNK_PER_NODE = 8, 4  # chunks of particles; particles in one, for every vertex
ROUNDING = 1e-9  # of a mean of values that are all alike, relative
OVERSHOOT = 1.0  # of a density beside a jump at most, in differences of the rocks
MASS_DEGREE = 3  # of the quadrature of the mass matrix, exact on squares that are not skew

# f of `forms.rheology`, for the values of the particles.
AVERAGED = {
    "arithmetic": lambda eta: eta,
    "geometric": np.log,
    "harmonic": lambda eta: 1 / eta,
}

# and its inverse
MEAN_OF_AVERAGED = {
    "arithmetic": lambda mean: mean,
    "geometric": np.exp,
    "harmonic": lambda mean: 1 / mean,
}


class RockFields:
    """Density and viscosity on the mesh, filled from particles.

    Args:
        spaces: `Spaces`.
        index: `CellIndex` of the same mesh.
        density: of every unit, shape (units,), kg/m^3.
        viscosity: of every unit over the reference viscosity, shape (units,).
        transfer: `scene.Transfer`.
        air: (density, viscosity over the reference) of the cells of the region `AIR`, which hold no
            particles; None where there is no air.
        line_rock: `LineRock` of the same mesh where a transfer is ``lines``, else None.
        ranks: `ranks.Ranks` that have some of the particles each; all have the same fields.

    Attributes:
        unsure: number of cells whose rock the lines could not tell when they were filled last: it
            is the mean of their particles.
        bare: cells of rock with a corner that no particle was near when they were filled last.
        table: density and averaged viscosity of every unit, shape (units, 2).
        rho: density, a Function, kg/m^3; in the air that of the rock goes on.
        density: with that of the air, a UFL expression, kg/m^3.
        eta: viscosity over the reference, a UFL expression.
        in_air: which cells are air, shape (cells,), bool.
        on_facets: (density, eta) as integrals over facets can read them: values at the quadrature
            points of cells are not there, so that the means of the cells stand for them.
    """

    def __init__(
        self, spaces, index, density, viscosity, transfer, air=None, line_rock=None, ranks=ALONE
    ):
        self.spaces, self.index, self.transfer, self._ranks = spaces, index, transfer, ranks
        self._line_rock, self.unsure = line_rock, 0
        self._density = np.asarray(density, float)
        self._mean = AVERAGED[transfer.mean](np.asarray(viscosity, float))
        self.table = np.stack([self._density, self._mean], 1)
        space = {"hat": spaces.H, "cell": spaces.D, "quadrature": spaces.P}
        if "linear" in (transfer.density, transfer.viscosity):
            family = "DQ" if spaces.section.cell == "quadrilateral" else "DG"
            space["linear"] = fem.FunctionSpace(spaces.section.mesh, (family, 1))
        self.rho = fem.Function(space.get(transfer.density, spaces.H), name="density")
        self.theta = fem.Function(space.get(transfer.viscosity, spaces.D), name="theta")
        self._air = air
        self.in_air = np.zeros(len(spaces.h_nodes), bool)
        if air:
            self.in_air = spaces.section.regions == AIR
        self._cell_means = {}  # by what they are the means of
        self.density, self.eta = self._with_air(self.rho, self.theta)
        self.on_facets = self._with_air(*map(self._traced, (self.rho, self.theta)))
        cell = getattr(basix.CellType, spaces.section.cell)
        points, _ = basix.make_quadrature(cell, spaces.degree)
        hats = basix.create_element(basix.ElementFamily.P, cell, 1).tabulate(0, points)
        self._hats_at_points = hats[0, :, :, 0]
        self._around = None
        self._vertices = int(spaces.h_nodes.max()) + 1
        self._hats = np.full((self._vertices, 2), np.nan)
        self.bare = np.empty(0, np.int64)
        self._sharpened = None
        if transfer.density in ("projection", "lines"):
            self._sharpened = Sharpening(spaces, index, ~self.in_air)

    def fill(self, x, cell, weights, unit, area, lines=()):
        """Fill the fields from particles, and from lines where a transfer is ``lines``.

        Args:
            x: positions, shape (n, 2), m.
            cell: their cells, shape (n,); those OUTSIDE do not count.
            weights: hats of the points, shape (n, k), see `CellIndex`.
            unit: row of the unit table, shape (n,).
            area: weight of each particle, shape (n,).
            lines: moving lines at this moment.
        """
        hats = self.hat_means(self.table, cell, weights, unit, area)
        alone = np.isnan(hats[:, 0])
        bare = alone[self.spaces.h_nodes].any(axis=1) & ~self.in_air if alone.any() else ()
        self.bare = np.flatnonzero(bare)
        # Inside a step, before particles can be born there, such a vertex keeps what it had.
        hats = np.where(np.isnan(hats), self._hats, hats)
        if self._air:  # high in the air no particle is near
            hats = np.where(np.isnan(hats), [self._density[0], self._mean[0]], hats)
        self._hats = hats
        cloud = x, cell, weights, unit, area
        between = self._between(lines, hats, *cloud[1:]) if self._line_rock else None
        self.rho.x.array[:] = self._values(self.transfer.density, 0, hats, between, *cloud)
        self.theta.x.array[:] = self._values(self.transfer.viscosity, 1, hats, between, *cloud)
        self._find_means()

    def memory(self):
        """Return the fields as they were filled last, and what the next filling may keep of it."""
        return self.values() | {"hats": self._hats}

    def recall(self, memory):
        """Take the fields that `memory` returned."""
        self.set_values(memory)
        self._hats = memory["hats"]

    def values(self):
        """Return the values of the fields, by name."""
        return {"rho": self.rho.x.array.copy(), "theta": self.theta.x.array.copy()}

    def set_values(self, values):
        """Take the values that `values` returned."""
        self.rho.x.array[:], self.theta.x.array[:] = values["rho"], values["theta"]
        self._find_means()

    def _find_means(self):
        for values, means in self._cell_means.items():
            means.x.array[:] = cell_means(values)

    def ranges(self):
        """Return (name, function, least, most) of what the fields hold, most and least possible.

        The density may overshoot beside a jump.
        """
        theta = self._mean.min(), self._mean.max()
        return (
            ("density", self.rho, *_widened(*self._densities())),
            ("viscosity", self.theta, *_widened(*theta)),
        )

    def _densities(self):
        """Return the least and the greatest density that the field may have, kg/m^3."""
        low, high = self._density.min(), self._density.max()
        room = OVERSHOOT * (high - low)
        return low - room, high + room

    def _limited(self, values):
        """Return densities that overshoot no more than they may.

        Where few particles are left in a corner the projection has no hold: by several times what
        the rocks differ it overshot there.
        """
        return np.clip(values, *self._densities())

    def _traced(self, values):
        """Return a function that has values on facets: itself, or the means of its cells."""
        if values.function_space != self.spaces.P:
            return values
        return self._cell_means.setdefault(values, fem.Function(self.spaces.D))

    def _with_air(self, rho, theta):
        """Return density and viscosity of rock and air, UFL expressions."""
        eta = VISCOSITY_OF_MEAN[self.transfer.mean](theta)
        if not self._air:
            return rho, eta
        above = fem.Function(self.spaces.D)
        above.x.array[:] = self.in_air
        air_rho, air_eta = self._air
        return (1 - above) * rho + above * air_rho, (1 - above) * eta + above * air_eta

    def density_means(self):
        """Return the mean density of every cell, shape (cells,), kg/m^3."""
        means = cell_means(self.rho)
        return np.where(self.in_air, self._air[0], means) if self._air else means

    def viscosity_means(self):
        """Return the mean viscosity of every cell over the reference, shape (cells,)."""
        means = MEAN_OF_AVERAGED[self.transfer.mean](cell_means(self.theta))
        return np.where(self.in_air, self._air[1], means) if self._air else means

    def hat_means(self, table, cell, weights, unit, area):
        """Return the hat-weighted means at the vertices, shape (vertices, properties).

        NaN where no particle is within two cells.

        Args:
            table: values of every unit, shape (units, properties).
            cell, weights, unit, area: as in `fill`.
        """
        nodes, n = self.spaces.h_nodes, self._vertices
        chunks = min(MOST_CHUNKS, 1 + len(cell) // (CHUNK_PER_NODE * n))
        sums = self._ranks.sum(_hat_sums(table, cell, weights, unit, area, nodes, n, chunks))
        return _means_of_sums(sums, nodes, BACKGROUND)

    def shares(self, table, cell, weights, unit, area):
        """Return values of rocks at the vertices as the density has them, (vertices, properties).

        Args:
            table, cell, weights, unit, area: as in `hat_means`.
        """
        hats = self.hat_means(table, cell, weights, unit, area)
        return hats if self._sharpened is None else self._sharpened(hats)

    def _between(self, lines, hats, cell, weights, unit, area):
        """Return the moments of density and averaged viscosity by the lines, (cells, 3, 2)."""
        nodes = self.spaces.h_nodes
        moments, unsure = self._line_rock.moments(lines, self.table, (cell, weights, unit, area))
        self.unsure = int(np.count_nonzero(unsure))
        if self.unsure:
            for j in range(2):
                fallback = hats[nodes, j].mean(axis=1)
                means = self._means_in_cells(self.table[unit, j], cell, area, fallback)
                moments[unsure, :, j] = (means * self.index.area)[unsure, None] / 3
        return moments

    def _values(self, kind, column, hats, between, x, cell, weights, unit, area):
        if kind == "hat":
            return hats[:, column]
        if kind == "lines" and column == 0:
            nodes = self.spaces.h_nodes
            moments = np.bincount(nodes.ravel(), between[..., 0].ravel(), self._vertices)
            return self._limited(self._sharpened.with_moments(moments, hats[:, 0]))
        if kind == "lines":  # lines that cross each other a little take away what is not there
            means = between[..., 1].sum(axis=1) / self.index.area
            means[self.in_air] = self._mean[0]
            return np.clip(means, self._mean.min(), self._mean.max())
        if kind == "projection":
            return self._limited(self._sharpened(hats[:, column]))
        table = (self._density, self._mean)[column]
        fallback = hats[self.spaces.h_nodes, column].mean(axis=1)
        if kind == "cell":
            return self._means_in_cells(table[unit], cell, area, fallback)
        if kind == "linear":
            sums, low, high = _plane_sums(table[unit], cell, weights, area, len(fallback))
            sums, low, high = self._ranks.sum(sums), self._ranks.least(low), self._ranks.most(high)
            return _cell_planes(sums, low, high, weights.shape[1], fallback).ravel()
        return self._around_points(table[unit], x, cell, area, fallback)

    def _means_in_cells(self, values, cell, area, fallback):
        """Return the means of the particles of every cell, shape (cells,)."""
        return _means(self._ranks.sum(_cell_sums(values, cell, area, len(fallback))), fallback)

    def _around_points(self, values, x, cell, area, fallback):
        """Return arithmetic means within a radius of every quadrature point (paper, sect. 3.4)."""
        corners = self.index.corners
        if self._around is None:
            self._around = _cells_around(self.spaces.h_nodes)
        radius = np.sqrt(self.index.area)
        inside = np.flatnonzero(cell != OUTSIDE)
        order = inside[np.argsort(cell[inside], kind="stable")]
        first = np.searchsorted(cell[order], np.arange(len(corners) + 1))
        points = np.einsum("qk,ckd->cqd", self._hats_at_points, corners)
        sums = _point_sums(
            points, radius, x[order], values[order], area[order], first, *self._around
        )
        fallback = np.repeat(fallback, points.shape[1])
        return _means(self._ranks.sum(sums).reshape(-1, 2), fallback)


class Sharpening:
    """Takes the smoothing of hat means back: from them to the linear field with their moments.

    With particles that lie evenly the mean at a vertex is the integral of the density times a wide
    hat, over that of the wide hat alone, and the wide hats are B times the hats,

        B = I + BACKGROUND sum of 1_c 1_c^T over the cells c.

    So the moments against the hats are y of ``B y = S mean``, S the integrals of the wide hats, and
    the field is ``M rho = y`` with the mass matrix M. Constants are kept, however particles lie.

    Args:
        spaces: `Spaces`.
        index: `CellIndex` of the same mesh, which may move.
        rock: which cells hold particles, shape (cells,), bool; the field elsewhere is the mean.
    """

    def __init__(self, spaces, index, rock):
        self._index, self._rock, self._corners = index, rock, None
        nodes = spaces.h_nodes
        self._inner = np.unique(nodes[rock])
        number = np.zeros(int(nodes.max()) + 1, np.int64)
        number[self._inner] = np.arange(len(self._inner))
        self._nodes = number[nodes[rock]]
        cell = getattr(basix.CellType, spaces.section.cell)
        points, self._weights = basix.make_quadrature(cell, MASS_DEGREE)
        hats = basix.create_element(basix.ElementFamily.P, cell, 1).tabulate(1, points)[..., 0]
        self._hats, self._slopes = hats[0], hats[1:]
        n, k = nodes.shape
        shared = _summed(nodes, np.ones((n, k, k)), len(number))[self._inner][:, self._inner]
        self._wide = (identity(len(self._inner)) + BACKGROUND * shared).tocsc()
        self._narrowed = _factor(self._wide)

    def __call__(self, means):
        """Return the values at the vertices that have the moments of means, same shape."""
        self._follow_mesh()
        values, inner = means.copy(), self._inner
        values[inner] = self._mass.solve(self._narrowed.solve((self._size * means[inner].T).T))
        return values

    def with_moments(self, moments, values):
        """Return the values at the vertices that have moments against the hats, (vertices,).

        Args:
            moments: shape (vertices,).
            values: those of the vertices that are not of the rock, shape (vertices,).
        """
        self._follow_mesh()
        values, inner = values.copy(), self._inner
        values[inner] = self._mass.solve(moments[inner])
        return values

    def _follow_mesh(self):
        if self._index.corners is not self._corners:
            self._find_mass()

    def _find_mass(self):
        self._corners = self._index.corners
        axes = np.einsum("aqk,ckd->acqd", self._slopes, self._corners[self._rock])
        weight = np.abs(_determinant(axes)) * self._weights
        mass = np.einsum("cq,qi,qj->cij", weight, self._hats, self._hats, optimize=True)
        mass = _summed(self._nodes, mass, len(self._inner))
        self._size = self._wide @ np.asarray(mass.sum(axis=1)).ravel()
        self._mass = _factor(mass)


class FittedFields:
    """Density and viscosity on a mesh whose lines follow the rock: one rock in every cell.

    Args:
        spaces: `Spaces`.
        density, viscosity: of every unit, as for `RockFields`.
        unit: of every cell, shape (cells,).

    Attributes:
        rho, density, eta, on_facets, in_air, bare: as in `RockFields`.
    """

    def __init__(self, spaces, density, viscosity, unit):
        self.unit, self.bare = unit, np.empty(0, np.int64)
        self._ranges = _widened(np.min(density), np.max(density))
        self._ranges += _widened(np.min(viscosity), np.max(viscosity))
        self.rho = self.density = fem.Function(spaces.D, name="density")
        self.eta = fem.Function(spaces.D, name="viscosity")
        self.rho.x.array[:] = np.asarray(density, float)[unit]
        self.eta.x.array[:] = np.asarray(viscosity, float)[unit]
        self.on_facets = self.density, self.eta
        self.in_air = np.zeros(len(unit), bool)

    def ranges(self):
        """Return what `RockFields.ranges` does."""
        low, high, *eta = self._ranges
        return ("density", self.rho, low, high), ("viscosity", self.eta, *eta)

    def memory(self):
        """Return nothing: the units of the cells, which decide all, are known to the grid."""
        return {}

    def recall(self, memory):
        """Do nothing."""

    values, set_values = memory, recall

    def density_means(self):
        """Return the density of every cell, shape (cells,), kg/m^3."""
        return self.rho.x.array.copy()

    def viscosity_means(self):
        """Return the viscosity of every cell over the reference, shape (cells,)."""
        return self.eta.x.array.copy()


def _widened(low, high):
    """Return the ends of a range with room for rounding."""
    room = ROUNDING * max(abs(low), abs(high))
    return low - room, high + room


def cell_means(function):
    """Return the mean of the values of a function in every cell, shape (cells,)."""
    return function.x.array[nodes(function.function_space)].mean(axis=1)


def _determinant(axes):
    """Return the determinants of two or three vectors at many places, shape (dim, ..., dim)."""
    r, s, *t = axes
    if t:
        return np.einsum("...d,...d->...", np.cross(r, s), t[0])
    return r[..., 0] * s[..., 1] - r[..., 1] * s[..., 0]


def _summed(nodes, parts, n):
    """Return the sum of small matrices of the cells, shape (cells, k, k), as a sparse one."""
    rows = np.broadcast_to(nodes[:, :, None], parts.shape)
    columns = np.broadcast_to(nodes[:, None, :], parts.shape)
    return coo_matrix((parts.ravel(), (rows.ravel(), columns.ravel())), (n, n)).tocsc()


def _factor(matrix):
    """Return the factors of a symmetric positive definite matrix."""
    options = {"SymmetricMode": True}
    return splu(matrix, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options=options)


@numba.njit(parallel=True, cache=True)
def _hat_sums(table, cell, weights, unit, area, nodes, n_nodes, chunks):
    """Return the weight at every vertex, and what it is of every property, (vertices, 1 + p).

    Every thread sums up chunks of particles of its own; they are the same ones, and added in the
    same order, however many threads there are.
    """
    columns = 1 + table.shape[1]
    parts = np.zeros((chunks, n_nodes, columns))
    size = -(-len(cell) // chunks)
    for part in numba.prange(chunks):
        for i in range(part * size, min((part + 1) * size, len(cell))):
            c = cell[i]
            if c < 0:
                continue
            for k in range(nodes.shape[1]):
                w, node = weights[i, k] * area[i], nodes[c, k]
                parts[part, node, 0] += w
                for j in range(1, columns):
                    parts[part, node, j] += w * table[unit[i], j - 1]
    sums = np.empty((n_nodes, columns))
    for v in numba.prange(n_nodes):
        for j in range(columns):
            total = 0.0
            for part in range(chunks):
                total += parts[part, v, j]
            sums[v, j] = total
    return sums


@numba.njit(cache=True)
def _means_of_sums(sums, nodes, background):
    n_nodes, columns = sums.shape
    near = np.zeros((n_nodes, columns))
    for c in range(len(nodes)):
        for j in range(columns):
            total = 0.0
            for k in range(nodes.shape[1]):
                total += sums[nodes[c, k], j]
            for k in range(nodes.shape[1]):
                near[nodes[c, k], j] += total
    mean = np.empty((n_nodes, columns - 1))
    for v in range(n_nodes):
        given = sums[v, 0] + background * near[v, 0]
        for j in range(columns - 1):
            held = sums[v, j + 1] + background * near[v, j + 1]
            mean[v, j] = held / given if given else np.nan
    return mean


@numba.njit(cache=True)
def _cell_sums(values, cell, area, n_cells):
    """Return weighted sum of the values in every cell, and the weight, shape (cells, 2)."""
    sums = np.zeros((n_cells, 2))
    for i in range(len(cell)):
        if cell[i] >= 0:
            sums[cell[i], 0] += area[i] * values[i]
            sums[cell[i], 1] += area[i]
    return sums


def _means(sums, fallback):
    """Return the means of weighted sums and weights, shape (n, 2); a fallback where none is."""
    held = sums[:, 1] > 0
    return np.where(held, sums[:, 0] / np.where(held, sums[:, 1], 1.0), fallback)


# Least spread of the particles of a cell, over the cell's size squared, for a plane through them;
# a triangle evenly filled has 1/18 along each reference axis.
LEAST_SPREAD = 5e-3


@numba.njit(cache=True)
def _plane_sums(values, cell, hats, area, n_cells):
    """Return moments of the particles of every cell, their number last, and extreme values."""
    k = hats.shape[1]
    sums = np.zeros((n_cells, 10))  # w, r, s, v, rr, rs, ss, rv, sv, 1
    low, high = np.full(n_cells, np.inf), np.full(n_cells, -np.inf)
    for i in range(len(cell)):
        c = cell[i]
        if c < 0:
            continue
        r, s, v, w = hats[i, 1], hats[i, 2], values[i], area[i]
        if k == 4:
            r, s = r + hats[i, 3], s + hats[i, 3]
        sums[c, 9] += 1
        low[c], high[c] = min(low[c], v), max(high[c], v)
        for j, q in enumerate((1.0, r, s, v, r * r, r * s, s * s, r * v, s * v)):
            sums[c, j] += w * q
    return sums, low, high


@numba.njit(cache=True)
def _cell_planes(sums, low, high, k, fallback):
    """Return least-squares planes of the particles of every cell at its corners, (cells, k).

    A plane keeps the mean of the particles at their centre, and is flattened until it stays within
    their least and greatest value at every corner.
    """
    n_cells = len(fallback)
    planes = np.empty((n_cells, k))
    for c in range(n_cells):
        if sums[c, 9] == 0:
            planes[c, :] = fallback[c]
            continue
        w = sums[c, 0]
        r, s, v = sums[c, 1] / w, sums[c, 2] / w, sums[c, 3] / w
        rr, rs, ss = sums[c, 4] / w - r * r, sums[c, 5] / w - r * s, sums[c, 6] / w - s * s
        rv, sv = sums[c, 7] / w - r * v, sums[c, 8] / w - s * v
        det = rr * ss - rs * rs
        gr, gs = 0.0, 0.0
        if sums[c, 9] > 2 and det > LEAST_SPREAD**2:
            gr, gs = (ss * rv - rs * sv) / det, (rr * sv - rs * rv) / det
        scale = 1.0
        for j in range(k):
            slope = gr * ((j % 2 if k == 4 else (j == 1)) - r)
            slope += gs * ((j // 2 if k == 4 else (j == 2)) - s)
            planes[c, j] = slope
            if slope > 0:
                scale = min(scale, (high[c] - v) / slope)
            elif slope < 0:
                scale = min(scale, (low[c] - v) / slope)
        for j in range(k):
            planes[c, j] = v + scale * planes[c, j]
    return planes


def _cells_around(nodes):
    """Return, for every cell, the cells that share a vertex with it: offsets and list."""
    cells = np.repeat(np.arange(len(nodes)), nodes.shape[1])
    incidence = csr_matrix((np.ones(nodes.size), (cells, nodes.ravel())))
    shared = (incidence @ incidence.T).tocsr()
    return shared.indptr, shared.indices


@numba.njit(cache=True)
def _point_sums(points, radius, x, values, area, first, offsets, around):
    """Return weighted sum of the values around every point, and the weight, (cells, points, 2)."""
    n_cells, n_points, _ = points.shape
    sums = np.zeros((n_cells, n_points, 2))
    for c in range(n_cells):
        for q in range(n_points):
            for a in range(offsets[c], offsets[c + 1]):
                for i in range(first[around[a]], first[around[a] + 1]):
                    dx = x[i, 0] - points[c, q, 0]
                    dz = x[i, 1] - points[c, q, 1]
                    if dx * dx + dz * dz < radius[c] * radius[c]:
                        sums[c, q, 0] += area[i] * values[i]
                        sums[c, q, 1] += area[i]
    return sums

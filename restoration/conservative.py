"""A velocity for particles that is free of divergence at every point, after Wang et al. (2015).

A flow of Taylor-Hood elements is free of divergence on average only, so that particles crowd here
and thin out there. What they move in is interpolated from it in three steps:

1. The fluxes through the edges are made those of a stream function of the vertices, close to the
   fluxes of the flow; on walls they are the same.
2. The normal velocity at the middle of every edge is corrected to these fluxes.
3. In every cell, split at its barycentre in three parts with a quadratic velocity each, the values
   inside follow from those on the edges: there is one quadratic velocity without divergence.

It is continuous, of third order, and any quadratic flow without divergence stays as it is. Walls
that let in and out different amounts leave the section swelling evenly; that part is taken off
before and put back after.

Wang, Agrusta & van Hunen (2015), Geochem. Geophys. Geosyst. 16, 2015-2023, do this for linear and
bilinear velocities.
"""

import numba
import numpy as np
from scipy.sparse import csc_matrix, diags
from scipy.sparse.linalg import splu

from restoration.errors import MeshError
from restoration.sampling import VelocitySampler

# Nodes of a cell: corners, middles of the edges opposite them, the barycentre, and the middles
# between it and the corners.
CORNER, MIDDLE, CENTRE, SPOKE = 0, 3, 6, 7


def velocity_sampler(spaces, velocity="conservative"):
    """Return the sampler of a velocity at points.

    Args:
        spaces: `Spaces` of two dimensions.
        velocity: ``conservative`` or ``plain``. A Scott-Vogelius flow is free of divergence as it
            is; on several ranks, and for velocities that are not quadratic on triangles, plain is
            what there is.
    """
    wanted = velocity == "conservative" and not spaces.pair.split
    if wanted and spaces.pair.name.startswith("P2") and spaces.section.mesh.comm.size == 1:
        return ConservativeSampler(spaces)
    return VelocitySampler(spaces)


class ConservativeSampler:
    """Evaluates a velocity without divergence at points, in place of a `VelocitySampler`.

    It reads the mesh where it is now, so that it may be moved in between; the weights of the
    least-squares problem are those of the mesh as it was here.

    Args:
        spaces: `Spaces` of triangles with quadratic velocities; bubbles in them are left out.

    Raises:
        MeshError: the walls are not one closed line.
    """

    def __init__(self, spaces):
        self.section, self.nodes = spaces.section, np.ascontiguousarray(spaces.v_nodes[:, :6])
        vertex = np.unique(self.nodes[:, :3], return_inverse=True)[1].reshape(-1, 3)
        self._geometry = np.empty(vertex.max() + 1, np.int64)
        self._geometry[vertex] = self.section.corner_vertices
        self._cells = vertex
        ends = np.stack([np.roll(vertex, -1, axis=1), np.roll(vertex, -2, axis=1)], axis=2)
        middles = self.nodes[:, 3:]
        self._middles, first, cells = np.unique(middles, return_index=True, return_counts=True)
        a, b = ends.reshape(-1, 2)[first].T  # counter-clockwise in cells that are
        turned = _cross(*np.moveaxis(np.diff(self._x[vertex], axis=1), 1, 0))[first // 3] < 0
        self._a, self._b = np.where(turned, b, a), np.where(turned, a, b)
        self._node = np.empty(len(self._geometry), np.int64)  # of V, at the vertices
        self._node[vertex] = self.nodes[:, :3]
        self._rim = _loop(self._a, self._b, np.flatnonzero(cells == 1))
        self._inner = np.flatnonzero(cells == 2)
        self._inside = np.setdiff1d(np.arange(len(self._geometry)), self._a[self._rim])
        self._factorise()

    @property
    def _x(self):
        """The vertices where they are now, shape (vertices, 2), m."""
        return self.section.mesh.geometry.x[self._geometry, :2]

    def _factorise(self):
        """Prepare the least-squares problem for the stream function at the inner vertices."""
        a, b = self._a[self._inner], self._b[self._inner]
        row, one = np.arange(len(a)), np.ones(len(a))
        shape = len(a), len(self._geometry)
        step = csc_matrix((np.r_[one, -one], (np.r_[row, row], np.r_[b, a])), shape)
        self._step_rim = step[:, self._a[self._rim]]
        weight = diags(1 / ((self._x[b] - self._x[a]) ** 2).sum(axis=1))
        self._weighted = (step[:, self._inside].T @ weight).tocsr()
        matrix = (self._weighted @ step[:, self._inside]).tocsc()
        symmetric = {"SymmetricMode": True}
        self._solve = splu(matrix, "MMD_AT_PLUS_A", 0.0, options=symmetric).solve

    def coefficients(self, u):
        """Return the values at the nodes of the split cells, shape (cells, 10, 2).

        Args:
            u: velocity, shape (nodes, 2), m/s.
        """
        x = self._x
        u, swell, centre = self._closed(u, x)
        return _values_in_cells(u, x, self.nodes, self._cells, swell, centre, INSIDE)

    def _closed(self, u, x):
        """Return a velocity whose fluxes through edges close, but for an even swelling.

        Returns:
            The velocity (nodes, 2), half the divergence of the swelling, 1/s, and its centre.
        """
        centre = x.mean(axis=0)
        flux, lever = _fluxes(u, x, self._a, self._b, self._node, self._middles, centre)
        rim = self._rim
        area = _cross(x[self._a[rim]] - centre, x[self._b[rim]] - centre).sum() / 2
        swell = flux[rim].sum() / area / 2
        flux -= swell * lever
        stream = np.zeros(len(x))
        stream[self._a[rim]] = np.r_[0, np.cumsum(flux[rim])[:-1]]
        left = flux[self._inner] - self._step_rim @ stream[self._a[rim]]
        stream[self._inside] = self._solve(self._weighted @ left)
        flux[rim] = stream[self._b[rim]] - stream[self._a[rim]]
        u = u.copy()
        _correct(u, x, self._a, self._b, self._middles, stream, flux)
        return u, swell, centre

    def __call__(self, coefficients, cell, hats):
        """Return the velocity at points, shape (n, 2), m/s.

        Args:
            coefficients: of `coefficients`.
            cell: cells of the points, shape (n,); OUTSIDE gives zero.
            hats: of the points, shape (n, 3), see `CellIndex`.
        """
        return _split_quadratic(coefficients, cell, hats)


def _loop(a, b, rim):
    """Return the wall edges from a to b in the order of one walk around."""
    after = dict(zip(a[rim].tolist(), rim.tolist(), strict=True))
    walk = [rim[0]]
    while len(walk) < len(rim) and (edge := after[b[walk[-1]]]) != rim[0]:
        walk.append(edge)
    if len(walk) != len(rim):
        raise MeshError("the walls of the section are not one closed line")
    return np.array(walk)


def _cross(one, two):
    """Return the cross products of vectors."""
    return one[..., 0] * two[..., 1] - one[..., 1] * two[..., 0]


def _part(k):
    """Return the nodes of the part of a cell at the edge opposite corner k.

    Two corners and the barycentre, then the middles of the edges opposite to them.
    """
    i, j = (k + 1) % 3, (k + 2) % 3
    return [CORNER + i, CORNER + j, CENTRE, SPOKE + j, SPOKE + i, MIDDLE + k]


def _inside():
    """Return the map of the values on the edges of the reference triangle to those inside, (8, 12).

    At the corners of each part its divergence, which is linear, vanishes. These nine equations
    hold for edges that let in what they let out.
    """
    corners = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [1 / 3, 1 / 3]])
    rows = []
    for k in range(3):
        nodes = _part(k)
        place = corners[[nodes[0], nodes[1], 3]]
        slope = np.linalg.inv(np.column_stack([place, np.ones(3)]))[:2].T  # of the three hats
        for at in range(3):
            row = np.zeros((10, 2))
            for corner in range(3):
                i, j = (corner + 1) % 3, (corner + 2) % 3
                row[nodes[corner]] = (4 * (corner == at) - 1) * slope[corner]
                row[nodes[3 + corner]] = 4 * ((i == at) * slope[j] + (j == at) * slope[i])
            rows.append(row.ravel())
    known, unknown = np.split(np.array(rows), [12], axis=1)
    return -np.linalg.pinv(unknown) @ known


INSIDE = _inside()


@numba.njit(parallel=True, cache=True)
def _fluxes(u, x, a, b, node, middles, centre):
    """Return the fluxes of a velocity through the edges, and of places seen from a centre."""
    flux, lever = np.empty(len(a)), np.empty(len(a))
    for e in numba.prange(len(a)):
        i, j = a[e], b[e]
        nx, nz = x[j, 1] - x[i, 1], x[i, 0] - x[j, 0]  # outwards on walls
        first, middle, last = u[node[i]], u[middles[e]], u[node[j]]
        sum_x = first[0] + 4 * middle[0] + last[0]
        sum_z = first[1] + 4 * middle[1] + last[1]
        flux[e] = (sum_x * nx + sum_z * nz) / 6
        away_x, away_z = (x[i, 0] + x[j, 0]) / 2 - centre[0], (x[i, 1] + x[j, 1]) / 2 - centre[1]
        lever[e] = away_x * nx + away_z * nz
    return flux, lever


@numba.njit(parallel=True, cache=True)
def _correct(u, x, a, b, middles, stream, flux):
    """Correct the normal velocity at the middles of edges to the fluxes of a stream function."""
    for e in numba.prange(len(a)):
        nx, nz = x[b[e], 1] - x[a[e], 1], x[a[e], 0] - x[b[e], 0]
        more = 1.5 * (stream[b[e]] - stream[a[e]] - flux[e]) / (nx * nx + nz * nz)
        u[middles[e], 0] += more * nx
        u[middles[e], 1] += more * nz


@numba.njit(parallel=True, cache=True)
def _split_quadratic(values, cell, hats):
    u = np.empty((len(cell), 2))
    for n in numba.prange(len(cell)):
        c = cell[n]
        if c < 0:
            u[n] = 0.0
            continue
        k = 0
        if hats[n, 1] < hats[n, k]:
            k = 1
        if hats[n, 2] < hats[n, k]:
            k = 2
        i, j = (k + 1) % 3, (k + 2) % 3
        centre = 3 * hats[n, k]
        one, two = hats[n, i] - hats[n, k], hats[n, j] - hats[n, k]
        for d in range(2):
            u[n, d] = (
                one * (2 * one - 1) * values[c, i, d]
                + two * (2 * two - 1) * values[c, j, d]
                + centre * (2 * centre - 1) * values[c, 6, d]
                + 4 * one * two * values[c, 3 + k, d]
                + 4 * one * centre * values[c, 7 + i, d]
                + 4 * two * centre * values[c, 7 + j, d]
            )
    return u


@numba.njit(parallel=True, cache=True)
def _values_in_cells(u, x, nodes, cells, swell, centre, inside):
    """Return the values at the nodes of the split cells, see `ConservativeSampler.coefficients`."""
    values = np.empty((len(cells), 10, 2))
    for c in numba.prange(len(cells)):
        places, straight = np.empty((10, 2)), np.empty(12)
        for d in range(2):
            a, b, e = x[cells[c, 0], d], x[cells[c, 1], d], x[cells[c, 2], d]
            places[0, d], places[1, d], places[2, d] = a, b, e
            places[3, d], places[4, d], places[5, d] = (b + e) / 2, (a + e) / 2, (a + b) / 2
            middle = (a + b + e) / 3
            places[6, d] = middle
            places[7, d], places[8, d], places[9, d] = (
                (a + middle) / 2,
                (b + middle) / 2,
                (e + middle) / 2,
            )
        one_x, one_z = places[1, 0] - places[0, 0], places[1, 1] - places[0, 1]
        two_x, two_z = places[2, 0] - places[0, 0], places[2, 1] - places[0, 1]
        size = one_x * two_z - one_z * two_x
        for k in range(6):
            ux, uz = u[nodes[c, k], 0], u[nodes[c, k], 1]
            values[c, k, 0], values[c, k, 1] = ux, uz
            ux -= swell * (places[k, 0] - centre[0])
            uz -= swell * (places[k, 1] - centre[1])
            straight[2 * k] = ux * two_z - uz * two_x
            straight[2 * k + 1] = one_x * uz - one_z * ux
        for k in range(4):
            r, s = 0.0, 0.0
            for m in range(12):
                r += inside[2 * k, m] * straight[m]
                s += inside[2 * k + 1, m] * straight[m]
            values[c, 6 + k, 0] = (r * one_x + s * two_x) / size + swell * (
                places[6 + k, 0] - centre[0]
            )
            values[c, 6 + k, 1] = (r * one_z + s * two_z) / size + swell * (
                places[6 + k, 1] - centre[1]
            )
    return values

"""The velocity at points, for every pair of elements."""

from itertools import product

import basix
import basix.ufl_wrapper
import numba
import numpy as np

from restoration.tetra import polynomial


class VelocitySampler:
    """Evaluates a velocity at points, for any element of `forms.elements`.

    On every cell the velocity is a polynomial of the reference coordinates. Its coefficients are
    found once for a flow; a point then costs a short sum.

    Args:
        spaces: `Spaces` of triangles, squares or tetrahedra.
    """

    def __init__(self, spaces):
        self.nodes = spaces.v_nodes
        cell = spaces.section.cell
        element = basix.ufl_wrapper.convert_ufl_element(spaces.pair.velocity(cell)).element
        self._square = cell == "quadrilateral"
        self._powers = _powers(element.highest_degree, spaces.section.dim, self._square)
        points = basix.create_lattice(element.cell_type, 8, basix.LatticeType.equispaced, True)
        values = element.tabulate(0, points)[0, :, :, 0]
        monomials = np.prod(points[:, None, :] ** self._powers[None], axis=2)
        # Shape functions as sums of monomials, exactly: the lattice is finer than their degree.
        self._shape = np.linalg.lstsq(monomials, values, rcond=None)[0].T

    def coefficients(self, u):
        """Return the coefficients of a velocity (nodes, dim), shape (cells, monomials, dim)."""
        return np.einsum("km,ckd->cmd", self._shape, u[self.nodes])

    def __call__(self, coefficients, cell, hats):
        """Return the velocity at points, shape (n, dim), m/s.

        Args:
            coefficients: of `coefficients`.
            cell: cells of the points, shape (n,); OUTSIDE gives zero.
            hats: of the points, shape (n, k), see `CellIndex`.
        """
        if self._powers.shape[1] == 3:
            return polynomial(coefficients, self._powers, cell, hats)
        return _polynomial(coefficients, self._powers, cell, hats, self._square)


def _powers(degree, dim, square):
    """Return the powers of the monomials of a degree, shape (monomials, dim)."""
    powers = product(range(degree + 1), repeat=dim)
    return np.array([each for each in powers if square or sum(each) <= degree])


@numba.njit(parallel=True, cache=True)
def _polynomial(coefficients, powers, cell, hats, square):
    u = np.empty((len(cell), 2))
    for i in numba.prange(len(cell)):
        c, ux, uz = cell[i], 0.0, 0.0
        if c >= 0:
            r, s = hats[i, 1], hats[i, 2]
            if square:
                r, s = r + hats[i, 3], s + hats[i, 3]
            for m in range(len(powers)):
                value = 1.0
                for _ in range(powers[m, 0]):
                    value *= r
                for _ in range(powers[m, 1]):
                    value *= s
                ux += coefficients[c, m, 0] * value
                uz += coefficients[c, m, 1] * value
        u[i, 0], u[i, 1] = ux, uz
    return u

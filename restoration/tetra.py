"""Points in tetrahedra: walking from cell to cell, and a polynomial velocity at points."""

import numba
import numpy as np

ON_FACET = 1e-10  # barycentric slack of a point on a facet, as in two dimensions


@numba.njit(cache=True)
def _barycentric(point, corner, hats):
    """Write the barycentric coordinates of a point in a tetrahedron to ``hats``, shape (4,)."""
    x, y, z = corner[0, 0], corner[0, 1], corner[0, 2]
    ax, ay, az = corner[1, 0] - x, corner[1, 1] - y, corner[1, 2] - z
    bx, by, bz = corner[2, 0] - x, corner[2, 1] - y, corner[2, 2] - z
    cx, cy, cz = corner[3, 0] - x, corner[3, 1] - y, corner[3, 2] - z
    px, py, pz = point[0] - x, point[1] - y, point[2] - z
    # the cofactors of the edges a, b and c
    bcx, bcy, bcz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    det = ax * bcx + ay * bcy + az * bcz
    hats[1] = (px * bcx + py * bcy + pz * bcz) / det
    pax, pay, paz = py * az - pz * ay, pz * ax - px * az, px * ay - py * ax
    hats[2] = -(pax * cx + pay * cy + paz * cz) / det
    hats[3] = (pax * bx + pay * by + paz * bz) / det
    hats[0] = 1.0 - hats[1] - hats[2] - hats[3]


@numba.njit(parallel=True, cache=True)
def walk(x, start, corners, neighbours):
    """Return the cell of points and their hats in it, by walking through the mesh.

    Args:
        x: points, shape (n, 3), m.
        start: cell to start from, shape (n,), int32.
        corners: of every cell, shape (cells, 4, 3), m.
        neighbours: cell across the facet opposite every corner, shape (cells, 4); -1 on a wall.

    Returns:
        cell (n,) int32, -1 where a walk has left the mesh, and hats (n, 4).
    """
    n = len(x)
    cell, hats = np.empty(n, np.int32), np.empty((n, 4))
    most = 2 * len(corners) + 8
    for i in numba.prange(n):
        c = start[i]
        for step in range(most):
            _barycentric(x[i], corners[c], hats[i])
            k = np.argmin(hats[i])
            if hats[i, k] >= -ON_FACET:
                break
            c = neighbours[c, k] if step < most - 1 else -1
            if c < 0:
                hats[i] = 0.0
                break
        cell[i] = c
    return cell, hats


@numba.njit(parallel=True, cache=True)
def polynomial(coefficients, powers, cell, hats):
    """Return the velocity at points, shape (n, 3), m/s; zero where they are in no cell.

    Args:
        coefficients: of the monomials in every cell, shape (cells, monomials, 3), m/s.
        powers: of the reference coordinates, shape (monomials, 3).
        cell, hats: of `walk`.
    """
    u = np.zeros((len(cell), 3))
    for i in numba.prange(len(cell)):
        c = cell[i]
        if c < 0:
            continue
        for m in range(len(powers)):
            value = 1.0
            for axis in range(3):
                for _ in range(powers[m, axis]):
                    value *= hats[i, 1 + axis]
            for axis in range(3):
                u[i, axis] += coefficients[c, m, axis] * value
    return u

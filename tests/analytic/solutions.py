"""Exact solutions, as plain functions with their source."""

import numpy as np


def solcx(contrast, at=0.5):
    """Return the velocity and pressure of SolCx: a sinusoidal weight over a viscosity step.

    Unit square, free slip all around, ``eta = 1`` left of ``at`` and ``contrast`` right of it,
    body force ``sin(pi z) cos(pi x)`` upwards. With ``u = U(x) cos(pi z)`` the Stokes equations
    become one ordinary equation of fourth order for U on each side, whose eight constants follow
    from the walls and from the continuity of velocity and traction at the step.
    Source: Zhong (1996), Analytic solutions for Stokes' flow with lateral variations in viscosity;
    derived anew here.

    Returns:
        A function of points (n, 2) giving velocity (n, 2) and pressure (n,).
    """
    pi = np.pi

    def basis(x, order):
        """The four homogeneous solutions, scaled to stay near 1, and their derivatives."""
        out = []
        for sign, origin in ((1, 1.0), (-1, 0.0)):
            e = np.exp(sign * pi * (x - origin))
            k = sign * pi
            out += [k**order * e, (k**order * x + order * k ** (order - 1)) * e]
        return np.array(out)

    def particular(x, order, eta):
        """U_p = c sin(pi x), from eta (U'''' - 2 pi^2 U'' + pi^4 U) = -pi^2 sin(pi x)."""
        c = -1 / (4 * eta * pi**2)
        return c * pi**order * np.sin(pi * x + order * pi / 2)

    def rows(x, eta):
        """Values of U, U', sigma_xx, sigma_xz (over pi) at x: coefficients and particular part."""

        def stress(value):
            u, du, d2u, d3u = (value(n) for n in range(4))
            # P from the vertical balance; W = -U'/pi
            p = -(eta * (-d3u / pi + pi * du)) / pi
            return [u, du, 2 * eta * du - p, eta * (-d2u / pi - pi * u)]

        homogeneous = stress(lambda n: basis(x, n))
        special = stress(lambda n: particular(x, n, eta))
        special[2] += np.cos(pi * x) / pi  # the weight's share of the pressure
        return np.array(homogeneous), np.array(special)

    eta_of = (1.0, float(contrast))
    matrix, right = np.zeros((8, 8)), np.zeros(8)
    for i, (x, side) in enumerate(((0.0, 0), (1.0, 1))):
        for j, order in enumerate((0, 2)):
            matrix[2 * i + j, 4 * side : 4 * side + 4] = basis(x, order)
            right[2 * i + j] = -particular(x, order, eta_of[side])
    one, p_one = rows(at, eta_of[0])
    two, p_two = rows(at, eta_of[1])
    matrix[4:, :4], matrix[4:, 4:] = one, -two
    right[4:] = p_two - p_one
    scale = np.abs(matrix).max(axis=1)
    constants = np.linalg.solve(matrix / scale[:, None], right / scale)

    def solution(points):
        x, z = points[:, 0], points[:, 1]
        side = (x > at).astype(int)
        eta = np.array(eta_of)[side]
        c = constants.reshape(2, 4)[side].T
        d = [(c * basis(x, n)).sum(axis=0) + particular(x, n, eta) for n in range(4)]
        u = np.column_stack([d[0] * np.cos(pi * z), -d[1] / pi * np.sin(pi * z)])
        p = -(eta * (-d[3] / pi + pi * d[1]) + np.cos(pi * x)) / pi * np.cos(pi * z)
        return u, p

    return solution


def manufactured(points):
    """Return a smooth velocity and pressure in the unit square; u = 0 on the walls, div(u) = 0."""
    x, z = np.pi * points[:, 0], np.pi * points[:, 1]
    u = np.column_stack([np.sin(x) ** 2 * np.sin(2 * z), -np.sin(2 * x) * np.sin(z) ** 2])
    return u, np.cos(x) * np.cos(z)

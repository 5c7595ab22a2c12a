"""Exact solutions, as plain functions of points with their source.

Points are rows (x, z), shape (n, 2), z up. The Stokes solutions are dimensionless and obey
``div(2 eta D(u) - p I) + f = 0`` and ``div(u) = 0``; p is positive in compression.
"""

import numpy as np


def solcx(contrast, at=0.5):
    """Return the velocity and pressure of SolCx: a sinusoidal weight over a viscosity step.

    Unit square, free slip all around, ``eta = 1`` left of ``at`` and ``contrast`` right of it,
    body force ``sin(pi z) cos(pi x)`` upwards. With ``u = U(x) cos(pi z)`` the Stokes equations
    become one equation of fourth order for U on each side, whose eight constants follow from the
    walls and from the continuity of velocity and traction at the step.
    Source: Zhong (1996), Analytic solutions for Stokes' flow...; derived anew here.

    Args:
        contrast: viscosity right of the step over that left of it.
        at: place of the step, between 0 and 1.

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

    def state(d, eta):
        """U, U', sigma_xx and sigma_xz (over pi), but for the weight's own share of sigma_xx."""
        p = -eta * (-d[3] / pi + pi * d[1]) / pi  # from the vertical balance, with W = -U'/pi
        return np.array([d[0], d[1], 2 * eta * d[1] - p, eta * (-d[2] / pi - pi * d[0])])

    eta_of = (1.0, float(contrast))
    matrix, right = np.zeros((8, 8)), np.zeros(8)
    for side, eta in enumerate(eta_of):
        own, sign = slice(4 * side, 4 * side + 4), 1 - 2 * side
        for row, order in ((2 * side, 0), (2 * side + 1, 2)):  # the wall is at x = side
            matrix[row, own] = basis(side, order)
            right[row] = -particular(side, order, eta)
        matrix[4:, own] = sign * state([basis(at, n) for n in range(4)], eta)
        right[4:] -= sign * state([particular(at, n, eta) for n in range(4)], eta)
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


def solkz_density(points, m=2.0):
    """Return the density of SolKz, (n,): -sin(m z) cos(3 pi x).

    Under a gravity of 1 downwards the body force is ``f_z = -rho``: upwards where rho < 0.
    """
    return -np.sin(m * points[:, 1]) * np.cos(3 * np.pi * points[:, 0])


def solkz(contrast, m=2.0):
    """Return the velocity and pressure of SolKz: viscosity that grows exponentially upwards.

    Unit square, free slip all around, ``eta = contrast**z = exp(2 B z)``, 1 at the base, body
    force ``-solkz_density`` upwards. With ``w = W(z) cos(k x)`` and ``W = exp(-B z) Y(z)`` the
    homogeneous equation is ``Y_zzzz - 2 (B^2 + k^2) Y_zz + (B^4 + 6 B^2 k^2 + k^4) Y = 0``, with
    roots ``+-a +- ib``, ``(a + ib)^2 = B^2 + k^2 + 2ikB``. Taking ``sin(b z) / b`` for the second
    solution of each pair keeps the case B = 0 regular.
    Source: Revenaugh & Parsons (1987), weight of Duretz et al. (2011), m = 2; derived anew here.

    Args:
        contrast: viscosity at the top over that at the base, > 0.
        m: wave number of the weight in z.

    Returns:
        A function of points (n, 2) giving velocity (n, 2) and pressure (n,).
    """
    k, growth = 3 * np.pi, np.log(contrast) / 2  # growth is B
    root = np.sqrt(growth**2 + k**2 + 2j * k * growth)
    a, b = root.real, root.imag

    def basis(z, order):
        """The four homogeneous solutions W, scaled to stay near 1, and their derivatives."""
        out = []
        for rate in (a - growth, -a - growth):
            even, odd = 1.0, 0.0  # (rate + ib)^order = even + i b odd
            for _ in range(order):
                even, odd = rate * even - b**2 * odd, rate * odd + even
            y = z - (rate > 0)
            e, cos, sin = np.exp(rate * y), np.cos(b * y), y * np.sinc(b * y / np.pi)
            out += [e * (even * cos - b**2 * odd * sin), e * (even * sin + odd * cos)]
        return np.array(out)

    def particular(z, order):
        """Im(k^2 exp(q z) / L(q)), from L(d/dz) W = k^2 exp(-2 B z) sin(m z)."""
        q = -2 * growth + 1j * m
        over = ((q + 2 * growth) ** 2 + k**2) * (q**2 + k**2) - 4 * k**2 * q * (q + 2 * growth)
        return (k**2 * q**order * np.exp(q * z) / over).imag

    ends = [(0.0, 0), (0.0, 2), (1.0, 0), (1.0, 2)]
    constants = -np.linalg.solve([basis(*end) for end in ends], [particular(*end) for end in ends])

    def solution(points):
        x, z = points[:, 0], points[:, 1]
        d = [constants @ basis(z, n) + particular(z, n) for n in range(4)]
        u = np.column_stack([-d[1] / k * np.sin(k * x), d[0] * np.cos(k * x)])
        # P from the horizontal balance, with the shear stress -eta (W'' + k^2 W) / k
        bent = d[3] + k**2 * d[1] + 2 * growth * (d[2] + k**2 * d[0])
        p = np.exp(2 * growth * z) * (bent / k**2 - 2 * d[1]) * np.cos(k * x)
        return u, p

    return solution


def solvi(contrast, radius=0.2):
    """Return the velocity and pressure of SolVi: a viscous inclusion in pure shear.

    A disc of viscosity ``contrast`` around the origin in a matrix of viscosity 1, no weight; far
    away ``u = (x, -z)``. The plane is unbounded: a box has to prescribe this velocity on its walls.
    The reference box is the unit square with the centre in its lower left corner, where free slip
    does as well on the left and the base, both lines of symmetry.
    Source: Schmid & Podladchikov (2003), Analytical solutions for deformable elliptical inclusions
    in general shear, circular case; derived anew from the potentials ``phi = -2 A a^2 / c`` and
    ``psi = -2 (c + A a^4 / c^3)``, with c = x + iz and A = (contrast - 1) / (contrast + 1).

    Args:
        contrast: viscosity of the inclusion over that of the matrix, >= 0.
        radius: radius a of the inclusion.

    Returns:
        A function of points (n, 2) giving velocity (n, 2) and pressure (n,).
    """
    amplitude = (contrast - 1) / (contrast + 1)

    def solution(points):
        c = points[:, 0] + 1j * points[:, 1]
        inside = np.abs(c) <= radius
        s = radius / np.where(inside, radius, c)  # a / c, outside only
        v = c - amplitude * (radius * s.conj() + c.conj() * s**2 - radius * s**3)  # u - iw
        v = np.where(inside, 2 / (contrast + 1) * c, v)
        p = np.where(inside, 0.0, -4 * amplitude * (s**2).real)
        return np.column_stack([v.real, -v.imag]), p

    return solution


def manufactured(points):
    """Return a smooth velocity and pressure in the unit square; u = 0 on the walls, div(u) = 0."""
    x, z = np.pi * points[:, 0], np.pi * points[:, 1]
    u = np.column_stack([np.sin(x) ** 2 * np.sin(2 * z), -np.sin(2 * x) * np.sin(z) ** 2])
    return u, np.cos(x) * np.cos(z)


def two_layer_growth_rate(k, h1, h2, eta1, eta2, drho, g):
    """Return the linear growth rate of the interface between two layers, no slip above and below.

    Source: Ramberg (1968), the paper's eqs. A1-A3, with the sign of A1 changed so that a heavy top
    layer sinks. Written ``drho g D / (2 k (D S - C^2))``, with ``C = eta1 c1 - eta2 c2``, D and S
    alike with plus signs, nothing cancels or overflows.

    Args:
        k: wave number 2 pi / lambda, 1/m; a number or an array.
        h1, h2: thickness of the top and the bottom layer, m.
        eta1, eta2: their viscosities, Pa s.
        drho: density of the top layer less that of the bottom layer, kg/m^3.
        g: gravity, m/s^2.

    Returns:
        Growth rate, 1/s, of the shape of ``k``; the interface moves at this rate times its height.
    """

    def excess(x):
        """(sinh(x) - x) exp(-x), by its series where the difference would cancel."""
        y, series = np.minimum(x, 1.0), 1.0
        for n in range(17, 3, -2):
            series = 1 + y**2 / (n * (n - 1)) * series
        short, scale = y**3 / 6 * series, np.exp(-x)
        return np.where(x < 1, short * scale, -np.expm1(-2 * x) / 2 - x * scale)

    def layer(h):
        """2 f^2, sinh 2f - 2f and sinh 2f + 2f, over cosh 2f - 1 - 2 f^2 = 2 (sinh^2 f - f^2)."""
        f = np.asarray(k * h, float)
        small, d, scale = excess(f), excess(2 * f), np.exp(-f)
        over = 2 * small * (small + 2 * f * scale)
        return 2 * (f * scale) ** 2 / over, d / over, (d + 4 * f * scale**2) / over

    (c1, d1, s1), (c2, d2, s2) = layer(h1), layer(h2)
    c, d, s = eta1 * c1 - eta2 * c2, eta1 * d1 + eta2 * d2, eta1 * s1 + eta2 * s2
    return drho * g / (2 * k) * d / (d * s - c**2)


def constant_speed_rotation(speed, centre):
    """Return the flow that turns every point around ``centre`` at the same speed.

    Source: the paper's appendix C, with e_theta = (-sin, cos); eq. C1 prints (sin, cos), which is
    not tangential. A point at the radius r returns after 2 pi r / speed.

    Args:
        speed: m/s; positive turns from x towards z.
        centre: (x, z), m; no point may lie there.

    Returns:
        ``velocity(points)``, (n, 2), m/s, and ``place(points, time)``, the points after a time, s.
    """

    def velocity(points):
        x, z = (points - centre).T
        return speed * np.column_stack([-z, x]) / np.hypot(x, z)[:, None]

    def place(points, time):
        c = (points - centre) @ (1, 1j)
        c *= np.exp(1j * speed * time / np.abs(c))
        return centre + np.column_stack([c.real, c.imag])

    return velocity, place


def single_vortex(period):
    """Return the time-reversed vortex ``velocity(points, time)``, (n, 2), in the unit square.

    ``u = (-dpsi/dz, dpsi/dx)``, ``psi = sin^2(pi x) sin^2(pi z) cos(pi t / period) / pi``; every
    point is back after one period. Source: LeVeque (1996), turning the other way.
    """

    def velocity(points, time):
        x, z = np.pi * points[:, 0], np.pi * points[:, 1]
        u = [-(np.sin(x) ** 2) * np.sin(2 * z), np.sin(z) ** 2 * np.sin(2 * x)]
        return np.cos(np.pi * time / period) * np.column_stack(u)

    return velocity

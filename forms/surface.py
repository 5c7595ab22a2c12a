"""Integrands over a surface in contact with air: its weight when moved, and its flux.

They are summed over both sides of the surface where air above it is meshed too: the outward normals
are opposite, so that the contrast of the density remains.
"""

from ufl import dot


def stabilisation(u, v, rho, g, n):
    """Return the weight of the rock that the surface will have moved through, per unit of time.

    Times ``theta dt``, with dt signed, it goes to the left of the momentum equation: the flow then
    meets the weight of the surface as it will be after that time. It is not symmetric on a slope.
    Source: Kaus et al. (2010), Phys. Earth Planet. Inter. 181, 12-20, eq. 9.

    Args:
        u, v: trial and test velocity.
        rho: density, kg/m^3.
        g: gravity, a vector, m/s^2.
        n: outward normal.
    """
    return -rho * dot(u, n) * dot(g, v)


def column_weight(v, rho, g, n, height):
    """Return the load of a column of rock put on the surface, or taken off.

    It is the derivative of the weight of the section with respect to its surface.

    Args:
        v, rho, g, n: as above.
        height: of the column, vertical, m.
    """
    return rho * dot(g, v) * height * n[len(n) - 1]

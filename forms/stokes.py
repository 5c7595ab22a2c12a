"""Weak forms of incompressible Stokes flow.

    -div(sigma) = rho g,    sigma = 2 eta D(u) - p I,    div(u) = 0

Pressure ``p`` is positive in compression and ``g`` is a vector (Schuh-Senlis et al. 2020,
eqs. 1 to 6). The forms take the viscosity divided by a reference ``eta0`` and the pressure in units
of ``eta0 / length``, so that both blocks of the matrix are of order one where eta is eta0.
"""

from ufl import FacetNormal, div, dot, grad, inner, sym
from ufl.geometry import FacetJacobianDeterminant, JacobianDeterminant


def strain_rate(u):
    """Return D(u), the symmetric part of the velocity gradient, 1/s."""
    return sym(grad(u))


def second_invariant(u):
    """Return eps_II = sqrt(D : D / 2), 1/s."""
    d = strain_rate(u)
    return (inner(d, d) / 2) ** 0.5


def stokes_form(u, p, v, q, eta, length, dx):
    """Return the symmetric bilinear form of the Stokes equations.

    Args:
        u, p: trial velocity (m/s) and pressure (in eta0 / length).
        v, q: test functions of the same spaces.
        eta: viscosity over eta0, a UFL expression.
        length: m, makes pressure and velocity blocks alike in size.
        dx: measure.
    """
    viscous = 2 * eta * inner(strain_rate(u), strain_rate(v))
    return (viscous - p / length * div(v) - q / length * div(u)) * dx


def slip_form(u, p, v, q, eta, length, ds, penalty=20.0):
    """Return the terms that hold u.n = 0 weakly on an inclined wall (Nitsche's method).

    The normal traction stays in the equation, so the terms vanish for the exact solution; they are
    symmetric, and a constant pressure is still in the null space of a closed section.
    Source: Freund & Stenberg (1995), Proc. 9th Int. Conf. Finite Elements in Fluids, 327-336.
    """
    n = FacetNormal(u.ufl_domain())
    # With this h the trace inequality bounds the penalty of P2 from below by 6, for any shape.
    # Half the height of the cell over the facet, at the point.
    domain = u.ufl_domain()
    h = abs(JacobianDeterminant(domain)) / abs(FacetJacobianDeterminant(domain)) / 2

    def normal_stress(w, r):
        return 2 * eta * dot(n, dot(strain_rate(w), n)) - r / length

    consistent = -normal_stress(u, p) * dot(v, n) - normal_stress(v, q) * dot(u, n)
    return (consistent + penalty * eta / h * dot(u, n) * dot(v, n)) * ds


def gravity_load(v, rho, g, dx):
    """Return the load of the weight ``rho g`` (g a vector, m/s^2)."""
    return rho * dot(g, v) * dx


def traction_load(v, traction, ds):
    """Return the load of a force per area on a wall, Pa."""
    return dot(traction, v) * ds


def traction_residual(u, p, v, eta, rho, g, dx):
    """Return the load of the tractions that the walls exert, from what is left of the equation.

    Args:
        u, p: solved velocity, m/s, and pressure, Pa.
        v: test function of the velocity; where it is zero on a wall, that wall does not count.
        eta, rho, g: viscosity, Pa s; density, kg/m^3; gravity, a vector, m/s^2.
        dx: measure.
    """
    stress = 2 * eta * inner(strain_rate(u), strain_rate(v)) - p * div(v)
    return (stress - rho * dot(g, v)) * dx


def source_load(q, rate, length, dx):
    """Return the load that lets div(u) equal ``rate``, 1/s, in the form of `stokes_form`."""
    return -rate / length * q * dx


def schur_mass(p, q, eta, length, dx):
    """Return the pressure mass over the viscosity, which preconditions the Schur complement."""
    return p * q / (length**2 * eta) * dx

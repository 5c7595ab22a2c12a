"""Steps in time. A stepper is a function of a velocity; ``dt`` is signed, negative restores.

``velocity`` maps positions (n, 2), m, to velocities (n, 2), m/s. Where it solves Stokes anew for
the rock at those positions, the steppers keep their order in time; ``paper`` and ``euler`` ask for
it once per step, the way the paper does.
"""


def euler(x, velocity, dt):
    """Advance points by one explicit Euler step (first order; paper, eqs. 7 and 8)."""
    return x + dt * velocity(x)


def paper(x, velocity, dt):
    """Advance points by two half moves in one frozen velocity field (paper, sect. 3.6).

    Each half move has its own Euler velocity, so the step is of first order, however it is called
    there.
    """
    half = x + 0.5 * dt * velocity(x)
    return half + 0.5 * dt * velocity(half)


def midpoint(x, velocity, dt):
    """Advance points by one explicit midpoint step (second order)."""
    return x + dt * velocity(x + 0.5 * dt * velocity(x))


def rk4(x, velocity, dt):
    """Advance points by one classical Runge-Kutta step (fourth order)."""
    k1 = velocity(x)
    k2 = velocity(x + 0.5 * dt * k1)
    k3 = velocity(x + 0.5 * dt * k2)
    k4 = velocity(x + dt * k3)
    return x + dt / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


STEPPERS = {"euler": euler, "paper": paper, "midpoint": midpoint, "rk4": rk4}
# Steppers that move points in one flow per step, without solving Stokes at their stages.
FROZEN = {"euler", "paper"}
STOKES_SOLVES = {"euler": 1, "paper": 1, "midpoint": 2, "rk4": 4}
# Share of the step at which every stage is.
STAGES = {"euler": (0.0,), "paper": (0.0, 0.0), "midpoint": (0.0, 0.5), "rk4": (0.0, 0.5, 0.5, 1.0)}

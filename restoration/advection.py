"""Steps in time. A stepper is a function of a velocity; ``dt`` is signed, negative restores.

``velocity`` maps positions (n, 2), m, to velocities (n, 2), m/s. Where it solves Stokes anew for
the rock at those positions, the steppers keep their order in time; ``paper`` and ``euler`` ask for
it once per step, the way the paper does.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from restoration.errors import SolveError

TOLERANCE = 1e-3  # m, change of a point at which `implicit_midpoint` ends
MOST_ITERATIONS = 40
DEPTH = 6  # earlier iterates that Anderson's acceleration combines


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


def rk3(x, velocity, dt):
    """Advance points by one step of Ralston's Runge-Kutta method (third order).

    Ralston (1962, Math. Comput. 16, 431) chose it for its least error bound; its first two stages
    are those of the midpoint rule, which tells the error, see `Scheme.embedded`.
    """
    k1 = velocity(x)
    k2 = velocity(x + 0.5 * dt * k1)
    k3 = velocity(x + 0.75 * dt * k2)
    return x + dt / 9 * (2 * k1 + 3 * k2 + 4 * k3)


def rk4(x, velocity, dt):
    """Advance points by one classical Runge-Kutta step (fourth order)."""
    k = velocity(x)
    total, k = k, velocity(x + 0.5 * dt * k)
    total = total + 2 * k  # of millions of particles only two velocities are kept at a time
    k = velocity(x + 0.5 * dt * k)
    total += 2 * k
    total += velocity(x + dt * k)
    return x + dt / 6 * total


def _alone(values):
    """Return what all ranks have together of what this one has, where there is one."""
    return values


def implicit_midpoint(
    x, velocity, dt, tolerance=TOLERANCE, own=slice(None), most=_alone, total=_alone
):
    """Advance points by one implicit midpoint step (second order, time-symmetric).

    The step back from where it leads, by ``-dt``, is its inverse, up to the tolerance. The middle y
    = x + dt/2 v(y) is found by fixed-point steps that Anderson's acceleration combines (Walker and
    Ni 2011, SIAM J. Numer. Anal. 49, 1715).

    Args:
        x: positions, shape (n, 2), m.
        velocity: function of positions.
        dt: signed step, s.
        tolerance: greatest move of any point in an iteration at which it ends, m.
        own: rows that count as this rank's; the others are another's too.
        most, total: of an array, the greatest and the sum over the ranks, which all go through
            the same iterations.

    Raises:
        SolveError: the iteration does not converge: the step is too long.
    """
    y = x + 0.5 * dt * velocity(x)
    images, gaps = [], []
    for _ in range(MOST_ITERATIONS):
        image = x + 0.5 * dt * velocity(y)
        gap = image - y
        off = np.abs(gap[own]).max(initial=0.0)
        off = 2 * float(most(np.array(off)))  # the end of the step moves twice as far as its middle
        if off <= tolerance:
            return 2 * image - x
        images, gaps = [*images[-DEPTH:], image], [*gaps[-DEPTH:], gap]
        y = _accelerated(images, gaps, own, total)
    raise SolveError(
        f"the implicit midpoint step does not settle: points still move by {off:.2g} m after "
        f"{MOST_ITERATIONS} iterations; take shorter steps (time.courant, time.min_steps)"
    )


def _accelerated(images, gaps, own, total):
    """Return the next iterate: of the combinations of the last ones that with the least gap."""
    if len(gaps) == 1:
        return images[0]
    turns = np.stack([(later - gap)[own].ravel() for gap, later in pairwise(gaps)])
    # by the normal equations: three columns of as many rows as there are points
    products = total(turns @ np.vstack([turns, gaps[-1][own].ravel()]).T)
    share = np.linalg.lstsq(products[:, :-1], products[:, -1], rcond=1e-12)[0]
    moves = (b - a for a, b in pairwise(images))
    return images[-1] - sum(s * move for s, move in zip(share, moves, strict=True))


@dataclass(frozen=True)
class Scheme:
    """A stepper and what an engine must know of it.

    Attributes:
        step: the function (x, velocity, dt).
        order: of its error in time.
        stages: share of the step at which every velocity is asked for; the last goes on for ever.
        solves: Stokes solves in a step; of an iterated one in a usual step.
        frozen: whether all velocities of a step are of one flow.
        stable: step times rate up to which it keeps a relaxing mode from growing.
        embedded: weights of the stages whose sum times the step is how far the next lower order
            would be off; None where there is no such estimate.
        iterated: whether ``step`` takes a tolerance.
    """

    step: Callable
    order: int
    stages: tuple[float, ...]
    solves: int
    frozen: bool = False
    stable: float = 2.0
    embedded: tuple[float, ...] | None = None
    iterated: bool = False


SCHEMES = {
    "euler": Scheme(euler, 1, (0.0,), 1, frozen=True),
    "paper": Scheme(paper, 1, (0.0,), 1, frozen=True),
    "midpoint": Scheme(midpoint, 2, (0.0, 0.5), 2),
    "rk3": Scheme(rk3, 3, (0.0, 0.5, 0.75), 3, stable=2.51, embedded=(2 / 9, -2 / 3, 4 / 9)),
    "rk4": Scheme(rk4, 4, (0.0, 0.5, 0.5, 1.0), 4, stable=2.785),
    "implicit-midpoint": Scheme(implicit_midpoint, 2, (0.0, 0.5), 6, iterated=True),
}

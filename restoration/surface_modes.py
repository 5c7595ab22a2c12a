"""The modes of a free surface, and what becomes of the fast ones where time runs backward.

A surface sinks back to its equilibrium, v = -G (h - h_eq), and G, found column by column from the
Stokes flow of the moment, parts it into modes with rates gamma. Backward a mode grows as
exp(gamma T). One that relaxes within a small part of the time to be restored has kept nothing of
what it was: it is slaved, set to where it moves no faster than its equilibrium does. The slower
ones are integrated.
"""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
import ufl
from dolfinx import fem
from scipy.linalg import eigh

from restoration.surface import heights_on

# Growth exp(gamma T) up to which a surface is integrated backward as it is, and the cut between
# slaved and integrated modes above it, as gamma T: see docs/surface.md.
INTEGRABLE = 5.0
CUT = 8.0
REFRESH = 10  # steps after which the modes are found anew
SETTLINGS = 3  # of a surface that may be far from its equilibrium
POWER_STEPS = 4
SAFETY = 1.1  # of the estimate of the fastest rate, which comes from below


def hat_mass(x):
    """Return the mass matrix of the hats of nodes along a line, shape (m, m), m."""
    width = np.diff(x)
    mass = np.diag(np.r_[width, 0] / 3 + np.r_[0, width] / 3)
    return mass + np.diag(width / 6, 1) + np.diag(width / 6, -1)


class SurfaceResponse:
    """What columns of rock on the surface do to it, by the flow solved last.

    Args:
        grid: `Grid` with a free surface.
    """

    def __init__(self, grid):
        self.grid, top = grid, grid.top
        self._u = fem.Function(grid.spaces.V)
        test = ufl.TestFunction(grid.spaces.H)
        self._moments = fem.form(top.over(top.rock * ufl.dot(self._u, top.n) * test))
        self.mass = hat_mass(top.x)

    def moments(self, u):
        """Return the rise of the surface weighted with the hats of its nodes, (m,), m^2/s.

        Args:
            u: velocity, shape (nodes, 2), m/s.
        """
        self._u.x.array[:] = u.ravel()
        vector = fem.petsc.assemble_vector(self._moments)
        found = vector.array[self.grid.top.dofs].copy()
        vector.destroy()
        return found

    def rise(self, u):
        """Return the velocity of the surface upwards at its nodes, (m,), m/s."""
        return np.linalg.solve(self.mass, self.moments(u))

    def flow(self, heights):
        """Return the velocity that columns of these heights add, (nodes, 2), m/s."""
        column = np.zeros(len(self.grid.stokes.column.x.array))
        column[self.grid.top.dofs] = heights
        return self.grid.stokes.response(column)

    def fastest(self, guess=None):
        """Return the fastest rate, 1/s, and its mode, by a power iteration.

        Args:
            guess: heights of a mode near it, or None.
        """
        x = self.grid.top.x
        mode = np.cos(np.pi * (x - x[0]) / np.ptp(x)) + 1e-2 * np.cos(7 * x / np.ptp(x))
        if guess is not None and len(guess) == len(x):
            mode = guess
        rate = 0.0
        for _ in range(POWER_STEPS):
            mode = mode / np.sqrt(mode @ self.mass @ mode)
            moved = -self.rise(self.flow(mode))
            rate = float(mode @ self.mass @ moved)
            if not np.any(moved):
                break
            mode = moved
        return max(rate, 0.0) * SAFETY, mode


class SurfaceModes:
    """The modes of a surface that relax faster than a cut.

    Args:
        response: `SurfaceResponse` of the flow solved last.
        cut: rate above which modes are slaved, 1/s.

    Attributes:
        rates: of all modes, ascending, 1/s.
        fast: shapes of the slaved ones at the nodes, shape (m, k).
    """

    def __init__(self, response, cut):
        self.x, self.mass, self.cut = response.grid.top.x.copy(), response.mass, cut
        count = len(self.x)
        drop = np.empty((count, count))
        for i, one in enumerate(np.eye(count)):
            drop[:, i] = -response.moments(response.flow(one))
        self.rates, shapes = eigh((drop + drop.T) / 2, self.mass)
        chosen = self.rates > cut
        self.fast, self._fast_rates = shapes[:, chosen], self.rates[chosen]

    def at(self, x):
        """Return the modes at other nodes, shape (m,), m: their shapes interpolated."""
        if len(x) == len(self.x) and np.allclose(x, self.x):
            return self
        other = copy(self)
        other.x, other.mass = x, hat_mass(x)
        other.fast = np.empty((len(x), self.fast.shape[1]))
        for k, shape in enumerate(self.fast.T):
            other.fast[:, k] = np.interp(x, self.x, shape)
        other.fast /= np.sqrt(np.einsum("ik,ij,jk->k", other.fast, other.mass, other.fast))
        return other

    def part(self, heights):
        """Return the slaved part of heights at the nodes."""
        return self.fast @ (self.fast.T @ (self.mass @ heights))

    def lift(self, moments, rate):
        """Return the heights to be added so that the slaved modes move as fast as is wanted.

        Args:
            moments: of the rise of the surface, see `SurfaceResponse.moments`.
            rate: wanted rise at the nodes, m/s.
        """
        excess = self.fast.T @ (moments - self.mass @ rate)
        return self.fast @ (excess / self._fast_rates)


@dataclass(frozen=True, eq=False)
class _Moment:
    """A surface line and how fast it rises at the top nodes of a mesh."""

    time: float
    points: np.ndarray
    x: np.ndarray
    rise: np.ndarray


class Slaving:
    """Keeps the fast modes of a surface on their equilibrium through a march.

    The equilibrium itself moves, as the interior does: its rate between the last two states is
    what the slaved modes are let move with. Without that they would lag behind by rate / gamma.

    Args:
        cut: rate above which modes are slaved, 1/s.

    Attributes:
        modes: `SurfaceModes` in use.
    """

    def __init__(self, cut):
        self.cut, self.modes = cut, None
        self._response = self._grid = None
        self._age, self._last, self._rate = 0, None, None

    def look(self, grid):
        """Take the mesh of the flow solved last; find the modes where that is due.

        Args:
            grid: `Grid`; the surface must be as it was for that flow.
        """
        if self._response is None or self._response.grid is not grid:
            self._response = SurfaceResponse(grid)
        if self.modes is None or self._age >= REFRESH:
            self.modes, self._age = SurfaceModes(self._response, self.cut), 0
        self.modes = self.modes.at(grid.top.x)

    def lift(self, flow):
        """Return the heights at the top nodes that are missing from the equilibrium, m."""
        return self.modes.lift(self._response.moments(flow.u), self._rate_at(self.modes.x))

    def corrected(self, flow):
        """Return the flow as it would be with the slaved modes where they belong."""
        return replace(flow, u=flow.u + self._response.flow(self.lift(flow)))

    def passes(self, time, points, flow):
        """Note a moment; what has changed since the last tells the rate of the equilibrium.

        It depends on the interior alone, so that no error of the surface feeds back.

        Args:
            time: model time, s.
            points: of the surface line, shape (n, 2), m.
            flow: `Flow` below that surface.
        """
        x = self.modes.x
        moment = _Moment(time, points, x, self._response.rise(flow.u))
        if self._last is not None and self._last.time != time:
            self._rate = x, (self._rest(moment) - self._rest(self._last)) / (time - self._last.time)
            self._age += 1
        self._last = moment

    def _rest(self, moment):
        """Return the equilibrium of the slaved modes of now at a moment, at the nodes of now, m."""
        x, mass = self.modes.x, self.modes.mass
        rise = np.interp(x, moment.x, moment.rise)
        still = np.zeros(len(x))
        return self.modes.part(heights_on(moment.points, x)) + self.modes.lift(mass @ rise, still)

    @property
    def last(self):
        """The moment noted last; `passes` and `returns` set it."""
        return self._last

    def returns(self, moment):
        """Go back to a moment, as after a trial step: what that told of the rate is kept."""
        self._last, self._age = moment, 0

    def _rate_at(self, x):
        if self._rate is None:
            return np.zeros(len(x))
        return np.interp(x, *self._rate)

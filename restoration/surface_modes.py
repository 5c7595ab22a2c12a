"""The modes of a free surface, and what becomes of the fast ones where time runs backward.

A surface sinks back to its equilibrium, v = -G (h - h_eq), and G, found column by column from the
Stokes flow of the moment, parts it into modes with rates gamma. Backward a mode grows as
exp(gamma T). One that relaxes within a small part of the time to be restored has kept nothing of
what it was: it is slaved, set to where it moves as its equilibrium does. The slower ones are
integrated.
"""

from copy import copy
from dataclasses import dataclass, replace

import numpy as np
import ufl
from dolfinx import fem
from scipy.linalg import eigh

from restoration.surface import heights_on

# A mode is integrated backward up to a growth exp(gamma T) with this gamma T and slaved above it,
# and above the second one too where it would grow out of all bounds; see docs/surface.md.
INTEGRABLE, LEAST = 5.0, 2.0
REFRESH = 10  # steps after which the modes are found anew
SETTLINGS = 3  # of a surface that may be far from its equilibrium
POWER_STEPS = 4
NEAR = 0.25  # of the shortest cell: how far nodes may be from those that the modes were found at
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
        self._x = top.x
        self.mass = hat_mass(self._x)

    def of(self, grid):
        """Return whether this is of a grid, and its surface nodes have not moved along it."""
        return grid is self.grid and np.array_equal(grid.top.x, self._x)

    def along(self, u):
        """Return the greatest speed of the rock along the surface, m/s."""
        top = self.grid.top.line
        cell, hats = self.grid.index.locate(top, self.grid.index.guess(top))
        sampler = self.grid.sampler
        return float(np.abs(sampler(sampler.coefficients(u), cell, hats)[:, 0]).max())

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
        column = np.zeros(int(self.grid.spaces.h_nodes.max()) + 1)
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

    The amounts of the modes, (k,), m, are those of shapes whose mean square is 1 / length.

    Args:
        response: `SurfaceResponse` of the flow solved last.
        cut: rate above which modes are slaved, 1/s.

    Attributes:
        x: of the nodes, (m,), m.
        rates: of all modes, ascending, (m,), 1/s.
        slaved: rates of those above the cut, (k,), 1/s.
    """

    def __init__(self, response, cut):
        x, mass = response.grid.top.x.copy(), response.mass
        drop = np.empty((len(x), len(x)))
        for i, one in enumerate(np.eye(len(x))):
            drop[:, i] = -response.moments(response.flow(one))
        self._set(x, *eigh((drop + drop.T) / 2, mass), cut)

    def _set(self, x, rates, shapes, cut):
        self.x, self._mass, self.rates, self._all = x, hat_mass(x), rates, shapes
        self.slaved, self._shapes = self._above(cut)

    def memory(self):
        """Return nodes, rates and shapes of all modes, for a checkpoint."""
        return {"x": self.x, "rates": self.rates, "shapes": self._all}

    @classmethod
    def recalled(cls, memory, cut):
        """Return the modes that `memory` was asked of, with a cut as in the constructor."""
        modes = cls.__new__(cls)
        modes._set(*(memory[name] for name in ("x", "rates", "shapes")), cut)
        return modes

    def _above(self, cut):
        chosen = self.rates > cut
        return self.rates[chosen], self._all[:, chosen]

    def bearable(self, cut, least, moments, remaining, tolerance):
        """Return the rate above which modes cannot be integrated backward, 1/s.

        Args:
            cut, least: between which it is to be, 1/s.
            moments: of the rise of the surface, see `SurfaceResponse.moments`.
            remaining: how long the modes will grow, s.
            tolerance: up to which what is missing from the equilibrium may grow, m.
        """
        rates, shapes = self._above(least)
        slow = rates <= cut
        rates, shapes = rates[slow], shapes[:, slow]
        missing = np.abs(shapes.T @ moments) / rates * np.abs(shapes).max(axis=0)
        grown = rates[missing * np.exp(rates * remaining) > tolerance]
        return np.nextafter(grown[0], 0) if len(grown) else cut

    def near(self, x):
        """Return whether the modes can be read at other nodes: as many, and hardly moved."""
        if len(x) != len(self.x):
            return False
        return np.abs(x - self.x).max() < NEAR * np.diff(self.x).min()

    def at(self, x):
        """Return the modes at nodes that are `near`, orthogonal there and without a mean."""
        if np.array_equal(x, self.x) or not len(self.slaved):
            return self
        other = copy(self)
        other.x, other._mass = x.copy(), hat_mass(x)
        shapes = np.column_stack([np.interp(x, self.x, shape) for shape in self._shapes.T])
        weight = other._mass.sum(axis=0)
        shapes -= weight @ shapes / weight.sum()
        square, turn = eigh(shapes.T @ other._mass @ shapes)
        other._shapes = shapes @ (turn / np.sqrt(square)) @ turn.T
        return other

    def amounts(self, heights):
        """Return the amounts of the modes in heights at the nodes."""
        return self._shapes.T @ (self._mass @ heights)

    def rises(self, moments):
        """Return the rates of the amounts, m/s, for `SurfaceResponse.moments` of a rise."""
        return self._shapes.T @ moments

    def heights(self, amounts):
        """Return the heights at the nodes that the modes make."""
        return self._shapes @ amounts

    def drift(self, speed):
        """Return by how many radians the modes drift along the surface while they relax, (k,).

        Args:
            speed: of the rock along the surface, m/s.
        """
        width = np.diff(self.x)[:, None]
        wave_number = np.sqrt((np.diff(self._shapes, axis=0) ** 2 / width).sum(axis=0))
        return speed * wave_number / self.slaved


@dataclass(frozen=True, eq=False)
class _Moment:
    """A surface line and how fast it rises at the top nodes of a mesh."""

    time: float
    points: np.ndarray
    x: np.ndarray
    rise: np.ndarray


_MOMENT = tuple(_Moment.__dataclass_fields__)


class Slaving:
    """Keeps the fast modes of a surface where they move with their equilibrium.

    The equilibrium h_eq moves, as the interior does. A mode h that obeys dh/dt = -gamma (h - h_eq)
    and has forgotten its start lags behind it by its own rate over gamma; where h_eq grows as
    exp(s t) that is h = h_eq gamma / (gamma + s). The rate of h_eq is that between the last states,
    smoothed over the time that the mode takes to relax: the equilibrium is known but to some
    error, which differences over less than that would make a larger error of the mode.

    Short waves drift with the rock along the surface faster than they relax. This turns what a
    correction leaves of an error, so that the mode takes a part of the correction alone.

    Args:
        time: to be restored, s.
        tolerance: error of the restored surface that can be borne, m.

    Attributes:
        cut: rate above which modes are slaved, 1/s.
        modes: `SurfaceModes` in use.
        last: the moment noted last; `passes` and `returns` set it.
    """

    def __init__(self, time, tolerance):
        self._time, self._tolerance = time, tolerance
        self.cut, self.modes = INTEGRABLE / time, None
        self._found = self._response = self._began = None
        self._steps, self._rate, self.last = 0, None, None

    def memory(self):
        """Return what the slaving remembers, for a checkpoint; see `recall`."""
        last = self.last and {name: getattr(self.last, name) for name in _MOMENT}
        rate = self._rate and dict(zip(("x", "heights"), self._rate, strict=True))
        return {
            "cut": self.cut,
            "began": self._began,
            "steps": self._steps,
            "modes": self._found and self._found.memory(),
            "rate": rate,
            "last": last,
        }

    def recall(self, memory, grid):
        """Go on from what `memory` returned, with the `Grid` of that moment."""
        self.cut, self._began, self._steps = (memory[n] for n in ("cut", "began", "steps"))
        self._rate = memory["rate"] and tuple(memory["rate"][name] for name in ("x", "heights"))
        self.last = memory["last"] and _Moment(**memory["last"])
        if memory["modes"]:
            self._found = SurfaceModes.recalled(memory["modes"], self.cut)
            self._response = SurfaceResponse(grid)
            self.modes = self._found.at(grid.top.x)

    def look(self, grid):
        """Take the mesh of the flow solved last; find the modes where that is due.

        Args:
            grid: `Grid`; the surface must be as it was for that flow.
        """
        if self._response is None or not self._response.of(grid):
            self._response = SurfaceResponse(grid)
        x = grid.top.x
        if self._found is None or self._steps >= REFRESH or not self._found.near(x):
            self._found, self._steps = SurfaceModes(self._response, self.cut), 0
        self.modes = self._found.at(x)

    def lift(self, flow):
        """Return the heights at the top nodes by which to come nearer to the equilibrium, m."""
        return self.modes.heights(self._share(flow) * self._missing(flow))

    def corrected(self, flow):
        """Return the flow as it would be with the slaved modes where they belong."""
        lift = self.modes.heights(self._missing(flow))
        return replace(flow, u=flow.u + self._response.flow(lift))

    def passes(self, time, points, flow):
        """Note a moment; what has changed since the last tells the rate of the equilibrium.

        It depends on the interior alone, but for how the rock drifts along the surface.

        Args:
            time: model time, s.
            points: of the surface line, shape (n, 2), m.
            flow: `Flow` below that surface.
        """
        moment = _Moment(time, points, self.modes.x, self._response.rise(flow.u))
        if self._steps == 0:
            self._choose(time, flow)
        if self.last is not None and self.last.time != time:
            dt = time - self.last.time
            new = (self._rest(moment) - self._rest(self.last)) / dt
            if self._rate is not None:
                old = self._read(*self._rate)
                passed = self.modes.slaved * abs(dt)
                new = old + self._share(flow) * passed / (1 + passed) * (new - old)
            self._rate = moment.x, self.modes.heights(new)
            self._steps += 1
        self.last = moment

    def returns(self, moment):
        """Go back to a moment, as after a trial step: what that told of the rate is kept.

        It is short for all but the fastest modes: of theirs it tells little.
        """
        modes = self.modes
        told = self._read(*self._rate) * modes.slaved / modes.rates[-1]
        self._rate = modes.x, modes.heights(told)
        self.last, self._steps = moment, 0

    def _rest(self, moment):
        """Return the equilibrium of the slaved modes at a moment, (k,), m."""
        modes = self.modes
        rise = modes.amounts(np.interp(modes.x, moment.x, moment.rise))
        return modes.amounts(heights_on(moment.points, modes.x)) + rise / modes.slaved

    def _choose(self, time, flow):
        """Slave what is so far from its equilibrium that it would grow out of all bounds."""
        self._began = time if self._began is None else self._began
        moments, remaining = self._response.moments(flow.u), self._time - abs(time - self._began)
        least = LEAST / self._time
        cut = self.modes.bearable(self.cut, least, moments, remaining, self._tolerance)
        if cut < self.cut:
            self.cut = cut
            self._found = SurfaceModes(self._response, cut)
            self.modes = self._found

    def _missing(self, flow):
        """Return the amounts of the modes that are missing from where they belong, m."""
        modes = self.modes
        return (modes.rises(self._response.moments(flow.u)) - self._own_rate()) / modes.slaved

    def _own_rate(self):
        """Return the rates that the amounts of the modes are to have, m/s."""
        if self._rate is None:
            return np.zeros(len(self.modes.slaved))
        rate, rest = self._read(*self._rate), self._rest(self.last)
        grows = rate * rest > 0
        growth = np.divide(rate, rest, out=np.zeros(len(rate)), where=grows)
        return rate / (1 + growth / self.modes.slaved)

    def _read(self, x, heights):
        """Return the amounts of the modes in heights at nodes of a mesh that may have gone."""
        return self.modes.amounts(np.interp(self.modes.x, x, heights))

    def _share(self, flow):
        """Return the part of a correction that the modes take."""
        return 1 / (1 + self.modes.drift(self._response.along(flow.u)) ** 2)

"""One step of the engine: what is moved, and how fast it moves at every stage."""

from dataclasses import replace
from itertools import chain, repeat

import numpy as np

from restoration.advection import SCHEMES
from restoration.errors import ParticleError
from restoration.inflow import wall_points
from restoration.lines import points_of, surface_of, with_points
from restoration.particles import OUTSIDE
from restoration.surface import line_area


class Step:
    """The rows that a stepper moves, and their velocity at its stages.

    The rows are the particles, the points of the lines and, below a free surface, one row with the
    area of the section over its width, whose rate is the flux through the surface: integrated by
    the same stepper it is kept to rounding where no wall is open.

    Args:
        engine: `StokesEngine`.
        state: `State` with its flow.
        dt: signed step, s.
        scheme: name of one of `advection.SCHEMES`.
        slaving: whether slaved modes of the surface move with their equilibrium.

    Attributes:
        start: the rows, shape (rows, dim), m.
        particles, fixed: number of particles, and of all rows but the area.
    """

    def __init__(self, engine, state, dt, scheme, slaving):
        self.engine, self.state, self.dt, self.scheme = engine, state, dt, SCHEMES[scheme]
        self.slaving = engine.surface.slaving if engine.surface and slaving else None
        points = points_of(state.lines) if state.lines else state.particles.x[:0]
        rows = {"particles": state.particles.x, "lines": points}
        rows |= {
            name: wall_points(name, engine.outline(state.lines), engine.spacing / 2)
            for name in sorted(engine.open)
        }
        ends = np.cumsum([len(part) for part in rows.values()])
        first = engine.ranks.first  # all ranks have the lines
        self._own = slice(None) if first else slice(0, len(state.particles.x))
        self._rows = dict(zip(rows, np.split(np.arange(ends[-1]), ends[:-1]), strict=True))
        self.particles, self.fixed = ends[0], ends[-1]
        surface = engine.surface
        self.width = engine.scene.outline.width
        height = [line_area(surface_of(state.lines).points) / self.width] if surface else []
        area = np.array([[h, 0.0] for h in height]).reshape(-1, points.shape[1])
        self.lead = surface.lead(dt) if surface else 0.0
        self.start = np.concatenate([*rows.values(), area])
        stages = self.scheme.stages
        self._stages = chain(stages, repeat(stages[-1]))
        self._velocities = []  # of the stages, where they tell the error
        self._flow, self._flow_grid, self._grid = None, None, state.grid
        others = self.start[self.particles : self.fixed]
        self._guess = np.r_[state.particles.cell, state.grid.index.guess(others)]

    def parts(self, x):
        """Return the rows of an array by name: particles, lines, and the open walls."""
        return {name: x[rows] for name, rows in self._rows.items()}

    def velocity(self, x):
        """Return the velocity of the rows where they are, solving Stokes where the scheme asks."""
        engine, state = self.engine, self.state
        share, first, found = next(self._stages), self._flow is None, None
        if first and not self.lead:
            flow = state.flow
        elif not first and self.scheme.frozen:
            flow = self._flow
        else:
            flow, found = self._solved(x, state.time + share * self.dt)
        if self.slaving and flow is not self._flow:
            with engine.timed("surface"):
                self.slaving.look(engine.grid)
                flow = self.slaving.corrected(flow)
        self._flow, self._flow_grid = flow, engine.grid
        cell, hats = found or self._located(x[: self.fixed])
        with engine.timed("advect"):
            grid = engine.grid
            u = grid.sampler(grid.sampler.coefficients(flow.u), cell, hats)
            if engine.surface:
                u = np.vstack([u, [grid.top.flux(flow) / self.width, 0.0]])
        if self.scheme.embedded:
            self._velocities.append(u)
        return u

    def taken(self, tolerance=None):
        """Return the rows where the step leads them, and what it is off by, m.

        Args:
            tolerance: at which the iterations of an implicit scheme end, m; None for the default.

        Returns:
            The rows, and what 99 of 100 of them may be off by the difference to the embedded
            scheme of the next lower order; None where there is none.
        """
        more, ranks = {}, self.engine.ranks
        if self.scheme.iterated:
            more = {"own": self._own, "most": ranks.most, "total": ranks.sum}
            more |= {"tolerance": tolerance} if tolerance else {}
        x = self.scheme.step(self.start, self.velocity, self.dt, **more)
        if not self.scheme.embedded or tolerance is None:
            return x, None
        weighted = zip(self.scheme.embedded, self._velocities, strict=True)
        off = self.dt * sum(weight * u for weight, u in weighted)
        off = ranks.rows(np.linalg.norm(off[self._own], axis=1))
        return x, float(np.percentile(off, 99))

    def _solved(self, x, time):
        """Return the flow of the rows where they are, and cells and hats of the rows there."""
        engine, state = self.engine, self.state
        at = replace(state.particles, x=x[: self.particles])
        rows = with_points(state.lines, x[self._rows["lines"]])
        lines = engine.with_ends(state.lines, rows)
        if engine.fitted:
            at = engine.fit(at, lines, rows=None if lines is rows else rows, begins=False)
            cell, hats = self._located(x[: self.fixed])
        else:
            engine.stand(lines)
            cell, hats = self._located(x[: self.fixed])
            at = replace(at, cell=cell[: self.particles])
        before = self._flow_at if self._flow is not None and self.lead else None
        flow = engine.solve(at, time, lines, hats[: self.particles], self.lead, before)
        return flow, (cell, hats)

    def _flow_at(self, points):
        """Return the velocity of the last stage at points, on the mesh it was solved on."""
        grid = self._flow_grid
        cell, hats = grid.index.locate(points, grid.index.guess(points))
        return grid.sampler(grid.sampler.coefficients(self._flow.u), cell, hats)

    def _located(self, x):
        """Return cells and hats of points in the mesh as it is."""
        grid, ranks = self.engine.grid, self.engine.ranks
        with self.engine.timed("advect"):
            if ranks.any(not np.isfinite(x.sum())):
                raise ParticleError("the step leads particles or lines nowhere: not finite")
            if grid is not self._grid:
                self._grid, self._guess = grid, grid.index.guess(x)
            # What has left goes on with the rock at the wall, and so does what a stage carried
            # through a closed one: a velocity of zero there would be a jump.
            cell, hats = grid.index.locate(self.engine.within(x), self._guess)
        self._guess = np.where(cell == OUTSIDE, self._guess, cell)
        return cell, hats

"""The engine that moves a section by Stokes flow.

The loop (`run.march`) asks an engine for three things, `with_flow`, `stable_step` and `advance`,
and knows nothing else of the physics; the recorder asks for `about`, `work`, `numbers` and
`snapshot`. A discrete-element engine will offer the same.
"""

import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from meshes.box import section_mesh
from restoration.advection import FROZEN, STEPPERS
from restoration.errors import SolveError
from restoration.lines import begin, points_of, refined, with_points
from restoration.particles import (
    CellIndex,
    empty_cells,
    fill_cells,
    relocate,
    seed,
)
from restoration.plan import active
from restoration.scene import WALLS
from restoration.snapshot import FieldSnapshot
from restoration.spaces import Spaces
from restoration.state import State
from restoration.stokes import StokesProblem
from restoration.transfer import RockFields, velocity_at

# A horizon is kept this many times finer than the mesh, see `lines.refined`.
LINE_POINTS_PER_CELL = 4
LINE_POINTS_PER_CELL_AT_TURNS = 32


class StokesEngine:
    """Moves a section by Stokes flow on a mesh that stands still.

    Args:
        scene: `scene.Scene`.

    Attributes:
        counts: solves, factorisations, worst residual.
        born: particles born so far to fill cells.
        empty_cells: cells without a particle after the last step; their rock is read from the
            particles around them.
        held_on_wall: times a particle was set back onto a closed wall.
        seconds: wall time by part, s.
    """

    def __init__(self, scene):
        self.seconds = dict.fromkeys(("setup", "fields", "assemble", "solve", "advect"), 0.0)
        with self._timed("setup"):
            self.scene = scene
            self.section = section_mesh(scene.outline.surface, scene.outline.base, scene.cells)
            self.spaces = Spaces(self.section)
            self.index = CellIndex(self.section)
            self.start_area = float(self.section.areas.sum())
            self.cell_size = float(np.sqrt(4 * self.index.area.mean()))
            self.eta0 = float(scene.unit_viscosity.min())
            relative = scene.unit_viscosity / self.eta0
            self.fields = RockFields(
                self.spaces, self.index, scene.unit_density, relative, scene.transfer
            )
            self.stokes = StokesProblem(
                self.section,
                self.spaces,
                self.fields.rho,
                self.fields.eta,
                self.eta0,
                scene.walls,
                scene.gravity,
                scene.closed,
                scene.one_viscosity,
            )
        self.born = 0
        self.empty_cells = 0
        self.held_on_wall = 0

    @property
    def counts(self):
        """What the solver has done so far."""
        return self.stokes.counts

    def about(self):
        """Return what this engine is and does, as entries of the run record."""
        return {
            "engine": "stokes",
            "active": active(self.scene),
            "cells": len(self.index.area),
            "unknowns": self.spaces.unknowns,
        }

    def work(self):
        """Return what it has done so far, as entries of the run record."""
        counts = self.stokes.counts
        return {
            "stokes_solves": counts.solves,
            "factorisations": counts.factorisations,
            "refinements": counts.refinements,
            "worst_residual": counts.worst_residual,
            "particles_born": self.born,
            "wall_leak_m2_per_s": self.stokes.leak,
            "wall_by_part_s": {part: round(s, 3) for part, s in self.seconds.items()},
        }

    def numbers(self, state):
        """Return the numbers of a step, as columns of the diagnostics table."""
        rms, greatest = self.speeds(state.flow)
        return {
            "stokes_solves": self.stokes.counts.solves,
            "residual": state.flow.residual,
            "rms_velocity_m_per_s": rms,
            "max_velocity_m_per_s": greatest,
            "particles": len(state.particles.x),
            "particles_lost": state.particles.lost,
            "particles_born": self.born,
            "empty_cells": self.empty_cells,
            "held_on_wall": self.held_on_wall,
        }

    def speeds(self, flow):
        """Return root mean square and greatest speed, m/s."""
        area, nodes = self.index.area, self.spaces.v_nodes
        squared = (flow.u**2).sum(axis=1)
        # The rule of the edge middles is exact to degree two, enough for a diagnostic.
        mean = (area * squared[nodes[:, 3:]].mean(axis=1)).sum() / area.sum()
        return float(np.sqrt(mean)), float(np.sqrt(squared.max()))

    def snapshot(self):
        """Return the reader of the fields for files."""
        return FieldSnapshot(self.spaces, self.fields, self.eta0)

    def start(self):
        """Return the state at the first mark."""
        particles = self._settled(relocate(seed(self.scene), self.index))
        lines = begin(self.scene.lines, self.cell_size / LINE_POINTS_PER_CELL)
        return State(self.scene.time.marks[0], particles, lines)

    def with_flow(self, state):
        """Return the state with its flow solved for."""
        if state.flow is not None:
            return state
        weights = self.index.locate(state.particles.x, state.particles.cell)[1]
        return replace(state, flow=self._solve(state.particles, weights))

    def stable_step(self, state):
        """Return the longest step that crosses ``courant`` cells, s; positive.

        Raises:
            SolveError: the velocity is not finite.
        """
        speed = np.linalg.norm(state.flow.u, axis=1)[self.spaces.v_nodes].max(axis=1)
        fastest = float((speed / np.sqrt(4 * self.index.area)).max())
        if not np.isfinite(fastest):
            raise SolveError("the velocity is not finite; no time step is possible")
        return self.scene.time.courant / fastest if fastest > 0 else np.inf

    def advance(self, state, until):
        """Return the state moved to the time ``until``, s; earlier than now restores."""
        dt = until - state.time
        n = len(state.particles.x)
        asked = 0

        def velocity(x):
            """Return velocities of particles and line points, solving Stokes for the rock at x."""
            nonlocal asked
            first, asked = asked == 0, asked + 1
            with self._timed("advect"):
                cell, weights = self.index.locate(x, guess)
                moved = replace(state.particles, x=x[:n], cell=cell[:n])
            frozen = first or self.scene.time.scheme in FROZEN
            flow = state.flow if frozen else self._solve(moved, weights[:n])
            with self._timed("advect"):
                return velocity_at(self.spaces.v_nodes, flow.u, cell, weights)

        points = points_of(state.lines)
        guess = np.r_[state.particles.cell, self.index.guess(points)]
        x = STEPPERS[self.scene.time.scheme](
            np.concatenate([state.particles.x, points]), velocity, dt
        )
        with self._timed("advect"):
            x = self._on_walls(x)
            particles = self._settled(relocate(state.particles, self.index, x[:n]))
            lines = refined(
                with_points(state.lines, x[n:]),
                self.cell_size / LINE_POINTS_PER_CELL,
                self.cell_size / LINE_POINTS_PER_CELL_AT_TURNS,
                until,
                dt,
            )
        return State(until, particles, lines)

    def _solve(self, particles, weights):
        with self._timed("fields"):
            self.fields.fill(particles.x, particles.cell, weights, particles.unit, particles.area)
        with self._timed("assemble"):
            self.stokes.assemble()
        with self._timed("solve"):
            return self.stokes.solve()

    def _settled(self, particles):
        """Return the particles with new ones where the fields could not be filled without.

        A cell that runs empty inside a sealed section reads its rock from the particles around it,
        continuously as they move. A birth is a jump that the way back cannot undo (see
        docs/accuracy.md), so particles are born only where all is empty for two cells around, and
        wherever a wall lets rock in.
        """
        empty = empty_cells(particles, len(self.index.area))
        self.empty_cells = len(empty)
        if self.scene.sealed and len(empty):
            nodes = self.spaces.q_nodes
            held = np.ones(len(nodes), bool)
            held[empty] = False
            served = np.zeros(nodes.max() + 1, bool)
            for _ in range(2):
                served[nodes[held]] = True
                held = served[nodes].any(axis=1)
            empty = empty[~served[nodes[empty]].all(axis=1)]
        self.born += len(empty)
        return fill_cells(particles, self.index, empty)

    def _on_walls(self, x):
        """Return the points with those that a step carried through a closed wall set back onto it.

        No rock crosses such a wall; a step of finite length can, by its own error.
        """
        outline = self.scene.outline
        held = {name: self.scene.normal_velocity(name) == 0 for name in WALLS}
        low = np.where(held["left"], outline.surface[0, 0], -np.inf)
        high = np.where(held["right"], outline.surface[-1, 0], np.inf)
        across = np.clip(x[:, 0], low, high)
        bottom = np.interp(across, *outline.base.T) if held["base"] else -np.inf
        top = np.interp(across, *outline.surface.T) if held["surface"] else np.inf
        inside = np.column_stack([across, np.clip(x[:, 1], bottom, top)])
        self.held_on_wall += int(np.count_nonzero(np.any(inside != x, axis=1)))
        return inside

    @contextmanager
    def _timed(self, part):
        begin = time.perf_counter()
        yield
        self.seconds[part] += time.perf_counter() - begin

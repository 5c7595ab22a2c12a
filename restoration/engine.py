"""The engine that moves a section by Stokes flow.

The loop (`run.march`) asks an engine for three things, `with_flow`, `stable_step` and `advance`,
and knows nothing else of the physics; the recorder asks for `about`, `work` and `numbers`. A
discrete-element engine will offer the same.
"""

import time
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

from restoration.advection import FROZEN, STEPPERS
from restoration.errors import MeshError, SolveError
from restoration.grid import Grid
from restoration.lines import begin, points_of, refined, with_points
from restoration.mesher import Mesher
from restoration.particles import OUTSIDE, empty_cells, fill_cells, relocate, seed
from restoration.plan import active
from restoration.scene import WALLS
from restoration.state import State
from restoration.stokes import Counts

# A horizon is kept this many times finer than the mesh, see `lines.refined`.
LINE_POINTS_PER_CELL = 4
LINE_POINTS_PER_CELL_AT_TURNS = 32
ROCK_JUMP = 0.02  # of the section, that no rock wins or loses from one fitted mesh to the next
PARTS = ("setup", "mesh", "fields", "assemble", "solve", "advect")


class StokesEngine:
    """Moves a section by Stokes flow.

    Args:
        scene: `scene.Scene`.

    Attributes:
        counts: solves, factorisations, worst residual.
        born: particles born so far to fill cells.
        empty_cells: cells without a particle after the last step; their rock is read from the
            particles around them.
        held_on_wall: times a particle was set back onto a closed wall.
        seconds: wall time by part, s.
        grid: the `Grid` in use: one for the run where the mesh stands still.
        meshes: number of meshes so far.
    """

    def __init__(self, scene):
        self.seconds = dict.fromkeys(PARTS, 0.0)
        self.scene, self.counts = scene, Counts()
        with self._timed("setup"):
            self.mesher = Mesher(scene)
            self.cell_size = self.mesher.finest
            section, points = self.mesher.mesh(self._first_lines())
            regions = None if points is None else (None, points)
            self.grid = Grid(scene, section, self.counts, regions)
        self.start_area = self.grid.section.area
        self.fitted = scene.mesh.interfaces == "fitted"
        self.meshes = 1
        self._steps, self._last_flow, self._rock_areas = 0, None, None
        self.born = 0
        self.empty_cells = 0
        self.held_on_wall = 0

    @property
    def section(self):
        """The mesh of this moment."""
        return self.grid.section

    def about(self):
        """Return what this engine is and does, as entries of the run record."""
        return {
            "engine": "stokes",
            "active": active(self.scene),
            "cells": self.grid.section.cell_count,
            "unknowns": self.grid.spaces.unknowns,
        }

    def work(self):
        """Return what it has done so far, as entries of the run record."""
        counts = self.counts
        return {
            "stokes_solves": counts.solves,
            "factorisations": counts.factorisations,
            "krylov_iterations": counts.krylov_iterations,
            "refinements": counts.refinements,
            "worst_residual": counts.worst_residual,
            "meshes": self.meshes,
            "particles_born": self.born,
            "wall_leak_m2_per_s": self.grid.stokes.leak,
            "wall_by_part_s": {part: round(s, 3) for part, s in self.seconds.items()},
        }

    def numbers(self, state):
        """Return the numbers of a step, as columns of the diagnostics table."""
        rms, greatest = state.grid.speeds(state.flow)
        return {
            "stokes_solves": self.counts.solves,
            "residual": state.flow.residual,
            "rms_velocity_m_per_s": rms,
            "max_velocity_m_per_s": greatest,
            "cells": state.grid.section.cell_count,
            "particles": len(state.particles.x),
            "particles_lost": state.particles.lost,
            "particles_born": self.born,
            "empty_cells": self.empty_cells,
            "held_on_wall": self.held_on_wall,
        }

    def start(self):
        """Return the state at the first mark."""
        particles = self._settled(relocate(seed(self.scene), self.grid.index))
        return State(self.scene.time.marks[0], particles, self._first_lines(), grid=self.grid)

    def _first_lines(self):
        return begin(self.scene.lines, self.cell_size / LINE_POINTS_PER_CELL)

    def with_flow(self, state):
        """Return the state with its flow solved for, on a new mesh where one is due."""
        if state.flow is not None:
            return state
        particles, refine = state.particles, self.scene.mesh.refine
        if self.fitted:
            particles = self._fit(particles, state.lines)
        elif refine and self._steps % refine.every == 0:
            if "velocity-gradient" in refine.where and self._last_flow is None:
                self._last_flow = self._solve(particles)
            particles = self._adapt(particles, state.lines)
        self._last_flow = self._solve(particles)
        return replace(state, particles=particles, flow=self._last_flow, grid=self.grid)

    def _fit(self, particles, lines):
        """Make a mesh that follows the lines; return the particles located in it."""
        with self._timed("mesh"):
            section, points = self.mesher.mesh(lines)
            particles = self._nowhere(particles)
            self.grid.stokes.release()
            self.grid = Grid(self.scene, section, self.counts, (particles, points))
            self.meshes += 1
            self._guard_rocks()
            return relocate(particles, self.grid.index)

    def _guard_rocks(self):
        """Raise where a rock of a fitted mesh has lost or won a part of the section at once."""
        rock = np.array([unit.rock for unit in self.scene.units])[self.grid.fields.unit]
        areas = np.bincount(rock, self.grid.index.area, len(self.scene.rocks))
        jump = np.abs(areas - (areas if self._rock_areas is None else self._rock_areas))
        if jump.max() > ROCK_JUMP * areas.sum():
            name = self.scene.rocks[jump.argmax()].name
            raise MeshError(
                f"{name} changed its area by {jump.max() / 1e6:.3g} km^2 at once: a horizon no "
                "longer parts the rocks; let particles carry them (mesh.interfaces: particles)"
            )
        self._rock_areas = areas

    def _adapt(self, particles, lines):
        """Adapt the mesh; return the particles located in it."""
        with self._timed("mesh"):
            section, _ = self.mesher.mesh(lines, self.grid, self._last_flow)
            self.grid.stokes.release()
            self.grid = Grid(self.scene, section, self.counts)
            self.meshes += 1
            return self._settled(relocate(self._nowhere(particles), self.grid.index))

    @staticmethod
    def _nowhere(particles):
        """Return the particles without cells: those of another mesh tell nothing."""
        return replace(particles, cell=np.full_like(particles.cell, OUTSIDE))

    def stable_step(self, state):
        """Return the longest step that crosses ``courant`` cells, s; positive.

        Raises:
            SolveError: the velocity is not finite.
        """
        fastest = state.grid.fastest(state.flow)
        if not np.isfinite(fastest):
            raise SolveError("the velocity is not finite; no time step is possible")
        return self.scene.time.courant / fastest if fastest > 0 else np.inf

    def advance(self, state, until):
        """Return the state moved to the time ``until``, s; earlier than now restores."""
        dt = until - state.time
        n = len(state.particles.x)
        asked = 0
        points = points_of(state.lines)
        guess = np.r_[state.particles.cell, state.grid.index.guess(points)]

        def velocity(x):
            """Return velocities of particles and line points, solving Stokes for the rock at x."""
            nonlocal asked
            first, asked = asked == 0, asked + 1
            frozen = first or self.scene.time.scheme in FROZEN
            grid, flow = state.grid, state.flow
            if not frozen and self.fitted:
                at = replace(state.particles, x=x[:n])
                at = self._fit(at, with_points(state.lines, x[n:]))
                grid, flow = self.grid, self._solve(at)
                cell, hats = grid.index.locate(x, np.r_[at.cell, grid.index.guess(x[n:])])
            else:
                with self._timed("advect"):
                    cell, hats = grid.index.locate(x, guess)
                if not frozen:
                    at = replace(state.particles, x=x[:n], cell=cell[:n])
                    flow = self._solve(at, hats[:n])
            with self._timed("advect"):
                return grid.sampler(grid.sampler.coefficients(flow.u), cell, hats)

        x = STEPPERS[self.scene.time.scheme](
            np.concatenate([state.particles.x, points]), velocity, dt
        )
        self._steps += 1
        with self._timed("advect"):
            x = self._on_walls(x)
            if self.fitted:  # the mesh they will be in is yet to come
                particles = self._nowhere(replace(state.particles, x=x[:n]))
            else:
                particles = self._settled(relocate(state.particles, self.grid.index, x[:n]))
            lines = refined(
                with_points(state.lines, x[n:]),
                self.cell_size / LINE_POINTS_PER_CELL,
                self.cell_size / LINE_POINTS_PER_CELL_AT_TURNS,
                until,
                dt,
            )
        return State(until, particles, lines)

    def _solve(self, particles, hats=None):
        grid = self.grid
        with self._timed("fields"):
            if hats is None:
                hats = grid.index.locate(particles.x, particles.cell)[1]
            grid.fill(particles, hats)
        with self._timed("assemble"):
            grid.stokes.assemble()
        with self._timed("solve"):
            return grid.stokes.solve()

    def _settled(self, particles):
        """Return the particles with new ones where the fields could not be filled without.

        A cell that runs empty inside a sealed section reads its rock from the particles around it,
        continuously as they move. A birth is a jump that the way back cannot undo (see
        docs/accuracy.md), so particles are born only where all is empty for two cells around, and
        wherever a wall lets rock in.
        """
        if self.fitted:  # the cells know their rock
            return particles
        index = self.grid.index
        empty = empty_cells(particles, len(index.area))
        self.empty_cells = len(empty)
        if self.scene.sealed and len(empty):
            nodes = self.grid.spaces.h_nodes
            held = np.ones(len(nodes), bool)
            held[empty] = False
            served = np.zeros(nodes.max() + 1, bool)
            for _ in range(2):
                served[nodes[held]] = True
                held = served[nodes].any(axis=1)
            empty = empty[~served[nodes[empty]].all(axis=1)]
        self.born += len(empty)
        return fill_cells(particles, index, empty)

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

"""The engine that moves a section by Stokes flow.

The loop (`run.march`) asks an engine for three things, `with_flow`, `stable_step` and `advance`,
and knows nothing else of the physics; the recorder asks for `about`, `work`, `numbers` and `notes`.
A discrete-element engine will offer the same.
"""

import time
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import numpy as np

from restoration.advection import SCHEMES
from restoration.bands import areas
from restoration.diagnostics import relief
from restoration.enclosed import kept
from restoration.environment import give_memory_back
from restoration.errors import MeshError, SolveError
from restoration.free_surface import FreeSurface, with_area, without_cliffs
from restoration.grid import Grid, units_of_regions
from restoration.guards import FittedGuard, StepGuards, look_at_fields
from restoration.inflow import cast_off, flowed_in, with_ends
from restoration.lines import (
    begin,
    most_vertices,
    refined,
    surface_of,
    with_points,
)
from restoration.mesher import Mesher
from restoration.particles import (
    OUTSIDE,
    born_in,
    empty_cells,
    held_inside,
    relocate,
    seed,
)
from restoration.plan import active, time_label
from restoration.ranks import world
from restoration.remembering import Remembering
from restoration.scene import WALLS, Line, Outline
from restoration.sharing import Sharing
from restoration.state import State
from restoration.step import Step
from restoration.stokes import Counts
from restoration.surface import standing
from restoration.surface_modes import SETTLINGS
from restoration.units import show

# A horizon is kept this many times finer than the mesh, see `lines.refined`.
LINE_POINTS_PER_CELL = 4
LINE_POINTS_PER_CELL_AT_TURNS = 32
SURFACE_POINTS_PER_CELL = 8  # finer than the particles, which are a quarter of a square apart
MOST_FALLEN = 1e-3  # of the section, that may fall from a surface in a step
TRIAL = 0.5  # of the relaxation time of the fastest mode: a step that tells a rate
SAFETY = 0.9  # of the step that would be off by just what is tolerated
MOST_SHRUNK, MOST_GROWN, MOST_TRIALS = 0.2, 2.0, 12  # of steps by their error
PARTS = ("setup", "mesh", "fields", "assemble", "solve", "surface", "advect", "guards")


class StokesEngine(Remembering):
    """Moves a section by Stokes flow.

    Args:
        scene: `scene.Scene`.
        ranks: `ranks.Ranks` that share the work; None for all that the program was started on.

    Attributes:
        ranks: these.
        sharing: `sharing.Sharing` of the particles.
        counts: solves, factorisations, worst residual.
        born: particles born so far to fill cells.
        empty_cells: cells without a particle after the last step; their rock is read from the
            particles around them.
        rejected: steps that were off by more than is tolerated, and taken anew.
        retried: steps that have failed, and were taken anew with half their length.
        longest: step that may be taken after such ones, s.
        held_on_wall: times a particle was set back onto a closed wall.
        seconds: wall time by part, s.
        grid: the `Grid` in use: one for the run where the mesh stands still.
        meshes: number of meshes so far.
        open: names of the walls that rock crosses.
        left, entered: particles that have left and entered through each of them.
        surface: `FreeSurface`, or None.
        fallen: area of rock that fell from cliffs of the surface so far, m^2.
        surface_shift: how far the surface was moved as a whole, in all steps so far, to keep the
            area below it what the flow through the walls makes it, m.
        horizon_shift: how far horizons were moved as a whole, in all steps so far, to keep the
            areas between them where no rock crosses a wall, m.
        notes: what has happened that whoever reads the results should know, lines of text.
    """

    make_mesher = Mesher  # of a scene and the ranks

    def __init__(self, scene, ranks=None):
        self.ranks = ranks or world()
        self.sharing = Sharing(self.ranks)
        self.seconds = dict.fromkeys(PARTS, 0.0)
        self.scene, self.counts = scene, Counts()
        self._given = scene.mesh
        self.meshes, self.grid = 0, None
        self.surface = FreeSurface(scene) if scene.free else None
        self.surface_shift, self.horizon_shift, self.fallen = 0.0, 0.0, 0.0
        self.notes, self.fitted = [], scene.mesh.interfaces != "particles"
        self._folded = set()  # names of lines that have come to the most vertices
        self.open = {n for n in WALLS if scene.normal_velocity(n) != 0} - (
            {"surface"} if scene.free else set()
        )
        self.left, self.entered = dict.fromkeys(self.open, 0), dict.fromkeys(self.open, 0)
        self.spacing = np.sqrt(scene.outline.area / (4 * np.prod(scene.cells)))
        self.spacing /= np.sqrt(scene.particles.per_cell)
        with self.timed("setup"):
            self.mesher = self.make_mesher(scene, self.ranks)
            self.cell_size = self.mesher.finest
            lines = self._first_lines()
            self._guard = FittedGuard(scene, self.mesher.coarsest)
            try:
                section, points = self.mesher.mesh(lines)
                self._take(section, lines, self._units(points))
                if self.fitted:
                    self._guard.begin(self.grid)
            except MeshError as error:
                self._leave_to_particles(scene.time.marks[0], error)
                self._take(self.mesher.mesh(lines)[0], lines)
        self.start_area = self.grid.section.area
        self._guards = StepGuards(scene, self.ranks, not self.open)
        self._steps, self._last_flow = 0, None
        self.rejected, self._next = 0, np.inf  # steps; the next one by the error of the last, s
        self.retried, self.longest = 0, np.inf
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
            "solves_rescued": counts.rescued,
            "worst_residual": counts.worst_residual,
            "meshes": self.meshes,
            "interfaces_used": "fitted" if self.fitted else "particles",
            "steps_rejected": self.rejected,
            "steps_retried": self.retried,
            "particles_born": self.born,
            "particles_left": dict(self.left),
            "particles_entered": dict(self.entered),
            "surface_rate_per_s": self.surface.gamma if self.surface else None,
            "wall_leak_m2_per_s": self.grid.stokes.leak,
            "wall_by_part_s": {part: round(s, 3) for part, s in self.seconds.items()},
        }

    def numbers(self, state):
        """Return the numbers of a step, as columns of the diagnostics table."""
        rms, greatest = state.grid.speeds(state.flow)
        particles = state.particles
        count, lost = self.ranks.sum(np.array([len(particles.x), particles.lost])).tolist()
        return {
            "stokes_solves": self.counts.solves,
            "residual": state.flow.residual,
            "rms_velocity_m_per_s": rms,
            "max_velocity_m_per_s": greatest,
            "cells": state.grid.section.cell_count,
            "particles": count,
            "particles_lost": lost,
            "particles_born": self.born,
            "particles_left": sum(self.left.values()),
            "particles_entered": sum(self.entered.values()),
            "empty_cells": self.empty_cells,
            "held_on_wall": self.held_on_wall,
            "steps_retried": self.retried,
            "surface_relief_m": relief(state.lines)["surface_relief_m"],
            "surface_shift_m": self.surface_shift if self.surface else None,
            "horizon_shift_m": None if self.open else self.horizon_shift,
            "surface_fallen_m2": self.fallen if self.surface else None,
            "surface_modes_slaved": self.surface.slaved if self.surface else None,
        }

    def start(self):
        """Return the state at the first mark."""
        index = self.grid.index
        particles = self._settled(self.sharing.dealt(relocate(seed(self.scene), index), index))
        return State(self.scene.time.marks[0], particles, self._first_lines(), grid=self.grid)

    def guard(self, state):
        """Raise where a state with its flow cannot be gone on from, see `StepGuards.look`."""
        with self.timed("guards"):
            self._guards.look(state, self._arrived)

    def watch(self, state):
        """Take from a state with its flow what `guard` compares those after it with."""
        with self.timed("guards"):
            self._guards.watch(state, self._arrived)

    @property
    def _arrived(self):
        return self.born + sum(self.entered.values()) - sum(self.left.values())

    def facts(self):
        """Return what a developer asks of mesh, rock and matrix, numbers by name."""
        return self.grid.facts()

    def taken_over(self, state):
        """Return the state of another engine, on another mesh, as one of this."""
        index = self.grid.index
        particles = relocate(self._nowhere(state.particles), index)
        return State(state.time, self.sharing.dealt(particles, index), state.lines)

    def whole(self, state):
        """Return the state with the particles of all ranks, in the order of the whole cloud."""
        return replace(state, particles=self.sharing.whole(state.particles))

    def _first_lines(self):
        lines = begin(self.scene.lines, self.cell_size / LINE_POINTS_PER_CELL)
        if not self.scene.free:
            return lines
        top = Line("surface", "surface", self.scene.outline.surface)
        return lines + begin([top], self.cell_size / SURFACE_POINTS_PER_CELL)

    def _take(self, section, lines, regions=None):
        """Go on with a new mesh, which follows the surface or, fitted, the lines."""
        if self.grid is not None:
            self.grid.stokes.release()
        self.grid = self._grid_of(section, lines, regions)
        give_memory_back()
        self.meshes += 1
        line = surface_of(lines)
        if regions is not None:
            # As it was made its nodes are on the lines; where it cannot better that it stays so.
            if not self.grid.fit(lines) and line is not None:
                self.grid.index.moved(self.grid.top.line)
        elif line is not None and not self.grid.follow(standing(line.points)[0]):
            raise MeshError(
                "the cells below the surface lose their shape: it is too steep for columns; "
                "raise mesh.cells"
            )

    def _grid_of(self, section, lines, regions):
        return Grid(self.scene, section, self.counts, regions, lines, self.ranks)

    def _units(self, points, particles=None, bands=()):
        """Return what tells a `Grid` the units of its regions; None where there are none."""
        if points is None:
            return None
        known = {"particles": particles, "points": points, "bands": dict(bands)}
        return partial(units_of_regions, **known, scene=self.scene, ranks=self.ranks)

    def _let_follow(self, fitted):
        """Let mesh lines follow the rock from now on, or particles carry it."""
        if fitted == self.fitted:
            return
        mesh = self._given if fitted else replace(self._given, interfaces="particles")
        self.scene, self.fitted = replace(self.scene, mesh=mesh), fitted
        self.mesher = self.make_mesher(self.scene, self.ranks)

    def stand(self, lines):
        """Move the mesh to where the surface is, or make a new one if its cells would suffer."""
        line = surface_of(lines)
        if line is None or self.fitted:
            return
        with self.timed("surface"):
            followed = self.grid.follow(standing(line.points)[0])
        if not followed:
            with self.timed("mesh"):
                section, _ = self.mesher.mesh(lines, self.grid, self._last_flow)
                self._take(section, lines)

    def with_flow(self, state):
        """Return the state with its flow solved for, on a new mesh where one is due."""
        if state.flow is not None:
            return state
        particles, refine = state.particles, self.scene.mesh.refine
        if self.fitted:
            try:
                particles = self.fit(particles, state.lines)
            except MeshError as error:
                return self.with_flow(self._left_to_particles(state, error))
        elif refine and self._steps % refine.every == 0:
            if "velocity-gradient" in refine.where and self._last_flow is None:
                self._last_flow = self.solve(particles, state.time, state.lines)
            particles = self._adapt(particles, state.lines)
        else:
            particles = self._carried(particles, state.lines)
        with self.timed("advect"):
            particles = self.sharing.migrated(particles, self.grid.index)
        self._last_flow = self.solve(particles, state.time, state.lines)
        return replace(state, particles=particles, flow=self._last_flow, grid=self.grid)

    def _carried(self, particles, lines):
        """Return the particles located in the mesh that follows the surface among the lines."""
        before = self.grid
        self.stand(lines)
        if self.grid is not before:
            particles = self._nowhere(particles)
        elif self.surface is None:
            return particles
        return relocate(particles, self.grid.index)

    def fit(self, particles, lines, rows=None, begins=True):
        """Move the mesh to the lines, or make one for them; return the particles located in it.

        Args:
            particles: `Particles`.
            lines, rows, begins: see `Contacts.follow`.
        """
        with self.timed("mesh"):
            if begins:
                self.grid.contacts.hold(lines)
            if not self.grid.fit(lines, rows, begins):
                section, points = self.mesher.mesh(lines)
                particles = self._nowhere(particles)
                self._take(section, lines, self._units(points, particles, areas(lines)))
            self._guard.look(self.grid)
            return relocate(particles, self.grid.index)

    def _adapt(self, particles, lines):
        """Adapt the mesh; return the particles located in it."""
        with self.timed("mesh"):
            section, _ = self.mesher.mesh(lines, self.grid, self._last_flow)
            self._take(section, lines)
            return self._settled(relocate(self._nowhere(particles), self.grid.index))

    @staticmethod
    def _nowhere(particles):
        """Return the particles without cells: those of another mesh tell nothing."""
        return replace(particles, cell=np.full_like(particles.cell, OUTSIDE))

    def stable_step(self, state, mark):
        """Return the longest step on the way to a mark, s; positive.

        It crosses ``courant`` cells, is off by what is tolerated, and a free surface bears it.

        Raises:
            SolveError: the velocity is not finite.
        """
        fastest = state.grid.fastest(state.flow)
        if not np.isfinite(fastest):
            raise SolveError("the velocity is not finite; no time step is possible")
        longest = self.scene.time.courant / fastest if fastest > 0 else np.inf
        longest = min(longest, self._next, self.longest)
        if self.surface:
            with self.timed("surface"):
                longest = min(longest, self.surface.stable_step(state.grid, state.time, mark))
        return longest

    def advance(self, state, until):
        """Return the state moved to the time ``until``, s; earlier than now restores.

        Or less far, where a whole step would be off by more than is tolerated.
        """
        crossed = self._crossed()
        try:
            return self._advanced(state, until)
        except MeshError as error:
            if not self.fitted:
                raise
            self.left, self.entered, self.born = crossed
            return self._advanced(self.with_flow(self._left_to_particles(state, error)), until)

    def _crossed(self):
        """Return how many particles have left, have entered and were born so far."""
        return dict(self.left), dict(self.entered), self.born

    def _left_to_particles(self, state, error):
        """Return a state, without its flow, whose particles carry the rock from now on."""
        self._leave_to_particles(state.time, error)
        return replace(state, flow=None, particles=self._adapt(state.particles, state.lines))

    def _leave_to_particles(self, time, error):
        """Go on with meshes through which particles carry the rock.

        Raises:
            MeshError: the error, where the scene does not leave the rock to them.
        """
        if self.scene.mesh.interfaces != "auto":
            raise error
        self.notes.append(
            f"from {time_label(self.scene, time)} on particles carry the rock: "
            f"{str(error).partition('; let particles')[0]}"
        )
        self._let_follow(False)
        self._last_flow = None

    def _advanced(self, state, until):
        slaving = self.surface and self.surface.slaving
        if slaving and slaving.modes is None:
            self._find_rate(state)
            state = self._on_equilibrium(state, SETTLINGS)
        after = self._moved(state, until, self.scene.time.scheme)
        self._steps += 1
        if not self.fitted:
            with self.timed("advect"):
                after = replace(after, particles=self._settled(after.particles))
        return self._on_equilibrium(after, 1) if slaving else after

    def _controlled(self, state, until, scheme, slaving):
        """Return a `Step` as long as its error allows, its rows at the end, and when that is.

        Raises:
            SolveError: steps fall below all bounds.
        """
        tolerance = self.scene.time.tolerance
        for _ in range(MOST_TRIALS):
            dt = until - state.time
            move = Step(self, state, dt, scheme, slaving)
            x, error = move.taken(tolerance)
            if tolerance is None or error is None:
                return move, x, until
            growth = SAFETY * (tolerance / max(error, 1e-9 * tolerance)) ** (
                1 / SCHEMES[scheme].order  # the error of one step of the embedded scheme
            )
            self._next = abs(dt) * min(max(growth, MOST_SHRUNK), MOST_GROWN)
            if error <= tolerance:
                return move, x, until
            self.rejected += 1
            until = state.time + np.sign(dt) * self._next
            if self.fitted or self.surface:  # the stages have moved the mesh
                state = self.with_flow(replace(state, flow=None))
        raise SolveError(
            f"a step of {show(abs(dt), 'time')} is still off by {show(error, 'length')} after "
            f"{MOST_TRIALS} trials; a larger time.tolerance, or finer cells, may help"
        )

    def _moved(self, state, until, scheme, slaving=True):
        """Return a state moved by a scheme, its particles located but no cells filled.

        Args:
            state: with its flow.
            until: model time, s, at the furthest.
            scheme: name of one of `advection.SCHEMES`.
            slaving: whether slaved modes of the surface move with their equilibrium.
        """
        move, x, until = self._controlled(state, until, scheme, slaving)
        dt, state = until - state.time, move.state
        with self.timed("advect"):
            moved = move.parts(self._on_walls(x[: move.fixed], move.particles))
            rows = with_points(state.lines, moved["lines"])
            lines = self.with_ends(state.lines, rows)
            most = most_vertices(self.section.cell_count)
            lines = refined(
                lines,
                self.cell_size / LINE_POINTS_PER_CELL,
                self.cell_size / LINE_POINTS_PER_CELL_AT_TURNS,
                until,
                dt,
                most,
            )
            lines = self.ranks.same(lines)  # rounding must not part what the ranks hold
            self._note_folded(lines, until, most)
        if self.surface:
            lines, fallen = without_cliffs(lines, MOST_FALLEN * self.start_area, self.cell_size)
            lines, shift = with_area(lines, x[-1, 0] * move.width)
            self.fallen, self.surface_shift = self.fallen + fallen, self.surface_shift + shift
        particles = replace(state.particles, x=moved["particles"])
        if not self.open:
            of_rocks = self.mesher.contacts
            lines, shift = kept(state.lines, lines, self.scene.outline, self.scene.free, of_rocks)
            self.horizon_shift += shift
        with self.timed("advect"):
            particles = self._through_walls(particles, lines, moved)
        if self.fitted:  # the mesh they will be in is yet to come
            self.grid.contacts.carry(rows, lines)
            return State(until, particles, lines)
        if self.surface:
            particles = self._carried(particles, lines)
        with self.timed("advect"):
            particles = relocate(particles, self.grid.index)
        return State(until, particles, lines)

    def _note_folded(self, lines, time, most):
        """Note which lines have come to the most vertices, once for each."""
        for line in lines:
            if len(line.points) == most and line.name not in self._folded:
                self._folded.add(line.name)
                self.notes.append(
                    f"from {time_label(self.scene, time)} on {line.kind} {line.name} is followed "
                    f"by no more than {most} vertices: it is folded finer than the cells tell; "
                    "finer cells or shorter steps stir it less"
                )

    def _find_rate(self, state):
        """Find the rate of the equilibrium of the surface where slaving begins, by a trial step."""
        slaving = self.surface.slaving
        with self.timed("surface"):
            slaving.look(self.grid)
            slaving.passes(state.time, surface_of(state.lines).points, state.flow)
        begin, crossed = slaving.last, self._crossed()
        trial = self._moved(
            state, state.time - TRIAL / slaving.modes.rates[-1], "euler", slaving=False
        )
        self.left, self.entered, self.born = crossed
        at = self._placed(trial.particles, trial.lines)
        flow = self.solve(at, trial.time, trial.lines)
        with self.timed("surface"):
            slaving.look(self.grid)
            slaving.passes(trial.time, surface_of(trial.lines).points, flow)
        slaving.returns(begin)

    def _placed(self, particles, lines):
        """Return the particles located in a mesh for the lines where they are."""
        place = self.fit if self.fitted else self._carried
        return place(particles, lines)

    def outline(self, lines):
        """Return the frame of the section at a moment."""
        surface, frame = surface_of(lines), self.scene.outline
        return frame if surface is None else Outline(standing(surface.points)[0], frame.base)

    def with_ends(self, before, lines):
        """Return lines cut at the open sides where they have left, and drawn on where they lack.

        Args:
            before: the lines before the step.
            lines: the same after it.
        """
        if not self.open.intersection(("left", "right")):
            return lines
        edges = self.scene.outline.surface[[0, -1], 0]
        return with_ends(before, lines, edges, self.open, self.cell_size / LINE_POINTS_PER_CELL)

    def _through_walls(self, particles, lines, moved):
        """Return the particles without those that left, and with those that flowed in."""
        if not self.open:
            return particles
        outline = self.outline(lines)
        particles, out = cast_off(particles, outline, self.open)
        for name in sorted(self.open):
            self.left[name] += int(self.ranks.sum(np.array(out[name])))
            born = flowed_in(particles, name, outline, moved[name], self.spacing, self.ranks)
            if born is not None:
                self.entered[name] += len(born.x)
                particles = self.sharing.with_newborn(particles, born)
        return particles

    def _on_equilibrium(self, state, settlings):
        """Return a state with the slaved modes of its surface on their equilibrium."""
        slaving, lines, particles = self.surface.slaving, state.lines, state.particles
        for _ in range(settlings):
            particles = self._placed(particles, lines)
            flow = self.solve(particles, state.time, lines)
            with self.timed("surface"):
                slaving.look(self.grid)
                surface = surface_of(lines)
                slaving.passes(state.time, surface.points, flow)
                lift = slaving.lift(flow)
                rise = np.interp(surface.points[:, 0], self.grid.top.x, lift)
                points = surface.points + np.column_stack([np.zeros(len(rise)), rise])
                moved = replace(surface, points=points)
                lines = tuple(moved if line is surface else line for line in lines)
        return self.with_flow(State(state.time, particles, lines))

    def solve(self, particles, time, lines, hats=None, lead=0.0, before=None):
        """Return the flow of particles in the mesh as it is.

        Args:
            particles: located `Particles`.
            time: model time, s, of what the walls prescribe.
            lines: at the same moment.
            hats: of the particles, or None.
            lead, before: see `StokesProblem.stabilise`.
        """
        grid = self.grid
        with self.timed("fields"):
            if hats is None:
                hats = grid.index.locate(particles.x, particles.cell)[1]
            grid.fill(particles, hats, lines)
            look_at_fields(grid)
        with self.timed("assemble"):
            grid.stokes.set_time(time)
            if self.surface:
                grid.stokes.stabilise(lead, before)
            grid.stokes.assemble()
        with self.timed("solve"):
            return grid.stokes.solve()

    def _settled(self, particles):
        """Return the particles with new ones where the fields could not be filled without.

        A cell that runs empty reads its rock from the particles around it, continuously as they
        move. A birth is a jump that the way back cannot undo (see docs/accuracy.md), so particles
        are born only where all is empty for two cells around. Air has none.
        """
        if self.fitted:  # the cells know their rock
            return particles
        index = self.grid.index
        empty = empty_cells(particles, len(index.area), self.ranks)
        empty = empty[~self.grid.fields.in_air[empty]]
        self.empty_cells = len(empty)
        if len(empty):
            nodes = self.grid.spaces.h_nodes
            held = np.ones(len(nodes), bool)
            held[empty] = False
            served = np.zeros(nodes.max() + 1, bool)
            for _ in range(2):
                served[nodes[held]] = True
                held = served[nodes].any(axis=1)
            empty = empty[~served[nodes[empty]].all(axis=1)]
        self.born += len(empty)
        if not len(empty):
            return particles
        return self.sharing.with_newborn(particles, born_in(empty, particles, index, self.ranks))

    def within(self, x):
        """Return the points with those beyond the frame set onto it; a free surface has none."""
        held = dict.fromkeys(WALLS, True) | {"surface": not self.scene.free}
        return held_inside(x, self.scene.outline, held)[0]

    def _on_walls(self, x, particles):
        """Return the points with those that a step carried through a closed wall set back onto it.

        No rock crosses such a wall; a step of finite length can, by its own error.

        Args:
            x: points, shape (n, 2), m.
            particles: how many of them, the first, are particles of this rank; all have the rest.
        """
        held = {name: name not in self.open for name in WALLS}
        held["surface"] &= not self.scene.free
        inside, count = held_inside(x, self.scene.outline, held)
        others = np.count_nonzero((inside[particles:] != x[particles:]).any(axis=1))
        self.held_on_wall += others + int(self.ranks.sum(np.array(count - others)))
        return inside

    @contextmanager
    def timed(self, part):
        """Count the time spent inside as that of a part of the run."""
        begin = time.perf_counter()
        yield
        self.seconds[part] += time.perf_counter() - begin

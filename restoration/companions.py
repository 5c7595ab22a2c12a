"""Companions of a restoration: how its errors grow, found without knowing the truth.

While a run restores, its state is kept at some instants. From each of them companions on a coarser
mesh restore the rock to the next instant: as the run has it, and displaced by what may be wrong
with it. What the coarse mesh does otherwise than the run tells, by the order of the mesh, what the
run itself does wrong there; what becomes of a displacement tells how errors grow. Both are carried
along from instant to instant. Companions begin anew from the run each time: left alone, they would
soon restore another section, whose errors grow otherwise.
"""

import time
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from restoration.diagnostics import line_distances, summary
from restoration.displacement import Perturbation, displaced, matched, offset
from restoration.errors import MeshError, SolveError, StoppedError, TooLargeError
from restoration.lines import as_drawn
from restoration.particles import subset
from restoration.shapes import on_columns

INSTANTS = 12  # between the given section and the end
STEPS = 4  # of the run at least, between two of them
MOST_KEPT = 20_000_000  # particles of all instants together
COARSER = (2.0, 3.0)  # cells of the companions, in cells of the run
LEAST_CELLS = 6  # along the shorter side of a companion
SHORTEST = 2  # cells of the companion: the shortest wave of it
ORDERS = 1.0, 2.0  # between which the observed order of the mesh is believed
ORDER = 1.0  # where it is not observed
CHEAPER = {"rk4": "midpoint", "rk3": "midpoint"}  # schemes: the mesh of a companion is off by more
THINNED = 4  # one of so many particles is in the companions that tell growth
PROBED = 3  # one of so many ways between instants is gone by the coarsest companion
FINER = 0.8  # cells of the way forward again, in cells of the run
OTHER = {"rk4": "midpoint", "euler": "midpoint", "paper": "midpoint"}  # schemes of that; else rk4
NOTED = "steps", "ends", "_last_seen", "_instants", "_next"  # by a follower, beside states


def way_back(marks):
    """Return the numbers of the marks where the longest way back begins and ends, or None.

    Args:
        marks: model times, s.
    """
    ways, begin = [], 0
    for number, (one, two) in enumerate(pairwise(marks), start=1):
        if two > one:
            begin = number
        else:
            ways.append((marks[begin] - two, begin, number))
    return max(ways, key=lambda way: (way[0], way[1]))[1:] if ways else None


class Follower:
    """Keeps the states of a run on its longest way back.

    Args:
        scene: `scene.Scene`.
        whole: maps a state to one with the particles of all ranks.

    Attributes:
        states: `State` of the given section, then of every instant passed; without flows.
        steps: number of steps so far on the way back.
        ends: model times where it begins and ends, s; None where nothing is restored.
    """

    def __init__(self, scene, whole=lambda state: state):
        self.scene, self.states, self.steps = scene, [], 0
        self._whole = whole
        self._last_seen = None
        way = way_back(scene.time.marks)
        self._begin = way[0] if way else None
        self.ends = tuple(scene.time.marks[number] for number in way) if way else None

    @property
    def done(self):
        """Whether the end of the way back was reached."""
        return bool(self.states) and self.states[-1].time == self.ends[1]

    def memory(self, keep):
        """Return what was kept so far, for a checkpoint; see `recall`.

        Args:
            keep: gives a state a name under which it is kept.
        """
        memory = {"states": [keep(state) for state in self.states]}
        if self.states:
            memory |= {name: getattr(self, name) for name in NOTED}
        return memory

    def recall(self, memory, kept):
        """Go on from what `memory` returned.

        Args:
            memory: of `memory`.
            kept: gives the state of a name.
        """
        self.states = [kept(name) for name in memory["states"]]
        if self.states:
            for name in NOTED:
                setattr(self, name, memory[name])
            self.ends = tuple(self.ends)

    def mark(self, number, state):
        """Begin at the mark of the given section."""
        if number == self._begin:
            instants = int(np.clip(MOST_KEPT / len(state.particles.x), 3, INSTANTS))
            self._instants = np.linspace(*self.ends, instants + 1)
            self._instants[-1] = self.ends[1]
            self._keep(state)

    def step(self, state):
        """Keep a state after a step, where it has passed the next instant."""
        if not self.states or self.done:
            return
        self.steps += 1
        self._last_seen = state.time
        # an instant that is missed by rounding is passed
        if state.time <= self._next + 1e-9 * (self.ends[0] - self.ends[1]):
            self._keep(state)

    def finished(self, state):
        """Return whether the way back was gone; ``state`` is where the run has ended."""
        if self.states and not self.done and state is not None and state.time == self._last_seen:
            # it stopped earlier than its last mark, or went back to where it was flattest
            self.states = [kept for kept in self.states if kept.time > state.time]
            self._keep(state)
            self.ends = self.ends[0], state.time
        if not self.done or len(self.states) < 2:
            return False
        # a companion makes a step at least from each to the next, and is to make fewer than the run
        ways = int(np.clip(self.steps // STEPS, 3, INSTANTS))
        kept = np.unique(np.linspace(0, len(self.states) - 1, ways + 1).round().astype(int))
        self.states = [self.states[i] for i in kept]
        return True

    def _keep(self, state):
        self.states.append(replace(self._whole(state), flow=None, grid=None))
        ahead = self._instants[self._instants < state.time - 1e-9 * np.ptp(self._instants)]
        self._next = ahead[0] if len(ahead) else self.ends[1]


def companion_scene(scene, coarser, times, scheme=None):
    """Return a scene on a mesh with cells some times as large, for a way back.

    Args:
        scene: `scene.Scene` of the run.
        coarser: how many times.
        times: model times of the way, s.
        scheme: of the steps; None for that of the run, or one that costs less.
    """
    coarser = min(coarser, max(1.0, min(scene.cells) / LEAST_CELLS))
    cells = tuple(max(1, round(n / coarser)) for n in scene.cells)
    way = scene.time
    per_cell = np.prod(scene.cells) / np.prod(cells) * scene.particles.per_cell
    return replace(
        scene,
        cells=cells,
        outline=on_columns(scene.outline, cells[0], scene.free)[0],
        particles=replace(scene.particles, per_cell=max(1, round(per_cell))),
        time=replace(
            scene.time, marks=tuple(times), scheme=scheme or CHEAPER.get(way.scheme, way.scheme)
        ),
    )


class Companion:
    """Restores the rock of a run from one of its instants to the next, on a mesh of its own.

    Args:
        follower: `Follower` of the run.
        make_engine: makes the engine of a scene.
        march: `run.march`.
        coarser: how many times larger its cells are.
        check: called after every step.
        scheme: see `companion_scene`.

    Attributes:
        cells: columns and rows of squares.
        coarser: the same, as the number of cells allows.
        seconds: it took so far.
    """

    def __init__(self, follower, make_engine, march, coarser, check=None, scheme=None):
        begin = time.perf_counter()
        times = [state.time for state in follower.states]
        self._scene = companion_scene(follower.scene, coarser, times, scheme)
        self.cells = self._scene.cells
        self._march = march
        self._every = () if check is None else (lambda *_: check(),)
        self.coarser = float(np.sqrt(np.prod(follower.scene.cells) / np.prod(self._scene.cells)))
        self._step = self.coarser * abs(times[-1] - times[0]) / follower.steps
        self.engine = make_engine(self._scene)
        self.seconds = time.perf_counter() - begin

    def restored(self, state, until, off=None):
        """Return where the particles of a state come to, as displaced.

        Args:
            state: `State` of the run at an instant.
            until: model time of the next one, s.
            off: displacement of its particles, shape (n, 2), m; None for none.

        Returns:
            `State`.

        Raises:
            MeshError, SolveError: the companion could not restore it.
        """
        begin = time.perf_counter()
        if off is not None:
            state = displaced(state, off, self.engine.within)
        steps = max(1, round(abs(until - state.time) / self._step))
        plan = replace(self._scene.time, marks=(state.time, until), min_steps=steps)
        after = self._march(self.engine.taken_over(state), self.engine, plan, self._every)
        after = self.engine.whole(after)
        self.seconds += time.perf_counter() - begin
        return after

    def __enter__(self):
        return self

    def __exit__(self, kind, *_):
        """Free the memory of its solver, together: not where one rank alone has met something."""
        together = kind is None or issubclass(kind, (MeshError, SolveError, StoppedError))
        if together and not (kind and issubclass(kind, TooLargeError)):
            self.engine.grid.stokes.release()


def order(near, far, coarser):
    """Return the observed order of the mesh, from distances of two companions to the run.

    ``far / near = (q^p - 1) / (r^p - 1)`` for cells r and q times as large.

    Args:
        near, far: distances of the finer and the coarser companion, m.
        coarser: r and q.
    """
    r, q = coarser
    if not (near > 0 and np.isfinite(far) and q > r > 1):
        return ORDER
    p = np.linspace(*ORDERS, 151)
    ratio = (q**p - 1) / (r**p - 1)
    return float(np.interp(far / near, ratio, p))


@dataclass(frozen=True)
class Growth:
    """What becomes of errors on the way back, at the instants that were reached.

    Attributes:
        states: of the run at the instants, with some of its particles.
        noise: displacement of these at every instant, one list for each of the random
            displacements of the given section; lists of (n, 2), m.
        mesh: the same of the error of the mesh.
        order: of the mesh, as observed.
        failure: why the companions did not come to the end; empty if they did.
        seconds: all took.
    """

    states: list
    noise: list
    mesh: list
    order: float
    failure: str
    seconds: float


def accompany(follower, make_engine, march, noise, seeds=(11, 12, 13), check=None):
    """Restore the given section of a run with companions, as `Growth`.

    Args:
        follower: `Follower` of the run.
        make_engine: makes the engine of a scene.
        march: `run.march`.
        noise: root mean square of the random displacements of the given section, m.
        seeds: of these, one for each.
        check: called after every step.
    """
    begin = time.perf_counter()

    def make(coarser):
        return Companion(follower, make_engine, march, coarser, check)

    states = thinned(follower.states)
    shortest = SHORTEST * COARSER[0] * follower.scene.outline.width / follower.scene.cells[0]
    waves = [Perturbation(states[0], follower.scene, noise, shortest, seed) for seed in seeds]
    rock = [[wave(states[0].particles.x)] for wave in waves]
    grown, p, failure = [np.zeros_like(states[0].particles.x)], ORDER, ""
    wrong, alone = [], []
    try:
        p, wrong = _wrong(follower.states, states, make)
    except TooLargeError:
        raise
    except (MeshError, SolveError) as error:
        failure = str(error)
    ways = list(pairwise(states))[: len(wrong)]
    # One after the other: every companion has a mesh and factors of its own.
    journeys = [(alone, None, None), *((off, alone, None) for off in rock), (grown, alone, wrong)]
    for off, less, more in journeys:
        if not ways:
            break
        try:
            with make(COARSER[0]) as other:
                _carry(other, ways, off, less, more)
        except TooLargeError:
            raise
        except (MeshError, SolveError) as error:
            failure = str(error)  # on an earlier way than any before: none goes farther than that
            del ways[len(off) - (off is not alone) :]
    for off in (*rock, grown):
        del off[len(ways) + 1 :]
    return Growth(states, rock, grown, p, failure, time.perf_counter() - begin)


def _carry(companion, ways, off, less=None, more=None):
    """Carry displacements of the given section along, from instant to instant.

    Args:
        companion: `Companion` that restores it.
        ways: pairs of `State`s of the run.
        off: displacements at the instants so far, to which those at the next ones are added: list
            of (n, 2), m. With no ``less`` nothing is displaced, and ``off`` begins empty.
        less: what the companion does without any, by way.
        more: what is displaced beside that, by way; None for nothing.
    """
    for i, (one, two) in enumerate(ways):
        found = offset(two, companion.restored(one, two.time, None if less is None else off[i]))
        if less is not None:
            found -= less[i]
        off.append(found if more is None else found + more[i])


def _wrong(states, kept, make):
    """Return the order of the mesh, and what a run does wrong between its instants.

    Args:
        states: `State` of the run at its instants.
        kept: the same with the particles that are asked about.
        make: makes a `Companion` with cells so many times larger.

    Returns:
        The order, and displacements of particles at the end of every way, list of (n, 2), m.
    """
    ways = list(pairwise(states))
    with make(COARSER[0]) as near:
        off = [offset(two, near.restored(one, two.time)) for one, two in ways]
    sizes, probed = [], slice(PROBED - 1, None, PROBED)
    with make(COARSER[1]) as far:
        for (one, two), x in zip(ways[probed], off[probed], strict=True):
            more = offset(two, far.restored(one, two.time))
            sizes.append([np.hypot(*y.T).mean() for y in (x, more)])
    coarser = near.coarser, far.coarser
    p = order(*np.sum(sizes, axis=0), coarser) if sizes else ORDER
    share = -1 / (coarser[0] ** p - 1) if coarser[0] > 1 else 0.0
    pairs = zip(states[1:], kept[1:], strict=True)
    rows = [matched(two.particles, one.particles) for one, two in pairs]
    return p, [
        share * np.where(at[:, None] >= 0, x[at], 0.0) for x, at in zip(off, rows, strict=True)
    ]


def thinned(states):
    """Return states with some of their particles, the same ones in all."""
    first = states[0].particles
    some = subset(first, np.arange(0, len(first.x), THINNED))
    found = []
    for state in states:
        rows = matched(some, state.particles)
        later = np.flatnonzero(state.particles.born)[::THINNED]
        particles = subset(state.particles, np.r_[rows[rows >= 0], later])
        found.append(replace(state, particles=particles))
    return found


def prove(follower, end, make_engine, march, check=None):
    """Move a restored section forward again, and compare it with the given one.

    Mesh, steps and scheme are others than those that restored it: what comes back is not the
    algebra of a scheme and its reverse.

    Args:
        follower: `Follower` of the run.
        end: `State` that was restored.
        make_engine: makes the engine of a scene.
        march: `run.march`.
        check: called after every step.

    Returns:
        Entries of the record: ``cells, scheme, mean_m, p99_m, max_m``, ``horizons`` with distances
        by name, ``failure``, None where the given section was reached, and ``wall_s``.
    """
    given, begin = follower.states[0], time.perf_counter()
    scheme = OTHER.get(follower.scene.time.scheme, "rk4")
    proof = {"cells": None, "scheme": scheme} | summary(np.empty(0))
    proof |= {"horizons": None, "failure": None}
    try:
        with Companion(follower, make_engine, march, FINER, check, scheme) as prover:
            proof["cells"] = list(prover.cells)
            reached = prover.restored(end, given.time)
    except TooLargeError:
        raise
    except (MeshError, SolveError) as error:
        return proof | {"failure": str(error), "wall_s": round(time.perf_counter() - begin, 3)}
    rows = matched(given.particles, reached.particles)
    off = reached.particles.x[rows] - given.particles.x
    proof |= summary(np.hypot(*off[rows >= 0].T))
    proof["horizons"] = line_distances(as_drawn(given.lines), as_drawn(reached.lines))
    return proof | {"wall_s": round(time.perf_counter() - begin, 3)}

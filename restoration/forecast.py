"""What a run will take, told by a rehearsal: its whole way on coarse cells, and a few real steps.

How many steps a run takes is up to the flow, which grows and slows down on the way. The rehearsal
goes the way on `COARSE` squares and notes how fast it flows there; the run crosses cells as much
faster as it does at the start. What a step costs is measured: two steps of the run itself are
taken, on its own mesh. So the forecast is one of this machine, as busy as it is.
"""

import resource
import time
from dataclasses import dataclass, replace
from math import ceil

import numpy as np

from restoration.advection import SCHEMES
from restoration.box_engine import BoxEngine
from restoration.companions import COARSER, INSTANTS, LEAST_CELLS, companion_scene, way_back
from restoration.engine import StokesEngine
from restoration.entries import BOX_CELLS, PRESETS
from restoration.errors import MeshError
from restoration.run import march, next_time
from restoration.shapes import on_columns
from restoration.stopping import Stopping

COARSE = {2: 12, 3: 5}  # squares, or cubes, along the shorter side of a rehearsal
LEAST = 4  # of them along any side
TIMED = 2  # steps of the run that are timed
START_S = 4.0  # of a run: what is loaded before its own clock begins, and what it writes
MARK_S, PER_PARTICLE_S = 1.0, 3e-6  # of a mark: frame and picture
FIGURES_MB = 150  # that the pictures take on top
ROUNDING = 1e-9  # of a number of steps
CERTIFICATE = 2.7  # times what its solves alone would cost: 2.6 and 3 in two of the shipped cases
COST_GROWTH = 1.1  # exponent of the cost of a step against cells


@dataclass(frozen=True)
class Pace:
    """A step of the rehearsal.

    Attributes:
        leg: number of the mark it leads to, from 1.
        dt: length, s.
        fastest: cells crossed in a time, 1/s.
        bound: longest step that its surface bears, s.
    """

    leg: int
    dt: float
    fastest: float
    bound: float


@dataclass(frozen=True)
class Forecast:
    """What a run will take.

    Attributes:
        steps, solves: of the run, without its certificate.
        step_s: wall seconds of a step.
        run_s, certificate_s: wall seconds of the run without the certificate, and of that.
        memory_mb: greatest resident memory.
        presets: wall seconds of the same scene by name of `entries.PRESETS`.
    """

    steps: int
    solves: int
    step_s: float
    run_s: float
    certificate_s: float
    memory_mb: float
    presets: dict[str, float]

    @property
    def seconds(self):
        """Wall seconds of the whole run."""
        return self.run_s + self.certificate_s


def forecast(scene):
    """Return the `Forecast` of a scene.

    Args:
        scene: `scene.Scene`.
    """
    paces, first = rehearsal(scene)
    begin = time.perf_counter()
    engine = (StokesEngine if scene.dim == 2 else BoxEngine)(scene)
    state = engine.with_flow(engine.start())
    setup = time.perf_counter() - begin
    ratio = state.grid.fastest(state.flow) / first if first else 1.0
    step_s = timed_step(engine, state)
    engine.grid.stokes.release()
    plan = scene.time
    steps = steps_of(paces, plan, ratio)
    marks = len(plan.marks) * (MARK_S + PER_PARTICLE_S * len(state.particles.x))
    run_s = START_S + setup + marks + sum(steps) * step_s
    presets = {}
    for name, preset in PRESETS.items():
        finer = (preset["cells"] if scene.dim == 2 else BOX_CELLS[name]) / min(scene.cells)
        # A courant number that bounds nothing stays so.
        courant = preset["courant"] if plan.courant <= 1 else plan.courant
        there = replace(plan, courant=courant, min_steps=preset["min_steps"])
        again = steps_of(paces, there, ratio * finer)
        cost = step_s * finer ** (scene.dim * COST_GROWTH)
        whole = START_S + marks + setup * finer**scene.dim + sum(again) * cost
        presets[name] = whole + certificate_seconds(scene, again, cost, finer)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    return Forecast(
        sum(steps),
        1 + sum(steps) * SCHEMES[plan.scheme].solves,
        step_s,
        run_s,
        certificate_seconds(scene, steps, step_s),
        peak + FIGURES_MB,
        presets,
    )


class Noting:
    """What an engine does besides: it notes what bounds its steps.

    Attributes:
        noted: cells crossed in a time, 1/s, and the longest step that the surface bears, s, when
            a step was asked for last.
    """

    def stable_step(self, state, mark):
        """Return the longest step, see the engine."""
        longest, fastest = super().stable_step(state, mark), state.grid.fastest(state.flow)
        bound = np.inf
        if self.surface:
            bound = self.surface.stable_step(state.grid, state.time, mark)
        self.noted = fastest, bound
        return longest


class NotingEngine(Noting, StokesEngine):
    """A `StokesEngine` that notes what bounds its steps."""


class NotingBox(Noting, BoxEngine):
    """A `BoxEngine` that notes what bounds its steps."""


def rehearsal(scene):
    """Go the way of a scene on coarse cells.

    Returns:
        A list of `Pace`, and how many cells were crossed in a time at the start, 1/s.
    """
    coarser = max(1.0, min(scene.cells) / COARSE[scene.dim])
    cells = tuple(max(min(LEAST, n), round(n / coarser)) for n in scene.cells)
    plane = scene.dim == 2
    rough = replace(
        scene,
        cells=cells,
        outline=on_columns(scene.outline, cells[0], scene.free)[0] if plane else scene.outline,
        mesh=replace(scene.mesh, interfaces="particles", refine=None),
        particles=replace(scene.particles, densify=min(scene.particles.densify, 4)),
        time=replace(scene.time, scheme="midpoint", courant=1.0, min_steps=8, tolerance=None),
    )
    engine, paces, leg = (NotingEngine if plane else NotingBox)(rough), [], [0]

    def note(before, state):
        paces.append(Pace(leg[0] + 1, abs(state.time - before.time), *engine.noted))

    def arrive(number, _state):
        leg[0] = number

    start = engine.with_flow(engine.start())
    first = start.grid.fastest(start.flow)
    try:
        march(start, engine, rough.time, (note,), (arrive,), Stopping(rough.time))
    except MeshError:  # too coarse to go on: what is left is taken to flow as fast as so far
        paces += _rest(paces, rough.time.marks)
    engine.grid.stokes.release()
    return paces, first


def _rest(paces, marks):
    """Return paces of the ways that a rehearsal did not come to."""
    if not paces:
        return []
    legs = np.abs(np.diff(marks))
    gone = np.bincount([pace.leg - 1 for pace in paces], [pace.dt for pace in paces], len(legs))
    left = [(leg, s) for leg, s in enumerate(legs - gone, start=1) if s > 0]
    return [replace(paces[-1], leg=leg, dt=s) for leg, s in left]


def timed_step(engine, state):
    """Return the wall seconds of a step of an engine, its first one left out."""
    plan, mark, seconds = engine.scene.time, engine.scene.time.marks[1], []
    for _ in range(1 + TIMED):
        begin = time.perf_counter()
        longest = abs(mark - state.time) / plan.min_steps
        until = next_time(state.time, mark, min(engine.stable_step(state, mark), longest))
        state = engine.with_flow(engine.advance(state, until))
        seconds.append(time.perf_counter() - begin)
        if state.time == mark:
            break
    return float(np.mean(seconds[1:] or seconds))


def steps_of(paces, plan, ratio):
    """Return the number of steps to every mark.

    Args:
        paces: of the rehearsal.
        plan: `scene.TimePlan` of the run.
        ratio: how many times more cells it crosses in a time than the rehearsal.
    """
    counts = []
    for leg in range(1, len(plan.marks)):
        own = [pace for pace in paces if pace.leg == leg]
        if not own:  # stopped before
            continue
        longest = abs(plan.marks[leg] - plan.marks[leg - 1]) / plan.min_steps
        count = 0.0
        for pace in own:
            crossed = plan.courant / (pace.fastest * ratio) if pace.fastest else np.inf
            count += pace.dt / min(crossed, pace.bound, longest)
        counts.append(max(1, ceil(count * (1 - ROUNDING))))
    return counts


def certificate_seconds(scene, steps, step_s, finer=1.0):
    """Return the wall seconds of the certificate of a run.

    Args:
        scene: `scene.Scene`.
        steps: of the run, to every mark.
        step_s: wall seconds of one of them.
        finer: how many times finer than the scene's the cells of the run are.
    """
    way = way_back(scene.time.marks)
    if not scene.certificate or way is None:
        return 0.0
    back = sum(steps[way[0] : way[1]])
    seconds = 0.0
    for coarser, runs in zip(COARSER, (6, 1 / 3), strict=True):
        coarser = min(coarser, max(1.0, finer * min(scene.cells) / LEAST_CELLS))
        scheme = companion_scene(scene, coarser, scene.time.marks[:2]).time.scheme
        share = SCHEMES[scheme].solves / SCHEMES[scene.time.scheme].solves
        count = max(back / coarser, min(INSTANTS, back / 4))
        seconds += runs * count * share * step_s * coarser ** (-2 * COST_GROWTH)
    return CERTIFICATE * seconds

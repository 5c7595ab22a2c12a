"""Salt under a free surface, restored: against forward runs that know nothing of it."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import shapely

from restoration.bench.rows import Clock, Row, compared
from restoration.bench.scenes import two_rocks
from restoration.bench.two_interface import GRAVITY, SALT, SEDIMENT, WIDTH, exact, system
from restoration.diagnostics import line_distances
from restoration.engine import StokesEngine
from restoration.errors import RestorationError
from restoration.layered import Layer, growth_matrix
from restoration.lines import surface_of
from restoration.resolve import load
from restoration.run import march
from restoration.scene import MeshPlan, Outline, ParticlePlan, RefinePlan, SurfacePlan, Wall
from restoration.units import MYR

NAME = "reverse-surface"
DRAWN_AGES = {"exp1": "0.2 Ma", "exp3": "1.11 Ma"}  # to which the case files restore
DRAWN = Path(__file__).parents[2] / "cases" / "salt-diapir"
HEIGHT = SALT[0] + SEDIMENT[0]
VISCOSITIES = {"one viscosity": (1e19, 1e19), "two viscosities": (1.4e17, 2.8e19)}
WALLS = {"left": "free-slip", "right": "free-slip", "base": "no-slip", "surface": "free-slip"}
REFINED = RefinePlan(1, ("interfaces",), 1)  # of meshes through which particles carry the rock
OFF_SCALE = 1000.0  # m, relief of a surface that has come off the truth for good
FREE = Wall("free", (None, None), (0.0, 0.0))


class OffScaleError(RestorationError):
    """A surface with a relief that no rock has."""


@dataclass(frozen=True, eq=False)
class Moment:
    """Where a run stands.

    Attributes:
        time: s.
        horizon, surface: shape (n, 2), m.
    """

    time: float
    horizon: np.ndarray
    surface: np.ndarray

    @property
    def amplitude(self):
        """Half of what the horizon is higher on the left side than on the right one, m."""
        return (self.horizon[0, 1] - self.horizon[-1, 1]) / 2

    @property
    def relief(self):
        """Of the surface, m."""
        return np.ptp(self.surface[:, 1])


def start(viscosities, amplitude, rest):
    """Return the moment at which a cosine begins to grow.

    Args:
        viscosities: of salt and sediment, Pa s.
        amplitude: of the horizon, m.
        rest: whether the surface stands where it moves with the horizon; it is flat otherwise.
    """
    rate, modes = np.linalg.eig(system(*viscosities))
    slow = modes[:, rate.argmax()]
    x = np.linspace(0, WIDTH, 401)
    wave = amplitude * np.cos(np.pi * x / WIDTH)
    lift = slow[1] / slow[0] if rest else 0.0
    return Moment(0.0, *(np.column_stack([x, z]) for z in (SALT[0] + wave, HEIGHT + lift * wave)))


def scene(viscosities, moment, marks, columns, interfaces, plan, **time):
    """Return the scene that goes on from a moment.

    Args:
        viscosities: as `start`.
        moment: `Moment`.
        marks: model times, s.
        columns: squares across.
        interfaces: ``fitted`` or ``particles``.
        plan: `scene.SurfacePlan`.
        time: ``scheme``, ``min_steps`` and ``courant`` of `scenes.two_rocks`.
    """
    salt = shapely.Polygon([*moment.horizon, [WIDTH, 0.0], [0.0, 0.0]])
    box = two_rocks(
        WIDTH,
        HEIGHT,
        lambda points: (~shapely.contains_xy(salt, *points.T)).astype(np.int16),
        moment.horizon,
        (SALT[1], SEDIMENT[1]),
        viscosities,
        (columns, round(columns * HEIGHT / WIDTH)),
        WALLS,
        gravity=GRAVITY,
        marks=marks,
        mesh=MeshPlan("P2-P1", interfaces, None if interfaces == "fitted" else REFINED),
        particles=ParticlePlan(4, 20, 0.5, columns),
        **time,
    )
    outline = Outline(moment.surface, box.outline.base)
    return replace(box, outline=outline, walls=box.walls | {"surface": FREE}, surface=plan)


def moment_of(state):
    """Return where a state stands, as a `Moment`."""
    (horizon,) = (line for line in state.lines if line.kind == "horizon")
    return Moment(state.time, horizon.points, surface_of(state.lines).points)


def moved(scene, until=None):
    """March through a scene.

    Args:
        scene: `scene.Scene`.
        until: the mark to stop at, s; None for the last.

    Returns:
        The `Moment` after every step, from the start on, the engine, and the error that ended the
        march early or None.
    """
    engine, stopped, marks = StokesEngine(scene), None, scene.time.marks
    last = len(marks) if until is None else marks.index(until) + 1
    first = engine.start()
    moments = [moment_of(first)]

    def note(_, state):
        moments.append(moment_of(state))
        if moments[-1].relief > OFF_SCALE:
            raise OffScaleError(f"a relief of {moments[-1].relief:.0f} m")

    try:
        march(first, engine, replace(scene.time, marks=marks[:last]), every_step=(note,))
    except RestorationError as error:
        stopped = error
    engine.grid.stokes.release()
    return moments, engine, stopped


@dataclass(frozen=True)
class Truth:
    """A forward run to restore from.

    Attributes:
        viscosities: key of `VISCOSITIES`.
        amplitude: of the horizon at the start, m.
        rest: see `start`.
        marks: where it is restored from, Myr.
        interfaces, columns: of its mesh.
    """

    viscosities: str
    amplitude: float
    rest: bool
    marks: tuple[float, ...]
    interfaces: str
    columns: int

    @property
    def start(self):
        """The `Moment` at which it begins."""
        return start(VISCOSITIES[self.viscosities], self.amplitude, self.rest)

    def moments(self):
        """Return the moments at the marks, and the greatest relief on the way to each, m."""
        marks = (0.0, *(mark * MYR for mark in self.marks))
        plan = SurfacePlan(theta=0.5)
        case = scene(
            VISCOSITIES[self.viscosities],
            self.start,
            marks,
            self.columns,
            self.interfaces,
            plan,
            scheme="midpoint",
            min_steps=12,
        )
        way, _, stopped = moved(case)
        if stopped:
            raise stopped
        times = [moment.time for moment in way]
        ends = [times.index(mark) for mark in marks[1:]]
        return [(way[end], max(m.relief for m in way[: end + 1])) for end in ends]

    def __str__(self):
        surface = "surface at rest" if self.rest else "flat surface"
        return f"{self.viscosities}, from {self.amplitude:g} m, {surface}"


# What is restored, and from each mark how: (mark, interfaces, columns, surface.reverse).
QUICK = {
    Truth("one viscosity", 100.0, True, (1.0,), "particles", 20): (
        (1.0, "fitted", 14, "auto"),
        (1.0, "particles", 16, "integrate"),
    ),
    Truth("two viscosities", 100.0, True, (0.2,), "particles", 20): (
        (0.2, "particles", 16, "auto"),
    ),
}
FULL = {
    Truth("one viscosity", 100.0, True, (1.0, 1.4, 1.75), "fitted", 24): (
        (1.0, "fitted", 18, "auto"),
        (1.4, "fitted", 18, "auto"),
        (1.4, "particles", 24, "auto"),
        (1.4, "particles", 16, "integrate"),
        (1.4, "particles", 16, "stabilise"),
        (1.75, "particles", 24, "auto"),
    ),
    Truth("one viscosity", 10.0, True, (2.0, 2.6), "particles", 24): (
        (2.0, "fitted", 18, "auto"),
        (2.6, "fitted", 18, "auto"),
    ),
    Truth("one viscosity", 200.0, False, (1.0,), "particles", 24): ((1.0, "fitted", 18, "auto"),),
    Truth("two viscosities", 100.0, True, (0.2, 0.35), "fitted", 24): (
        (0.2, "fitted", 18, "auto"),
        (0.35, "fitted", 18, "auto"),
        (0.35, "particles", 24, "auto"),
        (0.35, "particles", 16, "integrate"),
        (0.35, "particles", 16, "stabilise"),
    ),
    Truth("two viscosities", 100.0, False, (0.2,), "particles", 24): ((0.2, "fitted", 18, "auto"),),
}
BOUND = 0.05  # of the restored amplitude
RELIEF_BOUND = 0.5  # of the greatest relief, above that of the forward run
TRUTH = "the forward run, on another mesh and with other steps"


def run_reverse_surface(quick):
    """Restoration of salt under a free surface, against forward runs, and of a drawn diapir."""
    for truth, ways in (QUICK if quick else FULL).items():
        clock, found = Clock(), dict(zip(truth.marks, truth.moments(), strict=True))
        for mark, *way in ways:
            yield from restored(truth, *found[mark], *way, clock)
            clock = Clock()
    yield from run_noise()
    yield from run_drawn(quick)


def restored(truth, moment, highest, interfaces, columns, reverse, clock):
    """Yield the rows of a restoration from a moment of a truth.

    Args:
        truth: `Truth`.
        moment: `Moment` to begin from.
        highest: greatest relief of the surface on the way there, m.
        interfaces, columns, reverse: of the restoration.
        clock: `Clock` that began before what the rows cost.
    """
    case = scene(
        VISCOSITIES[truth.viscosities],
        moment,
        (moment.time, 0.0),
        columns,
        interfaces,
        SurfacePlan(reverse=reverse),
        scheme="rk4" if interfaces == "particles" else "midpoint",
        min_steps=20,
    )
    way, engine, stopped = moved(case)
    origin, last = truth.start, way[-1]
    gone = (moment.time - last.time) / moment.time
    overhang = bool((np.diff(moment.horizon[:, 0]) <= 0).any())
    off = np.abs(last.horizon[:, 1] - np.interp(last.horizon[:, 0], *origin.horizon.T))
    grown = moment.amplitude / HEIGHT
    common = {
        "name": NAME,
        "case": f"{truth}, grown to {grown:.3f}, {'overhanging, ' if overhang else ''}{reverse}, "
        f"{interfaces}, {columns} across",
        "unknowns": engine.grid.spaces.unknowns,
        "cells": engine.grid.section.cell_count,
        "steps": len(way) - 1,
        "stokes_solves": engine.counts.solves,
        "source": TRUTH,
        "wall_s": clock.seconds,
        "parameters": {
            "viscosities": truth.viscosities,
            "reverse": reverse,
            "interfaces": interfaces,
            "forward": f"{truth.interfaces}, {truth.columns} across",
            "gamma_t": engine.surface.growth,
            "ages": [(moment.time - m.time) / moment.time for m in way],
            "reliefs": [m.relief for m in way],
            "stopped": str(stopped or ""),
        },
    }
    slaved = reverse == "auto"
    yield Row(metric="gamma T", value=engine.surface.growth, **common)
    yield Row(metric="part of the way back that was made", value=gone, **common)
    yield compared(
        metric="greatest relief of the surface on the way back, m",
        value=max(m.relief for m in way),
        reference=highest,
        bound=RELIEF_BOUND if slaved else None,
        **common,
    )
    if stopped:
        return
    yield compared(
        metric="restored amplitude, m",
        value=last.amplitude,
        reference=truth.amplitude,
        bound=BOUND if slaved and not overhang else None,
        **common,
    )
    began = origin.relief or None
    yield Row(
        metric="relief of the restored surface, m",
        value=last.relief,
        reference=began,
        relative_error=began and last.relief / began - 1,
        **common,
    )
    yield Row(metric="mean distance of the horizon to the truth, m", value=off.mean(), **common)
    yield Row(metric="greatest distance of the horizon to the truth, m", value=off.max(), **common)


NOISE_WAVE = 4  # half waves of the noise across the section
NOISE_GROWTH = 2.0  # gamma t of the way back with integration
NOISE = 1.0  # m


def run_noise():
    """Yield what becomes of a wave of 1 m on the surface, integrated and slaved."""
    pair = VISCOSITIES["one viscosity"]
    k = NOISE_WAVE * np.pi / WIDTH
    a = growth_matrix((Layer(*SALT, pair[0]), Layer(*SEDIMENT, pair[1])), k, GRAVITY)
    time = NOISE_GROWTH / -np.linalg.eigvals(a).min()
    clean = start(pair, 20.0, True)
    noisy = replace(clean, surface=clean.surface + _wave(clean.surface[:, 0], k, NOISE))
    for reverse, whole in (("integrate", time), ("slave", 10 * time)):
        clock, ends = Clock(), []
        for moment in (clean, noisy):
            case = scene(
                pair,
                moment,
                (0.0, -time, -whole),
                20,
                "particles",
                SurfacePlan(reverse=reverse),
                scheme="rk4",
                min_steps=8,
            )
            case = replace(case, mesh=MeshPlan())
            ends.append(moved(case, until=-time)[0][-1].surface)
        left = _amount(ends[1], k) - _amount(ends[0], k)
        more = {"name": NAME, "case": f"noise, {reverse}", "wall_s": clock.seconds}
        if reverse == "integrate":
            yield compared(
                metric="growth of a wave of 1 m on the surface",
                value=left / NOISE,
                reference=exact(a, -time)[1, 1],
                bound=0.05,
                source="linear theory of layered flow",
                **more,
            )
        else:
            yield Row(metric="what is left of a wave of 1 m", value=left, bound=0.1, **more)


def _wave(x, k, amplitude):
    return np.column_stack([np.zeros(len(x)), amplitude * np.cos(k * x)])


def _amount(surface, k):
    """Return the amplitude of a wave in a surface, m."""
    x = np.linspace(0, WIDTH, 2001)
    z = np.interp(x, *surface.T)
    return 2 / WIDTH * np.trapz((z - z.mean()) * np.cos(k * x), x)


def run_drawn(quick):
    """Yield how the surface and the horizons of a drawn diapir fare; nobody knows its truth."""
    for name, age in DRAWN_AGES.items():
        for surface in ("free", "free-slip"):
            if not (quick and (name, surface) != ("exp1", "free")):
                yield from _drawn(name, age, surface, 14 if quick else 24)


def _drawn(name, age, surface, cells):
    clock = Clock()
    case = load(
        DRAWN / f"{name}.yaml",
        [
            f"boundary.surface={surface}",
            f"mesh.cells={cells}",
            "time.scheme=midpoint",
            "time.courant=1",
            f"time.marks=[0 Ma, {age}, 0 Ma]",
            "time.stop=null",
        ],
    ).scene
    engine, ages, reliefs, marks = StokesEngine(case), [], [], []

    def note(_, state):
        line = surface_of(state.lines)
        ages.append(-state.time / MYR)
        reliefs.append(0.0 if line is None else float(np.ptp(line.points[:, 1])))

    first = engine.start()
    note(None, first)
    keep = [lambda _, state: marks.append((len(reliefs), state.lines))]
    last = march(first, engine, case.time, every_step=(note,), at_marks=keep)
    engine.grid.stokes.release()
    steps, restored_lines = marks[1]
    common = {
        "name": NAME,
        "case": f"drawn diapir, {name}, {surface} top",
        "cells": engine.grid.section.cell_count,
        "steps": len(reliefs) - 1,
        "stokes_solves": engine.counts.solves,
        "wall_s": clock.seconds,
        "parameters": {"ages": ages, "reliefs": reliefs, "restored": steps - 1},
    }
    if surface == "free":
        highest = max(reliefs[:steps])
        yield Row(
            metric="greatest relief on the way back over the height",
            value=highest / case.outline.height,
            bound=0.1,
            **common,
        )
        yield Row(metric="greatest relief on the way back, m", value=highest, **common)
        yield Row(metric="relief where it is restored to, m", value=reliefs[steps - 1], **common)
        change = engine.grid.section.area / engine.start_area - 1
        yield Row(metric="change of the area, back and forth", value=change, bound=1e-3, **common)
    distances = line_distances(first.lines, last.lines)
    horizons = [row["mean_m"] for row in distances if row["kind"] == "horizon"]
    yield Row(
        metric="mean distance of the horizons, back and forth, m",
        value=float(np.mean(horizons)),
        **common,
    )
    yield Row(
        metric="rms height of the restored horizons about their means, m",
        value=_unevenness(restored_lines),
        **common,
    )


def _unevenness(lines):
    """Return the root mean square height of horizons about the mean of each, m."""
    squares, length = 0.0, 0.0
    for line in lines:
        if line.kind != "horizon":
            continue
        step = np.linalg.norm(np.diff(line.points, axis=0), axis=1)
        z = (line.points[1:, 1] + line.points[:-1, 1]) / 2
        if step.sum():
            squares += step @ (z - np.average(z, weights=step)) ** 2
            length += step.sum()
    return float(np.sqrt(squares / length))


def panels(rows):
    """Return the panels of the figure, see `pictures.draw`: reliefs on the way, and amplitudes."""
    ways = {row.case: row for row in rows if row.metric == "gamma T" and row.parameters}
    reliefs = {
        case.replace(", surface at rest", "").rsplit(", ", 1)[0]: (
            np.array(row.parameters["ages"]),
            np.maximum(row.parameters["reliefs"], 0.1),
            "line",
        )
        for case, row in ways.items()
    }
    ends = [row for row in rows if row.metric.startswith("restored amplitude")]
    amplitudes = {
        way: (
            np.array([row.parameters["gamma_t"] for row in ends if _way(row) == way]),
            np.array([row.value / row.reference for row in ends if _way(row) == way]),
            "",
        )
        for way in dict.fromkeys(map(_way, ends))
    }
    return [
        ("Relief of the surface", "part of the way back", "m", ("linear", "log"), reliefs),
        ("Restored amplitude", "gamma T", "over the truth", ("log", "linear"), amplitudes),
    ]


def _way(row):
    return f"{row.parameters['viscosities']}, restored {row.parameters['interfaces']}"

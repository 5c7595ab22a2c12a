"""The certificate of a restoration against what it cannot know: measured growth, and the truth."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from restoration.bench.rows import Clock, Row
from restoration.bench.scenes import two_rocks, under_a_wave
from restoration.certificate import certified, failed
from restoration.companions import Follower, accompany
from restoration.diagnostics import there_and_back
from restoration.displacement import Perturbation, displaced, offset
from restoration.engine import StokesEngine
from restoration.errors import CaseError, MeshError, SolveError
from restoration.resolve import load
from restoration.run import march
from restoration.scene import Line
from restoration.units import MYR
from restoration.welds import welds

CASES = Path(__file__).parents[2] / "cases"
NAME = "certificate"
FACTOR = 3.0  # within which the growth of errors is predicted
SEEDS, SHORTEST = (2026, 2027), 3.0  # of what is measured: other noise than predicted with
LARGEST = 1000.0  # m: beyond, a growth of 1 m means that nothing is left to grow


def run_certificate(quick=False):
    """Certificate: predicted growth and error against measured ones, and its verdicts."""
    yield from _journeys("isoviscous", "diapir-isoviscous", *_plan(quick))
    if not quick:
        lines = {"transfer__density": "lines"}
        plan = ("diapir-isoviscous", (2.0, 4.0, 5.0), 27, 45)
        yield from _journeys("isoviscous by lines", *plan, **lines)
        lines |= {"transfer__viscosity": "lines"}
        plan = ("diapir-two-viscosities", (0.5, 1.0), 40, 50)
        yield from _journeys("two viscosities", *plan, **lines)
        yield from _free_surfaces()
        yield from _short_graben()
    yield from _small_wave()
    yield from _thin_layers()


def _plan(quick):
    return ((1.5,), 20, 30) if quick else ((1.5, 3.0, 4.0, 5.0, 6.0), 27, 45)


def _load(name, **entries):
    path = CASES / name / "case.yaml"
    if not path.is_file():
        raise CaseError(f"{path}: is missing; the certificate needs the cases of a checkout")
    return load(path, [f"{entry.replace('__', '.')}={v}" for entry, v in entries.items()]).scene


def judged(scene, given):
    """Restore a given section and certify that.

    Args:
        scene: `scene.Scene` whose marks go back.
        given: `State`, of any engine.

    Returns:
        `companions.Follower`, `companions.Growth` and the certificate; growth is None where the
        restoration failed.
    """
    follower, engine = Follower(scene), StokesEngine(scene)
    steps, marks = (lambda _, state: follower.step(state),), (follower.mark,)
    try:
        end = march(engine.taken_over(given), engine, scene.time, steps, marks)
    except (MeshError, SolveError) as error:
        return follower, None, failed(scene, follower, error)
    follower.finished(end)
    growth = accompany(follower, StokesEngine, march, scene.certificate.noise)
    return follower, growth, certified(scene, follower, growth, engine.cell_size)


def measured(scene, follower):
    """Return what 1 m of noise in the given section has grown to at the instants, means, m.

    The restoration itself is repeated, with other displacements of the given section.
    """
    states = follower.states
    shortest = SHORTEST * scene.outline.width / scene.cells[0]
    steps = max(1, round(follower.steps / (len(states) - 1)))
    times = tuple(state.time for state in states)
    plan = replace(scene.time, marks=times, min_steps=steps)
    grown = []
    for seed in SEEDS:
        wave = Perturbation(states[0], scene, scene.certificate.noise, shortest, seed)
        begin = displaced(states[0], wave(states[0].particles.x))
        engine, found = StokesEngine(replace(scene, time=plan)), []

        def note(number, state, found=found):
            found.append(_mean(states[number].particles, offset(states[number], state)))

        march(engine.taken_over(begin), engine, plan, (), (note,))
        grown.append(found)
    return np.sqrt(np.mean(np.square(grown), axis=0)).tolist()


def _mean(particles, off):
    """Return the mean of displacements over the section, m."""
    return float(np.average(np.hypot(*off.T), weights=particles.area))


def _predicted(growth):
    """Return the means of what noise and mesh make at the instants, m."""
    noise, mesh = [], []
    for i, state in enumerate(growth.states[: len(growth.mesh)]):
        means = [_mean(state.particles, off[i]) for off in growth.noise]
        noise.append(float(np.sqrt(np.mean(np.square(means)))))
        mesh.append(_mean(state.particles, growth.mesh[i]))
    return noise, mesh


def _journeys(case, name, times, cells, truth, **more):
    """Yield the rows of sections that a forward run on another mesh made, each restored."""
    marks = ", ".join(f"{t:g} Myr" for t in (0.0, *times))
    forward = _load(name, mesh__cells=truth, time__marks=f"[{marks}]", time__min_steps=9, **more)
    engine, given = StokesEngine(forward), []
    march(engine.start(), engine, forward.time, (), (lambda _, state: given.append(state),))
    for t, state in zip(times, given[1:], strict=True):
        scene = _load(name, mesh__cells=cells, time__marks=f"[{t:g} Myr, 0 Myr]", **more)
        yield from _rows(f"{case}, {t:g} Myr", scene, replace(state, flow=None, grid=None))


def _rows(case, scene, given):
    """Yield the rows of one restoration."""
    clock = Clock()
    follower, growth, certificate = judged(scene, given)
    seconds = clock.seconds
    noise, mesh = _predicted(growth)
    known = measured(scene, follower)
    known_end, predicted_end = known[-1], noise[-1]
    actual, by_rock = _actual(scene, follower.states[-1].particles)
    trusted = {row["name"]: row["trusted"] for row in certificate["rocks"]}
    about = {
        "case": case,
        "predicted_growth": predicted_end,
        "measured_growth": known_end,
        "predicted_m": predicted_end + mesh[-1],
        "actual_m": actual,
        "actual_by_rock_m": by_rock,
        "trusted": trusted,
        "verdict": certificate["verdict"],
        "order": growth.order,
    }
    ratio = predicted_end / known_end
    yield Row(
        NAME,
        case,
        "growth of errors, predicted over measured",
        ratio,
        1.0,
        float(np.log(ratio) / np.log(FACTOR)),
        1.0 if max(known) < LARGEST else None,
        cells=4 * int(np.prod(scene.cells)),
        wall_s=seconds,
        parameters=about,
    )
    error = predicted_end + mesh[-1]
    yield Row(NAME, case, "error, predicted over actual", error / actual, 1.0, parameters=about)
    tolerance = scene.certificate.tolerance
    # the given section is without noise here, and the verdict is on one with it
    wrong = sum(_wrong(trusted[name], off + known_end, tolerance) for name, off in by_rock.items())
    yield Row(NAME, case, "verdicts wrong", float(wrong), bound=0.5, parameters=about)


def _actual(scene, particles):
    """Return how far particles are from where they began, m: the mean of all and of every rock."""
    distance, _ = there_and_back(particles)
    there = np.isfinite(distance)
    rock = np.array([unit.rock for unit in scene.units])[particles.unit]

    def mean(some):
        return float(np.average(distance[some], weights=particles.area[some]))

    by_rock = {scene.rocks[row].name: mean(there & (rock == row)) for row in np.unique(rock[there])}
    return mean(there), by_rock


def _wrong(trusted, actual, tolerance):
    """Return whether a verdict is wrong.

    What is off by more than the tolerance is not to be trusted, and what is off by far less is.
    """
    return actual > tolerance if trusted else actual < tolerance / FACTOR


def _small_wave():
    """Yield the rows of a small wave between two rocks, which grows forward and so decays back."""
    scene = _wave_scene((0.0, 1.0 * MYR))
    engine = StokesEngine(replace(scene, cells=(30, 30)))
    given = march(engine.start(), engine, scene.time)
    back = replace(scene, time=replace(scene.time, marks=scene.time.marks[::-1]))
    yield from _rows("small wave", back, replace(given, flow=None, grid=None))


def _wave_scene(marks, density=(2150.0, 2600.0)):
    height, unit_at = under_a_wave(2e3, 50.0, 2e4)
    x = np.linspace(0, 1e4, 201)
    walls = {"left": "free-slip", "right": "free-slip", "base": "no-slip", "surface": "no-slip"}
    return two_rocks(
        1e4,
        1e4,
        unit_at,
        np.column_stack([x, height(x)]),
        density,
        (1e19, 1e19),
        (20, 20),
        walls,
        marks=marks,
        min_steps=10,
    )


def _thin_layers():
    """Yield the rows of a section with a layer thinner than its cells in one half."""
    scene = _wave_scene((0.0, -0.1 * MYR))
    x = np.array([0.0, 4e3, 5e3, 1e4])
    line = Line("lower / upper", "horizon", np.column_stack([x, [100.0, 100.0, 2e3, 2e3]]))

    def unit_at(points):
        return (points[:, 1] > np.interp(points[:, 0], *line.points.T)).astype(np.int16)

    scene = replace(scene, lines=(line,), unit_at=unit_at)
    found = welds(scene, scene.lines, 500.0)
    # to where the layer is 500 m thick, less what a disc reaches into the wedge
    area = 4e5
    yield Row(
        NAME,
        "thin layer",
        "welded area, m^2",
        found.area,
        area,
        found.area / area - 1,
        0.25,
        parameters={"case": "thin layer"},
    )


def _free_surfaces():
    """Yield the verdicts of a diapir below a free surface, integrated and slaved."""
    for reverse, trusted in (("integrate", False), ("auto", True)):
        case = f"free surface, {reverse}"
        entries = {"mesh__cells": 16, "boundary__surface": "free", "surface__reverse": reverse}
        forward = _load("diapir-isoviscous", **entries, time__marks="[0 Myr, 0.4 Myr]")
        engine = StokesEngine(forward)
        given = march(engine.start(), engine, forward.time)
        entries["mesh__cells"] = 14
        scene = _load("diapir-isoviscous", **entries, time__marks="[0.4 Myr, 0 Myr]")
        _, _, found = judged(scene, replace(given, flow=None, grid=None))
        told = found["verdict"].startswith("trusted")
        about = {"case": case, "verdict": found["verdict"], "trusted": told}
        yield Row(NAME, case, "verdicts wrong", float(told != trusted), bound=0.5, parameters=about)


def _short_graben():
    """Yield the rows of a graben that is restored after little extension."""
    entries = {"time__min_steps": 6}
    forward = _load("graben", mesh__cells="[30, 10]", time__marks="[0 kyr, 10 kyr]", **entries)
    engine = StokesEngine(forward)
    given = march(engine.start(), engine, forward.time)
    scene = _load("graben", mesh__cells="[36, 12]", time__marks="[10 kyr, 0 kyr]", **entries)
    yield from _rows("graben, 10 kyr", scene, replace(given, flow=None, grid=None))


def panels(rows):
    """Return the panels of the figure: predicted against measured growth, and error."""
    found = {}
    for row in rows:
        if "predicted_growth" in row.parameters:
            found[row.case] = row.parameters
    drawn = []
    for title, one, two in (
        ("growth of 1 m of noise", "measured_growth", "predicted_growth"),
        ("mean error of the rock, m", "actual_m", "predicted_m"),
    ):
        values = [p[key] for p in found.values() for key in (one, two)]
        ends = np.array([min(values) / 2, max(values) * 2])
        series = {"as predicted": (ends, ends, "line")}
        series |= {case: ([p[one]], [p[two]], "") for case, p in found.items()}
        axes = (title, "as it is", "predicted", ("log", "log"), series)
        drawn.append(axes)
    return drawn

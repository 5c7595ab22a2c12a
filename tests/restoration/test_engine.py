"""The engine against linear theory, and what there and back must give."""

from dataclasses import replace

import numpy as np
import pytest

from restoration.diagnostics import (
    line_distances,
    relative_change,
    there_and_back,
    volume_by_rock,
)
from restoration.engine import StokesEngine
from restoration.lines import as_drawn
from restoration.particles import seed
from restoration.run import march
from restoration.scene import Cloud, Line, Outline, TimePlan, Transfer, Wall
from restoration.walls import unbalanced
from tests.restoration.conftest import HEIGHT, MYR, WIDTH, diapir_scene

# Initial rms velocity of van Keken's isoviscous diapir and of contrasts 10 and 100, computed
# independently (Fourier series at finite amplitude, 10 digits), over drho g H^2 / eta_top.
INITIAL_RMS = {1: 0.00018529497938115516, 10: 0.0006729607400473148}


@pytest.mark.parametrize(
    ("density", "viscosity", "ratio", "bound"),
    [
        ("hat", "hat", 1, 0.015),
        ("hat", "hat", 10, 0.015),
        ("projection", "hat", 1, 0.003),
        ("projection", "hat", 10, 0.008),
        ("projection", "linear", 10, 0.004),
    ],
)
def test_initial_velocity_meets_theory(density, viscosity, ratio, bound):
    top = 1e19
    transfer = Transfer(density, viscosity, "harmonic")
    scene = diapir_scene(cells=(32, 35), viscosity=(top / ratio, top), transfer=transfer)
    engine = StokesEngine(scene)
    state = engine.with_flow(engine.start())
    rms, _ = engine.grid.speeds(state.flow)
    scale = (2600 - 2150) * 9.81 * HEIGHT**2 / top
    assert rms / scale == pytest.approx(INITIAL_RMS[ratio], rel=bound)


@pytest.fixture(scope="module")
def journey():
    """A coarse diapir, 2 Myr forward and back."""
    engine = StokesEngine(diapir_scene(marks=(0, 2, 0)))
    start = engine.start()
    states = []
    march(start, engine, engine.scene.time, at_marks=(lambda _, state: states.append(state),))
    return engine, states


def test_the_diapir_rises_and_comes_back(journey):
    engine, (first, top, last) = journey
    crest = [state.lines[0].points[:, 1].max() for state in (first, top, last)]
    assert crest[1] > crest[0] + 1000
    assert crest[2] == pytest.approx(crest[0], abs=2)
    distance, stats = there_and_back(last.particles)
    assert stats["mean_m"] < 1.2  # 0.7 with a plain velocity, which bends less inside the cells
    assert stats["mean_m"] <= stats["p99_m"] <= stats["max_m"] == np.nanmax(distance)
    assert last.particles.lost == 0
    assert engine.born == 0


def area_below(state):
    """Area between the horizon and the base, m^2."""
    x, z = state.lines[0].points.T
    return abs(np.trapz(z + HEIGHT, x))


def test_horizons_and_volumes_come_back(journey):
    engine, (first, top, last) = journey
    (row,) = line_distances(first.lines, last.lines)
    assert row["max_m"] < 8  # 2 with a plain velocity
    before, middle, after = (
        volume_by_rock(engine.scene, engine.grid, s.particles) for s in (first, top, last)
    )
    assert sum(before.values()) == pytest.approx(WIDTH * HEIGHT)
    assert abs(relative_change(before, after)["salt"]) < 1e-3
    # 12 cells across: the fields miss 1.2 % of the salt, which the flow itself has kept
    assert abs(relative_change(before, middle)["salt"]) < 1.5e-2
    assert area_below(top) == pytest.approx(area_below(first), rel=5e-4)  # plain: 7e-4


def test_the_mesh_covers_the_box(journey):
    assert journey[0].section.areas.sum() == pytest.approx(WIDTH * HEIGHT, rel=1e-12)


def test_one_viscosity_takes_one_factorisation(journey):
    assert journey[0].counts.factorisations == 1
    assert journey[0].counts.worst_residual < 1e-8


@pytest.mark.parametrize("scheme", ["euler", "paper", "midpoint", "rk3", "rk4"])
def test_solves_per_step(scheme):
    per_step = {"euler": 1, "paper": 1, "midpoint": 2, "rk3": 3, "rk4": 4}[scheme]
    plan = TimePlan((0.0, 0.1 * MYR), scheme, 1.0, 3)
    engine = StokesEngine(diapir_scene(time=plan))
    march(engine.start(), engine, plan)
    assert engine.counts.solves == 3 * per_step + 1


def test_order_in_time_of_the_whole_scheme():
    """Steps of the coupled problem, Stokes at every stage: rk4 beats midpoint beats the paper's."""
    ends = {}
    for scheme, n in (("rk4", 32), ("rk4", 8), ("midpoint", 8), ("paper", 8)):
        plan = TimePlan((0.0, 1.0 * MYR), scheme, 1e9, n)
        engine = StokesEngine(diapir_scene(time=plan))
        ends[scheme, n] = march(engine.start(), engine, plan).particles.x
    gap = {key: np.linalg.norm(x - ends["rk4", 32], axis=1).mean() for key, x in ends.items()}
    assert gap["rk4", 8] < gap["midpoint", 8] / 5
    assert gap["midpoint", 8] < gap["paper", 8] / 5


def ends(scheme, counts, marks=(0.0, 2.0 * MYR), **plans):
    """Where the particles end after numbers of steps, shape (numbers, n, 2), m."""
    found = []
    for n in counts:
        plan = TimePlan(marks, scheme, 1e9, n, 1e-4 if scheme == "implicit-midpoint" else None)
        engine = StokesEngine(diapir_scene(time=plan, **plans))
        found.append(march(engine.start(), engine, plan).particles.x)
    return np.array(found)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scheme", "counts", "least"),
    [
        ("midpoint", (8, 16, 32), 1.8),
        ("implicit-midpoint", (10, 20, 40), 1.9),
        ("rk3", (6, 12, 24), 2.5),
        ("rk4", (5, 10, 20), 3.5),
    ],
)
def test_orders_of_the_coupled_system(scheme, counts, least):
    """One viscosity: three step sizes, Stokes solved at every stage, against small steps."""
    reference = ends("rk4", [96], cells=(29, 32))[0]
    gap = np.linalg.norm(ends(scheme, counts, cells=(29, 32)) - reference, axis=2).mean(axis=1)
    assert (np.log2(gap[:-1] / gap[1:]) > least).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scheme", "least"),
    [("midpoint", 1.85), ("implicit-midpoint", 1.85), ("rk3", 1.9), ("rk4", 1.85)],
)
def test_orders_on_two_viscosities(scheme, least):
    """Where the weak rock crosses the cells the fields have kinks, and no scheme goes beyond 2.

    Between mesh lines the rock has none: see `test_contacts` for the orders there.
    """
    two = {"viscosity": (1.4e17, 2.8e19), "marks": (0.0, 0.25 * MYR)}
    reference = ends("rk4", [128], **two)[0]
    gap = np.linalg.norm(ends(scheme, (8, 16, 32), **two) - reference, axis=2).mean(axis=1)
    assert (np.log2(gap[:-1] / gap[1:]) > least).all()


def test_the_implicit_midpoint_rule_comes_back():
    """Time-symmetric: what remains is the tolerance of its iterations, whatever the steps."""
    plan = TimePlan((0.0, 1.0 * MYR, 0.0), "implicit-midpoint", 1e9, 4, 1e-5)
    engine = StokesEngine(diapir_scene(time=plan))
    end = march(engine.start(), engine, plan)
    assert there_and_back(end.particles)[1]["max_m"] < 1e-2
    assert line_distances(engine.scene.lines, as_drawn(end.lines))[0]["max_m"] < 1e-2
    assert engine.counts.solves < 8 * (10 + 1)


def test_rk3_keeps_its_error_to_the_tolerance():
    """Long steps are refused and taken anew; what is left follows the tolerance."""

    def end(tolerance):
        plan = TimePlan((0.0, 1.5 * MYR), "rk3", 1e9, 1, tolerance)
        engine = StokesEngine(diapir_scene(time=plan))
        return march(engine.start(), engine, plan).particles.x, engine

    (coarse, first), (fine, second), (exact, _) = end(30.0), end(1.0), end(0.01)
    gap = [np.linalg.norm(x - exact, axis=1).mean() for x in (coarse, fine)]
    assert first.rejected > 0
    assert second.counts.solves > 1.8 * first.counts.solves
    assert gap[1] < gap[0] / 4
    assert gap[1] < 3.0


def test_a_mirrored_section_gives_the_mirrored_run():
    """Reflect the particles: the end is the reflection."""
    plan = TimePlan((0.0, 1.0 * MYR), "rk4", 1.0, 5)
    one = diapir_scene(time=plan)
    seeded = seed(one)
    ends = []
    for sign, shift in ((1, 0.0), (-1, WIDTH)):
        flip = np.array([sign, 1]), np.array([shift, 0])
        scene = replace(
            one,
            cloud=Cloud(seeded.x * flip[0] + flip[1], seeded.unit),
            lines=(Line("top", "horizon", one.lines[0].points * flip[0] + flip[1]),),
        )
        engine = StokesEngine(scene)
        end = march(engine.start(), engine, plan)
        ends.append(end.particles.x * flip[0] + flip[1])
    assert ends[1] == pytest.approx(ends[0], abs=1e-3)


def test_rock_flows_in_and_is_filled():
    """Shortening at 10 mm/yr that pushes rock out at the top: both are counted by wall."""
    speed = 0.01 / 31557600
    walls = diapir_scene().walls | {
        "right": Wall("velocity", (-speed, None), (0.0, 0.0)),
        "base": Wall("free-slip", (None, 0.0), (0.0, 0.0)),
        "surface": Wall("traction", (None, None), (0.0, 0.0)),
    }
    plan = TimePlan((0.0, 0.3 * MYR), "midpoint", 0.5, 5)
    engine = StokesEngine(diapir_scene(walls=walls, time=plan))
    assert not engine.scene.closed
    end = march(engine.start(), engine, plan)
    assert engine.entered["right"] > 0
    assert engine.left["surface"] > 0
    assert engine.entered["surface"] == engine.left["right"] == end.particles.lost == 0
    begun = len(engine.start().particles.x)
    kept = begun + engine.entered["right"] - engine.left["surface"]
    assert len(end.particles.x) == kept + engine.born
    # as dense where it flowed in as elsewhere: 0.3 Myr bring 3 km
    new = end.particles.x[end.particles.born]
    assert new[:, 0].min() == pytest.approx(WIDTH - 3000, abs=200)
    assert end.particles.area.sum() == pytest.approx(engine.start_area, rel=0.02)


def test_a_sloping_surface_keeps_its_rock():
    top = np.array([[0, 0], [WIDTH, 400.0]])
    scene = diapir_scene(
        outline=Outline(top, np.array([[0, -HEIGHT], [WIDTH, -HEIGHT]])),
        walls=diapir_scene().walls | {"surface": Wall("free-slip", (None, 0.0), (0.0, 0.0))},
        marks=(0, 1, 0),
    )
    engine = StokesEngine(scene)
    state = march(engine.start(), engine, scene.time)
    assert state.particles.lost == 0
    assert (state.particles.x[:, 1] <= np.interp(state.particles.x[:, 0], *top.T) + 1e-6).all()


@pytest.mark.parametrize("density", ["cell", "quadrature"])
def test_the_papers_projection_runs_too(density):
    scene = diapir_scene(
        viscosity=(1.4e17, 2.8e19),
        transfer=Transfer(density, "cell", "harmonic"),
        time=TimePlan((0.0, 0.2 * MYR, 0.0), "paper", 0.5, 4),
    )
    engine = StokesEngine(scene)
    last = march(engine.start(), engine, scene.time)
    assert there_and_back(last.particles)[1]["mean_m"] < 100
    assert engine.counts.factorisations == engine.counts.solves


def test_an_inclined_wall_held_in_one_component_is_no_closed_wall():
    top = np.array([[0, 0], [WIDTH, 400.0]])
    base = np.array([[0, -HEIGHT], [WIDTH, -HEIGHT]])
    held = Wall("velocity", (None, 0.0), (0.0, 0.0))
    walls = diapir_scene().walls | {"surface": held}
    assert diapir_scene(walls=walls).closed
    inclined = diapir_scene(walls=walls, outline=Outline(top, base))
    assert not inclined.closed
    assert not inclined.sealed
    slip = Wall("free-slip", (None, 0.0), (0.0, 0.0))
    assert diapir_scene(walls=walls | {"surface": slip}, outline=Outline(top, base)).sealed


def test_rock_may_leave_through_an_inclined_wall_held_in_one_component():
    top = np.array([[0, 0], [WIDTH, 400.0]])
    base = np.array([[0, -HEIGHT], [WIDTH, -HEIGHT]])
    inflow = Wall("velocity", (1e-3 / 31557600, None), (0.0, 0.0))
    walls = diapir_scene().walls | {
        "left": inflow,
        "surface": Wall("velocity", (None, 0.0), (0.0, 0.0)),
    }
    outline = Outline(top, base)
    assert unbalanced(walls, outline) == []
    scene = diapir_scene(
        walls=walls, outline=outline, time=TimePlan((0.0, 0.5 * MYR), "midpoint", 0.5, 5)
    )
    engine = StokesEngine(scene)
    march(engine.start(), engine, scene.time)
    assert engine.left["surface"] > 0

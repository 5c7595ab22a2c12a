"""A free surface carried by the engine: forward, back, at extremes, with air, with open sides."""

from dataclasses import replace

import numpy as np
import pytest

from restoration.engine import StokesEngine
from restoration.errors import MeshError
from restoration.free_surface import FreeSurface, without_cliffs
from restoration.layered import Layer, fastest_decay
from restoration.lines import surface_of
from restoration.run import march
from restoration.scene import (
    Air,
    Line,
    MeshPlan,
    Outline,
    SurfacePlan,
    TimePlan,
    Transfer,
    Wall,
)
from restoration.state import State
from tests.restoration.conftest import HEIGHT, MYR, WIDTH, diapir_scene

FREE = Wall("free", (None, None), (0.0, 0.0))
BASE = np.array([[0, -HEIGHT], [WIDTH, -HEIGHT]])
EXPLICIT = SurfacePlan()
ALONE = Layer(HEIGHT, 2600.0, 1e19)
K = np.pi / WIDTH
GAMMA = fastest_decay([ALONE], np.array([K]), 9.81)
PLAN = SurfacePlan()


def hill(height, points=201):
    """Return an outline below half a cosine, m."""
    x = np.linspace(0, WIDTH, points)
    return Outline(np.column_stack([x, height * np.cos(K * x)]), BASE)


def free_scene(height=10.0, plan=PLAN, steps=8, end=1.0, scheme="euler", **plans):
    """Return one rock below a hill that relaxes for ``end`` relaxation times and back."""
    time = TimePlan((0.0, end / GAMMA, 0.0), scheme, 1e6, steps)
    given = {
        "walls": diapir_scene().walls | {"surface": FREE},
        "unit_at": lambda p: np.ones(len(p), np.int16),
        "lines": (),
        "outline": hill(height),
        "time": time,
        "surface": plan,
        "cells": (16, 18),
    }
    return diapir_scene(**given | plans)


def heights(scene):
    """Return the height of the left end at all marks, and the engine."""
    engine, left = StokesEngine(scene), []

    def at_mark(_, state):
        left.append(surface_of(state.lines).points[0, 1])

    end = march(engine.start(), engine, scene.time, at_marks=(at_mark,))
    return left, engine, end


def test_a_hill_relaxes_as_linear_theory_says_in_second_order():
    left = []
    for steps in (4, 8, 16):
        plan = SurfacePlan(theta=0.5, limit=1e9)
        left.append(heights(free_scene(plan=plan, steps=steps))[0][1])
    assert left[-1] / 10 == pytest.approx(np.exp(-1), rel=2e-3)
    assert (left[0] - left[1]) / (left[1] - left[2]) == pytest.approx(4, rel=0.02)


@pytest.mark.parametrize("air", [None, Air(2e3, 1.0, 1e17)])
def test_rock_at_quadrature_points_has_a_weight_at_the_surface(air):
    left = []
    for kind in ("hat", "quadrature"):
        transfer = Transfer(kind, kind, "harmonic")
        scene = free_scene(plan=SurfacePlan(air=air), cells=(8, 9), steps=2, transfer=transfer)
        left.append(heights(scene)[0])
    assert left[1] == pytest.approx(left[0])


def test_rock_at_quadrature_points_slips_along_an_inclined_wall():
    flows = []
    for kind in ("hat", "quadrature"):
        engine = StokesEngine(
            free_scene(
                height=500.0,
                walls=diapir_scene().walls
                | {"surface": Wall("free-slip", (None, 0.0), (0.0, 0.0))},
                cells=(8, 9),
                transfer=Transfer(kind, kind, "harmonic"),
            )
        )
        flows.append(engine.with_flow(engine.start()).flow.p)
    assert flows[1] == pytest.approx(flows[0], rel=1e-6, abs=1e-6 * np.abs(flows[0]).max())


@pytest.mark.parametrize(("theta", "back"), [(0.0, 0.77), (0.5, 1.0), (1.0, 1.3)])
def test_only_theta_one_half_comes_back(theta, back):
    left, _, _ = heights(free_scene(plan=SurfacePlan(theta, "integrate", limit=1e9), steps=4))
    assert left[2] / left[0] == pytest.approx(back, abs=0.1 if theta != 0.5 else 2e-3)


@pytest.mark.parametrize("mesh", [MeshPlan(), MeshPlan("Q2-Q1"), MeshPlan(interfaces="fitted")])
def test_the_area_below_the_surface_is_kept(mesh):
    scene = free_scene(height=200.0, steps=6, mesh=mesh, scheme="midpoint")
    _, engine, end = heights(scene)
    area = np.trapz(*surface_of(end.lines).points.T[::-1])
    assert area == pytest.approx(np.trapz(*scene.outline.surface.T[::-1]), abs=1e-3)
    assert engine.surface_shift < 0.1
    if mesh.interfaces == "particles":
        assert engine.section.area == pytest.approx(WIDTH * HEIGHT, rel=1e-10)


def test_air_above_makes_little_difference():
    plan = SurfacePlan(limit=0.5, air=Air(3000.0, 1.0, 1e16))
    left, engine, end = heights(free_scene(plan=plan, scheme="midpoint"))
    assert left[1] / 10 == pytest.approx(np.exp(-1), rel=0.02)
    assert engine.section.area > 1.2 * WIDTH * HEIGHT
    assert engine.born == engine.empty_cells == 0
    alone = StokesEngine(replace(engine.scene, surface=SurfacePlan()))
    still = alone.with_flow(alone.taken_over(end))
    speeds = end.grid.speeds(end.flow)
    assert speeds == pytest.approx(still.grid.speeds(still.flow), rel=0.05)


def test_nodes_may_move_along_the_normal():
    left, engine, _ = heights(
        free_scene(height=500.0, plan=SurfacePlan(motion="normal"), scheme="midpoint")
    )
    assert left[2] == pytest.approx(500, rel=1e-2)
    assert engine.section.area == pytest.approx(WIDTH * HEIGHT, rel=1e-4)


def test_steps_stay_below_the_limit_of_an_explicit_surface():
    scene = free_scene(plan=SurfacePlan(reverse="integrate"))
    engine = StokesEngine(scene)
    state = engine.with_flow(engine.start())
    longest = engine.stable_step(state, scene.time.marks[1])
    assert longest == pytest.approx(0.5 * 2 / GAMMA, rel=0.15)
    assert engine.surface.gamma > GAMMA
    scene = replace(scene, surface=SurfacePlan(theta=0.5))
    engine = StokesEngine(scene)
    state = engine.with_flow(engine.start())
    assert engine.stable_step(state, scene.time.marks[1]) > 100 * longest
    assert engine.work()["surface_rate_per_s"] is None


def test_the_slope_of_45_degrees_solves_or_says_where():
    x = np.linspace(0, WIDTH, 401)
    ramp = np.clip(x - WIDTH / 2, -700, 700)
    surface = np.column_stack([x, ramp - ramp.mean()])
    for mesh in (MeshPlan(), MeshPlan(interfaces="fitted")):
        scene = free_scene(
            outline=Outline(surface, BASE), mesh=mesh, steps=4, end=0.3, cells=(24, 26)
        )
        _, engine, end = heights(scene)
        assert np.ptp(surface_of(end.lines).points[:, 1]) < 1500
        assert engine.counts.worst_residual < 1e-8


def test_a_layer_that_thins_to_a_thousandth_solves_on_a_fitted_mesh():
    x = np.linspace(0, WIDTH, 201)
    horizon = -10 - 1500 * (1 - np.cos(K * x)) / 2  # 10 m below the surface at the left
    scene = free_scene(
        outline=Outline(np.array([[0.0, 0], [WIDTH, 0]]), BASE),
        unit_at=lambda p: (p[:, 1] > np.interp(p[:, 0], x, horizon)).astype(np.int16),
        lines=(Line("salt / sediment", "horizon", np.column_stack([x, horizon])),),
        mesh=MeshPlan(interfaces="fitted"),
        viscosity=(1e17, 1e19),
        cells=(10, 11),
    )
    engine = StokesEngine(scene)
    flow = engine.with_flow(engine.start()).flow
    assert np.isfinite(flow.u).all()
    assert flow.residual < 1e-8


def test_a_surface_that_overturns_ends_with_its_place():
    scene = free_scene(height=10.0)
    engine = StokesEngine(scene)
    state = engine.start()
    surface = surface_of(state.lines)
    points = surface.points.copy()
    points[80:120, 0] += np.linspace(3000, -3000, 40)  # folded over
    points[80:120, 1] += 1500
    folded = replace(surface, points=points)
    lines = tuple(folded if line is surface else line for line in state.lines)
    with pytest.raises(MeshError, match=r"overturns near x = .* km and z = "):
        without_cliffs(lines, 1e-3 * engine.start_area, engine.cell_size)
    assert MeshError.exit_code == 4


def test_a_surface_restored_beyond_its_relaxation_stays_bounded():
    """Ten relaxation times back: integrated it grows, slaved it stays on the flat equilibrium."""
    scene = free_scene(height=1e-3, end=12.0, steps=24, scheme="midpoint")
    marks = (scene.time.marks[1], 0.0)
    left = {}
    for reverse in ("auto", "integrate"):
        time = replace(scene.time, marks=marks)
        engine = StokesEngine(replace(scene, time=time, surface=SurfacePlan(reverse=reverse)))
        end = march(engine.start(), engine, time)
        left[reverse] = np.ptp(surface_of(end.lines).points[:, 1])
        assert (engine.surface.slaving is not None) == (reverse == "auto")
    assert left["integrate"] > 10  # m, from a millimetre
    assert left["auto"] < 1e-2


def test_rock_stretched_out_of_the_section_comes_back_layer_by_layer():
    """Pure shear between free-slip walls: uniform layers thin, and thicken on the way back."""
    rate = 0.05 / (0.2 * MYR)
    slip = Wall("free-slip", (None, 0.0), (0.0, 0.0))
    pull = Wall("velocity", (rate * WIDTH, None), (0.0, 0.0))
    walls = diapir_scene().walls | {"base": slip, "right": pull, "surface": FREE}
    x = np.array([0.0, WIDTH])
    layer = Line("salt / sediment", "horizon", np.column_stack([x, [-6000.0, -6000.0]]))
    for interfaces in ("particles", "fitted"):
        scene = diapir_scene(
            walls=walls,
            unit_at=lambda p: (p[:, 1] > -6000).astype(np.int16),
            lines=(layer,),
            time=TimePlan((0.0, 0.2 * MYR, 0.0), "midpoint", 1e6, 4),
            mesh=MeshPlan(interfaces=interfaces),
        )
        engine = StokesEngine(scene)
        tops = []

        def at_mark(_, state, tops=tops):
            tops.append([line.points[:, 1] + HEIGHT for line in state.lines])

        end = march(engine.start(), engine, scene.time, at_marks=(at_mark,))
        for layer_z, surface_z in tops[1:2]:
            assert layer_z == pytest.approx(4000 * np.exp(-0.05), rel=5e-3)
            assert surface_z == pytest.approx(HEIGHT * np.exp(-0.05), rel=2e-3)
        for layer_z, surface_z in tops[2:]:
            assert layer_z == pytest.approx(4000, rel=5e-3)
            assert surface_z == pytest.approx(HEIGHT, rel=2e-3)
        assert engine.left["right"] > 0
        assert engine.entered["right"] > 0
        assert end.lines[0].points[-1, 0] == WIDTH
        assert end.particles.x[:, 0].max() <= WIDTH
        born = end.particles.x[end.particles.born]
        below = end.particles.unit[end.particles.born] == 0
        assert born[below, 1].max() < -5900
        assert born[~below, 1].min() > -6100


def test_no_weight_to_come_counts_backward_where_modes_are_slaved():
    """A step of 30 relaxation times: with it the fast modes would fly off."""
    plan = SurfacePlan(theta=0.5, reverse="slave")
    time = TimePlan((0.0, -30 / GAMMA), "midpoint", 1e6, 1)
    left, engine, _ = heights(free_scene(plan=plan, time=time, cells=(8, 9)))
    assert engine.surface.slaved
    assert engine.surface.lead(-8.0) == 0
    assert abs(left[-1]) < 0.05 * left[0]


@pytest.mark.parametrize("reverse", ["auto", "slave"])
def test_without_gravity_a_surface_has_nothing_to_be_slaved_to(reverse):
    plan = SurfacePlan(reverse=reverse)
    left, engine, _ = heights(free_scene(plan=plan, gravity=0.0, steps=1, cells=(8, 9)))
    assert engine.surface.slaving is None
    assert left == pytest.approx([10.0] * 3)


def test_legs_of_a_march_are_told_apart():
    scene = free_scene(plan=SurfacePlan(theta=0.25, reverse="stabilise"))
    surface = FreeSurface(scene)
    assert surface.lead(8.0) == 2.0
    assert surface.lead(-8.0) == 2.0
    assert FreeSurface(free_scene(plan=SurfacePlan(theta=0.25))).lead(-8.0) == -2.0
    assert isinstance(StokesEngine(scene).start(), State)

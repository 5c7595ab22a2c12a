"""Meshes that follow the rock or are adapted, and runs on them."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from restoration.bench.scenes import velocity_at
from restoration.diagnostics import line_distances
from restoration.engine import StokesEngine
from restoration.errors import MeshError
from restoration.mesher import Mesher
from restoration.run import march
from restoration.scene import Line, MeshPlan, Outline, RefinePlan, Wall
from tests.restoration.conftest import HEIGHT, WIDTH, diapir_scene, diapir_top

ELEMENTS = ["P2-P1", "P2b-P1dg", "P2-P1dg", "MINI", "Q2-Q1", "Q2-P1dg"]
REFINED = MeshPlan(refine=RefinePlan(2, ("interfaces",), 1))
FITTED = MeshPlan(interfaces="fitted")


def journey(scene):
    engine, states = StokesEngine(scene), []
    march(engine.start(), engine, scene.time, at_marks=(lambda _, state: states.append(state),))
    return engine, states


def test_cells_are_small_at_the_interface_and_nowhere_else():
    scene = diapir_scene(mesh=REFINED)
    section, points = Mesher(scene).mesh(scene.lines)
    assert points is None
    x, area = section.corners.mean(axis=1), section.areas
    off = np.abs(x[:, 1] - diapir_top(x[:, 0]))
    square = WIDTH / 12 * HEIGHT / 13
    assert area[off < 100].max() <= square / 4 / 16 * 1.001
    assert area[off > 0.4 * HEIGHT] == pytest.approx(square / 4)
    assert area.min() >= square / 4 / 16 * 0.999
    assert area.sum() == pytest.approx(WIDTH * HEIGHT)


def test_faults_are_refined_where_that_is_asked_for():
    fault = Line("F", "fault", np.array([[3000, -1000], [4000, -5000.0]]))
    lines = (*diapir_scene().lines, fault)
    for where, finer in ((("faults",), True), (("interfaces",), False)):
        plan = MeshPlan(refine=RefinePlan(2, where, 1))
        scene = diapir_scene(mesh=plan, lines=lines)
        section, _ = Mesher(scene).mesh(scene.lines)
        near = np.abs(section.corners.mean(axis=1) - (3500, -3000)).max(axis=1) < 200
        assert (section.areas[near].max() < WIDTH / 12 * HEIGHT / 13 / 30) == finer


def test_a_line_between_units_of_one_rock_is_no_interface():
    scene = diapir_scene()
    same = Line("a / b", "horizon", np.array([[0, -3000], [WIDTH, -3000.0]]))
    mesher = Mesher(diapir_scene(lines=(*scene.lines, same)))
    assert mesher.contacts == {"salt / sediment"}


def test_a_fitted_mesh_has_one_rock_in_every_cell():
    engine = StokesEngine(diapir_scene(mesh=FITTED))
    section = engine.grid.section
    corners, top = section.corners, diapir_top(section.corners[:, :, 0])
    above = (corners[:, :, 1] >= top - 1).all(axis=1)
    below = (corners[:, :, 1] <= top + 1).all(axis=1)
    assert (above | below).all()
    assert (engine.grid.fields.rho.x.array == np.where(above, 2600, 2150)).all()


def test_velocity_gradients_draw_cells_to_where_the_flow_bends():
    plan = MeshPlan(refine=RefinePlan(2, ("velocity-gradient",), 1))
    engine = StokesEngine(diapir_scene(mesh=plan, viscosity=(1e17, 1e20)))
    before = engine.grid.section.cell_count
    state = engine.with_flow(engine.start())
    section = state.grid.section
    assert section.cell_count > 1.5 * before
    z = section.corners.mean(axis=1)[:, 1]
    assert (z < -6000).mean() > 0.6  # the salt moves, its cover hardly


@pytest.mark.slow
@pytest.mark.parametrize("element", ELEMENTS)
def test_every_element_moves_the_diapir_alike(element):
    """The speed of all is that of the finest, to what 12 squares are good for."""
    scene = diapir_scene(mesh=MeshPlan(element), marks=(0, 1))
    engine = StokesEngine(scene)
    state = engine.with_flow(engine.start())
    rms, _ = state.grid.speeds(state.flow)
    reference = StokesEngine(diapir_scene(mesh=FITTED, cells=(24, 26)))
    start = reference.with_flow(reference.start())
    assert rms == pytest.approx(start.grid.speeds(start.flow)[0], rel=0.04)
    end = march(state, engine, scene.time)
    assert end.particles.lost == 0


@pytest.mark.slow
@pytest.mark.parametrize(("mesh", "adapts"), [(REFINED, True), (FITTED, False)])
def test_a_diapir_comes_back_on_meshes_that_change(mesh, adapts):
    engine, (first, top, last) = journey(diapir_scene(mesh=mesh, marks=(0, 1, 0)))
    assert (engine.meshes > 10) == adapts  # the other one moves
    assert first.time == last.time != top.time
    (row,) = line_distances(first.lines, last.lines)
    assert row["max_m"] < 5
    assert np.linalg.norm(last.particles.x - first.particles.x, axis=1).mean() < 2
    assert last.particles.lost == 0


def test_adaption_every_few_steps_keeps_the_mesh_between():
    plan = MeshPlan(refine=RefinePlan(1, ("interfaces",), 3))
    engine, _ = journey(diapir_scene(mesh=plan, marks=(0, 1)))
    steps = engine._steps
    assert steps >= 5
    assert engine.meshes == 1 + len(range(0, steps + 1, 3))  # the first, then every third step


@pytest.mark.parametrize("element", ["Q2-Q1", "Q2-P1dg", "P2b-P1dg"])
def test_elements_hold_an_inclined_wall(element):
    relief = np.array([[0, 0], [WIDTH, 800.0]])
    base = np.array([[0, -HEIGHT], [WIDTH, -HEIGHT]])
    slip = Wall("free-slip", (None, 0.0), (0.0, 0.0))
    walls = diapir_scene().walls | {"surface": slip}
    scene = diapir_scene(mesh=MeshPlan(element), outline=Outline(relief, base), walls=walls)
    engine = StokesEngine(scene)
    state = engine.with_flow(engine.start())
    at = np.column_stack([np.linspace(100, WIDTH - 100, 50)] * 2)
    at[:, 1] = np.interp(at[:, 0], *relief.T) - 1
    u = velocity_at(state, at)
    through = np.abs(u @ (np.array([-800, WIDTH]) / np.hypot(800, WIDTH)))
    assert through.max() < 0.02 * state.grid.speeds(state.flow)[1]


def test_a_rock_that_vanishes_from_a_fitted_mesh_stops_the_run(monkeypatch):
    engine = StokesEngine(diapir_scene(mesh=FITTED))
    state = engine.with_flow(engine.start())
    lost = replace(
        state, flow=None, particles=replace(state.particles, unit=0 * state.particles.unit)
    )
    monkeypatch.setattr(engine.grid, "fit", lambda *_: False)  # a new mesh is due
    with pytest.raises(MeshError, match="changed its area"):
        engine.with_flow(lost)


def test_meshes_of_the_past_leave_the_memory():
    def resident():
        return int(Path("/proc/self/statm").read_text().split()[1]) * 4096 / 1e6

    engine = StokesEngine(diapir_scene(mesh=REFINED, cells=(24, 26)))
    state = engine.with_flow(engine.start())
    used = []
    for _ in range(12):
        engine.solve(engine._adapt(state.particles, state.lines), 0.0, state.lines)
        used.append(resident())
    assert used[-1] - used[3] < 40  # MB; each of the eight took 30


def test_rock_that_flows_in_is_filled_on_an_adapted_mesh():
    inward = Wall("velocity", (3e-11, None), (0.0, 0.0))
    stress_free = Wall("traction", (None, None), (0.0, 0.0))
    slip = Wall("free-slip", (None, 0.0), (0.0, 0.0))
    side = Wall("free-slip", (0.0, None), (0.0, 0.0))
    walls = {"left": inward, "right": side, "base": slip, "surface": stress_free}
    engine, states = journey(diapir_scene(mesh=REFINED, walls=walls, marks=(0, 1)))
    assert engine.entered["left"] > 0
    state = states[-1]
    assert len(np.unique(state.particles.cell[state.particles.inside])) > 100

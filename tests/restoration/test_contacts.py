"""Fitted meshes that move with the rock: areas, orders in time, the way back, new meshes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from restoration.diagnostics import line_distances, there_and_back, volume_by_rock
from restoration.engine import StokesEngine
from restoration.errors import MeshError
from restoration.lines import as_drawn, points_of, with_points
from restoration.run import march, run_job
from restoration.run_folder import Job
from restoration.scene import Line, MeshPlan, TimePlan
from tests.restoration.conftest import HEIGHT, MYR, WIDTH, diapir_scene

FITTED, AUTO = MeshPlan(interfaces="fitted"), MeshPlan(interfaces="auto")
TWO = (1e18, 1e20)


def journey(scene):
    """Run a scene; return the engine, its states at the marks, and areas of salt at the steps.

    The areas are those of the mesh and below the tracked horizon, shape (steps, 2), m^2.
    """
    engine, states, salt = StokesEngine(scene), [], []

    def note(_, state):
        mesh = volume_by_rock(scene, state.grid, state.particles)["salt"]
        salt.append((mesh, below(state.lines[0].points)))

    march(
        engine.start(),
        engine,
        scene.time,
        every_step=(note,),
        at_marks=(lambda _, state: states.append(state),),
    )
    return engine, states, np.array(salt)


def below(points):
    """Return the area below a horizon that goes from side to side, m^2; it may overhang."""
    x, z = np.vstack([points, [[WIDTH, -HEIGHT], [0, -HEIGHT]]]).T
    return 0.5 * abs(np.dot(x, np.roll(z, 1)) - np.dot(z, np.roll(x, 1)))


@pytest.mark.parametrize("viscosity", [(1e19, 1e19), TWO])
def test_areas_by_rock_are_those_between_the_lines(viscosity):
    engine, states, salt = journey(diapir_scene(mesh=FITTED, viscosity=viscosity))
    assert np.abs(salt[:, 0] / salt[:, 1] - 1).max() < 1e-9
    assert engine.meshes < 4 < engine.counts.solves  # not one for every stage
    first, top, last = states
    assert first.time == last.time != top.time
    (row,) = line_distances(as_drawn(first.lines), as_drawn(last.lines))
    assert row["max_m"] < 0.5
    assert last.particles.lost == 0


def test_a_contact_of_several_lines_moves_as_one_of_one():
    """Salt below layers of one rock: its top is one line below each of them."""
    whole = diapir_scene(mesh=FITTED)
    points = whole.lines[0].points
    parts = ("west", points[:80]), ("middle", points[79:120]), ("east", points[119:])
    lines = tuple(Line(f"salt / {name}", "horizon", part) for name, part in parts)
    _, (_, one, _), _ = journey(whole)
    engine, (_, several, _), _ = journey(replace(whole, lines=lines))
    joined = np.concatenate([line.points for line in several.lines])
    area = below(joined)
    salt = volume_by_rock(engine.scene, several.grid, several.particles)["salt"]
    assert abs(salt / area - 1) < 1e-9
    assert abs(area / below(one.lines[0].points) - 1) < 1e-9
    off = line_distances(one.lines, (replace(one.lines[0], points=joined),))[0]
    assert off["max_m"] < 20
    assert off["mean_m"] < 2


def test_a_level_contact_stays():
    top = Line("salt / sediment", "horizon", np.array([[0, -4000], [WIDTH, -4000.0]]))
    scene = diapir_scene(
        mesh=FITTED, lines=(top,), unit_at=lambda p: (p[:, 1] > -4000).astype(np.int16)
    )
    engine, states, _ = journey(scene)
    assert engine.meshes == 1
    assert states[-1].lines[0].points[:, 1] == pytest.approx(-4000, abs=1e-6)


def test_the_mesh_is_a_function_of_the_lines():
    """Away and back it stands where it stood; nodes of walls stay on them."""
    engine = StokesEngine(diapir_scene(mesh=FITTED))
    state = engine.with_flow(engine.start())
    grid = engine.grid
    before = grid.section.mesh.geometry.x.copy()
    points = points_of(state.lines)
    lifted = points + np.column_stack([0 * points[:, 0], 200 * np.sin(points[:, 0] / 1500)])
    assert grid.fit(with_points(state.lines, lifted))
    moved = grid.section.mesh.geometry.x.copy()
    assert np.abs(moved - before).max() > 100
    assert grid.section.area == pytest.approx(WIDTH * HEIGHT)
    assert grid.index.area.sum() == pytest.approx(WIDTH * HEIGHT)
    assert grid.fit(state.lines)
    assert np.array_equal(grid.section.mesh.geometry.x, before)
    far = points + [0, 9000.0]
    assert not grid.fit(with_points(state.lines, far))
    assert np.array_equal(grid.section.mesh.geometry.x, before)


def test_lines_of_another_state_get_a_mesh_of_their_own():
    engine = StokesEngine(diapir_scene(mesh=FITTED))
    state = engine.with_flow(engine.start())
    points = points_of(state.lines) + [0, 1500.0]
    unit = state.particles.unit * (state.particles.x[:, 1] > -6500).astype(np.int16)
    engine._guard.areas = None
    engine.with_flow(
        replace(
            state,
            flow=None,
            lines=with_points(state.lines, points),
            particles=replace(state.particles, unit=unit),
        )
    )
    assert engine.meshes == 2


@pytest.mark.parametrize(
    ("scheme", "least"),
    [("midpoint", 1.85), ("implicit-midpoint", 1.9), ("rk3", 2.8), ("rk4", 3.5)],
)
def test_orders_in_time_while_the_mesh_only_moves(scheme, least):
    """Two viscosities: where particles carry the rock no scheme goes beyond 2, fitted they do."""
    ends = []
    for name, steps in ((scheme, 3), (scheme, 6), ("rk4", 16)):
        tolerance = 1e-5 if name == "implicit-midpoint" else None
        plan = TimePlan((0.0, 0.4 * MYR), name, 1e9, steps, tolerance)
        engine = StokesEngine(diapir_scene(mesh=FITTED, viscosity=TWO, time=plan))
        ends.append(points_of(march(engine.start(), engine, plan).lines))
        assert engine.meshes == 1
    gap = [np.linalg.norm(end - ends[-1], axis=1).mean() for end in ends[:-1]]
    assert np.log2(gap[0] / gap[1]) > least


def test_the_implicit_midpoint_rule_comes_back_on_a_mesh_that_moves():
    plan = TimePlan((0.0, 0.4 * MYR, 0.0), "implicit-midpoint", 1e9, 4, 1e-5)
    engine = StokesEngine(diapir_scene(mesh=FITTED, viscosity=TWO, time=plan))
    end = march(engine.start(), engine, plan)
    assert there_and_back(end.particles)[1]["max_m"] < 1e-2
    assert line_distances(engine.scene.lines, as_drawn(end.lines))[0]["max_m"] < 1e-3


def test_a_refused_step_begins_anew_where_it_was():
    def end(tolerance):
        plan = TimePlan((0.0, 1.0 * MYR), "rk3", 1e9, 1, tolerance)
        engine = StokesEngine(diapir_scene(mesh=FITTED, time=plan))
        return points_of(march(engine.start(), engine, plan).lines), engine

    (coarse, first), (exact, _) = end(3.0), end(0.01)
    assert first.rejected > 0
    assert np.linalg.norm(coarse - exact, axis=1).mean() < 5.0


def test_a_mirrored_section_gives_the_mirrored_mesh_run():
    scene = diapir_scene(mesh=FITTED, marks=(0, 1))
    turned = diapir_scene(
        mesh=FITTED,
        marks=(0, 1),
        lines=tuple(
            replace(line, points=(line.points * [-1, 1] + [WIDTH, 0])[::-1]) for line in scene.lines
        ),
        unit_at=lambda p: scene.unit_at(p * [-1, 1] + [WIDTH, 0]),
    )
    ends = [journey(one)[1][-1].lines[0].points for one in (scene, turned)]
    mirrored = (ends[1] * [-1, 1] + [WIDTH, 0])[::-1]
    off = np.linalg.norm(ends[0] - mirrored, axis=1)
    assert off.max() < 0.05 * np.ptp(ends[0][:, 1])  # gmsh makes another mesh of it


def film(mesh, thickness=5.0):
    """A scene whose salt is a film on the base."""
    z = -HEIGHT + thickness
    top = Line("salt / sediment", "horizon", np.array([[0, z], [WIDTH, z]]))
    return diapir_scene(
        mesh=mesh, lines=(top,), marks=(0, 0.1), unit_at=lambda p: (p[:, 1] > z).astype(np.int16)
    )


def test_areas_below_horizons_stay_where_particles_carry_the_rock_too():
    engine, states, _ = journey(diapir_scene(marks=(0, 1), viscosity=TWO))
    start, end = (below(state.lines[0].points) for state in states)
    assert end == pytest.approx(start, rel=1e-12)
    assert 0 < engine.horizon_shift < 5


def test_a_weld_is_left_to_particles_where_that_is_asked_for():
    engine, states, _ = journey(film(AUTO))
    assert engine.work()["interfaces_used"] == "particles"
    (note,) = engine.notes
    assert note.startswith("from 0 ")
    assert "particles carry the rock: salt is a weld near x = " in note
    assert states[-1].time > 0
    engine = StokesEngine(film(FITTED))
    engine.with_flow(engine.start())
    assert engine.work()["interfaces_used"] == "fitted"
    engine = StokesEngine(film(AUTO, 300.0))
    engine.with_flow(engine.start())
    assert engine.notes == []


@pytest.mark.parametrize("begins", [True, False])
def test_a_horizon_that_no_mesh_follows_is_left_to_particles(begins, monkeypatch):
    """Once a mesh fails, at the beginning of a step or in the middle, the rest goes on."""

    def run(mesh):
        engine = StokesEngine(diapir_scene(mesh=mesh, marks=(0, 1)))
        follow = type(engine.grid).fit
        steps = []

        def fails(grid, lines, rows=None, at_start=False):
            return not (at_start == begins and len(steps) > 2) and follow(
                grid, lines, rows, at_start
            )

        def broken(lines, *more):
            raise MeshError("no mesh follows the horizons any more: lines cross; let particles do")

        monkeypatch.setattr(type(engine.grid), "fit", fails)
        start = engine.start()
        monkeypatch.setattr(engine.mesher, "mesh", broken)
        end = march(start, engine, engine.scene.time, every_step=(lambda *_: steps.append(1),))
        monkeypatch.undo()
        return engine, end

    engine, end = run(AUTO)
    (note,) = engine.notes
    assert note.endswith(
        "particles carry the rock: no mesh follows the horizons any more: lines cross"
    )
    assert end.time == MYR
    assert engine.work()["interfaces_used"] == "particles"
    with pytest.raises(MeshError, match="lines cross"):
        run(FITTED)


def test_a_run_tells_in_its_log_who_carries_the_rock(tmp_path):
    job = Job(Path("x/case.yaml"), "title: a\n", "resolved: 1\n", film(AUTO), tmp_path / "run")
    record, folder = run_job(job)
    assert record["interfaces_used"] == "particles"
    assert "salt is a weld" in (folder / "log.txt").read_text()

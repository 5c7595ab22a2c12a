"""The normal stress on a surface of free slip, and the topography it stands for."""

import json
from dataclasses import replace

import numpy as np
import pytest

from restoration.bench.boxes import Solved, unit_square
from restoration.bench.reliefs import ALONG, _density, _one, load_stress
from restoration.engine import StokesEngine
from restoration.layered import Layer, growth_matrix
from restoration.run import run_job
from restoration.run_folder import Job
from restoration.scene import MeshPlan, Outline, Transfer, Wall
from restoration.topography import SurfaceStress, dynamic_topography
from tests.restoration.conftest import HEIGHT, WIDTH, diapir_scene

FITTED = MeshPlan("P2b-P1dg", "fitted")
SLIP = Wall("free-slip", (None, 0.0), (0.0, 0.0))


def stress_of(element, n):
    solved = Solved(unit_square(element, n), element, _one, _density, degree=8)
    spaces = solved.spaces
    return solved, SurfaceStress(spaces.section, spaces, _density(spaces), _one(spaces), 1.0, 1.0)


@pytest.mark.parametrize("element", ["P2-P1", "Q2-P1dg"])
def test_a_load_pulls_the_surface_down(element):
    solved, stress = stress_of(element, 16)
    wave = np.cos(ALONG * stress.x)
    assert load_stress() > 0
    assert stress.amplitude(stress.normal(solved.flow), wave) == pytest.approx(
        load_stress(), rel=1e-4
    )
    heights = stress.heights(solved.flow)
    assert heights == pytest.approx(-load_stress() * wave, abs=6e-3 * load_stress())
    assert stress.amplitude(heights, wave) == pytest.approx(-load_stress(), rel=1e-4)


def slipping(cells=(12, 13), mesh=FITTED, **plans):
    """The diapir with a horizon of a hundredth of its wave under a surface of free slip."""
    x = np.linspace(0, WIDTH, 201)
    line = np.column_stack([x, -8000 + 20 * np.cos(np.pi * x / WIDTH)])
    scene = diapir_scene(cells=cells, mesh=mesh, **plans)
    lines = (replace(scene.lines[0], points=line),)
    return replace(
        scene,
        lines=lines,
        unit_at=lambda p: (p[:, 1] > np.interp(p[:, 0], *line.T)).astype(np.int16),
        walls=scene.walls | {"surface": SLIP},
    )


def test_topography_is_where_a_free_surface_would_stand_still():
    scene = slipping()
    engine = StokesEngine(scene)
    state = engine.with_flow(engine.start())
    x, heights = dynamic_topography(scene, engine.grid, state.flow)
    assert x[[0, -1]] == pytest.approx([0, WIDTH])
    a = growth_matrix(
        (Layer(2000.0, 2150.0, 1e19), Layer(8000.0, 2600.0, 1e19)), np.pi / WIDTH, 9.81
    )
    assert (heights[0] - heights[-1]) / 40 == pytest.approx(
        -a[1, 0] / a[1, 1], rel=1.5e-2
    )  # chords cut the horizon
    assert np.trapz(heights, x) == pytest.approx(0, abs=1e-3 * np.ptp(heights) * WIDTH)


def test_layers_at_rest_have_none_below_an_inclined_surface_that_bears_them():
    surface = np.array([[0, 0], [WIDTH, 500.0]])
    scene = diapir_scene()
    scene = replace(
        scene,
        outline=Outline(surface, scene.outline.base),
        unit_at=lambda points: np.zeros(len(points), np.int16),
        walls=scene.walls | {"surface": SLIP},
    )
    engine = StokesEngine(scene)
    state = engine.with_flow(engine.start())
    _, heights = dynamic_topography(scene, engine.grid, state.flow)
    # a wall that leans bears the weight below its highest point as the rock there would
    assert np.ptp(heights) == pytest.approx(500, rel=1e-3)


def test_only_a_surface_of_free_slip_under_gravity_has_one():
    scene = diapir_scene()
    assert dynamic_topography(scene, None, None) is None
    assert dynamic_topography(replace(slipping(), gravity=0.0), None, None) is None


def test_the_run_record_tells_it_at_every_mark(tmp_path):
    scene = slipping((8, 9), MeshPlan(), marks=(0, 0.05))
    made = Job(tmp_path / "case.yaml", "a: b\n", "a: b\n", scene, tmp_path / "run")
    record, folder = run_job(made)
    found = json.loads((folder / "run.json").read_text())["dynamic_topography_m"]
    assert found == record["dynamic_topography_m"]
    assert len(found) == 2
    assert all(0 < relief < HEIGHT / 100 for relief in found)


def test_rock_at_quadrature_points_has_a_topography_too():
    heights = []
    for density in ("hat", "quadrature"):
        scene = diapir_scene(
            walls=diapir_scene().walls | {"surface": Wall("free-slip", (None, 0.0), (0.0, 0.0))},
            transfer=Transfer(density, "hat", "harmonic"),
        )
        engine = StokesEngine(scene)
        state = engine.with_flow(engine.start())
        heights.append(np.ptp(dynamic_topography(scene, state.grid, state.flow)[1]))
    assert heights[1] == pytest.approx(heights[0], rel=0.02)

from dataclasses import replace

import numpy as np
import pytest
import shapely

from restoration.scene import Line
from restoration.welds import thin_part, welds
from tests.restoration.conftest import HEIGHT, WIDTH, diapir_scene


def scene_of(points):
    """Salt below a line."""
    points = np.array(points, float)
    return diapir_scene(
        lines=(Line("salt / sediment", "horizon", points),),
        unit_at=lambda p: (p[:, 1] > np.interp(p[:, 0], *points.T)).astype(np.int16),
    )


def test_a_box_has_no_welds():
    scene = scene_of([[0, -8000], [WIDTH, -8000]])
    found = welds(scene, scene.lines, 1500.0)
    assert found.area == pytest.approx(0, abs=1)
    assert not found.holds(np.array([[1.0, -9999.0], [WIDTH / 2, -5000]])).any()


def test_a_thin_layer_is_one_weld():
    scene = scene_of([[0, 100 - HEIGHT], [WIDTH, 100 - HEIGHT]])
    found = welds(scene, scene.lines, 200.0)
    assert found.area == pytest.approx(100 * WIDTH, rel=1e-4)
    assert found.by_rock["salt"]["share"] == pytest.approx(1, rel=1e-4)
    assert found.by_rock["sediment"]["area_m2"] == pytest.approx(0, abs=1)
    assert found.share == pytest.approx(100 / HEIGHT, rel=1e-4)
    points = np.array([[1.0, 50 - HEIGHT], [1.0, 500 - HEIGHT]])
    assert found.holds(points).tolist() == [True, False]


def test_a_wedge_is_thin_up_to_its_thickness():
    scene = scene_of([[0, -HEIGHT], [WIDTH, 2000 - HEIGHT]])
    found = welds(scene, scene.lines, 500.0)
    upto = WIDTH * 500 / 2000
    assert 0.6 < found.by_rock["salt"]["area_m2"] / (upto * 500 / 2) < 1.1


def test_layers_of_one_rock_are_one_layer():
    scene = scene_of([[0, -8000], [WIDTH, -8000]])
    more = Line("a / b", "horizon", np.array([[0, -7900.0], [WIDTH, -7900.0]]))
    assert welds(scene, (*scene.lines, more), 500.0).area == pytest.approx(0, abs=1)


def test_bands_of_faults_are_no_welds():
    scene = scene_of([[0, 100 - HEIGHT], [WIDTH, 100 - HEIGHT]])
    from restoration.scene import Fault

    scene = replace(scene, faults=(Fault("salt", 0, 50.0),))
    assert welds(scene, scene.lines, 200.0).area == pytest.approx(0, abs=1)


def test_corners_are_no_thin_parts():
    corner = shapely.Polygon(
        [(0, 0), (3000, 0), (3000, 1000), (1000, 1000), (1000, 3000), (0, 3000)]
    )
    assert thin_part(corner, 400.0).area == pytest.approx(0, abs=1)
    neck = shapely.union_all(
        [
            shapely.box(0, 0, 1e3, 1e3),
            shapely.box(1e3, 400, 2e3, 500),
            shapely.box(2e3, 0, 3e3, 1e3),
        ]
    )
    assert thin_part(neck, 400.0).area == pytest.approx(1e5, rel=0.05)


def test_what_is_in_no_weld_is_compared_by_itself():
    from restoration.certificate import outside_welds
    from restoration.engine import StokesEngine

    scene = scene_of([[0, 100 - HEIGHT], [WIDTH, 100 - HEIGHT]])
    state = StokesEngine(scene).start()
    thin = state.particles.x[:, 1] < 100 - HEIGHT
    off = np.where(thin[:, None], [500.0, 0.0], [3.0, 4.0])
    last = replace(state, particles=replace(state.particles, x=state.particles.x + off))
    found = welds(scene, state.lines, 200.0, state.particles)
    particles, horizons = outside_welds(found, state, state, last)
    assert particles["mean_m"] == pytest.approx(5)
    assert particles["max_m"] == pytest.approx(5)
    assert particles["share"] == pytest.approx(0.99, abs=0.01)
    assert horizons["salt / sediment"]["share"] == 0

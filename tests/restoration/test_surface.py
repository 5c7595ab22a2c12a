"""The surface line and the mesh that follows it."""

from dataclasses import replace

import numpy as np
import pytest

from meshes.box import section_mesh
from restoration.engine import StokesEngine
from restoration.grid import Grid
from restoration.scene import Air, MeshPlan, SurfacePlan, Wall
from restoration.surface import heights_on, line_area
from tests.restoration.conftest import HEIGHT, WIDTH, diapir_scene

FREE = Wall("free", (None, None), (0.0, 0.0))
X = np.linspace(0, WIDTH, 13)


def rough(n=301, seed=3):
    """A surface line with unevenly spaced points that lie between those of the mesh."""
    rng = np.random.default_rng(seed)
    x = np.sort(np.r_[0, WIDTH, rng.uniform(0, WIDTH, n)])
    return np.column_stack([x, 200 * np.cos(3 * x / WIDTH) + rng.normal(0, 20, len(x))])


def free_scene(**plans):
    scene = diapir_scene(**plans)
    return replace(scene, walls=scene.walls | {"surface": FREE})


@pytest.fixture(scope="module")
def grid():
    return StokesEngine(free_scene()).grid


def test_the_heights_keep_the_area_and_the_first_moment():
    line = rough()
    z = heights_on(line, X)
    fine = np.unique(np.r_[X, line[:, 0]])
    for weight in (np.ones(len(fine)), fine / WIDTH):
        left, right = fine[:-1], fine[1:]
        middle = (left + right) / 2

        def moment(values, at, left=left, right=right, middle=middle, weight=weight):
            """Integral of a polyline times one linear in x, by Simpson's rule."""
            ends = np.interp(left, at, values), np.interp(right, at, values)
            half = np.interp(middle, at, values) * (weight[:-1] + weight[1:]) / 2
            return ((ends[0] * weight[:-1] + 4 * half + ends[1] * weight[1:]) @ (right - left)) / 6

        assert moment(z, X) == pytest.approx(moment(line[:, 1], line[:, 0]), rel=1e-12)


def test_the_heights_of_a_line_between_the_same_points_are_its_own():
    z = 100 * np.sin(X / 1e3)
    assert heights_on(np.column_stack([X, z]), X) == pytest.approx(z, abs=1e-9)


def test_the_heights_are_linear_in_the_line_and_mirrored_with_it():
    line = rough()
    twice = line * [1, 2]
    assert heights_on(twice, X) == pytest.approx(2 * heights_on(line, X))
    mirrored = (line * [-1, 1] + [WIDTH, 0])[::-1]
    assert heights_on(mirrored, X) == pytest.approx(heights_on(line, X)[::-1])


@pytest.mark.parametrize("interfaces", ["particles", "fitted"])
def test_the_mesh_has_the_area_below_the_line(interfaces):
    grid = StokesEngine(free_scene(mesh=MeshPlan("P2b-P1dg", interfaces))).grid
    line = rough(seed=4)
    assert grid.follow(line)
    area = line_area(line) + WIDTH * HEIGHT
    assert grid.section.area == pytest.approx(area, rel=1e-13)
    assert grid.index.area.sum() == pytest.approx(area, rel=1e-13)
    assert line_area(grid.top.line) == pytest.approx(line_area(line), rel=1e-12)


def test_the_mesh_remembers_no_step(grid):
    line = rough(seed=5)
    assert grid.follow(line)
    direct = grid.section.mesh.geometry.x.copy()
    for seed in (6, 7):
        assert grid.follow(rough(seed=seed))
    assert grid.follow(line)
    assert np.array_equal(grid.section.mesh.geometry.x, direct)


def test_walls_stay_where_they_are(grid):
    still = replace_flat(grid)
    assert grid.follow(rough(seed=8))
    moved = grid.section.mesh.geometry.x
    base = still[:, 1] == -HEIGHT
    assert np.array_equal(moved[base], still[base])
    for side in (0.0, WIDTH):
        at = still[:, 0] == side
        assert at.sum() > 2
        assert (moved[at, 0] == side).all()
    assert np.array_equal(moved[:, 0], still[:, 0])  # the motion is vertical


def replace_flat(grid):
    """Return the nodes of the mesh below a flat surface, and leave it so."""
    assert grid.follow(np.array([[0, 0], [WIDTH, 0.0]]))
    return grid.section.mesh.geometry.x.copy()


def test_the_mesh_moves_as_the_line_does_and_less_below(grid):
    still = replace_flat(grid)
    assert grid.follow(np.array([[0, 100], [WIDTH, 100.0]]))
    lift = grid.section.mesh.geometry.x[:, 1] - still[:, 1]
    assert lift == pytest.approx(100 * (1 + still[:, 1] / HEIGHT), abs=1e-6)


def test_normal_motion_keeps_the_ends_on_the_sides():
    grid = StokesEngine(free_scene(surface=SurfacePlan(motion="normal"))).grid
    line = np.column_stack([X, 400 * np.sin(np.pi * X / WIDTH) ** 2])
    assert grid.follow(line)
    top = grid.top.line
    assert top[[0, -1], 0] == pytest.approx([0, WIDTH])
    assert top[:, 1] == pytest.approx(np.interp(top[:, 0], *line.T), abs=1e-9)
    assert (np.diff(top[:, 0]) > 0).all()


def test_a_mesh_that_would_tangle_is_refused_and_left_as_it_is(grid):
    before = replace_flat(grid)
    spike = np.column_stack([X, np.where(np.arange(len(X)) == 6, -1.2 * HEIGHT, 0.0)])
    assert not grid.follow(spike)
    assert np.array_equal(grid.section.mesh.geometry.x, before)
    assert grid.section.area == pytest.approx(WIDTH * HEIGHT)


def test_air_gives_way_and_keeps_its_top():
    scene = free_scene(surface=SurfacePlan(air=Air(3e3, 1.0, 1e18)))
    grid = StokesEngine(scene).grid
    rock = ~grid.fields.in_air
    whole, line = grid.section.area, rough(seed=9)
    assert grid.follow(line)
    assert grid.section.area == pytest.approx(whole, rel=1e-13)
    below = line_area(line) + WIDTH * HEIGHT
    assert grid.index.area[rock].sum() == pytest.approx(below, rel=1e-12)


def test_the_flux_of_a_uniform_rise_is_its_rate_times_the_width(grid):
    replace_flat(grid)
    state = StokesEngine(free_scene())
    flow = state.with_flow(state.start()).flow
    rising = replace(flow, u=np.tile([0.0, 2.0], (len(flow.u), 1)))
    assert grid.top.flux(rising) == pytest.approx(2 * WIDTH)
    sideways = replace(flow, u=np.tile([2.0, 0.0], (len(flow.u), 1)))
    assert grid.follow(rough(seed=10))
    first, last = grid.top.line[[0, -1], 1]
    assert grid.top.flux(sideways) == pytest.approx(-2 * (last - first))


def test_a_mesh_made_below_the_line_is_the_one_that_followed_it():
    scene = free_scene()
    z = heights_on(rough(seed=11), X)
    line = np.column_stack([X, z])
    grid = Grid(scene, section_mesh(line, scene.outline.base, scene.cells))
    made = grid.section.mesh.geometry.x.copy()
    assert grid.follow(line)
    assert grid.section.mesh.geometry.x == pytest.approx(made, abs=1e-8)

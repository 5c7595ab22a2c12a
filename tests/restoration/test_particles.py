from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

from meshes.box import section_mesh
from restoration.errors import ParticleError
from restoration.particles import (
    OUTSIDE,
    CellIndex,
    Particles,
    born_in,
    empty_cells,
    held_inside,
    joined,
    relocate,
    seed,
)
from restoration.scene import Cloud, Outline, ParticlePlan
from restoration.seeding import count_points

RELIEF = Outline(
    np.array([[0, 0], [300, 120], [700, -80], [1000, 50.0]]), np.array([[0, -900], [1000, -1000.0]])
)


@pytest.fixture(scope="module")
def index():
    section = section_mesh(RELIEF.surface, RELIEF.base, (20, 18))
    return CellIndex(section)


def cloud_at(x, unit=None):
    n = len(x)
    unit = np.zeros(n, np.int16) if unit is None else unit
    return Particles(x, unit, np.ones(n), x.copy(), np.full(n, OUTSIDE, np.int32))


def test_every_point_is_found_in_the_cell_that_holds_it(index):
    rng = np.random.default_rng(0)
    corner = index.corners[rng.integers(len(index.corners), size=5000)]
    weights = rng.dirichlet([1, 1, 1], 5000)
    x = np.einsum("nk,nkd->nd", weights, corner)
    for guess in (np.full(5000, OUTSIDE), rng.integers(len(index.corners), size=5000)):
        cell, found = index.locate(x, guess)
        assert (cell != OUTSIDE).all()
        assert found.min() > -1e-9
        assert np.einsum("nk,nkd->nd", found, index.corners[cell]) == pytest.approx(x, abs=1e-8)


def test_points_outside_are_marked_and_counted(index):
    x = np.array([[500, 400.0], [-1, -500], [1001, -500], [500, -1200], [500, -500]])
    cell, _ = index.locate(x, np.full(5, OUTSIDE))
    assert (cell == OUTSIDE).tolist() == [True] * 4 + [False]
    assert relocate(cloud_at(x), index).lost == 4


def test_points_on_walls_and_corners_are_inside(index):
    cell, _ = index.locate(np.concatenate([RELIEF.surface, RELIEF.base]), np.full(6, OUTSIDE))
    assert (cell != OUTSIDE).all()


def seeded(make_scene, **plans):
    return seed(make_scene(cells=(20, 18), **plans))


def test_seeded_particles_fill_the_section_and_stand_for_its_area(make_scene):
    plan = ParticlePlan(per_cell=5, densify=10, jitter=0.5, seed=4)
    particles = seeded(
        make_scene, outline=RELIEF, particles=plan, unit_at=lambda p: np.zeros(len(p), np.int16)
    )
    assert len(particles.x) == pytest.approx(5 * 4 * 20 * 18, rel=0.05)  # one rock: none denser
    assert particles.area.sum() == pytest.approx(RELIEF.area, rel=2e-3)
    assert (np.interp(particles.x[:, 0], *RELIEF.surface.T) >= particles.x[:, 1]).all()
    assert (np.interp(particles.x[:, 0], *RELIEF.base.T) <= particles.x[:, 1]).all()


def test_seeding_is_denser_where_rocks_meet_and_repeatable(make_scene):
    clouds = [
        seeded(make_scene, particles=ParticlePlan(4, densify, 0.3, 7)) for densify in (1, 8, 8)
    ]
    near, far = (
        [cKDTree(c.x).query_ball_point([4571, z], 300, return_length=True) for c in clouds]
        for z in (-8000, -4000)
    )
    assert near[1] == pytest.approx(8 * near[0], rel=0.25)
    assert far[1] == pytest.approx(far[0], rel=0.1)
    assert np.array_equal(clouds[1].x, clouds[2].x)
    assert clouds[1].area.sum() == pytest.approx(make_scene().outline.area, rel=1e-12)


def test_layers_of_one_rock_are_not_densified(make_scene):
    scene = make_scene(particles=ParticlePlan(4, 20, 0.3, 7))
    one = replace(scene, units=tuple(replace(unit, rock=0) for unit in scene.units))
    assert len(seed(one).x) < 0.6 * len(seed(scene).x)


def test_the_number_of_particles_is_known_before(make_scene):
    scene = make_scene()
    assert count_points(scene) == len(seed(scene).x)


@pytest.mark.parametrize(("jitter", "regular"), [(0.0, True), (1.0, False)])
def test_regular_or_jittered(make_scene, jitter, regular):
    x = seeded(make_scene, particles=ParticlePlan(4, 1, jitter, 1)).x
    assert (len(np.unique(x[:, 0].round(6))) < 100) == regular


def test_units_follow_the_section(make_scene):
    scene = make_scene()
    cloud = seed(scene)
    assert np.array_equal(cloud.unit, scene.unit_at(cloud.x))
    salt = cloud.area[cloud.unit == 0].sum()
    assert salt == pytest.approx(9142 * 2000, rel=2e-3)  # the cosine adds nothing to the area


def test_an_empty_cell_takes_the_nearest_rock(index):
    centre = index.corners.mean(axis=1)
    left = centre[:, 0] < 500
    some = np.arange(len(centre)) % 3 > 0
    particles = relocate(cloud_at(centre[some], left[some].astype(np.int16)), index)
    empty = empty_cells(particles, len(centre))
    assert np.array_equal(empty, np.flatnonzero(~some))
    filled = joined(particles, born_in(empty, particles, index))
    assert not len(empty_cells(filled, len(centre)))
    assert filled.born.sum() == len(empty)
    far = np.abs(centre[empty, 0] - 500) > 60
    assert np.array_equal(filled.unit[filled.born][far], left[empty][far])


def test_no_particle_at_all_is_an_error(index):
    with pytest.raises(ParticleError, match="no particle is left inside the section"):
        born_in(np.array([0], np.int32), cloud_at(np.empty((0, 2))), index)


def test_a_cloud_shares_the_area(make_scene):
    scene = make_scene(cloud=Cloud(np.ones((8, 2)), np.zeros(8, np.int16)))
    given = seed(scene)
    assert len(given.x) == 8
    assert given.area.sum() == pytest.approx(scene.outline.area)


def test_cells_of_another_mesh_are_good_guesses(index):
    x = np.array([[500, -500.0], [20, -300]])
    cell, hats = index.locate(x, np.full(2, OUTSIDE))
    for guess in ([0, 1], [10**6, 5]):
        again, same = index.locate(x, np.array(guess))
        assert (again == cell).all()
        assert same == pytest.approx(hats)


@pytest.mark.parametrize("held", ["left", "right", "base", "surface"])
def test_walls_that_hold_set_points_back_onto_them(held):
    rng = np.random.default_rng(3)
    x = rng.uniform([-200, -1200], [1200, 300], (4000, 2))
    walls = dict.fromkeys(("left", "right", "base", "surface"), False) | {held: True}
    inside, count = held_inside(x, RELIEF, walls)
    wanted = x.copy()
    if held == "left":
        wanted[:, 0] = np.maximum(x[:, 0], 0)
    elif held == "right":
        wanted[:, 0] = np.minimum(x[:, 0], 1000)
    elif held == "base":
        wanted[:, 1] = np.maximum(x[:, 1], np.interp(x[:, 0], *RELIEF.base.T))
    else:
        wanted[:, 1] = np.minimum(x[:, 1], np.interp(x[:, 0], *RELIEF.surface.T))
    assert inside == pytest.approx(wanted, abs=1e-9)
    assert count == np.count_nonzero((wanted != x).any(axis=1)) > 100

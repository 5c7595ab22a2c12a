from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from restoration import companions
from restoration.bench.certificate import judged
from restoration.bench.scenes import two_rocks, under_a_wave
from restoration.companions import Follower, accompany, order, way_back
from restoration.displacement import Perturbation, deformation, displaced, matched, offset, read
from restoration.engine import StokesEngine
from restoration.errors import MeshError
from restoration.layered import Layer, rates
from restoration.particles import subset
from restoration.run import march
from restoration.scene import Outline
from tests.restoration.conftest import HEIGHT, MYR, WIDTH, diapir_scene


@pytest.fixture(scope="module")
def given():
    scene = diapir_scene()
    return scene, StokesEngine(scene).start()


@pytest.mark.parametrize(
    ("marks", "expected"),
    [((0, 6, 0), (1, 2)), ((0, 3, 6, 3, 0), (2, 4)), ((0, -2, 5, 4), (0, 1)), ((0, 6), None)],
)
def test_the_longest_way_back(marks, expected):
    assert way_back(marks) == expected


def test_noise_keeps_to_the_walls_and_has_its_size(given):
    scene, state = given
    wave = Perturbation(state, scene, 1.0, 1500.0, 7)
    u = wave(state.particles.x)
    assert np.average((u**2).sum(axis=1), weights=state.particles.area) == pytest.approx(1)
    side = np.linspace(-HEIGHT, 0, 50)
    level = np.linspace(0, WIDTH, 50)
    for x in (0, WIDTH):
        assert wave(np.column_stack([np.full(50, x), side]))[:, 0] == pytest.approx(0, abs=1e-9)
    for z in (0, -HEIGHT):
        assert wave(np.column_stack([level, np.full(50, z)]))[:, 1] == pytest.approx(0, abs=1e-9)


def test_noise_has_no_divergence(given):
    scene, state = given
    base = np.array([[0, -HEIGHT], [WIDTH / 3, 500 - HEIGHT], [WIDTH, 100 - HEIGHT]])
    scene = replace(scene, outline=Outline(scene.outline.surface, base))
    wave = Perturbation(state, scene, 1.0, 1500.0, 7)
    x = np.random.default_rng(1).uniform([0.4 * WIDTH, -8000], [0.9 * WIDTH, -500], (50, 2))
    h = 1e-2
    along, up = np.array([h, 0]), np.array([0, h])
    dx, dz = wave(x + along) - wave(x - along), wave(x + up) - wave(x - up)
    size = np.abs(dx[:, 0]).max()
    assert dx[:, 0] + dz[:, 1] == pytest.approx(0, abs=1e-5 * size)


def test_other_seeds_are_other_noise(given):
    scene, state = given
    one, two = (Perturbation(state, scene, 1.0, 1500.0, s)(state.particles.x) for s in (1, 2))
    alike = (one * two).sum() / np.sqrt((one**2).sum() * (two**2).sum())
    assert abs(alike) < 0.8


def test_particles_are_known_again_in_any_order(given):
    _, state = given
    p = state.particles
    rows = np.random.default_rng(1).permutation(len(p.x))[:-5]
    other = subset(p, rows)
    found = matched(p, other)
    there = found >= 0
    assert np.count_nonzero(~there) == 5
    assert rows[found[there]].tolist() == np.flatnonzero(there).tolist()
    moved = replace(state, particles=replace(other, x=other.x + [3.0, 4.0]))
    assert np.hypot(*offset(state, moved).T) == pytest.approx(5)


def test_lines_are_displaced_as_the_rock_around_them(given):
    _, state = given
    off = np.tile([1.0, -2.0], (len(state.particles.x), 1))
    after = displaced(state, off)
    moved = np.tile([1.0, -2.0], (len(state.lines[0].points), 1))
    moved[[0, -1], 0] = 0.0  # ends on the sides of the section stay on them
    assert after.lines[0].points - state.lines[0].points == pytest.approx(moved)
    x = state.particles.x
    assert read(x, x, x[:9]) == pytest.approx(x[:9], rel=1e-3)


def test_order_of_the_mesh():
    assert order(1.0, 2.0, (2.0, 3.0)) == pytest.approx(1, abs=1e-3)
    assert order(3.0, 8.0, (2.0, 3.0)) == pytest.approx(2, abs=1e-3)
    assert order(1.0, 50.0, (2.0, 3.0)) == 2
    assert order(1.0, 1.0, (2.0, 3.0)) == 1
    assert order(0.0, 0.0, (2.0, 3.0)) == 1


def test_stretch_of_a_shear():
    x = np.random.default_rng(1).uniform(0, 1, (400, 2))
    sheared = x + np.column_stack([2 * x[:, 1], 0 * x[:, 1]])
    assert deformation(x, sheared) == pytest.approx(1 + np.sqrt(2))
    sheared[3] = np.nan
    assert np.isnan(deformation(x, sheared)[3])


def wave_scene(density, marks):
    """Two layers with a small wave between them, on a coarse mesh."""
    height, unit_at = under_a_wave(2e3, 20.0, 2e4)
    x = np.linspace(0, 1e4, 201)
    walls = {"left": "free-slip", "right": "free-slip", "base": "no-slip", "surface": "no-slip"}
    line = np.column_stack([x, height(x)])
    rock = (density, (1e19, 1e19), (16, 16), walls)
    return two_rocks(1e4, 1e4, unit_at, line, *rock, marks=marks, min_steps=12)


@pytest.mark.slow
def test_errors_grow_as_linear_theory_says():
    """Heavy below light is stable, and grows backward at the rate at which it decays forward."""
    layers = [Layer(2e3, 2600.0, 1e19), Layer(8e3, 2150.0, 1e19)]
    k = np.arange(1, 9) * np.pi / 1e4
    gamma = -rates(layers, k, 9.81, "no-slip", "no-slip")[:, 0]
    time = 4.0 / gamma.max()
    scene = wave_scene((2600.0, 2150.0), (0.0, -time))
    follower, engine = Follower(scene), StokesEngine(scene)
    march(engine.start(), engine, scene.time, (lambda _, s: follower.step(s),), (follower.mark,))
    assert len(follower.states) == 13
    assert follower.done
    growth = accompany(follower, StokesEngine, march, 1e-2, seeds=(3,))
    assert growth.failure == ""
    late = [
        np.sqrt(np.mean(growth.noise[0][i][:, 1] ** 2)) for i in (8, 12)
    ]  # when the fastest mode has won
    rate = np.log(late[1] / late[0]) / (follower.states[8].time - follower.states[12].time)
    assert rate == pytest.approx(gamma.max(), rel=0.2)


@pytest.mark.slow
def test_a_section_that_can_be_restored_is_trusted():
    scene = wave_scene((2150.0, 2600.0), (0.0, -0.3 * MYR))
    _, _, found = judged(scene, StokesEngine(scene).start())
    assert found["verdict"].startswith("trusted to ")
    (row,) = found["horizons"]
    assert row["verdict"].startswith("horizon lower / upper: trusted to ")
    assert "from 1 m of noise" in row["verdict"]
    assert row["overturned"] == 0
    assert [rock["trusted"] for rock in found["rocks"]] == [True, True]
    assert found["new_rock_share"] == 0


@pytest.mark.slow
def test_a_section_that_cannot_be_restored_is_not_trusted():
    """Stable layers whose modes decay fast: errors grow e^9-fold on the way back."""
    layers = [Layer(2e3, 2600.0, 1e19), Layer(8e3, 2150.0, 1e19)]
    gamma = -rates(layers, np.pi / 1e4 * np.arange(1, 9), 9.81, "no-slip", "no-slip").min()
    scene = wave_scene((2600.0, 2150.0), (0.0, -9 / gamma))
    _, _, found = judged(scene, StokesEngine(scene).start())
    assert found["verdict"].startswith("not to be trusted")
    (row,) = found["horizons"]
    assert "not to be trusted beyond -" in row["verdict"] or "Ma" in row["verdict"]
    assert row["trusted"] is False


class FakeCompanion:
    """Is off by 0.1 m a way on the mesh of the run, in second order, and fails where it is to.

    Attributes:
        made: all there were, in their order.
        fails: (companion, way) that fail.
    """

    made, fails = [], {}

    def __init__(self, follower, _engine, _march, coarser, *_):
        self.number, self.way, self.coarser, self.states = len(self.made), 0, coarser, follower
        self.made.append(self)

    def __enter__(self):
        assert sum(one.works for one in self.made) == 0
        self.works = True
        return self

    works = False

    def __exit__(self, *_):
        self.works = False

    def restored(self, state, until, off=None):
        self.way = next(i for i, one in enumerate(self.states.states) if one.time == until)
        if self.fails.get(self.number) == self.way:
            raise MeshError(f"companion {self.number} on way {self.way}")
        beside = 0.1 * (self.coarser**2 - 1)  # of the run, which is off by 0.1 m itself
        x = state.particles.x + (0 if off is None else off) + [beside, 0]
        return replace(state, time=until, particles=replace(state.particles, x=x))


@pytest.mark.parametrize(
    ("fails", "reached", "text"),
    [
        ({}, 4, ""),
        ({0: 2}, 0, "companion 0 on way 2"),  # before anything is known
        ({2: 1}, 0, "companion 2 on way 1"),
        ({2: 3}, 2, "companion 2 on way 3"),
        ({3: 4}, 3, "companion 3 on way 4"),
        ({4: 4, 5: 2}, 1, "companion 5 on way 2"),  # what limits it
        ({4: 2, 5: 4}, 1, "companion 4 on way 2"),  # the other never comes there
        ({6: 4}, 3, "companion 6 on way 4"),
    ],
)
def test_a_companion_that_fails_ends_the_way_of_all(given, monkeypatch, fails, reached, text):
    scene, start = given
    monkeypatch.setattr(companions, "Companion", FakeCompanion)
    monkeypatch.setattr(FakeCompanion, "made", [])
    monkeypatch.setattr(FakeCompanion, "fails", fails)
    states = [replace(start, time=-MYR * i) for i in range(5)]
    follower = SimpleNamespace(scene=scene, states=states)
    growth = accompany(follower, None, None, 10.0)
    assert growth.failure == text
    assert [len(off) for off in (*growth.noise, growth.mesh)] == [reached + 1] * 4
    assert not any(one.works for one in FakeCompanion.made)
    if reached == 4:
        assert len(FakeCompanion.made) == 7
        assert growth.noise[0][4] == pytest.approx(growth.noise[0][0])
        assert growth.order == pytest.approx(2)
        back = np.broadcast_to([-0.4, 0], growth.mesh[4].shape)  # to where the truth is
        assert growth.mesh[4] == pytest.approx(back)
    if reached == 0:
        assert len(FakeCompanion.made) == 1 + 2 * (0 not in fails)

"""The modes of a surface and where they are slaved, on surfaces whose response is known."""

from types import SimpleNamespace

import numpy as np
import pytest

from restoration.surface_modes import Slaving, SurfaceModes, hat_mass

LENGTH, RATE = 10.0, 4.0  # RATE: of a half wave
HALF_WAVE = np.pi / LENGTH


class Response:
    """A surface whose waves of wave number k relax with RATE (k / HALF_WAVE)^2.

    Args:
        x: of the nodes.
        speed: of the rock along the surface: the rise has a part -speed dh/dx.
    """

    def __init__(self, x, speed=0.0):
        self.grid, self.mass = SimpleNamespace(top=SimpleNamespace(x=x)), hat_mass(x)
        width = np.diff(x)
        self.stiffness = np.diag(np.r_[1 / width, 0] + np.r_[0, 1 / width])
        self.stiffness -= np.diag(1 / width, 1) + np.diag(1 / width, -1)
        n = len(x)
        self.slope = (np.eye(n, k=1) - np.eye(n, k=-1)) / 2
        self.slope[[0, -1], [0, -1]] = -0.5, 0.5
        self.speed = speed

    def flow(self, heights):
        return heights

    def moments(self, u):
        return -RATE / HALF_WAVE**2 * self.stiffness @ u

    def rise(self, u):
        return np.linalg.solve(self.mass, self.moments(u))

    def along(self, u):
        return self.speed


class Drifting(Response):
    """The same where the heights of a flow are (above the equilibrium, all): the rock drifts."""

    def moments(self, u):
        if u.ndim == 1:
            return super().moments(u)
        return super().moments(u[0]) - self.speed * self.slope @ u[1]


@pytest.fixture
def x():
    return np.linspace(0, LENGTH, 41)


def test_rates_and_shapes_of_known_modes(x):
    modes = SurfaceModes(Response(x), 1.0)
    assert modes.rates[:4] == pytest.approx(RATE * np.arange(4) ** 2, rel=0.01, abs=1e-9)
    assert len(modes.slaved) == len(x) - 1  # all but the mean
    wave = np.cos(HALF_WAVE * x)
    assert modes.heights(modes.amounts(wave + 1e4)) == pytest.approx(wave, abs=2e-3)
    assert modes.drift(2.0)[:3] * RATE * HALF_WAVE == pytest.approx(
        2.0 * HALF_WAVE**2 / np.array([1, 2, 3]), rel=0.02
    )


def test_modes_between_other_nodes_stay_orthogonal_and_without_a_mean(x):
    modes = SurfaceModes(Response(x), 1.0)
    moved = x + 0.05 * np.sin(2 * HALF_WAVE * x)
    assert modes.near(moved)
    assert not modes.near(x[1:])
    assert not modes.near(np.linspace(0, LENGTH, 41) ** 2 / LENGTH)
    there = modes.at(moved)
    amounts = np.random.default_rng(1).normal(size=len(modes.slaved))
    assert there.amounts(there.heights(amounts) + 1e4) == pytest.approx(amounts, abs=1e-7)


def test_what_is_far_from_rest_is_slaved_though_it_grows_slowly(x):
    response, time = Response(x), 1.0  # gamma T = 4 of a half wave, 16 of a wave
    modes = SurfaceModes(response, 5.0)
    assert len(modes.slaved) == len(x) - 2
    moments = response.moments(np.cos(HALF_WAVE * x))
    assert modes.bearable(5.0, 2.0, moments, time, 100.0) == 5.0  # 1 m grows to 55 m
    assert 2.0 < modes.bearable(5.0, 2.0, moments, time, 10.0) < 1.01 * RATE
    assert modes.bearable(5.0, 2.0, moments, time / 2, 10.0) == 5.0  # no time left to grow
    assert modes.bearable(5.0, 4.5, moments, time, 10.0) == 5.0  # too slow to be slaved


def march(x, dt, growth, speed=0.0, steps=60, noise=0.0):
    """Return what the slaved half wave is of its equilibrium, step by step backward."""
    response, random = Drifting(x, speed), np.random.default_rng(1)
    slaving = Slaving(10.0, 100.0)
    slaving._response, slaving.modes = response, SurfaceModes(response, slaving.cut)
    wave, height, time, parts = np.cos(HALF_WAVE * x), np.cos(HALF_WAVE * x), 0.0, []
    for _ in range(steps):
        rest = np.exp(growth * time) * (wave + noise * random.normal(size=len(x)))
        flow = SimpleNamespace(u=np.array([height - rest, height]))
        slaving.passes(time, np.column_stack([x, height]), flow)
        height = height + slaving.lift(flow)
        parts.append((height @ response.mass @ wave) / (wave @ response.mass @ wave))
        parts[-1] *= np.exp(-growth * time)
        if slaving._rate is not None:
            height = height + dt * slaving.modes.heights(slaving._own_rate())
        time += dt
    return np.array(parts)


@pytest.mark.parametrize("passed", [0.05, 0.5, 5.0])
def test_a_mode_lags_behind_a_growing_equilibrium(x, passed):
    growth = RATE / 5
    parts = march(x, -passed / RATE, growth, steps=max(10, int(10 / passed)))
    assert parts[-1] == pytest.approx(RATE / (RATE + growth), rel=0.05 * (1 + passed))
    assert np.abs(parts).max() < 1.5


@pytest.mark.parametrize("passed", [0.01, 0.1, 1.0])
def test_drift_along_the_surface_and_noise_stay_bounded_however_short_the_steps(x, passed):
    drifted = march(x, -passed / RATE, 0.2, speed=RATE / HALF_WAVE / 4, steps=200)
    assert np.abs(drifted).max() < 2
    noisy = march(x, -passed / RATE, 0.2, steps=200, noise=0.01)
    assert np.abs(noisy - RATE / (RATE + 0.2)).max() < 0.2

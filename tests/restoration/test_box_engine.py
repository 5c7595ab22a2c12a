"""The engine of three dimensions against linear theory, two dimensions and itself."""

from dataclasses import replace

import numpy as np
import pytest

from restoration.box_engine import BoxEngine
from restoration.engine import StokesEngine
from restoration.layered import Layer, rates
from restoration.lines import as_drawn
from restoration.particles import relocate, seed
from restoration.resolve import load
from restoration.run import march
from restoration.scene import TimePlan
from tests.restoration.conftest import MYR

CASE = """
section:
  box: {{width: {width} km, {length} height: 5 km}}
  layers:
    - rock: salt
      top: {{depth: 3.5 km, cosine: {{amplitude: {amplitude} km, wavelength: {wave} km, {wave_y}}}}}
    - {{rock: sediment}}
rocks:
  salt: {{density: 2150 kg/m^3, viscosity: {viscosity} Pa s}}
  sediment: {{density: 2600 kg/m^3, viscosity: 1e19 Pa s}}
mesh: {{cells: {cells}, element: {element}}}
particles: {{densify: {densify}}}
time: {{marks: [0 Myr, 1 Myr, 0 Myr], min_steps: 10}}
"""
DEFAULTS = {
    "width": 10,
    "length": "length: 10 km,",
    "amplitude": 0.2,
    "wave": 20,
    "wave_y": "wavelength_y: 20 km",
    "viscosity": "1e19",
    "cells": [4, 4, 4],
    "element": "P2-P1",
    "densify": 5,
}


@pytest.fixture
def scene(tmp_path):
    def make(**entries):
        path = tmp_path / "case.yaml"
        path.write_text(CASE.format(**DEFAULTS | entries), encoding="utf-8")
        return load(path).scene

    return make


def vertical(engine, state, points):
    """Return the vertical velocity at points, m/s."""
    grid = engine.grid
    cell, hats = grid.index.locate(points, grid.index.guess(points))
    return grid.sampler(grid.sampler.coefficients(state.flow.u), cell, hats)[:, -1]


def begun(scene):
    engine = BoxEngine(scene)
    return engine, engine.with_flow(engine.start())


@pytest.mark.parametrize(
    ("element", "viscosity", "off"),
    [("P2-P1", "1e19", 0.03), ("P2-P1", "1e18", 0.1), ("P2b-P1dg", "1e19", 0.03)],
)
def test_a_wave_grows_as_linear_theory_says(scene, element, viscosity, off):
    """By k = sqrt(kx^2 + ky^2), as a wave of two dimensions does; cubes of 0.8 km."""
    found = scene(cells=[6, 6, 6], element=element, densify=20, viscosity=viscosity)
    engine, state = begun(found)
    points, k = found.sheets[0].points, np.pi / 10e3
    mode = np.cos(k * points[:, 0]) * np.cos(k * points[:, 1])
    weight = np.ones(found.sheets[0].shape)
    weight[[0, -1]] *= 0.5
    weight[:, [0, -1]] *= 0.5
    moved = np.average(vertical(engine, state, points) * mode, weights=weight.ravel())
    rate = moved / np.average(200 * mode**2, weights=weight.ravel())
    layers = [Layer(1500.0, 2150.0, float(viscosity)), Layer(3500.0, 2600.0, 1e19)]
    (exact,) = rates(layers, np.sqrt(2) * k, 9.81, "no-slip", "free-slip")
    assert rate == pytest.approx(exact, rel=off)


def test_x_and_y_are_alike(scene):
    """A box that is its own image where x and y are swapped has a flow that is too."""
    engine, state = begun(scene(densify=1))
    half = seed(engine.scene).x
    x = np.vstack([half, half[:, [1, 0, 2]]])
    particles = state.particles
    twice = {n: np.concatenate([getattr(particles, n)] * 2) for n in ("unit", "area", "cell")}
    particles = relocate(replace(particles, x=x, start=x, **twice), engine.grid.index)
    state = replace(state, particles=particles, flow=None)
    state = engine.advance(engine.with_flow(state), 0.2 * MYR)
    one, two = np.split(state.particles.x, 2)
    moved = np.linalg.norm(one - half, axis=1).max()
    assert moved > 10
    assert np.abs(one - two[:, [1, 0, 2]]).max() < 1e-6 * moved


@pytest.mark.slow
def test_what_does_not_vary_along_y_is_a_section(scene):
    """The horizon of a section of two dimensions, after 1 Myr."""
    entries = {"width": 7, "wave": 14, "wave_y": "", "densify": 20}
    deep = scene(**entries, length="length: 1.75 km,", cells=[8, 2, 6])
    flat = scene(**entries, length="", cells=[24, 18])
    ends = []
    for engine in (BoxEngine(deep), StokesEngine(flat)):
        plan = replace(engine.scene.time, marks=(0.0, 1 * MYR))
        ends.append(march(engine.start(), engine, plan).lines)
    sheet, (line,) = ends[0][0], as_drawn(ends[1])
    start = flat.lines[0].points[:, 1]
    middle = sheet.points.reshape(*sheet.shape, 3)[sheet.shape[0] // 2]
    height = np.interp(line.points[:, 0], middle[:, 0], middle[:, 2])
    rise = np.ptp(line.points[:, 1]) - np.ptp(start)
    assert rise > 300
    assert np.abs(height - line.points[:, 1]).max() < 0.1 * rise
    across = np.ptp(sheet.points.reshape(*sheet.shape, 3)[..., 2], axis=0)
    assert across.max() < 0.1 * rise


def test_particles_move_in_the_order_of_the_scheme(scene):
    """Half the step, and the way there and back misses by a quarter or less (midpoint)."""
    found, gaps = scene(amplitude=0.5), []
    engine = BoxEngine(replace(found, time=replace(found.time, scheme="midpoint")))
    for steps in (2, 4, 8):
        plan = TimePlan((0.0, 1 * MYR, 0.0), "midpoint", 100.0, steps)
        end = march(engine.start(), replace_step(engine), plan)
        gaps.append(np.linalg.norm(end.particles.x - end.particles.start, axis=1).mean())
    assert gaps[0] > 1
    assert gaps[1] < gaps[0] / 4
    assert gaps[2] < gaps[1] / 4


def replace_step(engine):
    engine.stable_step = lambda *_: np.inf
    return engine


def test_everything_comes_back(scene):
    found = scene()
    engine = BoxEngine(found)
    end = march(engine.start(), engine, found.time)
    assert np.linalg.norm(end.particles.x - end.particles.start, axis=1).max() < 1
    assert np.abs(end.lines[0].points - found.sheets[0].points).max() < 1
    assert end.particles.lost == 0
    assert engine.counts.factorisations == 1


def test_points_stay_in_the_box(scene):
    engine, _ = begun(scene())
    x = np.array([[-1, 5e3, -1e3], [5e3, 10.5e3, 1], [1, 2, -5001.0], [4, 5, -6]])
    inside = engine._on_walls(x, 2)
    assert inside.tolist() == [[0, 5e3, -1e3], [5e3, 1e4, 0], [1, 2, -5e3], [4, 5, -6]]
    assert engine.held_on_wall == 3


@pytest.mark.parametrize("jitter", [0.0, 1.0])
def test_particles_stand_for_the_volume_of_the_box(scene, jitter):
    found = scene(width=8)
    found = replace(found, particles=replace(found.particles, jitter=jitter))
    cloud = seed(found)
    assert cloud.area.sum() == pytest.approx(8e3 * 10e3 * 5e3)
    assert np.average(cloud.x, axis=0, weights=cloud.area) == pytest.approx(
        (4e3, 5e3, -2.5e3), abs=30
    )
    assert ((cloud.x >= (0, 0, -5e3)) & (cloud.x <= (8e3, 10e3, 0))).all()
    assert cloud.area[cloud.unit == 0].sum() == pytest.approx(8e3 * 10e3 * 1.5e3, rel=0.02)

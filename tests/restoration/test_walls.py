"""Walls of a case: what balances, what rock may cross, and where it is filled up."""

from dataclasses import replace

import numpy as np
import pytest

from restoration.engine import StokesEngine
from restoration.particles import seed
from restoration.scene import Cloud, Outline, TimePlan, Wall
from restoration.stokes import Flow
from restoration.walls import unbalanced
from tests.restoration.conftest import HEIGHT, MYR, WIDTH, diapir_scene

BOX = Outline(np.array([[0, 0], [1000, 0.0]]), np.array([[0, -500], [1000, -500.0]]))
WEDGE = Outline(np.array([[0, 0], [1000, 300.0]]), np.array([[0, -500], [1000, -700.0]]))
SLIP_X = Wall("free-slip", (0.0, None), (0.0, 0.0))
SLIP_Z = Wall("free-slip", (None, 0.0), (0.0, 0.0))
FREE = Wall("traction", (None, None), (0.0, 0.0))


def moving(*velocity):
    return Wall("velocity", velocity, (0.0, 0.0))


@pytest.mark.parametrize("outline", [BOX, WEDGE])
@pytest.mark.parametrize("velocity", [(1e-9, 0.0), (0.0, 1e-9), (3e-10, -2e-10)])
def test_a_section_that_moves_as_a_whole_is_balanced(outline, velocity):
    walls = dict.fromkeys(("left", "right", "base", "surface"), moving(*velocity))
    assert not unbalanced(walls, outline)


@pytest.mark.parametrize(
    ("name", "wall", "way"),
    [
        ("left", moving(1e-9, None), "in"),
        ("right", moving(1e-9, None), "out"),
        ("base", moving(None, 1e-9), "in"),
        ("surface", moving(None, 1e-9), "out"),
    ],
)
def test_one_wall_alone_is_out_of_balance(name, wall, way):
    slip = {"left": SLIP_X, "right": SLIP_X, "base": SLIP_Z, "surface": SLIP_Z}
    (message,) = unbalanced(slip | {name: wall}, BOX)
    assert f"m^2/yr more {way} than" in message


def pushed(walls, shift):
    """A diapir after one step that moves all rock by ``shift``, m, and its engine."""
    plan = TimePlan((0.0, 1.0 * MYR), "euler", 1.0, 1)
    engine = StokesEngine(diapir_scene(cells=(6, 6), time=plan, walls=walls))
    u = np.tile(np.array(shift) / MYR, (len(engine.grid.spaces.V.tabulate_dof_coordinates()), 1))
    start = replace(engine.start(), flow=Flow(u, np.zeros(1), 0.0))
    return engine, start.particles, engine.advance(start, MYR).particles


@pytest.mark.parametrize("shift", [(400.0, 300.0), (-400.0, -300.0)])
def test_a_step_carries_no_rock_through_a_closed_wall(shift):
    engine, before, after = pushed(diapir_scene().walls, shift)
    to = np.clip(before.x + shift, (0, -HEIGHT), (WIDTH, 0))
    assert after.x[: len(before.x)] == pytest.approx(to, abs=1e-6)
    assert after.lost == 0
    assert engine.held_on_wall > 0


def test_a_step_carries_rock_through_an_open_wall():
    walls = {"left": FREE, "right": FREE, "base": SLIP_Z, "surface": FREE}
    engine, before, after = pushed(walls, (400.0, 300.0))
    to = before.x + (400, 300)
    assert after.x[: len(to)] == pytest.approx(to, abs=1e-6)
    assert after.lost == np.count_nonzero((to[:, 0] > WIDTH) | (to[:, 1] > 0))
    assert engine.held_on_wall == 0


@pytest.mark.parametrize(("surface", "born"), [(SLIP_Z, 0), (FREE, 1)])
def test_one_empty_cell_is_filled_where_a_wall_is_open(surface, born):
    """In a sealed section it reads its rock from the particles around it."""
    scene = diapir_scene(cells=(6, 6), walls=diapir_scene().walls | {"surface": surface})
    engine = StokesEngine(scene)
    cloud = seed(scene)
    cell, _ = engine.grid.index.locate(cloud.x, cloud.cell)
    some = cell != engine.grid.index.guess(np.array([[WIDTH / 3, -HEIGHT / 2]]))
    engine = StokesEngine(replace(scene, cloud=Cloud(cloud.x[some], cloud.unit[some])))
    assert engine.start().particles.born.sum() == engine.born == born
    assert engine.empty_cells == 1

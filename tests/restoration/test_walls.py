"""Walls of a case: what balances, what rock may cross, and where it is filled up."""

from dataclasses import replace

import numpy as np
import pytest

from restoration.engine import StokesEngine
from restoration.particles import seed
from restoration.scene import Cloud, Outline, Table, TimePlan, Wall, normal_velocity
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


def table(axis, values, positions=(0.0,), times=(0.0,)):
    return Table(axis, positions, times, values)


@pytest.mark.parametrize(
    ("wall", "flux"),
    [
        (table(1, ((0.0, 4e-9),), (-500.0, 0.0)), 1e-6),
        (table(1, ((0.0, 4e-9),), (-250.0, 0.0)), 0.5e-6),
        (table(1, ((2e-9,), (3e-9,)), times=(0.0, MYR)), 1e-6),
    ],
)
def test_tables_are_balanced_by_what_they_let_out(wall, flux):
    walls = {"left": moving(flux / 500, None), "right": moving(wall, None)}
    messages = unbalanced(walls | {"base": SLIP_Z, "surface": SLIP_Z}, BOX)
    late = ["more out than in at 1 Myr"] if len(wall.times) > 1 else []
    assert [part for part in late if part in messages[0]] == late
    assert len(messages) == len(late)


def test_a_table_lets_rock_through_unless_all_of_it_is_zero():
    still, slow = (
        table(1, ((0.0,), (0.0,)), times=(0.0, 1.0)),
        table(1, ((0.0, -1e-9),), (0.0, 1.0)),
    )
    assert normal_velocity("left", moving(still, None), BOX) == 0
    assert normal_velocity("left", moving(slow, None), BOX) == -1e-9
    assert normal_velocity("surface", moving(slow, 0.0), WEDGE) == -1e-9
    assert normal_velocity("surface", moving(slow, None), WEDGE) is None


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
    beyond = to[:, 0] > WIDTH
    above = (to[:, 1] > 0) & ~beyond
    stay = to[~beyond & ~above]
    assert after.x[: len(stay)] == pytest.approx(stay, abs=1e-6)
    assert engine.left == {"right": beyond.sum(), "surface": above.sum(), "left": 0}
    assert after.lost == engine.held_on_wall == 0


@pytest.mark.parametrize("surface", [SLIP_Z, FREE])
def test_one_empty_cell_reads_its_rock_from_the_particles_around_it(surface):
    scene = diapir_scene(cells=(6, 6), walls=diapir_scene().walls | {"surface": surface})
    engine = StokesEngine(scene)
    cloud = seed(scene)
    cell, _ = engine.grid.index.locate(cloud.x, cloud.cell)
    some = cell != engine.grid.index.guess(np.array([[WIDTH / 3, -HEIGHT / 2]]))
    engine = StokesEngine(replace(scene, cloud=Cloud(cloud.x[some], cloud.unit[some])))
    assert engine.start().particles.born.sum() == engine.born == 0
    assert engine.empty_cells == 1

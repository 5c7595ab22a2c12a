"""What must hold after every step, each with its own fault."""

from types import SimpleNamespace

import numpy as np
import pytest

from restoration.engine import StokesEngine
from restoration.errors import MeshError, ParticleError, SolveError
from restoration.guards import StepGuards, look_at_fields
from restoration.ranks import ALONE
from restoration.scene import TimePlan
from restoration.surface import STEEPEST
from tests.restoration.conftest import MYR, diapir_scene

LEVEL = np.array([[0.0, 0.0], [100.0, 0.0], [200.0, 0.0]])


def grid(area=(2.0, 3.0), kept=(1.0, 0.9), thinnest=0.5, line=None, air=(False, False)):
    """A mesh of two cells, as far as the guards look at it."""
    corners = np.array([[[0, -9], [3, -9], [0, -6]], [[30, -90], [60, -90], [30, -60]]], float)
    return SimpleNamespace(
        index=SimpleNamespace(area=np.array(area), corners=corners),
        fields=SimpleNamespace(in_air=np.array(air), bare=()),
        kept_shape=np.array(kept),
        thinnest=thinnest,
        top=None if line is None else SimpleNamespace(line=np.array(line, float)),
    )


def state(of_grid):
    x = np.ones((3, 2))
    particles = SimpleNamespace(x=x, lost=0, inside=np.ones(3, bool))
    flow = SimpleNamespace(u=np.zeros((4, 2)), p=np.zeros(3))
    return SimpleNamespace(particles=particles, flow=flow, lines=(), grid=of_grid)


def look(after, before=None, closed=True):
    guards = StepGuards(None, ALONE, closed)
    guards.watch(state(before or grid()))
    guards.look(state(after))


def test_a_sound_state_passes():
    look(grid(line=LEVEL))


def test_area_that_is_won_or_lost_is_told():
    with pytest.raises(MeshError, match=r"won 2\.0e-06 of its area"):
        look(grid(area=(2.0, 3.00001)))
    with pytest.raises(MeshError, match=r"lost 2\.0e-06 of its area"):
        look(grid(area=(1.99999, 3.0)))
    look(grid(area=(2.0, 3.000001)))
    look(grid(area=(2.0, 4.0)), closed=False)


def test_air_has_no_area_to_keep():
    air = (False, True)
    look(grid(area=(2.0, 5.0), air=air), before=grid(air=air))


def test_a_cell_that_turns_over_is_told_with_its_place():
    with pytest.raises(MeshError, match=r"1 of 2 cells have turned over.* x = 40 m and z = -80 m"):
        look(grid(kept=(1.0, -0.2)))
    with pytest.raises(MeshError, match="turned over"):
        look(grid(kept=(1.0, np.nan)))


def test_a_cell_that_loses_its_shape_is_told():
    with pytest.raises(MeshError, match=r"has kept 14 % of its shape"):
        look(grid(kept=(0.14, 1.0)))
    look(grid(kept=(0.16, 1.0)))


def test_a_cell_that_is_no_cell_is_told():
    with pytest.raises(MeshError, match="times as long as it is high"):
        look(grid(thinnest=0.9e-5))


@pytest.mark.parametrize(
    ("slope", "what"), [(2.1, "too steep"), (-2.1, "too steep"), (np.nan, "nowhere")]
)
def test_a_surface_that_is_too_steep_is_told(slope, what):
    line = LEVEL.copy()
    line[1, 1] = slope * STEEPEST * 100.0
    with pytest.raises(MeshError, match=f"the surface is {what}"):
        look(grid(line=line))


def test_steep_is_not_too_steep():
    line = LEVEL.copy()
    line[1, 1] = 1.9 * STEEPEST * 100.0
    look(grid(line=line))


@pytest.mark.parametrize(("what", "value"), [("theta", np.nan), ("theta", 2.0), ("rho", np.inf)])
def test_rock_that_no_rock_is_like_is_told(what, value):
    engine = StokesEngine(diapir_scene(cells=(4, 4), time=TimePlan((0.0, MYR), "euler", 1.0, 2)))
    engine.with_flow(engine.start())
    look_at_fields(engine.grid)
    getattr(engine.grid.fields, what).x.array[3] = value
    with pytest.raises(SolveError, match=r"is not that of any rock at 1 of .* x = "):
        look_at_fields(engine.grid)


def test_births_are_not_taken_for_what_appears():
    guards = StepGuards(None, ALONE, True)
    first = state(grid())
    guards.watch(first, arrived=5)
    more = replace_particles(first, 4)
    guards.look(more, arrived=6)
    with pytest.raises(ParticleError, match="1 of 4 particles are new"):
        guards.look(more, arrived=5)
    with pytest.raises(ParticleError, match="1 of 4 particles are missing"):
        guards.look(more, arrived=7)


def replace_particles(of, count):
    particles = SimpleNamespace(x=np.ones((count, 2)), lost=0, inside=np.ones(count, bool))
    return SimpleNamespace(**vars(of) | {"particles": particles})

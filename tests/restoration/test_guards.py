"""What must hold after every step, each with its own fault."""

from types import SimpleNamespace

import numpy as np
import pytest

from restoration.engine import StokesEngine
from restoration.errors import MeshError, ParticleError, SolveError
from restoration.guards import StepGuards, look_at_fields
from restoration.ranks import ALONE
from restoration.scene import Line, TimePlan
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


def after(**changed):
    """Return a sound state but for what is changed of it or its particles, flow and mesh."""
    made = state(grid())
    for name, value in changed.items():
        owner = next((x for x in vars(made).values() if hasattr(x, name)), made)
        setattr(owner, name, value)
    return made


def refused(made, error):
    """Return what is said of a state that is not gone on from."""
    guards = StepGuards(None, ALONE, True)
    guards.watch(state(grid()))
    with pytest.raises(error) as caught:
        guards.look(made)
    return str(caught.value)


def test_a_flow_that_is_not_finite_is_told_with_its_nodes():
    u = np.zeros((4, 2))
    u[1] = u[3, 0] = np.nan
    assert refused(after(u=u), SolveError) == (
        "the flow is not finite: the velocity at 2 of 4 nodes, the pressure at 0 of 3"
    )
    assert refused(after(p=np.array([0.0, np.inf, 1.0])), SolveError) == (
        "the flow is not finite: the velocity at 0 of 4 nodes, the pressure at 1 of 3"
    )


def test_a_line_that_is_not_finite_is_told():
    line = Line("top", "horizon", np.array([[0.0, 1.0], [np.nan, np.nan], [2.0, 1.0]]))
    assert refused(after(lines=(line,)), MeshError) == "horizon top: 1 of 3 points are not finite"


def test_particles_that_are_nowhere_are_told():
    x = np.ones((3, 2))
    x[2, 1] = np.nan
    assert refused(after(x=x), ParticleError).startswith("1 of 3 particles are nowhere")


def test_a_particle_that_is_lost_is_told_with_its_place():
    x = np.array([[1.0, -1.0], [20.0, -30.0], [5.0, -5.0]])
    inside = np.array([True, False, True])
    told = refused(after(x=x, lost=1, inside=inside), ParticleError)
    assert told.startswith("1 of 3 particles have left the section where nothing may, the first ")
    assert "near x = 20 m and z = -30 m" in told


@pytest.mark.parametrize(("cell", "where"), [(0, "x = 1 m and z = -8 m"), (1, "x = 40 m")])
def test_a_part_without_particles_is_told_with_its_place(cell, where):
    bare = after()
    bare.grid.fields.bare = (cell,)
    told = refused(bare, ParticleError)
    assert told.startswith(f"no particle is within two cells of 1 cells, the first near {where}")


def test_how_long_a_cell_is_is_told():
    told = refused(state(grid(thinnest=0.5e-5)), MeshError)
    assert told.startswith(
        "a cell is 2e+05 times as long as it is high, at most 1e+05 are possible"
    )
    look(grid(thinnest=1e-5))


def test_what_a_cell_is_to_keep_is_told():
    told = refused(state(grid(kept=(0.1, 1.0))), MeshError)
    assert told.endswith("has kept 10 % of its shape, at least 15 % are needed")


def test_the_area_of_hundreds_of_steps_is_told_from_where_the_run_began():
    guards = StepGuards(None, ALONE, True)
    guards.watch(state(grid()))
    for step in range(1, 112):  # of 9e-7 each
        guards.look(state(grid(area=(2.0, 3.0 + 4.5e-6 * step))))
    with pytest.raises(MeshError, match=r"won 1\.0e-04 of its area since the run began"):
        guards.look(state(grid(area=(2.0, 3.0 + 4.5e-6 * 112))))


def test_guards_go_on_from_what_they_remember():
    guards, others = (StepGuards(None, ALONE, True) for _ in range(2))
    guards.watch(state(grid()))
    guards.look(state(grid(area=(2.0, 3.000004))))
    others.recall(guards.memory())
    others.look(state(grid(area=(2.0, 3.000008))))
    with pytest.raises(MeshError, match="in this step"):
        others.look(state(grid(area=(2.0, 3.0))))
    others.recall(guards.memory() | {"begun": 4.0})
    with pytest.raises(MeshError, match="since the run began"):
        others.look(state(grid(area=(2.0, 3.000004))))
    others.recall(guards.memory() | {"particles": 2})
    with pytest.raises(ParticleError, match="1 of 3 particles are new"):
        others.look(state(grid(area=(2.0, 3.000004))))


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

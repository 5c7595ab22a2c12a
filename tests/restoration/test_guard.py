"""What a fitted mesh must not do unseen: rocks as drawn, one rock alone."""

from types import SimpleNamespace

import numpy as np
import pytest

from restoration.engine import StokesEngine
from restoration.errors import MeshError
from restoration.guards import FittedGuard, drawn_shares
from restoration.scene import Line, MeshPlan
from tests.restoration.conftest import HEIGHT, WIDTH, diapir_scene, diapir_top


def short_of_the_wall(interfaces):
    """The diapir with a horizon that ends 100 m before the wall, so that it parts nothing."""
    x = np.linspace(0, WIDTH - 100, 201)
    lines = (Line("salt / sediment", "horizon", np.column_stack([x, diapir_top(x)])),)
    return diapir_scene(mesh=MeshPlan(interfaces=interfaces), lines=lines)


def test_shares_as_drawn():
    salt = 2000 / HEIGHT
    assert drawn_shares(diapir_scene()) == pytest.approx([salt, 1 - salt], abs=1e-4)


def test_a_horizon_that_closes_no_region_is_refused():
    """The whole section would be of one rock, and nothing tell so."""
    with pytest.raises(MeshError, match=r"salt has 0.0% of the section .* 20.0% more or less"):
        StokesEngine(short_of_the_wall("fitted"))


def test_a_horizon_that_closes_no_region_is_left_to_particles():
    engine = StokesEngine(short_of_the_wall("auto"))
    assert not engine.fitted
    assert "a horizon ends before a wall" in engine.notes[0]


@pytest.mark.parametrize("interfaces", ["fitted", "auto"])
def test_one_rock_alone_needs_no_mesh_lines(interfaces):
    scene = diapir_scene(
        mesh=MeshPlan(interfaces=interfaces),
        lines=(),
        cells=(6, 6),
        unit_at=lambda points: np.ones(len(points), np.int16),
    )
    engine = StokesEngine(scene)
    state = engine.with_flow(engine.start())
    assert engine.fitted
    assert np.isfinite(state.flow.u).all()


ROCKS = (SimpleNamespace(name="salt"), SimpleNamespace(name="sediment"))


def scene_of(interfaces, faults=()):
    """Two units of two rocks and one of a fault, as far as the guard looks at them."""
    units = [SimpleNamespace(rock=0), SimpleNamespace(rock=1), SimpleNamespace(rock=1)]
    mesh = SimpleNamespace(interfaces=interfaces)
    return SimpleNamespace(rocks=ROCKS, units=units, faults=faults, mesh=mesh)


def mesh_of(areas, units=(0, 1), across=(False, False), length=100.0):
    """Two cells of some areas, m^2, with their greatest edges on z = 0 and z = -500 m."""
    flat = np.array([[0, 0], [length, 0], [length / 2, -2 * areas[0] / length]])
    corners = np.array([flat, flat - [0, 500]])
    return SimpleNamespace(
        index=SimpleNamespace(area=np.array(areas, float), corners=corners),
        fields=SimpleNamespace(unit=np.array(units)),
        contacts=SimpleNamespace(across=lambda: np.array(across)),
    )


def test_rock_that_wins_a_part_of_the_section_at_once_is_told():
    guard = FittedGuard(scene_of("fitted"), 100.0)
    guard.look(mesh_of((4e6, 6e6)))
    guard.look(mesh_of((4.2e6, 5.8e6)))  # the most it may, and compared with in what follows
    guard.look(mesh_of((4.4e6, 5.6e6)))
    with pytest.raises(MeshError, match=r"changed its area by 0\.201 km\^2 at once"):
        guard.look(mesh_of((4.601e6, 5.399e6)))
    with pytest.raises(MeshError, match=r"changed its area by 0\.201 km\^2 at once"):
        guard.look(mesh_of((4.199e6, 5.801e6)))


def test_the_rock_that_changed_is_named():
    guard = FittedGuard(scene_of("fitted"), 100.0)
    guard.look(mesh_of((4e6, 6e6)))
    with pytest.raises(MeshError, match=r"^salt changed"):
        guard.look(mesh_of((4.5e6, 6e6)))
    guard = FittedGuard(scene_of("fitted"), 100.0)
    guard.look(mesh_of((4e6, 6e6)))
    with pytest.raises(MeshError, match=r"^sediment changed"):
        guard.look(mesh_of((4e6, 6.5e6)))


def test_a_weld_is_left_to_particles_where_these_may_take_over():
    """A cell of 2 m is as thin as a weld may not be where cells are of 100 m."""
    at = {"across": (True, False)}
    thin, thick = mesh_of((99.0, 99.0), **at), mesh_of((101.0, 101.0), **at)
    FittedGuard(scene_of("fitted"), 100.0).look(thin)
    FittedGuard(scene_of("auto"), 100.0).look(thick)
    FittedGuard(scene_of("auto"), 100.0).look(mesh_of((100.0, 100.0), **at))
    FittedGuard(scene_of("auto"), 100.0).look(mesh_of((99.0, 99.0)))  # reaches across nothing
    told = r"^salt is a weld near x = 50 m and z = -66 cm, 1\.98 m thick"
    with pytest.raises(MeshError, match=told):
        FittedGuard(scene_of("auto"), 100.0).look(thin)
    below = mesh_of((99.0, 99.0), across=(False, True))
    with pytest.raises(MeshError, match=r"^sediment is a weld near x = 50 m and z = -501 m"):
        FittedGuard(scene_of("auto"), 100.0).look(below)


def test_a_fault_may_be_as_thin_as_it_is():
    faults = (SimpleNamespace(unit=2),)
    band = mesh_of((99.0, 99.0), units=(2, 2), across=(True, True))
    FittedGuard(scene_of("auto", faults), 100.0).look(band)
    with pytest.raises(MeshError, match="sediment is a weld"):
        FittedGuard(scene_of("auto"), 100.0).look(band)

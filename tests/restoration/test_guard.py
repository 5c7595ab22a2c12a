"""What a fitted mesh must not do unseen: rocks as drawn, one rock alone."""

import numpy as np
import pytest

from restoration.engine import StokesEngine
from restoration.errors import MeshError
from restoration.guards import drawn_shares
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

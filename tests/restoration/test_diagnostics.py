"""Numbers of a run against what can be worked out by hand."""

import numpy as np
import pytest

from restoration.diagnostics import line_distances, relative_change, volume_by_rock
from restoration.engine import StokesEngine
from restoration.scene import Line, Outline, TimePlan
from restoration.state import State
from restoration.stokes import Flow
from tests.restoration.conftest import HEIGHT, MYR, WIDTH, diapir_scene


@pytest.fixture(scope="module")
def engine():
    plan = TimePlan((0.0, 1.0 * MYR), "euler", 0.25, 1)
    return StokesEngine(diapir_scene(time=plan))


def flow_of(engine, field):
    """The flow whose velocity is ``field`` at the nodes."""
    x, z = engine.grid.spaces.V.tabulate_dof_coordinates()[:, :2].T
    u = np.column_stack(np.broadcast_arrays(*field(x, z), x)[:2])
    return Flow(u, np.zeros(engine.grid.spaces.h_nodes.max() + 1), 0.0)


def test_speeds_of_a_linear_flow_are_exact(engine):
    """Integrals of x^2 and z^2 over the box."""
    rms, greatest = engine.grid.speeds(flow_of(engine, lambda x, z: (2e-13 * x, -1e-13 * z)))
    assert rms == pytest.approx(1e-13 * np.sqrt((4 * WIDTH**2 + HEIGHT**2) / 3))
    assert greatest == pytest.approx(1e-13 * np.sqrt(4 * WIDTH**2 + HEIGHT**2))


def test_a_stable_step_crosses_courant_squares_of_the_mesh(engine):
    flow = flow_of(engine, lambda x, z: (3e-9, -4e-9))
    square = np.sqrt(WIDTH / 12 * HEIGHT / 13)
    step = engine.stable_step(State(0.0, None, (), flow, engine.grid), 1.0)
    assert step == pytest.approx(0.25 * square / 5e-9)


@pytest.mark.parametrize("back", [False, True])
def test_a_spike_is_seen_in_either_line(back):
    """The vertex of the spike is 100 m off and stands for 50 m of 700 m."""
    straight = (Line("top", "horizon", np.array([[0, 0], [300, 0.0]])),)
    spike = (Line("top", "horizon", np.array([[0, 0], [300, 0], [300, 100.0]])),)
    (row,) = line_distances(*((spike, straight) if back else (straight, spike)))
    assert row == {
        "name": "top",
        "kind": "horizon",
        "mean_m": pytest.approx(100 * 50 / 700),
        "max_m": pytest.approx(100),
    }


def test_change_is_gain_over_the_first():
    change = relative_change({"salt": 2.0, "sand": 4.0, "none": 0.0}, {"salt": 3.0, "sand": 1.0})
    assert change == {"salt": 0.5, "sand": -0.75}


def test_volumes_of_rock_under_a_relief():
    """Two rocks side by side under a slope, 1500 m high on average and 2500 m."""
    outline = Outline(np.array([[0, 0], [2000, 2000.0]]), np.array([[0, -1000], [2000, -1000.0]]))
    engine = StokesEngine(
        diapir_scene(
            cells=(20, 8),
            outline=outline,
            unit_at=lambda p: (p[:, 0] > 1000).astype(np.int16),
            lines=(),
        )
    )
    volume = volume_by_rock(engine.scene, engine.grid, engine.start().particles)
    assert sum(volume.values()) == pytest.approx(4e6)
    assert volume == pytest.approx({"salt": 1.5e6, "sediment": 2.5e6}, rel=5e-3)

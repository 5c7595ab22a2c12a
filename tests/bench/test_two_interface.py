"""The linear problem of a horizon and a free surface: which ways back restore the horizon."""

import numpy as np
import pytest

from restoration.bench import two_interface
from restoration.bench.two_interface import exact, implicit, integrated, slaved, system
from restoration.units import MYR

A, TIME = system(1.4e17, 2.8e19), 1.5 * MYR


@pytest.fixture(scope="module")
def rows():
    return list(two_interface.run_two_interface(True))


def restored(rows, way):
    return [
        row.value for row in rows if row.case.endswith(way) and row.metric.startswith("restored")
    ]


def test_every_bound_is_held(rows):
    assert [row for row in rows if row.held is False] == []
    assert sum(row.held is not None for row in rows) > 10
    assert all(np.isfinite(row.value) for row in rows)


def test_amplitudes_computed_independently(rows):
    assert restored(rows, "slaved to the slow mode") == pytest.approx([1.001, 1.026], abs=1e-3)
    assert restored(rows, "quasi-static") == pytest.approx([1.012, 1.345], abs=1e-3)
    assert min(restored(rows, "integrated by rk4")) > 7e27


def test_there_and_back_exactly_over_a_short_time():
    time = 2 / np.abs(np.linalg.eigvals(A)).max()
    assert exact(A, -time) @ exact(A, time) == pytest.approx(np.eye(2), abs=1e-12)
    assert integrated(A, -time, 40) == pytest.approx(exact(A, -time), rel=1e-5)
    gaps = [np.abs(implicit(A, -time, n) - exact(A, -time)).max() for n in (400, 800)]
    assert gaps[0] / gaps[1] == pytest.approx(2, rel=0.05)


def test_many_corrections_reach_the_slow_mode():
    rate, modes = np.linalg.eig(A)
    slow = modes[:, rate.argmax()]
    back = slaved(A, -TIME, 20)
    assert back[1, 0] / back[0, 0] == pytest.approx(slow[1] / slow[0], rel=1e-12)
    assert back[0, 0] == pytest.approx(np.exp(-rate.max() * TIME), rel=1e-12)
    assert not back[:, 1].any()


def test_implicit_euler_damps_only_above_twice_the_relaxation_time():
    gamma = -np.linalg.eigvals(A).min()
    fast = [abs(implicit(A, -dt / gamma, 1)[1, 1]) for dt in (1.5, 2.5)]
    assert fast[0] > 1 > fast[1]

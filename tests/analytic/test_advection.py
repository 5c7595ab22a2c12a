"""Steppers in prescribed fields: observed orders, and the paper's scheme for what it is."""

import numpy as np
import pytest

from restoration.advection import SCHEMES

YEAR = 31557600.0
CENTRE, START = np.array([5000.0, 5000.0]), np.array([[8000.0, 5000.0]])


def constant_speed(x, speed=0.03 / YEAR):
    """Rotation at one speed (paper, appendix C, with the tangential field (-sin, cos))."""
    r = x - CENTRE
    return speed * np.column_stack([-r[:, 1], r[:, 0]]) / np.linalg.norm(r, axis=1)[:, None]


def drift_after_a_turn(scheme, steps, direction=1):
    """How far from its circle, and from its start, a point is after one turn, m."""
    period = 2 * np.pi * 3000 / (0.03 / YEAR)
    x = START
    for _ in range(steps):
        x = SCHEMES[scheme].step(x, constant_speed, direction * period / steps)
    return abs(np.linalg.norm(x - CENTRE) - 3000), np.linalg.norm(x - START)


@pytest.mark.parametrize(
    ("scheme", "order"),
    [("euler", 1), ("paper", 1), ("midpoint", 2), ("rk3", 3), ("rk4", 4), ("implicit-midpoint", 2)],
)
def test_order_on_the_rotation(scheme, order):
    steps = (200, 400, 800)
    gap = [drift_after_a_turn(scheme, n)[1] for n in steps]
    assert np.log2(gap[1] / gap[2]) == pytest.approx(order, abs=0.12)


def test_the_papers_scheme_drifts_as_its_table_says():
    """2000-year steps: 92.8 m off the circle; a true midpoint rule has 9.4e-3 m."""
    steps = round(2 * np.pi * 3000 / 0.03 / 2000)
    assert drift_after_a_turn("paper", steps)[0] == pytest.approx(92.8, rel=0.02)
    assert drift_after_a_turn("midpoint", steps)[0] == pytest.approx(9.4e-3, rel=0.02)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_restoring_is_the_forward_run_in_the_mirrored_field(scheme):
    """A negative step is the same step in the reversed flow."""
    forward = SCHEMES[scheme].step(START, constant_speed, -1000 * YEAR)
    reversed_flow = SCHEMES[scheme].step(START, lambda x: -constant_speed(x), 1000 * YEAR)
    assert forward == pytest.approx(reversed_flow, abs=1e-9)


@pytest.mark.parametrize(("scheme", "order"), [("midpoint", 3), ("rk4", 5)])
def test_there_and_back(scheme, order):
    """One step forward and one back returns with a gap that falls as dt^order or faster."""
    gap, step = [], SCHEMES[scheme].step
    for dt in (8000 * YEAR, 4000 * YEAR):
        back = step(step(START, constant_speed, dt), constant_speed, -dt)
        gap.append(np.linalg.norm(back - START))
    assert np.log2(gap[0] / gap[1]) > order - 0.1

"""The Pareto front and what it recommends."""

import json
import math

import pytest

from restoration.trade.trials import (
    Trial,
    asked_for,
    effects,
    front,
    gain,
    mesh_slope,
    promising,
    recommended,
)


def trial(label, cpu_s, error, *axes, **more):
    return Trial(label, axes, {}, error, 3 * error, cpu_s, **more)


GIVEN = trial("as given", 10.0, 8.0)
FINER = trial("finer", 40.0, 2.0, "mesh")
FITTED = trial("fitted", 20.0, 0.5, "rock")
EULER = trial("euler", 5.0, 100.0, "stepper")
LONGER = trial("longer", 5.0, 8.1, "step")
SHORTER = trial("shorter", 20.0, 7.9, "step")
FAILED = Trial("folded", ("rock",), failed="cells turned over", cpu_s=0.1)
ALL = [GIVEN, FINER, FITTED, EULER, LONGER, SHORTER, FAILED]


def test_the_front_holds_what_none_beats():
    assert [t.label for t in front(ALL)] == ["longer", "as given", "fitted"]


def test_equals_and_failures_are_not_on_the_front():
    twin = trial("twin", GIVEN.cpu_s, GIVEN.error)
    assert [t.label for t in front([GIVEN, twin])] == ["as given"]
    assert front([FAILED, trial("nothing", 1.0, math.nan)]) == []


@pytest.mark.parametrize(
    ("error", "round_one"), [(7.3, 10), (10, 10), (0.011, 0.02), (2.0, 2), (4.9, 5), (0, 0)]
)
def test_errors_that_people_ask_for(error, round_one):
    assert asked_for(error) == pytest.approx(round_one)


def test_the_cheapest_that_is_good_enough_is_recommended():
    found = [(asked, t.label) for asked, t in recommended(ALL)]
    assert found == [(10.0, "longer"), (0.5, "fitted")]


def test_gains_are_against_a_change_of_cells():
    slope = mesh_slope(ALL)
    assert slope == pytest.approx(-1)  # four times less for four times the cost
    assert gain(FINER, GIVEN, slope) == pytest.approx(1)
    assert gain(FITTED, GIVEN, slope) == pytest.approx(8)
    assert list(promising(ALL, GIVEN)) == ["rock", "step"]
    assert promising(ALL, GIVEN)["step"] is LONGER


def test_changes_are_told_by_what_they_gain():
    told = effects(ALL, GIVEN)
    assert told[0] == "fitted: error / 16, cost x 2"
    assert told[1] == "longer: error as before, cost / 2"
    assert told[-1].startswith("euler")


def test_a_trial_is_plain_values():
    plain = trial("odd", 1.0, math.inf).plain()
    assert plain["error"] is None
    json.dumps(plain, allow_nan=False)

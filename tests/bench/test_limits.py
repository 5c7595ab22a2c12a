"""The benchmarks of extremes: what they hold themselves to, and that they see what is wrong.

Their bounds are held by `test_suite`, as those of all benchmarks.
"""

import json
import sys

import numpy as np
import pytest

from restoration.bench import contrasts, extremes, shapes
from restoration.errors import CaseError, SolveError
from tests.torture import tries


@pytest.mark.slow
@pytest.mark.torture
def test_no_shape_is_solved_wrong_or_ends_without_a_reason():
    """Beyond those of the benchmark itself."""
    last = tries(shapes.QUICK + len(shapes.KINDS), 1000)
    found = list(shapes.told(shapes.QUICK, last))
    assert len(found) == last - shapes.QUICK
    assert [row for row in found if row["verdict"] == "silent"] == []
    assert {row["verdict"] for row in found} == {"solved", "refused"}


def test_a_process_that_dies_or_hangs_is_a_finding(monkeypatch, tmp_path):
    """The child ends by itself at shape 1, and hangs at shape 3."""
    child = tmp_path / "child"
    child.write_text(
        f"#!{sys.executable}\n"
        "import json, os, sys, time\n"
        "print('null', flush=True)\n"
        "for number in range(int(sys.argv[-2]), int(sys.argv[-1])):\n"
        "    if number == 1: os.abort()\n"
        "    if number == 3: time.sleep(60)\n"
        "    print(json.dumps({'number': number, 'verdict': 'solved'}), flush=True)\n"
    )
    child.chmod(0o755)
    monkeypatch.setattr(shapes, "PATIENCE", 1)
    monkeypatch.setattr(shapes.sys, "executable", str(child))
    found = list(shapes.told(0, 5))
    assert [row["number"] for row in found] == [0, 1, 2, 3, 4]
    assert [row["verdict"] for row in found] == ["solved", "silent", "solved", "silent", "solved"]


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"fastest": float("nan")}, "not finite"),
        ({"residual": float("nan")}, "residual"),
        ({"area": 1e-3}, "area lost"),
        ({"cut": -1e-3}, "area not as drawn"),
        ({"rock": 0.5}, "rocks not as drawn"),
    ],
)
def test_a_wrong_answer_is_a_finding(monkeypatch, changed, why):
    sound = {"residual": 1e-12, "cut": 0.0, "area": 0.0, "rock": 0.0, "fastest": 1.0}
    sound |= {"cells": 1, "bound": 1e-6}
    monkeypatch.setattr(shapes, "marched", lambda path: sound)
    assert shapes.judged(0)["verdict"] == "solved"
    monkeypatch.setattr(shapes, "marched", lambda path: sound | changed)
    told = shapes.judged(0)
    assert (told["verdict"], told["why"]) == ("silent", why)


@pytest.mark.parametrize(
    ("error", "verdict"),
    [(CaseError("no"), "refused"), (CaseError(""), "silent"), (ValueError("no"), "silent")],
)
def test_only_a_reason_is_a_refusal(monkeypatch, error, verdict):
    def fails(path):
        raise error

    monkeypatch.setattr(shapes, "marched", fails)
    assert shapes.judged(0)["verdict"] == verdict


def test_every_kind_of_shape_is_drawn():
    kinds = [shapes.drawn(number)[0] for number in range(len(shapes.KINDS))]
    assert kinds == list(shapes.KINDS)


@pytest.mark.parametrize("contrast", [1e-6, 1e-3, 1.0, 1e6])
def test_the_flow_of_the_channel_solves_its_equation(contrast):
    """u'' = -1 / eta in every layer, the velocity and the shear go through, the lid moves by 1."""
    exact = contrasts.channel(16, contrast, 5)
    assert exact(np.array([[0.0, 0.0], [0.0, 1.0]]))[0][:, 0] == pytest.approx([0, 1], abs=1e-9)
    shear = []
    for low, high, eta in ((0, 5 / 16, 1.0), (5 / 16, 6 / 16, contrast), (6 / 16, 1, 1.0)):
        z = np.linspace(low, high, 7)[1:-1]
        u = exact(np.column_stack([0 * z, z]))[0][:, 0]
        slope = np.polyfit(z - z.mean(), u, 2)
        assert 2 * slope[0] * eta == pytest.approx(-1, rel=1e-4)
        shear.append(eta * slope[1] + z.mean())
    assert shear == pytest.approx([shear[0]] * 3, rel=1e-6)


def test_what_is_refused_is_held_and_told():
    row = contrasts.refusal("a", "b", SolveError("too rough"), {})
    assert (row.value, row.held, row.parameters) == (3, None, {"refused": "too rough"})
    assert not contrasts.refusal("a", "b", SolveError(""), {}).held


def test_what_should_be_refused_and_is_not_misses_its_bound():
    row = extremes.told("units", "feet", "horizon off", 0.0, lambda: np.inf, "")
    assert row.held is False
    json.dumps(row.plain(), allow_nan=False)

"""The paper's models as a benchmark: which rows there are, and small ones of them."""

import numpy as np
import pytest

from restoration.bench.paper import Model, Way, models, panels, rows_of

METRICS = ("mean_m", "p99_m", "max_m", "horizon_mean_m", "horizon_max_m")
DIAPIRS = [
    f"diapir-{name}{end}" for name in ("isoviscous", "two-viscosities") for end in ("", "-full")
]
SALT = [f"salt-diapir-{number}" for number in range(1, 6)]


@pytest.mark.parametrize("quick", [True, False])
def test_the_models_are_those_of_the_paper(quick):
    found = list(models(quick))
    assert [model.name for model in found] == DIAPIRS + SALT
    for model in found:
        assert model.there != model.back != model.same
        assert model.there.cells != model.back.cells


def small(file, turn, drawn=False):
    ends = ("0 Ma", turn) if drawn else ("0 Myr", turn)
    same, there, back = (
        Way(10, 6, more=("time.tolerance=1 mm",)),
        Way(11, 8, "rk4", more=("mesh.interfaces=auto",)),
        Way(12, 9, "midpoint", more=("mesh.interfaces=particles",)),
    )
    bounds = {"same_scheme": {"mean_m": 0.1}}
    return Model("diapir-small", file, ends, same, there, back, bounds, {"mean_m": 14}, drawn)


def values(model, kind, one, other):
    rows = list(rows_of(model, kind, one, other))
    found = {row.metric.removeprefix(f"{kind}."): row.value for row in rows}
    assert tuple(found)[:5] == METRICS
    assert np.isfinite(list(found.values())).all()
    return rows, found


def test_there_and_back_flatters():
    """One scheme comes back to centimetres, two runs of other meshes are metres apart."""
    model = small("diapir-isoviscous/case.yaml", "1 Myr")
    rows, same = values(model, "same_scheme", model.same, model.same)
    assert rows[0].held is True
    assert rows[0].parameters["paper"] == 14
    more, independent = values(model, "independent", model.there, model.back)
    assert same["max_m"] < 0.1 < 1.0 < independent["mean_m"] < 100
    assert same["horizon_max_m"] < 0.1 < independent["horizon_mean_m"] < 50
    assert sum(rows[-1].parameters["share"]) == pytest.approx(1)
    assert all(series for *_, series in panels(rows + more))


def test_a_drawn_section_is_restored_first():
    model = small("salt-diapir/exp1.yaml", "8 ka", drawn=True)
    rows, found = values(model, "independent", model.back, model.there)
    assert found["restored_kyr"] == pytest.approx(8)  # so short that no criterion is met
    assert 1000 < found["top_of_salt_m"] < 1400
    assert found["mean_m"] < 100
    assert not rows[-1].parameters["met"]

"""The benchmarks themselves, coarse: every number that is held to a bound is within it."""

import json

import pytest

from restoration.bench import suite
from restoration.bench.rows import Row, compared, observed_order
from restoration.cli import main
from restoration.errors import CaseError


@pytest.mark.slow
@pytest.mark.parametrize("name", suite.BENCHMARKS)
def test_a_benchmark_holds_its_bounds(name, tmp_path):
    rows = suite.run_benchmarks([name], quick=True, folder=tmp_path)
    assert rows
    assert [suite.line(row) for row in rows if row.held is False] == []
    assert (tmp_path / f"{name}.png").stat().st_size > 10_000
    told = json.loads((tmp_path / f"{name}.json").read_text())
    assert [row["value"] for row in told] == pytest.approx([row.value for row in rows])


def test_rows_know_whether_they_are_held():
    assert compared("a", "b", "c", 1.01, 1.0, bound=0.02).held
    assert not compared("a", "b", "c", 1.03, 1.0, bound=0.02).held
    assert compared("a", "b", "c", 1.03, 1.0).held is None
    assert not Row("a", "b", "error", 0.1, 0.0, None, 0.01).held
    assert not Row("a", "b", "error", float("nan"), 0.0, None, 0.01).held
    assert Row("a", "b", "error", float("nan")).plain()["value"] is None


def test_order_of_a_quadratic_error():
    assert observed_order([0.1, 0.05], [4e-2, 1e-2]) == pytest.approx(2)


def test_an_unknown_benchmark_is_named():
    with pytest.raises(CaseError, match="no benchmark 'solxc'; did you mean 'solcx'"):
        suite.chosen(["solxc"])


def test_a_missed_bound_is_told_and_ends_with_another_code(monkeypatch, capsys):
    def run_wrong(_):
        """A number that is off."""
        yield compared("wrong", "a case", "a number", 2.0, 1.0, bound=0.1)

    monkeypatch.setitem(suite.BENCHMARKS, "wrong", run_wrong)
    assert main(["bench", "wrong"]) == 1
    assert "MISSED: held to 0.1" in capsys.readouterr().out
    assert main(["bench", "wrong", "--json"]) == 1
    (row,) = json.loads(capsys.readouterr().out)
    assert row["held"] is False
    assert row["relative_error"] == pytest.approx(1)


def test_the_list_has_a_line_for_every_benchmark(capsys):
    assert main(["bench", "--list"]) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == [*suite.BENCHMARKS]

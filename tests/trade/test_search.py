"""The search by a worker that invents its answers, and the choices of scenes."""

from dataclasses import replace
from pathlib import Path

import pytest

from restoration.errors import CaseError, SolveError
from restoration.resolve import load
from restoration.trade.choices import choices_of, presets_of, references_of, together
from restoration.trade.questions import QUESTIONS
from restoration.trade.report import table_of, table_text, words
from restoration.trade.search import BenchmarkSubject, CaseSubject, Worker, search

CASES = Path(__file__).parents[2] / "cases"
DEMO = CASES / "diapir-isoviscous" / "case.yaml"


class Inventor:
    """Answers as if mesh lines on contacts were worth a hundredfold and squares were refused."""

    def __init__(self):
        self.asked, self.limit = [], None

    def ask(self, request):
        entries = request["entries"]
        self.asked.append(entries)
        if entries["mesh.element"].startswith("Q"):
            return {"refused": "no squares"}
        if entries.get("transfer.mean") == "arithmetic":
            return {"failed": "the solver did not converge"}
        fitted = entries["mesh.interfaces"] == "fitted"
        cells = int(entries["mesh.cells"])
        error = (0.01 if fitted else 1.0) / cells
        cost = {"cpu_s": cells**2 / 1e3, "wall_s": 1.0, "memory_mb": 100}
        return cost | {"error": error, "most": 2 * error, "unknowns": 9 * cells**2}


class Solcx(BenchmarkSubject):
    def request(self, entries):
        return {"entries": self.question.base | entries}


def searched(**settings):
    subject, worker = Solcx("solcx", QUESTIONS["solcx"]), Inventor()
    return subject, worker, list(search(subject, worker, **settings))


def test_a_search_goes_from_what_was_given_to_what_goes_well_together():
    subject, worker, trials = searched()
    labels = [trial.label for trial in trials]
    assert labels[0] == "as given"
    assert "fitted" in labels
    assert "fitted, 64 cells" in labels
    assert not any("Q2" in label for label in labels)  # refused: it does not apply
    assert len(worker.asked) == len({str(sorted(e.items())) for e in worker.asked})
    assert worker.limit > 0
    text = words(trials, subject)
    assert "arithmetic mean" in text
    assert "did not converge" in text
    assert "for 0.02 % take fitted, 64 cells" in text
    quick = searched(quick=True)[2]
    assert len(quick) < len(trials)


def test_a_table_has_a_mark_where_nothing_beats():
    subject, _, trials = searched()
    rows = table_of(trials, subject.unit, subject.columns)
    assert {len(row) for row in rows} == {9}
    best = [row[1] for row in rows if row[0]]
    assert "as given" not in best
    assert best[-1] == "fitted, 64 cells"
    assert len(table_text(rows).splitlines()) == len(rows)


def test_what_was_given_must_succeed():
    worker = Inventor()
    subject = Solcx("solcx", QUESTIONS["solcx"], {})
    subject.question.base["mesh.element"]
    worker.ask = lambda request: {"failed": "folded"}
    with pytest.raises(SolveError, match="folded"):
        list(search(subject, worker))


def names(scene, quick=False):
    return {choice.name for choice in choices_of(scene, quick)}


def test_choices_are_those_that_apply():
    one = names(load(DEMO).scene)
    assert {"fitted", "transfer lines", "midpoint", "Q2-Q1", "31 cells"} <= one
    assert not {"rk4", "geometric mean"} & one
    two = names(load(CASES / "diapir-two-viscosities" / "case.yaml").scene)
    assert "geometric mean" in two
    graben = names(load(CASES / "graben" / "case.yaml").scene)
    assert "particles" in graben
    assert not {"Q2-Q1", "transfer lines", "fitted"} & graben
    assert len(names(load(DEMO).scene, quick=True)) < len(one)


def test_choices_are_entries_of_a_case():
    scene = load(DEMO).scene
    for choice in [*choices_of(scene), *presets_of(scene), *references_of(scene)]:
        load(DEMO, [f"{name}={value}" for name, value in choice.entries.items()])


def test_mesh_lines_leave_out_what_averages_particles():
    scene = load(DEMO).scene
    by_name = {choice.name: choice for choice in choices_of(scene)}
    both = together(by_name["transfer hat"], by_name["fitted"], by_name["midpoint"])
    assert both.name == "fitted, midpoint"
    assert both.axis == "rock+stepper"
    assert both.entries == {"mesh.interfaces": "fitted", "time.scheme": "midpoint"}


def test_a_cloud_without_horizons_is_refused(tmp_path):
    scene = load(DEMO).scene
    with pytest.raises(CaseError, match="no horizon"):
        CaseSubject(tmp_path / "case.yaml", replace(scene, lines=()))


def test_a_worker_that_dies_is_a_finding():
    with Worker() as worker:
        assert "failed" in worker.ask({"benchmark": "no such", "entries": {}})
        worker._process.kill()
        worker._process.wait()
        assert "failed" in worker.ask({"benchmark": "no such", "entries": {}})
        assert "failed" in worker.ask({"benchmark": "no such", "entries": {}})


def test_a_trial_that_takes_too_long_is_ended():
    with Worker() as worker:
        worker.limit = 0.2
        request = {"benchmark": "solcx", "entries": {"mesh.cells": 400}}
        assert worker.ask(request) == {"failed": "ended after 0 CPU s"}

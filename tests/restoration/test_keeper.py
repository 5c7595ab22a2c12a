"""When checkpoints are due and a run has to stop, by a clock that the tests set."""

from types import SimpleNamespace

import pytest

from restoration import keeper
from restoration.errors import CaseError, StoppedError
from restoration.keeper import Keeper, how_often, wall_time
from restoration.ranks import ALONE


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("23 h", 82800),
        ("90min", 5400),
        ("1.5 d", 129600),
        ("3600 s", 3600),
        (" 23:30:00 ", 84600),
        ("100:00:01", 360001),
        ("2-01:30", 178200),
        ("1-00:00:05", 86405),
    ],
)
def test_wall_times(text, seconds):
    assert wall_time(text) == seconds


@pytest.mark.parametrize(
    "text",
    [
        "",
        "0 s",
        "00:00:00",
        "-5 h",
        "1e3 s",
        "inf h",
        "5 weeks",
        "5",
        "1:99:00",
        "1:00:60",
        "30:00",
    ],
)
def test_what_is_no_wall_time(text):
    with pytest.raises(CaseError, match=r"^--walltime: .*; write "):
        wall_time(text)


def test_what_slurm_reads_as_minutes_is_not_taken_for_hours():
    with pytest.raises(CaseError, match="hours or minutes; write 30:00:00 or 30 min"):
        wall_time("30:00")


def test_how_often():
    assert how_often("auto") == "auto"
    assert how_often("off") is None
    assert how_often("12") == 12
    for text in ("", "0", "-1", "1.5", "AUTO", "on", "9" * 10):
        with pytest.raises(CaseError, match=r"--checkpoint: .* is not possible"):
            how_often(text)


class FakeRun:
    """A recorder and checkpoints whose steps and writing take time of a clock of their own."""

    ranks, job = ALONE, None

    def __init__(self, monkeypatch, cost=1.0):
        self.now, self.cost, self.steps, self.written = 0.0, cost, 0, []
        monkeypatch.setattr(keeper, "time", SimpleNamespace(monotonic=lambda: self.now))
        monkeypatch.setattr(keeper, "about", lambda job: {})

    def memory(self, state):
        return {}

    def write(self, step, memory):
        self.now += self.cost
        self.written.append(step)

    def step(self, keep, seconds, passed=0):
        self.steps += 1
        self.now += seconds
        keep(passed, None)


def test_automatic_checkpoints_take_a_twentieth_of_the_time(monkeypatch):
    run = FakeRun(monkeypatch)
    keep = Keeper(run, run)
    for _ in range(100):
        run.step(keep, 5.0)
    assert run.written == [1, *range(5, 101, 4)]  # the first mark, and after 20 s each
    run.step(keep, 0.1, passed=1)
    assert run.written[-1] == 101  # at a mark


def test_checkpoints_after_so_many_steps(monkeypatch):
    run = FakeRun(monkeypatch)
    keep = Keeper(run, run, every=3)
    for _ in range(7):
        run.step(keep, 1.0)
    assert run.written == [3, 6]


@pytest.mark.parametrize("kept", [True, False])
def test_a_run_ends_within_its_wall_time(monkeypatch, kept):
    run = FakeRun(monkeypatch, cost=2.0)
    keep = Keeper(run, run if kept else None, every=1, walltime=100.0)
    for _ in range(9 if kept else 12):
        run.step(keep, 7.0)
    with pytest.raises(StoppedError):
        run.step(keep, 7.0)
    assert run.now <= 100.0 - 7.0  # neither had the next step been too much
    assert run.now >= 100.0 - 3 * 9.0
    assert run.written == ([*range(1, run.steps + 1)] if kept else [])


def test_a_wish_to_stop_is_granted_with_a_checkpoint(monkeypatch):
    run, wanted = FakeRun(monkeypatch), []
    keep = Keeper(run, run, every=10, wanted=lambda: bool(wanted))
    run.step(keep, 1.0)
    keep.check()
    wanted.append(True)
    with pytest.raises(StoppedError):
        run.step(keep, 1.0)
    assert run.written == [2]
    with pytest.raises(StoppedError):
        keep.check()

"""When checkpoints are due and when a run stops, by a clock that the tests hold."""

import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

from restoration import keeper
from restoration.errors import CaseError, CheckpointError, SolveError, StoppedError
from restoration.keeper import Keeper, about, how_often, newest, wall_time
from restoration.ranks import ALONE
from tests.forked import Forked

JOB = SimpleNamespace(sha256="a1")


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("23 h", 82800),
        ("90 min", 5400),
        ("3600 s", 3600),
        ("1.5 d", 129600),
        ("2h", 7200),
        (" 0.5 s ", 0.5),
        ("23:30:15", 84615),
        ("00:00:01", 1),
        ("1-02:03", 93780),
        ("2-00:00:09", 172809),
        ("1000:00:00", 3600000),
    ],
)
def test_wall_times(text, seconds):
    assert wall_time(text) == seconds
    assert type(wall_time(text)) is float


@pytest.mark.parametrize(
    "text",
    [
        "",
        "0 s",
        "0:00:00",
        "-1 h",
        "1",
        "1 y",
        "1  h",
        "h",
        "1 h 30 min",
        "1:2",
        "1:00:00:00",
        "nan s",
    ],
)
def test_what_is_no_wall_time(text):
    with pytest.raises(CaseError, match=r"^--walltime: '.*' is no time; write such as 23 h"):
        wall_time(text)


def test_what_slurm_reads_as_minutes_is_not_taken_for_hours():
    with pytest.raises(CaseError, match="hours or minutes; write 30:00:00 or 30 min"):
        wall_time("30:00")


def test_how_often():
    assert how_often("auto") == "auto"
    assert how_often("off") is None
    assert [how_often(text) for text in ("1", "20", "999999999")] == [1, 20, 999999999]
    for text in ("0", "-1", "1.5", "on", "", "01", "1000000000", "1 step"):
        with pytest.raises(CaseError, match="auto, off or a number of steps is"):
            how_often(text)


class Clock:
    """Tells the time; writing a checkpoint takes ``cost`` of it."""

    def __init__(self, monkeypatch):
        self.now, self.cost = 1000.0, 0.0
        monkeypatch.setattr(keeper, "time", SimpleNamespace(monotonic=lambda: self.now))

    def write(self, step, memory):
        self.now += self.cost
        self.written.append((step, memory))

    written = None


@pytest.fixture
def clock(monkeypatch):
    return Clock(monkeypatch)


class Run:
    """A run that steps as the tests let it."""

    def __init__(self, clock, checkpoints=True, **options):
        self.clock, self.passed, self.asked = clock, 0, False
        clock.written = []
        self.recorder = SimpleNamespace(
            ranks=ALONE, steps=0, job=JOB, memory=lambda state, _: {"state": state}
        )
        self.recorder.checkpoints_s = 0.0
        kept = clock if checkpoints else None
        self.keeper = Keeper(self.recorder, kept, wanted=lambda: self.asked, **options)

    def step(self, seconds=1.0):
        """Make a step, and return whether a checkpoint was written."""
        before = len(self.clock.written)
        self.recorder.steps += 1
        self.clock.now += seconds
        self.keeper(self.passed, f"state {self.recorder.steps}")
        return len(self.clock.written) > before


def test_every_few_steps(clock):
    run = Run(clock, every=3)
    assert [run.step() for _ in range(7)] == [False, False, True, False, False, True, False]
    assert [step for step, _ in clock.written] == [3, 6]
    assert clock.written[1][1] == {"state": "state 6", "passed": 0, "about": about(JOB)}


def test_what_checkpoints_take_is_told(clock):
    run = Run(clock, every=2)
    clock.cost = 1.5
    for _ in range(5):
        run.step()
    assert run.recorder.checkpoints_s == 3.0


def test_every_few_steps_and_at_marks(clock):
    run, written = Run(clock, every=3), []
    for run.passed in (0, 0, 0, 1, 1, 2):
        written.append(run.step())
    assert written == [False, False, True, True, False, True]


def test_a_run_that_goes_on_and_fails_at_once_keeps_the_mark_it_had_passed(clock):
    run = Run(clock, passed=2)
    run.recorder.last = SimpleNamespace(time=5.0)
    run.recorder.memory = lambda state, engine: {"engine": engine}
    error = SolveError("failed")
    error.memory = {"time": 5.0}
    run.keeper.failed(error)
    assert [memory["passed"] for _, memory in clock.written] == [2]


def test_by_itself_one_is_written_as_often_as_it_is_worth(clock):
    run = Run(clock)
    clock.cost = 2.0
    assert run.step()  # the first step, whose cost is not known
    assert not any(run.step(10.0) for _ in range(3))  # 30 s of 40
    assert not run.step(9.99)
    assert run.step(0.01)  # 20 times 2 s since the last one was written
    clock.cost = 1.0
    assert run.step(40.0)
    assert not run.step(19.0)
    assert run.step(1.0)


def test_by_itself_one_is_written_at_every_mark(clock):
    run = Run(clock)
    clock.cost = 100.0
    written = []
    for run.passed in (0, 0, 1, 1, 2):
        written.append(run.step())
    assert written == [True, False, True, False, True]
    assert [memory["passed"] for _, memory in clock.written] == [0, 1, 2]


def test_a_wish_to_stop_is_followed_by_a_checkpoint(clock):
    run = Run(clock, every=100)
    run.step()
    run.keeper.check()
    run.asked = True
    with pytest.raises(StoppedError, match="stopped on request"):
        run.step()
    assert [step for step, _ in clock.written] == [2]
    with pytest.raises(StoppedError, match="stopped on request"):
        run.keeper.check()
    assert len(clock.written) == 1


def test_without_checkpoints_none_is_written(clock):
    run = Run(clock, checkpoints=False)
    assert not run.step()
    run.asked = True
    with pytest.raises(StoppedError):
        run.step()
    assert clock.written == []


@pytest.mark.parametrize("late", [False, True])
def test_a_run_ends_within_its_wall_time(clock, late):
    """After 60 s of 85 there are 25: two of the longest step of 10 s and a checkpoint of 5 s."""
    clock.cost = 5.0
    run = Run(clock, walltime=85.0 - late * 0.01)
    run.step(10.0)  # and the checkpoint: 15 s have passed
    run.step(10.0)
    run.step(4.0)
    for _ in range(3):
        run.step(10.0)
    assert clock.now == 1059.0
    if late:
        with pytest.raises(StoppedError):
            run.step(1.0)
        assert len(clock.written) == 2
        with pytest.raises(StoppedError):
            run.keeper.check()
    else:
        assert not run.step(1.0)
        run.keeper.check()


def test_the_longest_step_counts_not_the_last(clock):
    run = Run(clock, every=1000, walltime=100.0)
    run.step(30.0)
    run.step(5.0)  # 65 s are left, and 60 are needed
    with pytest.raises(StoppedError):
        run.step(6.0)


def of(memory, *notes):
    return SimpleNamespace(folder=Path("run/checkpoints"), newest=lambda: (memory, list(notes)))


def test_a_run_without_checkpoints_begins_without_a_word():
    assert newest(of(None), JOB) == (None, [])


def test_a_run_whose_checkpoints_are_all_damaged_says_so():
    memory, notes = newest(of(None, "one is damaged"), JOB)
    assert memory is None
    assert notes == ["one is damaged", "no checkpoint is whole: the run begins anew"]


def test_the_newest_is_gone_on_from():
    memory = {"about": about(JOB)}
    assert newest(of(memory, "a note"), JOB) == (memory, ["a note"])


def test_one_of_another_case_is_refused():
    memory = {"about": about(SimpleNamespace(sha256="b2"))}
    with pytest.raises(CheckpointError, match=r"run/checkpoints: case_sha256 .* --fresh"):
        newest(of(memory), JOB)


def test_one_of_other_versions_is_taken_with_a_note():
    told = about(JOB)
    name = sorted(told["versions"])[0]
    found = told | {"version": "0.0.9", "versions": told["versions"] | {name: "0.1", "gone": "1"}}
    memory, notes = newest(of({"about": found}), JOB)
    assert memory["about"] is found
    assert notes == [
        f"the checkpoint was written by restoration 0.0.9, now {told['version']}; "
        f"{name} 0.1, now {told['versions'][name]}: last digits may differ"
    ]
    del found["versions"][name]
    assert f"{name} None, now" in newest(of({"about": found}), JOB)[1][0]


def test_a_short_wall_time_is_used(clock):
    """Nothing is known of steps and checkpoints before the first ones."""
    run = Run(clock, every=1000, walltime=1.0)
    for _ in range(7):
        run.step(0.1)
    Keeper(run.recorder, None, walltime=0.01).check()


def test_the_loading_of_libraries_counts(clock):
    """A run that has begun nine seconds ago has one left of ten."""
    run = Run(clock, every=1000, walltime=10.0, began=clock.now - 9.0)
    with pytest.raises(StoppedError):
        run.step(2.0)
    assert len(clock.written) == 1


@pytest.mark.parametrize("gone", [0.0, -5.0])
def test_a_wall_time_that_is_over_already_ends_the_run(clock, gone):
    with pytest.raises(StoppedError):
        Run(clock, walltime=gone).step()


def test_the_age_of_a_process_is_from_its_start():
    begin = time.monotonic()
    command = "import time; time.sleep(0.5); from restoration.keeper import age; print(age())"
    told = subprocess.run([sys.executable, "-c", command], capture_output=True, check=True)
    assert 0.5 <= float(told.stdout) <= time.monotonic() - begin + 0.02  # of a clock that ticks


def test_the_age_of_a_fork_is_its_own(tmp_path):
    def child():
        time.sleep(0.3)
        (tmp_path / "age").write_text(str(keeper.age()))

    Forked(child).wait()
    assert 0.25 < float((tmp_path / "age").read_text()) < 60


def test_nobody_asks_a_run_to_stop_unless_told(clock):
    run = Run(clock)
    Keeper(run.recorder, None)(0, None)

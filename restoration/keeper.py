"""When a run writes checkpoints, and when it stops by itself so as to be gone on with later."""

import os
import re
import time
from pathlib import Path

from restoration import __version__
from restoration.environment import versions
from restoration.errors import CaseError, CheckpointError, StoppedError

SHARE = 20  # a checkpoint is due when so many times as long has passed as one takes to write
MARGIN = 2.0  # longest steps so far that are left to a run within its wall time
CLOCK = re.compile(r"(?:(\d{1,4})-)?(\d{1,4}):([0-5]\d)(?::([0-5]\d))?$")
SECONDS = {"s": 1, "min": 60, "h": 3600, "d": 86400}


def wall_time(text):
    """Return the seconds of a wall time such as ``23 h``, ``90 min``, ``HH:MM:SS``, ``D-HH:MM``.

    Raises:
        CaseError: it is none.
    """
    if clock := CLOCK.match(text.strip()):
        if clock[1] is None and clock[4] is None:  # minutes and seconds to SLURM, hours to others
            raise CaseError(
                f"--walltime: {text!r} may be hours or minutes; write {text.strip()}:00 or "
                f"{clock[2]} min"
            )
        days, hours, minutes, seconds = (int(part or 0) for part in clock.groups())
        found = 86400 * days + 3600 * hours + 60 * minutes + seconds
    else:
        parts = re.fullmatch(r"(\d{1,9}(?:\.\d{1,9})?) ?(s|min|h|d)", text.strip())
        found = float(parts[1]) * SECONDS[parts[2]] if parts else 0
    if not found > 0:
        raise CaseError(
            f"--walltime: {text!r} is no time; write such as 23 h, 90 min, 3600 s or 23:30:00"
        )
    return float(found)


def age():
    """Return how long this process has been there, s: the loading of libraries counts too."""
    fields = Path("/proc/self/stat").read_text().rpartition(")")[2].split()  # from the third on
    return time.clock_gettime(time.CLOCK_BOOTTIME) - int(fields[19]) / os.sysconf("SC_CLK_TCK")


def how_often(text):
    """Return what ``--checkpoint`` asks for: a number of steps, ``auto``, or None for ``off``.

    Raises:
        CaseError: it is none of these.
    """
    if text in ("auto", "off"):
        return None if text == "off" else text
    if re.fullmatch(r"[1-9]\d{0,8}", text):
        return int(text)
    raise CaseError(f"--checkpoint: {text!r} is not possible; auto, off or a number of steps is")


class Keeper:
    """Writes the checkpoints of a run, and ends it where it is to stop.

    Args:
        recorder: `recorder.Recorder`, that knows all of the run.
        checkpoints: `checkpoint.Checkpoints`, or None to write none.
        every: steps between two of them, or ``auto``: whenever twenty times as long has passed as
            one takes to write; in both cases at marks too.
        walltime: after which the run is to have ended, s from ``began`` on, or None.
        wanted: tells whether the run is asked to stop.
        passed: number of the last mark that a run which goes on had passed; None where it begins.
        began: when the run began, of time.monotonic; None for now.
    """

    def __init__(
        self,
        recorder,
        checkpoints,
        every="auto",
        walltime=None,
        wanted=lambda: False,
        passed=None,
        began=None,
    ):
        self._recorder, self._checkpoints, self._every = recorder, checkpoints, every
        self._walltime, self._wanted = walltime, wanted
        self._last = self._written = time.monotonic()
        self._began = self._last if began is None else began
        self._longest = self._cost = 0.0
        self._passed, self._reached = None, passed

    def __call__(self, passed, state):
        """Write a checkpoint if one is due; a task of `run.march` at rest.

        Raises:
            StoppedError: the run is to stop; its checkpoint is written.
        """
        now, ranks = time.monotonic(), self._recorder.ranks
        arrived, self._reached = self._reached not in (None, passed), passed
        self._longest, self._last = max(self._longest, now - self._last), now
        stop = ranks.any(self._wanted() or self._late(now))
        if self._checkpoints and (stop or self._due(passed, arrived, now)):
            self._write(passed, state)
        if stop:
            raise StoppedError("stopped on request")

    def failed(self, error):
        """Write a checkpoint of the state before a step that has failed for good.

        Args:
            error: what ends the run; only one of a step has the memory of that state.
        """
        last, memory = self._recorder.last, getattr(error, "memory", None)
        if self._checkpoints and memory and last and memory["time"] == last.time:
            self._write(self._reached, last, memory)

    def check(self):
        """Raise StoppedError where the run is to stop, and no checkpoint is to be written."""
        now = time.monotonic()
        if self._recorder.ranks.any(self._wanted() or self._late(now)):
            raise StoppedError("stopped on request")

    def _late(self, now):
        if self._walltime is None:
            return False
        left = self._walltime - (now - self._began)
        return left < MARGIN * self._longest + self._cost

    def _due(self, passed, arrived, now):
        if self._every != "auto":
            return arrived or self._recorder.steps % self._every == 0
        due = passed != self._passed or now - self._written >= SHARE * self._cost
        return self._recorder.ranks.same(due)

    def _write(self, passed, state, engine=None):
        recorder, begin = self._recorder, time.monotonic()
        memory = recorder.memory(state, engine) | {"passed": passed, "about": about(recorder.job)}
        recorder.ranks.alone(self._checkpoints.write, recorder.steps, memory)
        self._passed, self._written = passed, time.monotonic()
        self._cost = self._written - begin
        recorder.checkpoints_s += self._cost
        self._last = self._written  # what a checkpoint takes is no part of the next step


def about(job):
    """Return what a checkpoint must agree with to be gone on from."""
    return {"case_sha256": job.sha256, "version": __version__, "versions": versions()}


def newest(checkpoints, job):
    """Return the memory of the newest checkpoint of a job, and notes for the user.

    Args:
        checkpoints: `checkpoint.Checkpoints`.
        job: `run_folder.Job`.

    Returns:
        The memory, None where there is none to go on from, and a list of texts.

    Raises:
        CheckpointError: it is of another case.
    """
    memory, notes = checkpoints.newest()
    if memory is None:
        return None, [*notes, "no checkpoint is whole: the run begins anew"] if notes else []
    found, own = memory["about"], about(job)
    if found["case_sha256"] != own["case_sha256"]:
        raise CheckpointError(
            f"{checkpoints.folder}: case_sha256 is not that of this case; give another --out, or "
            "--fresh to throw the run away"
        )
    before = {"restoration": found["version"]} | found["versions"]
    now = {"restoration": own["version"]} | own["versions"]
    others = [
        f"{name} {before.get(name)}, now {now[name]}"
        for name in now
        if now[name] != before.get(name)
    ]
    if others:
        notes.append(f"the checkpoint was written by {'; '.join(others)}: last digits may differ")
    return memory, notes

"""The march through time, and a whole run with its folder.

`march` knows no physics and no files; what is written is a task it calls.
"""

import fcntl
import hashlib
import json
import os
import signal
import tempfile
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from math import ceil
from pathlib import Path

from restoration.checkpoint import Checkpoints
from restoration.errors import CaseError, OutputError, SolveError, StoppedError
from restoration.keeper import Keeper, newest
from restoration.launch import as_many_as_told
from restoration.retry import stepped
from restoration.stopping import Stopping
from restoration.units import show
from restoration.writing import write_text

STOPPING = signal.SIGINT, signal.SIGTERM, signal.SIGUSR1, signal.SIGHUP
ROUNDING = 1e-9  # of a number of steps, which is a quotient of times
MOST_STEPS = 1_000_000  # to a mark; a flow that needs more is not what the case is about


def next_time(t, mark, stable):
    """Return the next model time on the way from ``t`` to ``mark``, s.

    Raises:
        SolveError: the step would be so short that the mark is out of reach.
    """
    n = abs(mark - t) / stable
    if not n <= MOST_STEPS:
        raise SolveError(
            f"the flow is so fast that {n:.1g} steps of {show(stable, 'time')} lie between "
            f"{show(t, 'time')} and {show(mark, 'time')}, at most {MOST_STEPS} are made; check "
            "viscosities and walls, or set nearer marks"
        )
    n = ceil(n * (1 - ROUNDING))
    return mark if n <= 1 else t + (mark - t) / n


def march(state, engine, plan, every_step=(), at_marks=(), stopping=None, at_rest=(), passed=None):
    """March through the model times of a plan; decreasing marks restore.

    Args:
        state: `State` at the first mark, or where ``passed`` says.
        engine: offers ``stable_step(state, mark)``, ``watch(state)`` and what `retry.stepped` asks
            for.
        plan: `scene.TimePlan`.
        every_step: functions of the state before and after a step.
        at_marks: functions of the number of the mark and the state there, from the first mark on.
        stopping: `stopping.Stopping` that may end the march; where it does is its last mark.
        at_rest: functions of the number of the last mark passed and the state, when all else of a
            step, or of the mark it has led to, is done: the march can go on from there.
        passed: number of the last mark that a march which goes on from there had passed; None where
            it begins.

    Returns:
        The state at the last mark.
    """
    stopping = stopping or Stopping()
    if passed is None:
        passed, state = 0, engine.with_flow(state)
        engine.watch(state)
        stopping.begin(state)
        for task in (*at_marks, *at_rest):
            task(0, state)
    for number, mark in enumerate(plan.marks[passed + 1 :], start=passed + 1):
        if stopping.over:
            break
        way = abs(mark - plan.marks[number - 1])
        longest = way / plan.min_steps
        while state.time != mark and not stopping.over:
            before = state
            until = next_time(state.time, mark, min(engine.stable_step(state, mark), longest))
            state = stepped(engine, before, until, least=way / MOST_STEPS)
            state = stopping.landed(engine, before, state)
            for task in every_step:
                task(before, state)
            if state.time != mark and not stopping.over:
                for task in at_rest:
                    task(number - 1, state)
        for task in (*at_marks, *at_rest):
            task(number, state)
    return state


@dataclass(frozen=True)
class Job:
    """A case and where its run goes.

    Attributes:
        path: the case file.
        case_text: its text as given.
        resolved: text of the resolved case.
        scene: `scene.Scene`.
        out: run folder; None for ``runs/<case>-<hash8>`` in the working folder.
        fresh: whether an earlier run in the folder is thrown away.
        prove: whether the restored section is moved forward again; no part of the case.
        checkpoint: steps between two checkpoints, ``auto``, or None for none.
        walltime: after which the run is to have ended, s; None for no matter.
    """

    path: Path
    case_text: str
    resolved: str
    scene: object
    out: Path | None = None
    fresh: bool = False
    prove: bool = False
    checkpoint: int | str | None = "auto"
    walltime: float | None = None

    @property
    def sha256(self):
        """Hash of the resolved case: two runs of one hash answer the same question."""
        return hashlib.sha256(self.resolved.encode()).hexdigest()

    @property
    def folder(self):
        """Where the run goes."""
        if self.out is not None:
            return Path(self.out)
        name = self.path.parent.name if self.path.stem == "case" else self.path.stem
        return Path("runs") / f"{name or 'case'}-{self.sha256[:8]}"


def prepare_folder(job):
    """Make the run folder, or clear it of an earlier run of this tool that is not gone on with.

    Returns:
        The folder; None where a run of this very case has ended well in it already.

    Raises:
        CaseError: the folder holds something else.
        OutputError: it cannot be made.
    """
    folder = job.folder
    try:
        if folder.exists() and not (folder.is_dir() and _hardly_begun(folder)):
            earlier = _earlier(folder)
            if earlier is None:
                raise CaseError(f"{folder}: is not a run folder and not empty; give another --out")
            if not job.fresh and earlier != (job.sha256, True):
                if earlier[0] != job.sha256:
                    raise CaseError(
                        f"{folder}: holds the run of another case; give another --out, or --fresh "
                        "to throw it away"
                    )
            elif not job.fresh:
                return None
            if job.fresh or not any(folder.glob("checkpoints/step-*.h5")):
                clear(folder)
        _lay_out(job)
    except OSError as error:
        raise OutputError(f"{folder}: {error.strerror}; give another --out") from error
    return folder


def _lay_out(job):
    """Make the folders of a run, and write the case."""
    job.folder.mkdir(parents=True, exist_ok=True)
    write_text(job.folder / "resolved.yaml", job.resolved)  # the first one: see `_hardly_begun`
    write_text(job.folder / "case.yaml", job.case_text)
    for name in ("figures", "horizons"):
        (job.folder / name).mkdir(exist_ok=True)


def _hardly_begun(folder):
    """Return whether a folder is empty, or was when a run that was cut short began in it."""
    return {path.name for path in folder.iterdir()} <= {
        ".resolved.yaml.tmp",
        "resolved.yaml",
        ".case.yaml.tmp",
    }


# What a run leaves in its folder, beside the case. Checkpoints first: if it is killed while these
# files are removed nothing may go on with what is left.
RUN_FILES = (
    "checkpoints/step-*.h5",
    "checkpoints/kept-*.h5",
    "checkpoints/latest.json",
    "run.json",
    "diagnostics.csv",
    "log.txt",
    "fields*.xdmf",
    "fields*.h5",
    "particles*.xdmf",
    "particles*.h5",
    "horizons*.xdmf",
    "horizons*.h5",
    "figures/section-*.png",
    "figures/strip.png",
    "figures/there-and-back.png",
    "figures/certificate.png",
    "certificate.md",
    "figures/flatness.png",
    "failure/facts.json",
    "failure/step-*.h5",
    "failure/latest.json",
    "horizons/[0-9]*-*.geojson",
)


def _earlier(folder):
    """Return hash and good end of the run in a folder; None if it is no run folder."""
    if not (folder / "resolved.yaml").is_file() or not (folder / "case.yaml").is_file():
        return None
    sha = hashlib.sha256((folder / "resolved.yaml").read_bytes()).hexdigest()
    try:
        return sha, bool(json.loads((folder / "run.json").read_text())["ended_well"])
    except (OSError, ValueError, KeyError, TypeError):
        return sha, False


def _proved(folder):
    """Return whether the run in a folder has a proof."""
    return bool(json.loads((folder / "run.json").read_text()).get("proof"))


def clear(folder):
    """Remove what a run leaves, and nothing else."""
    for pattern in RUN_FILES:
        for path in folder.glob(pattern):
            path.unlink()


@contextmanager
def locked(folder, what="run", patience=0.0):
    """Keep other runs out of a run folder as long as this one works in it.

    Args:
        folder: pathlib.Path of it.
        what: works in it, for the message.
        patience: seconds to wait for one that is about to end.

    Yields:
        The lock, an open file: a child that inherits it keeps the folder as long as it lives.

    Raises:
        CaseError: another run is at work in it.
    """
    name = hashlib.sha256(os.fsencode(os.path.realpath(folder))).hexdigest()[:16]
    path = Path(tempfile.gettempdir()) / f"restore-{os.getuid()}-{name}.lock"
    limit = time.monotonic() + patience
    # where all may write, a link of this name would lead to a file of somebody else
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC, 0o600)
    with os.fdopen(descriptor, "w") as lock:
        while True:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                if time.monotonic() >= limit:
                    raise CaseError(
                        f"{folder}: another {what} is at work in it; give another --out"
                    ) from None
            time.sleep(0.05)
        yield lock


class StopRequest:
    """Turns Ctrl-C, SIGTERM, SIGUSR1 and SIGHUP into a wish that is granted after the step.

    What is ignored already stays so: under nohup a run outlives its terminal. A second Ctrl-C ends
    at once. Programs that start ranks hand SIGUSR1 on to them, not the others.
    """

    def __init__(self):
        self.wanted = False
        self._before = {}

    def __enter__(self):
        if self._before:
            return self
        heard = [s for s in STOPPING if signal.getsignal(s) != signal.SIG_IGN or s != signal.SIGHUP]
        self._before = {s: signal.signal(s, self._ask) for s in heard}
        return self

    def listen(self):
        """Hear again what PETSc, once it is loaded, has taken; a reader who goes ends no run."""
        for number in self._before:
            signal.signal(number, self._ask)
        signal.signal(signal.SIGPIPE, signal.SIG_IGN)

    def __exit__(self, *_):
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before = {}

    def _ask(self, number, _frame):
        if self.wanted and number == signal.SIGINT:
            raise KeyboardInterrupt
        self.wanted = True


def _recorder(job, folder, progress, memory):
    """Return what writes the run folder; it loads dolfinx, which only a run needs."""
    if job.scene.dim == 3:
        from restoration.box_recorder import BoxRecorder

        return BoxRecorder(job, folder, progress, memory)
    from restoration.recorder import Recorder

    return Recorder(job, folder, progress, memory)


def _went_before(job, checkpoints):
    """Return the memory that a job goes on from, or None, and notes on it."""
    memory, notes = newest(checkpoints, job)
    if memory is None and notes:
        clear(job.folder)
    return memory, notes


def run_job(job, progress=None, stop=None):
    """Run a job: set up, march, write; leave the record whatever happens.

    Args:
        job: `Job`.
        progress: `Progress` to tell the user; None is silent.
        stop: a `StopRequest` that listens already; None makes one for the run.

    Returns:
        The record (a dict) and the run folder. The record of an earlier run that ended well is
        returned unread as None.

    Raises:
        RestorationError: with the exit code; the folder then holds what was reached.
    """
    from restoration.ranks import world  # loads MPI: only a run needs it

    ranks = world()
    as_many_as_told(ranks.size)

    def check(*_):
        if ranks.any(stop.wanted):
            raise StoppedError("stopped on request")

    with stop or StopRequest() as stop, ExitStack() as locks:
        ranks.alone(lambda: locks.enter_context(locked(job.folder)))
        folder = ranks.same(ranks.alone(prepare_folder, job))
        if folder is None:
            if job.prove and not ranks.same(ranks.alone(_proved, job.folder)):
                raise CaseError(
                    f"{job.folder}: holds this very run, without a proof; --fresh --prove runs it "
                    "again with one"
                )
            return None, job.folder
        check()
        checkpoints = Checkpoints(folder / "checkpoints")
        memory, notes = ranks.same(ranks.alone(_went_before, job, checkpoints))
        recorder = _recorder(job, folder, progress, memory)
        stop.listen()
        kept = checkpoints if job.checkpoint else None
        passed = memory and memory["passed"]
        every, walltime = job.checkpoint, job.walltime
        keeper = Keeper(recorder, kept, every, walltime, lambda: stop.wanted, passed)
        try:
            for note in notes:
                recorder.say(note)
            recorder.begin()
            check()
            march(
                recorder.start(),
                recorder.engine,
                job.scene.time,
                every_step=(recorder.step,),
                at_marks=(recorder.mark,),
                stopping=recorder.stopping,
                at_rest=(keeper,),
                passed=passed,
            )
            recorder.compare()
            recorder.certify(march, keeper.check)
            if job.prove:
                recorder.prove(march, keeper.check)
        except StoppedError as stopped:
            recorder.end(stopped)
            raise StoppedError(f"stopped on request {recorder.reached()}; {_later(job)}") from None
        except BaseException as error:
            try:
                keeper.failed(error)
            finally:
                recorder.end(error)
            raise
        record = recorder.end()
        ranks.alone(_tidy, checkpoints)
        return record, folder


def _tidy(checkpoints):
    """Remove what a run that has ended well does not need, nor what failed in it before."""
    checkpoints.clear()
    failure = checkpoints.folder.with_name("failure")
    (failure / "facts.json").unlink(missing_ok=True)
    Checkpoints(failure).clear()


def _later(job):
    """Return what becomes of a run that was stopped."""
    if job.checkpoint:
        return "the same command goes on from here"
    there = any(job.folder.glob("checkpoints/step-*.h5"))
    return "it goes on from its last checkpoint" if there else "it begins anew"

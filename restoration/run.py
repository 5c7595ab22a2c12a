"""The march through time, and a whole run with its folder.

`march` knows no physics and no files; what is written is a task it calls.
"""

import time
from contextlib import ExitStack, suppress
from math import ceil

from restoration.checkpoint import Checkpoints
from restoration.errors import CaseError, OutputError, SolveError, StoppedError
from restoration.keeper import Keeper, newest
from restoration.launch import as_many_as_told
from restoration.retry import stepped
from restoration.run_folder import claim, clear, proved
from restoration.stop_request import StopRequest
from restoration.stopping import Stopping
from restoration.units import show
from restoration.writing import disk_faults

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
    began = time.monotonic()
    from restoration.ranks import world  # loads MPI: only a run needs it

    ranks = world()
    as_many_as_told(ranks.size)

    def check(*_):
        if ranks.any(stop.wanted):
            raise StoppedError("stopped on request")

    with stop or StopRequest() as stop, ExitStack() as locks:
        folder = ranks.same(ranks.alone(claim, job, locks))
        checkpoints = Checkpoints(job.folder / "checkpoints")
        if folder is None:
            _look_back(job, ranks, checkpoints)
            return None, job.folder
        check()
        memory, notes = ranks.same(ranks.alone(_went_before, job, checkpoints))
        recorder = _recorder(job, folder, progress, memory)
        stop.listen()
        kept = checkpoints if job.checkpoint else None
        passed = memory and memory["passed"]
        every, walltime = job.checkpoint, job.walltime
        keeper = Keeper(recorder, kept, every, walltime, lambda: stop.wanted, passed, began)
        try:
            for note in notes:
                recorder.say(note)
            recorder.begin()
            check()
            _carry_out(job, recorder, keeper, passed)
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


def _carry_out(job, recorder, keeper, passed):
    """March to the last mark, then compare, certify and prove what was found."""
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


def _look_back(job, ranks, checkpoints):
    """Do for a run that has ended well what it may have been killed before.

    Raises:
        CaseError: a proof is asked for, and it has none.
    """

    def tidy():
        with suppress(OutputError):  # a result may lie where nothing can be changed
            _tidy(checkpoints)

    ranks.alone(tidy)
    if job.prove and not ranks.same(ranks.alone(proved, job.folder)):
        raise CaseError(
            f"{job.folder}: holds this very run, without a proof; --fresh --prove runs it again "
            "with one"
        )


def _tidy(checkpoints):
    """Remove what a run that has ended well does not need, nor what failed in it before."""
    checkpoints.clear()
    failure = checkpoints.folder.with_name("failure")
    with disk_faults(failure / "facts.json"):
        (failure / "facts.json").unlink(missing_ok=True)
    Checkpoints(failure).clear()


def _later(job):
    """Return what becomes of a run that was stopped."""
    if job.checkpoint:
        return "the same command goes on from here"
    there = any(job.folder.glob("checkpoints/step-*.h5"))
    return "it goes on from its last checkpoint" if there else "it begins anew"

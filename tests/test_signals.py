"""Signals at any moment of a run: it stops after the step, and goes on as if it had not."""

import os
import signal

import pytest

from restoration import grid, mesher, recorder, step, stokes
from restoration.errors import StoppedError
from tests.forked import Forked
from tests.test_kills import ends, job, no_pictures, run, shortest, two_steps

pytestmark = [pytest.mark.slow, pytest.mark.torture]
__all__ = ["no_pictures", "two_steps"]  # fixtures

# Where a signal comes: the function, and at which of its calls.
MOMENTS = {
    "mesh": (mesher, "section_mesh", 1),
    "forms": (grid, "Spaces", 1),
    "assemble": (stokes.StokesProblem, "assemble", 4),
    "solve": (stokes.StokesProblem, "solve", 3),
    "advect": (step.Step, "_located", 2),
    "write": (recorder.Recorder, "_write_frame", 1),
}


def asked_at(moment, number, folder, ignored=False):
    """Run a job that is sent a signal at a moment, and return the exit code."""
    owner, name, call = MOMENTS[moment]
    made, calls = getattr(owner, name), []

    def called(*arguments, **options):
        calls.append(1)
        if len(calls) == call:
            os.kill(os.getpid(), number)
        return made(*arguments, **options)

    setattr(owner, name, called)
    if number == signal.SIGHUP and not ignored:  # the tests may have been started under nohup
        signal.signal(number, signal.SIG_DFL)
    code = run(job(folder, shortest()))
    assert len(calls) >= call
    return code


@pytest.mark.parametrize("moment", MOMENTS)
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGUSR1, signal.SIGHUP])
def test_a_run_that_is_asked_to_stop_goes_on_as_if_it_had_not(two_steps, tmp_path, moment, number):
    scene, end, _ = two_steps
    stopped = Forked(lambda: asked_at(moment, number, tmp_path / "run")).wait()
    assert stopped == StoppedError.exit_code
    assert Forked(lambda: run(job(tmp_path / "run", scene))).wait() == 0
    assert ends(tmp_path / "run") == end


@pytest.mark.parametrize("moment", MOMENTS)
def test_a_pipe_that_breaks_stops_no_run(two_steps, tmp_path, moment):
    _, end, _ = two_steps
    assert Forked(lambda: asked_at(moment, signal.SIGPIPE, tmp_path / "run")).wait() == 0
    assert ends(tmp_path / "run") == end


def test_under_nohup_a_run_outlives_its_terminal(two_steps, tmp_path):
    _, end, _ = two_steps

    def unheard():
        signal.signal(signal.SIGHUP, signal.SIG_IGN)
        return asked_at("solve", signal.SIGHUP, tmp_path / "run", ignored=True)

    assert Forked(unheard).wait() == 0
    assert ends(tmp_path / "run") == end

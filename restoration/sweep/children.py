"""Child processes: so many at a time, each told as it ends, all ended with this one."""

import os
import signal
import subprocess
import tempfile
import time
from collections import deque
from dataclasses import dataclass

from restoration.launch import child_environment, end_with_parent

EVERY = 0.1  # s, between two looks at children
LONGEST = 2000  # characters of what a child has said that are kept
QUIETLY = ("warning: ", "note: ")  # beginnings of what a child says that is no error


@dataclass(frozen=True)
class Ended:
    """How a child ended.

    Attributes:
        code: its exit code; 128 and the number of the signal that ended it, as shells have it.
        error: one line that tells why; empty where all went well.
        wall_s: seconds it took.
    """

    code: int
    error: str
    wall_s: float


class Child:
    """A process that runs a command with one thread.

    Args:
        command: list of texts.
        held: descriptors of files that it keeps open.

    Attributes:
        process: subprocess.Popen.
        said: file of what it has told as errors.
    """

    def __init__(self, command, held=()):
        self._began = time.monotonic()
        self.said = tempfile.TemporaryFile()
        self.process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=self.said,
            env=child_environment(one_thread=True),
            start_new_session=True,  # Ctrl-C is for the parent, which hands it on once
            pass_fds=held,
            preexec_fn=end_with_parent,
        )

    def ended(self):
        """Return how it `Ended`, or None where it goes on."""
        code = self.process.poll()
        if code is None:
            return None
        with self.said:
            self.said.seek(0)
            text = self.said.read().decode(errors="replace")
        wall_s = time.monotonic() - self._began
        if code < 0:
            return Ended(128 - code, signal_text(-code), wall_s)
        return Ended(code, error_line(text) if code else "", wall_s)


def signal_text(number):
    """Return in words that a signal has ended a process."""
    try:
        name = signal.Signals(number).name
    except ValueError:
        name = f"signal {number}"
    why = "; perhaps out of memory" if number == signal.SIGKILL else ""
    return f"ended by {name}{why}"


def error_line(text):
    """Return the line that tells the error: the first, of a traceback the last."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    lines = [line for line in lines if not line.startswith(QUIETLY)]
    if not lines:
        return "ended without a word"
    traced = any(line.startswith("Traceback") for line in lines)
    return (lines[-1] if traced else lines[0])[:LONGEST]


def run_children(jobs, command, workers, stop, held=()):
    """Run a command for every job, and yield each job and how it `Ended`, as they do.

    Once a stop is wanted none begins any more, and all are asked to end by SIGTERM. They are
    waited for; a KeyboardInterrupt then ends them at once. So they are where the caller closes
    the generator before its end.

    Args:
        jobs: what to run, in this order.
        command: function of a job that returns the command, a list of texts.
        workers: number of children at a time.
        stop: `stop_request.StopRequest`, or any with an attribute ``wanted``.
        held: descriptors of files that children keep open.
    """
    waiting, alive, asked = deque(jobs), {}, False
    try:
        while alive or (waiting and not stop.wanted):
            while waiting and len(alive) < workers and not stop.wanted:
                job = waiting.popleft()
                alive[Child(command(job), held)] = job
            if stop.wanted and not asked:
                asked = True
                _ask(alive)
            over = [(child, ended) for child in alive if (ended := child.ended())]
            for child, ended in over:
                yield alive.pop(child), ended
            if not over:
                time.sleep(EVERY)
    except KeyboardInterrupt:
        for child in alive:
            child.process.kill()
        raise
    finally:
        _end(alive)


def _end(children):
    """Ask children to end, and wait until they have."""
    _ask(children)
    try:
        for child in children:
            child.process.wait()
    except KeyboardInterrupt:
        for child in children:
            child.process.kill()
        raise
    finally:
        for child in children:
            child.said.close()


def _ask(children):
    """Ask children to end after their step."""
    for child in children:
        if child.process.poll() is None:
            os.kill(child.process.pid, signal.SIGTERM)

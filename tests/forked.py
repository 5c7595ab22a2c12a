"""Runs in processes of their own, forked so that nothing is loaded anew, to be killed by tests."""

import os
import signal
import time
import traceback
from contextlib import suppress

FAULT = 99  # exit code of what escapes from the function


class Forked:
    """A call in a process of its own.

    Args:
        function: called there without arguments; its return value is the exit code.
    """

    def __init__(self, function):
        self.pid = os.fork()
        if self.pid == 0:
            try:
                os._exit(function() or 0)
            except BaseException:
                traceback.print_exc()
            finally:
                os._exit(FAULT)

    def wait(self, seconds=120.0):
        """Return the exit code, negative where a signal ended it; kill it after a time."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            if pid:
                return os.waitstatus_to_exitcode(status)
            time.sleep(0.002)
        self.kill()
        raise TimeoutError(f"still running after {seconds:.0f} s")

    def send(self, number):
        """Send it a signal."""
        with suppress(ProcessLookupError):
            os.kill(self.pid, number)

    def kill(self):
        """Kill it, and wait until it is gone."""
        self.send(signal.SIGKILL)
        with suppress(ChildProcessError):
            os.waitpid(self.pid, 0)

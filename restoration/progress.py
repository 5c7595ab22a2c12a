"""What a run tells its user while it works."""

import sys
import time


class Progress:
    """One line that is rewritten on a terminal, plain lines elsewhere.

    Args:
        stream: where to; standard error by default.
        every: seconds between plain lines.
    """

    def __init__(self, stream=None, every=10.0):
        self.stream = stream or sys.stderr
        self.terminal = self.stream.isatty()
        self.every = every
        self._last = -1e9
        self._width = 0

    def update(self, line):
        """Show the state of the run, at most every so often."""
        now = time.monotonic()
        if now - self._last < (0.2 if self.terminal else self.every):
            return
        self._last = now
        if self.terminal:
            self.stream.write("\r" + line.ljust(self._width))
            self._width = len(line)
        else:
            self.stream.write(line + "\n")
        self.stream.flush()

    def say(self, line):
        """Print a line that stays."""
        if self.terminal and self._width:
            self.stream.write("\r" + " " * self._width + "\r")
            self._width = 0
        self.stream.write(line + "\n")
        self.stream.flush()

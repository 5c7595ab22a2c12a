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
            self._put("\r" + line.ljust(self._width))
            self._width = len(line)
        else:
            self._put(line + "\n")

    def say(self, line):
        """Print a line that stays."""
        if self.terminal and self._width:
            self._put("\r" + " " * self._width + "\r")
            self._width = 0
        self._put(line + "\n")

    def _put(self, text):
        """Write at once; where nobody reads any more, a run goes on and its log has it all."""
        if self.stream is None:
            return
        try:
            self.stream.write(text)
            self.stream.flush()
        except OSError:  # a broken pipe, or a terminal that was closed
            self.stream = None

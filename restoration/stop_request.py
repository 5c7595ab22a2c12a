"""How a run is asked to stop: the signals it hears."""

import signal

STOPPING = signal.SIGINT, signal.SIGTERM, signal.SIGUSR1, signal.SIGHUP


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

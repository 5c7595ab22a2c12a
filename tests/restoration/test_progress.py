import io

import pytest

from restoration.progress import Progress


class Terminal(io.StringIO):
    def isatty(self):
        return True


def test_a_terminal_has_one_line_that_is_rewritten(monkeypatch):
    now = iter(range(0, 100, 10))
    monkeypatch.setattr("time.monotonic", lambda: next(now))
    stream = Terminal()
    progress = Progress(stream)
    progress.update("step 1 of many")
    progress.update("step 2")
    progress.say("done")
    assert stream.getvalue().split("\r") == [
        "",
        "step 1 of many",
        "step 2        ",
        " " * 6,
        "done\n",
    ]


@pytest.mark.parametrize(("every", "shown"), [(0.0, 5), (1e9, 1)])
def test_elsewhere_plain_lines_come_now_and_then(every, shown):
    stream = io.StringIO()
    progress = Progress(stream, every)
    for step in range(5):
        progress.update(f"step {step}")
    progress.say("done")
    assert stream.getvalue().splitlines() == [f"step {k}" for k in range(shown)] + ["done"]


def test_a_reader_who_goes_stops_nothing():
    class Closed(io.StringIO):
        def write(self, text):
            raise BrokenPipeError

    progress = Progress(Closed())
    progress.say("one")
    progress.update("two")
    progress.say("three")

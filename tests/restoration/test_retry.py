"""Steps that fail are taken anew, shorter, from the state before them."""

from types import SimpleNamespace

import numpy as np
import pytest

from restoration.errors import MeshError, ParticleError, SolveError, TooLargeError
from restoration.retry import MOST_HALVINGS, stepped
from restoration.units import MYR


class Engine:
    """Goes where it is told, unless the step is longer than one that succeeds, s."""

    def __init__(self, succeeds=np.inf, error=None, by="advance"):
        self.succeeds, self.error, self.by = succeeds, error or MeshError("a cell; or so"), by
        self.longest, self.retried, self.notes = np.inf, 3, ["before"]
        self.tried, self.state, self.asked = [], None, []

    def _fail(self, by, state):
        if by == self.by and abs(state.time - state.before) > self.succeeds:
            raise self.error

    def advance(self, state, until):
        assert state.whole
        self.tried.append(until)
        self.state = SimpleNamespace(time=until, before=state.time, whole=False)
        self.retried += 100  # which must not last where the step fails
        self._fail("advance", self.state)
        return self.state

    def with_flow(self, state):
        self._fail("flow", state)
        state.whole = True
        return state

    def guard(self, state):
        assert state.whole
        self._fail("guard", state)

    def memory(self, state, gather=True):
        self.asked.append(gather)
        return {"time": state.time, "gathered": gather}

    def gathered(self, memory):
        return memory | {"gathered": True}

    def recalled(self, memory):
        return at(memory["time"])

    def facts(self):
        return {"tried": len(self.tried)}


def at(time):
    return SimpleNamespace(time=time, before=None, whole=True)


def test_a_step_that_succeeds_is_the_step():
    engine = Engine()
    engine.longest = 50.0
    assert stepped(engine, at(100.0), 140.0).time == 140.0
    assert (engine.tried, engine.retried, engine.notes) == ([140.0], 3, ["before"])
    assert engine.longest == 100.0  # twice as long as the longest that is known to succeed


def test_the_longest_step_grows_with_the_step():
    engine = Engine()
    engine.longest = 10.0
    stepped(engine, at(0.0), -30.0)
    assert engine.longest == 60.0


@pytest.mark.parametrize("by", ["advance", "flow", "guard"])
@pytest.mark.parametrize(
    "error", [MeshError("a cell"), ParticleError("a cell"), SolveError("a cell")]
)
@pytest.mark.parametrize("sign", [1, -1])
def test_a_step_that_fails_is_halved(by, error, sign):
    engine = Engine(0.3 * MYR, error, by)
    end = stepped(engine, at(MYR), MYR + sign * MYR)
    assert engine.tried == [MYR + sign * MYR, MYR + sign * 0.5 * MYR, MYR + sign * 0.25 * MYR]
    assert end.time == engine.tried[-1]
    assert engine.retried == 5
    assert engine.longest == 0.5 * MYR
    told = "1 Myr" if sign > 0 else "-1 Myr"
    half = "500 kyr" if sign > 0 else "-500 kyr"
    assert engine.notes == [
        "before",
        f"a step of {told} has failed: a cell; taken anew with half",
        f"a step of {half} has failed: a cell; taken anew with half",
    ]


def test_the_shortest_step_is_the_256th_part():
    engine = Engine(MYR / 256)
    assert stepped(engine, at(0.0), MYR).time == MYR / 256
    assert len(engine.tried) == MOST_HALVINGS + 1


@pytest.mark.parametrize("error", [ParticleError("one; two"), SolveError("one; two")])
def test_where_all_fail_the_error_tells_and_has_the_state_before(error):
    engine = Engine(MYR / 300, error)
    with pytest.raises(type(error)) as caught:
        stepped(engine, at(5.0), 5.0 + MYR)
    assert str(caught.value) == ("one; two; shorter steps, down to 3.91 kyr, have failed too")
    assert caught.value.__cause__ is error
    assert caught.value.memory == {"time": 5.0, "gathered": True}
    assert caught.value.facts == {"tried": 9}
    assert len(engine.tried) == 9
    assert engine.asked == [False]  # no rank sends its particles before a step has failed for good


def test_what_does_not_fit_into_memory_is_not_tried_again():
    engine = Engine(0.0, TooLargeError("too large"))
    with pytest.raises(TooLargeError):
        stepped(engine, at(0.0), MYR)
    assert len(engine.tried) == 1


def test_a_bug_is_no_failure_of_a_step():
    engine = Engine(0.0, ZeroDivisionError())
    with pytest.raises(ZeroDivisionError):
        stepped(engine, at(0.0), MYR)
    assert len(engine.tried) == 1

"""A step that fails is taken anew with half its length, from the whole state before it."""

from restoration.errors import MeshError, SolveError, TooLargeError
from restoration.units import show

MOST_HALVINGS = 8  # of one step
GROWTH = 2.0  # of the step after one that was shortened and has succeeded


def stepped(engine, state, until, least=0.0):
    """Return the state after a step towards a time, which may be shorter than asked for.

    After a failure the engine is what it was before: mesh, particles, lines, factors and counts.

    Args:
        engine: offers ``advance(state, until)``, ``with_flow(state)``, ``guard(state)``,
            ``memory(state, gather)``, ``recalled(memory)``, ``gathered(memory)`` and ``facts()``;
            has ``longest``, ``retried`` and ``notes``.
        state: with its flow.
        until: model time, s.
        least: no shorter step is tried, s; positive.

    Raises:
        SolveError, MeshError: a step of the 256th part, or one as short as may be, has failed too.
            The error has the memory of the state before, and the facts of the last matrix.
        TooLargeError: at once: a shorter step needs no less memory.
    """
    begin, retried, first, notes = state.time, engine.retried, until - state.time, []
    memory = engine.memory(state, gather=False)
    for halvings in range(MOST_HALVINGS + 1):
        dt = first / 2**halvings
        try:
            after = engine.with_flow(engine.advance(state, until if not halvings else begin + dt))
            engine.guard(after)
        except TooLargeError:
            raise
        except (SolveError, MeshError) as error:
            over = halvings == MOST_HALVINGS or abs(dt) / 2 < least
            failure, facts = error, engine.facts() if over else None
            notes.append(f"a step of {show(dt, 'time')} has failed: {error}; taken anew with half")
            state = engine.recalled(memory)
            if over:
                break
            continue
        engine.retried, engine.notes = retried + halvings, [*engine.notes, *notes]
        longest = abs(dt) if halvings else max(abs(dt), engine.longest)
        engine.longest = GROWTH * longest
        return after
    ended = type(failure)(f"{failure}; shorter steps, down to {show(dt, 'time')}, have failed too")
    ended.memory, ended.facts = engine.gathered(memory), facts
    raise ended from failure

"""An engine rebuilt from the memory of another goes on bit for bit as that one does."""

import numpy as np
import pytest

from restoration.box_engine import BoxEngine
from restoration.checkpoint import packed, unpacked
from restoration.engine import StokesEngine
from restoration.run import march
from tests.mpi_runs import SCENES

EVERY = 2  # steps, after which one is rebuilt


def engine_of(scene):
    return (BoxEngine if scene.dim == 3 else StokesEngine)(scene)


def arrays_of(memory):
    """Return all that a memory holds but wall times, as one text or array after another."""
    if isinstance(memory, dict):
        return [x for key, v in memory.items() if key != "seconds" for x in arrays_of(v)]
    if isinstance(memory, (list, tuple)):
        return [x for v in memory for x in arrays_of(v)]
    return [memory.tobytes() if isinstance(memory, np.ndarray) else repr(memory)]


@pytest.mark.parametrize("name", SCENES)
def test_a_rebuilt_engine_goes_on_bit_for_bit(name):
    scene = SCENES[name]()
    rests, engine = [], engine_of(scene)

    def rest(passed, state):
        rests.append((passed, packed(engine.memory(state))))

    march(engine.start(), engine, scene.time, at_rest=(rest,))
    last = arrays_of(unpacked(rests[-1][1], "last"))
    for passed, content in [rests[len(rests) * share // 4] for share in (0, 1, 2, 3)]:
        memory = unpacked(content, "memory")
        other = engine_of(scene)
        state = other.recalled(memory)
        assert arrays_of(unpacked(packed(other.memory(state)), "again")) == arrays_of(memory)
        end = march(state, other, scene.time, passed=passed)
        assert arrays_of(unpacked(packed(other.memory(end)), "end")) == last

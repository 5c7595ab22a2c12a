"""An engine rebuilt from the memory of another goes on bit for bit as that one does."""

import numpy as np
import pytest

from restoration.box_engine import BoxEngine
from restoration.checkpoint import packed, unpacked
from restoration.engine import StokesEngine
from restoration.run import march
from restoration.scene import Air, MeshPlan, RefinePlan, SurfacePlan, TimePlan, Transfer
from tests.mpi_runs import SCENES
from tests.restoration.conftest import MYR, diapir_scene
from tests.restoration.test_free_surface import FREE, GAMMA, free_scene, hill


def diapir(**plans):
    """Return the diapir of two viscosities, back and forth in a few steps."""
    time = TimePlan((0.0, -0.2 * MYR, 0.0), "rk4", 1.0, 3)
    return diapir_scene(**{"cells": (8, 9), "viscosity": (1e18, 1e20), "time": time} | plans)


def below_a_hill(plan, **plans):
    """Return the diapir below a free surface, back and forth."""
    walls = diapir_scene().walls | {"surface": FREE}
    time = TimePlan((0.0, -8 / GAMMA, 0.0), "midpoint", 1.0, 6)
    plans = {"walls": walls, "outline": hill(50.0), "time": time} | plans
    return diapir(surface=plan, **plans)


MORE = {
    "slaved modes": lambda: below_a_hill(SurfacePlan(reverse="slave")),
    "slaved modes, one viscosity": lambda: below_a_hill(
        SurfacePlan(reverse="slave"),
        viscosity=(1e19, 1e19),
        time=TimePlan((0.0, -1 / GAMMA), "midpoint", 1.0, 6),
    ),
    "stabilised": lambda: below_a_hill(SurfacePlan(theta=0.5, motion="normal")),
    "one rock, forward and back": lambda: free_scene(steps=4, end=0.5),
    "air": lambda: below_a_hill(
        SurfacePlan(air=Air(2000.0, 1.0, 1e17)),
        time=TimePlan((0.0, 0.4 / GAMMA), "midpoint", 1.0, 4),
    ),
    "fitted below a free surface": lambda: below_a_hill(
        SurfacePlan(), mesh=MeshPlan(interfaces="fitted")
    ),
    "left to particles": lambda: diapir(
        mesh=MeshPlan(interfaces="auto"), time=TimePlan((0.0, 3 * MYR), "midpoint", 2.0, 4)
    ),
    "steps by their error": lambda: diapir(
        time=TimePlan((0.0, -0.6 * MYR), "rk3", 1.0, 3, tolerance=1.0)
    ),
    "refined in every third step": lambda: diapir(
        mesh=MeshPlan(refine=RefinePlan(1, ("interfaces",), 3)),
        time=TimePlan((0.0, -0.3 * MYR), "midpoint", 1.0, 7),
    ),
    "squares": lambda: diapir(mesh=MeshPlan(element="Q2-P1dg")),
    "split triangles": lambda: diapir(mesh=MeshPlan(element="P2-P1dg", interfaces="fitted")),
    "moments": lambda: diapir(transfer=Transfer("projection", "linear", "geometric")),
    "lines": lambda: diapir(transfer=Transfer("lines", "lines", "harmonic")),
}


def engine_of(scene):
    return (BoxEngine if scene.dim == 3 else StokesEngine)(scene)


def arrays_of(memory):
    """Return all that a memory holds but wall times, as one text or array after another."""
    if isinstance(memory, dict):
        return [x for key, v in memory.items() if key != "seconds" for x in arrays_of(v)]
    if isinstance(memory, (list, tuple)):
        return [x for v in memory for x in arrays_of(v)]
    return [memory.tobytes() if isinstance(memory, np.ndarray) else repr(memory)]


@pytest.mark.parametrize("name", SCENES | MORE)
def test_a_rebuilt_engine_goes_on_bit_for_bit(name):
    scene = (SCENES | MORE)[name]()
    rests, engine = [], engine_of(scene)

    def rest(passed, state):
        rests.append((passed, packed(engine.memory(state))))

    march(engine.start(), engine, scene.time, at_rest=(rest,))
    last = arrays_of(unpacked(rests[-1][1], "last"))
    for passed, content in [rests[len(rests) * share // 4] for share in (0, 1, 3)]:
        memory = unpacked(content, "memory")
        other = engine_of(scene)
        state = other.recalled(memory)
        assert arrays_of(unpacked(packed(other.memory(state)), "again")) == arrays_of(memory)
        end = march(state, other, scene.time, passed=passed)
        assert arrays_of(unpacked(packed(other.memory(end)), "end")) == last


def test_a_step_that_was_shortened_stays_short():
    engine, other = (StokesEngine(diapir()) for _ in range(2))
    state = engine.with_flow(engine.start())
    engine.longest, engine.retried = 1e10, 3
    memory = unpacked(packed(engine.memory(state)), "memory")
    assert other.stable_step(other.recalled(memory), -MYR) == 1e10
    assert other.retried == 3

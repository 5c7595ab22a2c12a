"""Prints what becomes of faults on two ranks, as JSON.

Of flows whose ranks do not hear of each other, and of a step that fails however short it is, where
the first rank solves and where all do.
"""

import json

from petsc4py import PETSc

from restoration import acceptance
from restoration.engine import StokesEngine
from restoration.environment import use_jit_cache
from restoration.errors import MeshError, SolveError
from restoration.retry import stepped
from restoration.scene import SolverPlan
from tests.restoration.conftest import diapir_scene

DEAF = {"none": None, "load": PETSc.InsertMode.ADD, "solution": PETSc.InsertMode.INSERT}


def outcome(deaf):
    """Return how the first solve ends where ranks do not hear of vectors in one way."""
    solver = SolverPlan("direct", (), reproducible=False)  # by all ranks
    engine = StokesEngine(diapir_scene(viscosity=(1e19, 1e20), solver=solver))
    send = acceptance._send
    acceptance._send = lambda vector, how, way: None if how == deaf else send(vector, how, way)
    try:
        engine.with_flow(engine.start())
    except SolveError as error:
        return str(error), engine.ranks
    finally:
        acceptance._send = send
    return "solved", engine.ranks


def failed(reproducible):
    """Return the error of a step that no guard lets pass, whether it has facts, and the ranks."""
    solver = SolverPlan("direct", (), reproducible=reproducible)
    engine = StokesEngine(diapir_scene(viscosity=(1e19, 1e20), solver=solver))
    state = engine.with_flow(engine.start())

    def refuse(*_):
        raise MeshError("refused")

    engine.guard = refuse
    try:
        stepped(engine, state, state.time + 1e9)
    except MeshError as error:
        told = "mumps_infog_1" in error.facts and len(error.memory["particles"]["x"]) > 0
        return f"{error}, {'with' if told else 'without'} facts", engine.ranks


if __name__ == "__main__":
    use_jit_cache()
    found = {}
    for reproducible in (True, False):
        text, ranks = failed(reproducible)
        found[f"step {reproducible}"] = sorted(set(ranks.comm.allgather(text)))
    for name, deaf in DEAF.items():
        text, ranks = outcome(deaf)
        found[name] = sorted(set(ranks.comm.allgather(text)))
    if ranks.first:
        print(json.dumps(found))

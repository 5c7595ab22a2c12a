"""Prints what becomes of flows whose ranks do not hear of each other, as JSON; on two ranks."""

import json

from petsc4py import PETSc

from restoration import acceptance
from restoration.engine import StokesEngine
from restoration.environment import use_jit_cache
from restoration.errors import SolveError
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


if __name__ == "__main__":
    use_jit_cache()
    found = {}
    for name, deaf in DEAF.items():
        text, ranks = outcome(deaf)
        found[name] = sorted(set(ranks.comm.allgather(text)))
    if ranks.first:
        print(json.dumps(found))

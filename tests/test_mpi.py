"""The same answer on one, two and three ranks."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[1]
# Root may be all there is in a container; OpenMPI asks twice.
SETTINGS = {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
SETTINGS |= {"OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
SETTINGS["OMPI_MCA_mpi_yield_when_idle"] = "1"


def on_ranks(script, ranks, *arguments):
    """Return the numbers that a script prints as JSON on its first rank."""
    # What MPI left for the children of the test runner would make mpirun one of them.
    left = ("OMPI_", "ORTE_", "PMIX_")
    environment = {name: text for name, text in os.environ.items() if not name.startswith(left)}
    # Ranks wait by spinning: other tests, which watch the clock, go first; bound to the core of
    # one of these a rank would hardly ever have its turn.
    launch = ["nice", "-n", "19", "mpirun", "--oversubscribe", "--bind-to", "none"]
    launch += ["-n", str(ranks)]
    done = subprocess.run(
        [*launch, sys.executable, str(script), *map(str, arguments)],
        env=environment | SETTINGS,
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture(scope="module", params=["mpi_flows.py", "mpi_runs.py", "meshes/mpi_meshes.py"])
def script(request):
    return ROOT / "tests" / request.param


@pytest.fixture(scope="module")
def alone(script):
    return on_ranks(script, 1)


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [2, 3])
def test_nothing_depends_on_the_ranks(script, alone, ranks):
    together = on_ranks(script, ranks)
    assert together.keys() == alone.keys()
    off = {name: float(np.abs(np.divide(together[name], alone[name]) - 1).max()) for name in alone}
    assert {name: error for name, error in off.items() if not error < 1e-9} == {}

"""A run goes on from its checkpoint on any number of ranks; on as many as before, bit for bit."""

import shutil
from pathlib import Path

import numpy as np
import pytest

from tests.test_mpi import on_ranks

SCRIPT = Path(__file__).parent / "mpi_restarts.py"
STOP = 2  # step after which the runs are stopped


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory):
    """Return the ends of unbroken runs by their ranks."""
    folder = tmp_path_factory.mktemp("unbroken")
    return {ranks: on_ranks(SCRIPT, ranks, folder / f"{ranks}", 0) for ranks in (1, 2)}


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """Return the folders of runs stopped on one, two and three ranks."""
    folder = tmp_path_factory.mktemp("stopped")
    for ranks in (1, 2, 3):
        found = on_ranks(SCRIPT, ranks, folder / f"{ranks}", STOP)
        assert {name: (run["code"], run["steps"]) for name, run in found.items()} == dict.fromkeys(
            found, (75, STOP)
        )
    return folder


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, 2])
def test_on_as_many_ranks_a_run_goes_on_bit_for_bit(unbroken, stopped, tmp_path, ranks):
    shutil.copytree(stopped / f"{ranks}", tmp_path / "run")
    end = on_ranks(SCRIPT, ranks, tmp_path / "run", 0)
    for name, run in end.items():
        assert run["code"] == 0
        assert run["digest"] == unbroken[ranks][name]["digest"], name


@pytest.mark.slow
@pytest.mark.parametrize(("before", "after"), [(1, 2), (2, 1), (2, 3), (3, 2)])
def test_on_other_ranks_a_run_goes_on_the_same_to_rounding(
    unbroken, stopped, tmp_path, before, after
):
    shutil.copytree(stopped / f"{before}", tmp_path / "run")
    end = on_ranks(SCRIPT, after, tmp_path / "run", 0)
    for name, run in end.items():
        x, reference = np.array(run["x"]), np.array(unbroken[1][name]["x"])
        assert run["steps"] == unbroken[1][name]["steps"]
        assert np.abs(x / reference - 1).max() < 1e-10, name

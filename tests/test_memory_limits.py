"""Runs that get less memory than they need end with exit code 6 and one line, and do not hang."""

import os
import resource
import subprocess
import sys

import numpy as np
import pytest

from restoration.errors import TooLargeError, out_of_memory
from restoration.saved import read_particles
from tests.small_case import small_case
from tests.test_mpi import ROOT
from tests.torture import tries

MB = 2**20
USUAL = (60, 200, 400, 750, 1150, 1350)  # MB, from where numpy cannot be loaded to nearly enough
LIMITS = tries(USUAL, tuple(np.linspace(50, 1800, 40).astype(int)))
PATIENCE = 120.0  # s, that no run of this size needs


def run(folder, limit):
    """Run the small case with so much address space, MB; return the finished process."""

    def limited():
        resource.setrlimit(resource.RLIMIT_AS, (int(limit) * MB, int(limit) * MB))

    return subprocess.run(
        [sys.executable, "-m", "restoration.cli", "run", str(small_case(folder)), "--quiet"]
        + ["--out", str(folder / "run")],
        env=os.environ | {"PYTHONPATH": str(ROOT), "OMP_NUM_THREADS": "1"},
        preexec_fn=limited,
        capture_output=True,
        text=True,
        timeout=PATIENCE,
        check=False,
    )


@pytest.mark.slow
@pytest.mark.torture
@pytest.mark.parametrize("limit", LIMITS)
def test_too_little_memory_is_told(tmp_path, limit):
    done = run(tmp_path, limit)
    assert done.returncode in (0, TooLargeError.exit_code), done.stderr
    if limit <= 750:
        assert done.returncode == TooLargeError.exit_code
    if done.returncode:
        assert len(done.stderr.splitlines()) == 1, done.stderr
        assert "memory" in done.stderr
    for path in (tmp_path / "run").rglob("*"):
        if path.suffix in (".csv", ".json", ".geojson"):
            assert "nan" not in path.read_text().lower()
    if (tmp_path / "run" / "particles.h5").exists():
        assert np.isfinite(read_particles(tmp_path / "run" / "particles.h5").x).all()


def test_enough_memory_is_enough(tmp_path):
    assert run(tmp_path, 6000).returncode == 0


def chained(error):
    """Return an error that another one was met by."""
    try:
        try:
            raise error
        except Exception as first:
            raise ValueError("somewhere else") from first
    except ValueError as second:
        return second


@pytest.mark.parametrize(
    "error",
    [
        MemoryError(),
        OSError(12, "Cannot allocate memory"),
        RuntimeError("can't start new thread"),
        RuntimeError("std::bad_alloc"),
        ImportError("libdmumps-5.5.so: failed to map segment from shared object"),
        TooLargeError("the factorisation does not fit"),
    ],
)
def test_what_tells_that_memory_has_run_out(error):
    assert out_of_memory(error)
    assert out_of_memory(chained(error))


def test_what_has_nothing_to_do_with_memory():
    assert not out_of_memory(chained(OSError(28, "No space left on device")))
    assert not out_of_memory(None)

"""R18: the series of a run that is killed at any moment open as whole ones do."""

import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.long_runs import CASE, TIME
from tests.torture import tries
from tests.vtk_reads import read_by_vtk

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
@pytest.mark.torture
def test_series_of_a_killed_run_open(tmp_path):
    """A frame in every step, so that most of the time something is being written."""
    rng, times = random.Random(18), tries(3, 60)
    text = CASE + "mesh: {cells: 6}\noutput: {at: 1}\n" + TIME.format(end=1, steps=2000)
    (tmp_path / "case.yaml").write_text(text)
    for number in range(times):
        out = tmp_path / f"run-{number}"
        command = [sys.executable, "-m", "restoration.cli", "run", tmp_path / "case.yaml"]
        process = subprocess.Popen(
            [*command, "--quiet", "--out", out],
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        try:
            limit = time.monotonic() + 60
            while not (out / "particles.xdmf").exists() and process.poll() is None:
                assert time.monotonic() < limit
                time.sleep(0.01)
            time.sleep(rng.uniform(0, 1.5))
            process.send_signal(signal.SIGKILL)
        finally:
            process.kill()
        assert process.wait() == -signal.SIGKILL
    found = read_by_vtk(tmp_path)
    assert found["fields.xdmf"]["frames"] >= 1
    series = list(tmp_path.glob("run-*/*.xdmf"))
    assert len(series) >= 2 * times

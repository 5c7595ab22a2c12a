"""Runs on a disk that is too small end with exit code 5 and one line, and leave whole files."""

import json
import os
import resource
import signal
import subprocess
import sys
from contextlib import contextmanager

import h5py
import numpy as np
import pytest

from restoration.checkpoint import Checkpoints
from restoration.errors import OutputError
from tests.small_case import small_case
from tests.test_mpi import ROOT
from tests.torture import tries

KB = 1024
ENOUGH = 8_000  # kB, more than the run leaves
SIZES = np.unique(np.geomspace(64, 3000, tries(12, 200)).astype(int)).tolist()


@contextmanager
def small_disk(folder, size):
    """Yield a folder on a disk of so many kB, or None where that cannot be made."""
    place = folder / "disk"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}k", "tmpfs", str(place)]
    try:
        made = subprocess.run(mount, capture_output=True, check=False).returncode == 0
    except FileNotFoundError:
        made = False
    try:
        yield place if made else None
    finally:
        if made:
            subprocess.run(["umount", "-l", str(place)], check=True)


def run(case, out, largest=None):
    """Run a case with a checkpoint after every step; return the finished process.

    Args:
        case: path of the case file.
        out: run folder.
        largest: size of a file at most, kB, where that stands for a full disk.
    """

    def limited():
        if largest is not None:
            signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
            resource.setrlimit(resource.RLIMIT_FSIZE, (largest * KB, largest * KB))

    command = [sys.executable, "-m", "restoration.cli", "run", str(case), "--quiet"]
    return subprocess.run(
        [*command, "--checkpoint", "1", "--out", str(out)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        preexec_fn=limited,
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )


def check(done, folder):
    """Assert that a run has ended as it is to on a full disk, and that what it left is whole."""
    assert done.returncode in (0, OutputError.exit_code), (done.returncode, done.stderr)
    if done.returncode:
        assert len(done.stderr.splitlines()) == 1, done.stderr
        assert "not written" in done.stderr or "No space left" in done.stderr, done.stderr
    for path in folder.rglob("*.h5"):
        if "checkpoints" not in path.parts:
            with h5py.File(path, "r") as h5:
                assert all(len(frame) for frame in h5["frames"].values())
    for path in folder.rglob("*.json"):
        json.loads(path.read_text())
    for path in folder.rglob("*.geojson"):
        json.loads(path.read_text())
    memory, notes = Checkpoints(folder / "checkpoints").newest()
    assert notes == []
    latest = folder / "checkpoints" / "latest.json"
    assert not latest.exists() or memory["steps"] >= json.loads(latest.read_text())["step"]
    assert not list(folder.rglob(".*.tmp"))
    return memory


@pytest.mark.slow
@pytest.mark.torture
@pytest.mark.parametrize("size", SIZES)
def test_a_full_disk_is_told_and_leaves_whole_files(tmp_path, size):
    case = small_case(tmp_path)
    with small_disk(tmp_path, size) as disk:
        folder = (disk or tmp_path) / "run"
        done = run(case, folder, largest=None if disk else int(size) // 8)
        check(done, folder)
        if size < 1000 and disk:
            assert done.returncode == OutputError.exit_code

"""`restore run` on several ranks: what the user sees."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from restoration.launch import cores, rank_and_size

ROOT = Path(__file__).parents[1]
CASE = ROOT / "cases" / "diapir-two-viscosities" / "case.yaml"
SMALL = ["--set", "mesh.cells=8", "--set", "time.marks=[0.2 Myr, 0 Myr, 0.2 Myr]"]


LAST = ["nice", "-n", "19"]  # ranks wait by spinning: tests that watch the clock go first


def command(*arguments):
    return [*LAST, sys.executable, "-m", "restoration.cli", "run", *map(str, arguments)]


def without_launcher():
    """Return the environment without what a launcher of the tests may have left."""
    left = ("OMPI_", "ORTE_", "PMIX_", "PMI_", "SLURM_")
    return {name: text for name, text in os.environ.items() if not name.startswith(left)}


def run(*arguments, seconds=900, **environment):
    return subprocess.run(
        command(*arguments),
        env=without_launcher() | environment,
        cwd=ROOT,
        capture_output=True,
        text=True,
        timeout=seconds,
        check=False,
    )


@pytest.fixture(scope="module")
def two_ranks(tmp_path_factory):
    out = tmp_path_factory.mktemp("ranks") / "two"
    return run(CASE, *SMALL, "--out", out, "--ranks", 2, "--quiet"), out


def test_ranks_are_not_bound_to_cores(tmp_path):
    """Every run would be bound to the same ones."""
    launcher = tmp_path / "mpirun"
    launcher.write_text('#!/bin/sh\necho "$@"\n')
    launcher.chmod(0o755)
    done = run(CASE, "--ranks", 2, PATH=f"{tmp_path}:{os.environ['PATH']}")
    assert done.returncode == 0, done.stderr
    assert "--bind-to none -n 2" in done.stdout
    assert f"restoration.cli run {CASE}" in done.stdout


@pytest.mark.slow
def test_a_run_on_two_ranks_leaves_what_a_run_leaves(two_ranks, tmp_path):
    done, out = two_ranks
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("Stokes solves") == 1
    record = json.loads((out / "run.json").read_text())
    assert record["ended_well"]
    assert record["ranks"] == 2
    assert record["particle_load"] < 1.2
    assert record["certificate"]["verdict"]
    alone = run(CASE, *SMALL, "--out", tmp_path / "one", "--quiet")
    assert alone.returncode == 0
    names = [
        {str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file()}
        for folder in (out, tmp_path / "one")
    ]
    assert names[0] == names[1]
    reference = json.loads((tmp_path / "one" / "run.json").read_text())
    for name in ("particles", "steps", "stokes_solves", "cells", "unknowns"):
        assert record[name] == reference[name]
    for kind in ("mean_m", "max_m"):
        assert record["there_and_back"][kind] == pytest.approx(
            reference["there_and_back"][kind], abs=1e-5
        )


@pytest.mark.slow
def test_a_run_that_is_there_is_left_as_it_is(two_ranks):
    _, out = two_ranks
    again = run(CASE, *SMALL, "--out", out, "--ranks", 2, "--quiet")
    assert again.returncode == 0
    assert again.stdout.count("holds this very run") == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "code", "text"),
    [
        ((CASE, "--set", "mesh.cells=-3"), 2, "--set mesh.cells: -3 squares are not possible"),
        ((CASE, "--out", "/dev/null/x"), 5, "/dev/null/x: Not a directory; give another --out"),
        ((CASE, "--out", ROOT / "docs"), 2, "is not a run folder and not empty"),
    ],
)
def test_faults_are_told_once(arguments, code, text):
    done = run(*arguments, "--ranks", 2, "--quiet")
    assert done.returncode == code
    assert done.stderr.count("\n") == 1
    assert text in done.stderr


def test_so_many_ranks_cannot_be():
    for count in (0, -2, 1_000_000):
        done = run(CASE, "--ranks", count)
        assert done.returncode == 2
        assert done.stderr.startswith(f"--ranks: {count} is not possible")


@pytest.mark.slow
def test_ctrl_c_ends_all_ranks_after_the_step(tmp_path):
    out = tmp_path / "stopped"
    arguments = command(CASE, "--set", "mesh.cells=12", "--out", out, "--ranks", 2, "--quiet")
    with subprocess.Popen(
        arguments, env=without_launcher(), cwd=ROOT, stderr=subprocess.PIPE, text=True
    ) as work:
        table, deadline = out / "diagnostics.csv", time.monotonic() + 120
        while not table.exists() or table.read_text().count("\n") < 3:
            assert time.monotonic() < deadline
            time.sleep(0.1)
        work.send_signal(signal.SIGINT)
        _, told = work.communicate(timeout=120)
    assert work.returncode == 75, told
    assert told.startswith("stopped on request")
    record = json.loads((out / "run.json").read_text())
    assert record["exit_code"] == 75


@pytest.mark.slow
@pytest.mark.parametrize(
    "where", ["StokesEngine._settled = fails", "Companion.restored = fails_beside"]
)
def test_a_rank_that_fails_alone_ends_the_others(tmp_path, where):
    script = tmp_path / "one_fails.py"
    script.write_text(
        "import sys\n"
        "from mpi4py import MPI\n"
        "from restoration import launch\n"
        "from restoration.cli import main\n"
        "from restoration.companions import Companion\n"
        "from restoration.engine import StokesEngine\n"
        "launch.PATIENCE = 2\n"
        "settled, restored = StokesEngine._settled, Companion.restored\n"
        "def fails(self, particles):\n"
        "    if MPI.COMM_WORLD.rank == 1 and self._steps == 2:\n"
        "        raise MemoryError\n"
        "    return settled(self, particles)\n"
        "def fails_beside(self, *arguments):\n"
        "    if MPI.COMM_WORLD.rank == 1:\n"
        "        raise MemoryError\n"
        "    return restored(self, *arguments)\n"
        f"{where}\n"
        "sys.exit(main(sys.argv[1:]))\n"
    )
    environment = without_launcher() | {
        "OMPI_ALLOW_RUN_AS_ROOT": "1",
        "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1",
        "PYTHONPATH": str(ROOT),
    }
    arguments = [*LAST, "mpirun", "--quiet", "--oversubscribe", "--bind-to", "none", "-n", "2"]
    arguments += [sys.executable, script, "run", CASE, *SMALL, "--out", tmp_path / "run", "--quiet"]
    done = subprocess.run(
        arguments, env=environment, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 6
    assert "rank 1: out of memory" in done.stderr


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({}, (0, 1)),
        ({"OMPI_COMM_WORLD_RANK": "3", "OMPI_COMM_WORLD_SIZE": "8"}, (3, 8)),
        ({"PMI_RANK": "1", "PMI_SIZE": "2"}, (1, 2)),
        ({"SLURM_PROCID": "5", "SLURM_STEP_NUM_TASKS": "16"}, (5, 16)),
        ({"SLURM_PROCID": "0"}, (0, 1)),  # a shell of a job, no step of it
    ],
)
def test_launchers_tell_the_rank(environment, expected, monkeypatch):
    for name in list(os.environ):
        if name.startswith(("OMPI_", "PMI_", "SLURM_")):
            monkeypatch.delenv(name)
    for name, text in environment.items():
        monkeypatch.setenv(name, text)
    assert rank_and_size() == expected


def test_there_are_cores():
    assert cores() >= 1

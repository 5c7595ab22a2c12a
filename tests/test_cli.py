"""The commands as a user types them: exit codes, what is said, how fast, what is left behind."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from restoration.cli import main
from tests.vtk_reads import read_by_vtk

ROOT = Path(__file__).parents[1]
DEMO = ROOT / "cases" / "diapir-isoviscous" / "case.yaml"
BROKEN = sorted((ROOT / "tests" / "broken").glob("*.yaml"))


def restore(*arguments, cwd, timeout=60):
    return subprocess.run(
        [sys.executable, "-m", "restoration.cli", *map(str, arguments)],
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "default"},
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )


def test_check_answers_within_three_seconds(tmp_path):
    begin = time.perf_counter()
    done = restore("check", DEMO, cwd=tmp_path)
    assert time.perf_counter() - begin < 3
    assert done.returncode == 0
    assert "salt" in done.stdout
    assert list(tmp_path.iterdir()) == []


def test_check_as_json(tmp_path):
    done = restore("check", DEMO, "--json", cwd=tmp_path)
    assert json.loads(done.stdout)["title"].startswith("Diapir")


@pytest.mark.parametrize("command", ["check", "run"])
@pytest.mark.parametrize("path", BROKEN[:: max(1, len(BROKEN) // 6)], ids=lambda path: path.stem)
def test_bad_input_exits_2_and_leaves_nothing(tmp_path, command, path):
    begin = time.perf_counter()
    done = restore(command, path, cwd=tmp_path)
    assert time.perf_counter() - begin < 3
    assert done.returncode == 2
    assert done.stdout == ""
    lines = done.stderr.strip().splitlines()
    assert lines
    assert all(line.startswith((str(path), "warning: ", "sections/")) for line in lines)
    assert "Traceback" not in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_all_of_the_corpus_through_the_command(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for path in BROKEN:
        assert main(["run", str(path)]) == 2, path.stem
        said = capsys.readouterr()
        assert said.out == ""
        assert said.err.strip()
    assert list(tmp_path.iterdir()) == []


def test_a_full_device_is_told_in_a_line(tmp_path):
    with open("/dev/full", "w") as full:
        done = subprocess.run(
            [sys.executable, "-m", "restoration.cli", "check", str(DEMO)],
            env=os.environ | {"PYTHONPATH": str(ROOT)},
            stdout=full,
            stderr=subprocess.PIPE,
            text=True,
            check=False,
        )
    assert done.returncode == 5
    assert "No space left" in done.stderr
    assert "Traceback" not in done.stderr


def test_an_override_that_is_wrong_is_named(tmp_path):
    done = restore("check", DEMO, "--set", "rocks.salt.viscosity=-1e19 Pa s", cwd=tmp_path)
    assert done.returncode == 2
    assert "--set rocks.salt.viscosity" in done.stderr


def test_a_bare_section_is_answered_with_a_case(tmp_path):
    section = ROOT / "cases" / "salt-diapir" / "section.geojson"
    done = restore("check", section, cwd=tmp_path)
    assert done.returncode == 0
    assert "rocks:" in done.stdout
    refused = restore("run", section, cwd=tmp_path)
    assert refused.returncode == 2
    assert "restore check" in refused.stderr


def test_run_folder_has_a_name_of_its_own(tmp_path):
    sets = ["mesh.cells=6", "time.marks=[0 Myr, 0.2 Myr, 0 Myr]", "time.min_steps=2"]
    flags = [part for entry in sets for part in ("--set", entry)]
    done = restore("run", DEMO, *flags, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (folder,) = (tmp_path / "runs").iterdir()
    assert folder.name.startswith("diapir-isoviscous-")
    assert str(Path("runs") / folder.name / "figures") in done.stdout
    assert "there and back" in done.stdout
    again = restore("run", DEMO, *flags, cwd=tmp_path)
    assert again.returncode == 0
    assert "--fresh" in again.stdout


def test_ctrl_c_from_outside(tmp_path):
    out = tmp_path / "run"
    process = subprocess.Popen(
        [sys.executable, "-m", "restoration.cli", "run", str(DEMO), "--out", str(out)],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
    )
    try:
        rows = out / "diagnostics.csv"
        limit = time.monotonic() + 60
        while not rows.exists() or len(rows.read_text().splitlines()) < 4:
            assert time.monotonic() < limit, process.stderr.read()
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        begin = time.monotonic()
        _, said = process.communicate(timeout=30)
    finally:
        process.kill()
    assert time.monotonic() - begin < 10
    assert process.returncode == 75
    assert "stopped on request at" in said
    assert "Traceback" not in said
    record = json.loads((out / "run.json").read_text())
    assert record["exit_code"] == 75
    assert record["steps"] >= 3


def test_help_is_quick(tmp_path):
    begin = time.perf_counter()
    assert restore("--help", cwd=tmp_path).returncode == 0
    assert time.perf_counter() - begin < 1


@pytest.mark.slow
def test_odd_surroundings(tmp_path):
    """R21: spaces and umlauts, no locale, no display, a home that holds nothing."""
    folder = tmp_path / "Übung mit Maß"
    folder.mkdir()
    (folder / "Fläche 1.yaml").write_bytes(DEMO.read_bytes())
    sets = ["mesh.cells=6", "time.marks=[0 Ma, 0.2 Ma]", "time.min_steps=2", "certificate=off"]
    flags = [part for entry in sets for part in ("--set", entry)]
    command = [sys.executable, "-m", "restoration.cli", "run", "Fläche 1.yaml", *flags]
    for arguments in ([], ["--out", "zwei Läufe"]):
        done = subprocess.run(
            [*command, *arguments],
            cwd=folder,
            env={"PATH": "/usr/bin:/bin", "LANG": "C", "HOME": "/proc", "PYTHONPATH": str(ROOT)},
            capture_output=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        assert b"WARNING" not in done.stderr
        assert b"figures" in done.stdout
    (run,) = (folder / "runs").iterdir()
    assert run.name.startswith("Fläche 1-")
    for out in (run, folder / "zwei Läufe"):
        assert json.loads((out / "run.json").read_text())["ended_well"] is True
        assert set(read_by_vtk(out)) == {"fields.xdmf", "particles.xdmf"}

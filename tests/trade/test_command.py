"""`restore trade` as a user types it, on tiny cases and a small benchmark."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from restoration.cli import main
from restoration.trade.command import subject_of
from restoration.trade.picture import draw_trade
from restoration.trade.search import Subject
from restoration.trade.trials import Trial

ROOT = Path(__file__).parents[2]
DEMO = ROOT / "cases" / "diapir-isoviscous"
TINY = ("mesh.cells=6", "time.marks=[0 Myr, 0.2 Myr]", "time.min_steps=2", "particles.densify=2")


def flags(sets):
    return [part for text in sets for part in ("--set", text)]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["solcxx"], "did you mean 'solcx'"),
        (["no-such.yaml"], "no-such.yaml"),
        (["diapir-3d"], "two dimensions only"),
        (["graven"], "did you mean 'graben'"),
        (["solcx", "--set", "mesh.cell=3"], "did you mean 'mesh.cells'"),
        (["solcx", "--set", "mesh.cells=many"], "'many' is no int"),
        ([str(DEMO), "--set", "mesh.elemnt=MINI"], "element"),
    ],
)
def test_what_is_wrong_is_named(arguments, said, capsys):
    assert main(["trade", *arguments]) == 2
    error = capsys.readouterr().err
    assert said in error
    assert "Traceback" not in error


@pytest.mark.parametrize("name", [DEMO, DEMO / "case.yaml", "diapir-isoviscous"])
def test_a_case_goes_by_its_folder_or_its_name(name):
    assert subject_of(str(name), TINY).name == "diapir-isoviscous"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("what", "sets"), [(str(DEMO), TINY), ("solcx", ("mesh.cells=8",))], ids=["case", "bench"]
)
def test_a_search_end_to_end(what, sets, tmp_path, capsys):
    arguments = ["trade", what, *flags(sets), "--quick", "--out", str(tmp_path), "--json"]
    assert main(arguments) == 0
    found = json.loads(capsys.readouterr().out)
    trials = {trial["label"]: trial for trial in found["trials"]}
    assert trials["as given"]["error"] > 0
    assert trials["as given"]["cpu_s"] > 0
    assert any(trial["front"] for trial in found["trials"])
    assert found["recommendation"]
    assert found["command"].startswith("restore trade ")
    (kept,) = tmp_path.glob("*.json")
    assert json.loads(kept.read_text()) == found
    assert next(tmp_path.glob("*.png")).read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_ctrl_c_tells_what_is_there(tmp_path):
    process = subprocess.Popen(
        [sys.executable, "-m", "restoration.cli", "trade", "solcx"],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        begin = time.monotonic()
        while "as given" not in process.stderr.readline():
            assert time.monotonic() - begin < 60
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=20)
    finally:
        process.kill()
    assert process.returncode == 75
    assert "as given" in out
    assert "Traceback" not in err


def test_a_picture_of_many_points_that_lie_together(tmp_path):
    trials = [
        Trial(f"number {i}", ("mesh",), {}, 1 + 0.01 * i, 2.0, 1 + 0.01 * i) for i in range(40)
    ]
    subject = Subject("many", "Many points", "m", ("mean", "greatest"), "nothing", 0.5)
    draw_trade(tmp_path / "many.png", trials, subject)
    assert (tmp_path / "many.png").stat().st_size > 1000

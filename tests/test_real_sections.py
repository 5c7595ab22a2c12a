"""Every section of ../shared/data runs: survey, starter case, check, and a coarse run.

The data is not part of the repository; without it these tests are skipped.
"""

import json
import shutil
from pathlib import Path

import pytest

from restoration.cli import main

DATA = Path(__file__).parents[2] / "shared" / "data"
SECTIONS = sorted(DATA.glob("*/*.geojson"))
COARSE = (
    "mesh.cells=8",
    "particles.densify=2",
    "time.marks=[0 Ma, 50 ka]",
    "time.min_steps=2",
    "time.courant=2",
)


@pytest.fixture(params=SECTIONS or [None], ids=lambda path: path and path.parent.name)
def case(request, tmp_path, capsys):
    """The case that `restore check` of the bare section prints, saved beside the section."""
    if request.param is None:
        pytest.skip(f"no real sections: {DATA} is not there")
    section = shutil.copy(request.param, tmp_path / "section.geojson")
    assert main(["check", str(section)]) == 0
    text = capsys.readouterr().out
    assert "to mend" not in text
    (tmp_path / "case.yaml").write_text(text, encoding="utf-8")
    return tmp_path / "case.yaml"


def test_starter_case_is_checked(case, capsys):
    assert main(["check", str(case), "--json"]) == 0
    about = json.loads(capsys.readouterr().out)
    assert about["units"]
    assert about["lines"]
    assert about["area_m2"] == pytest.approx(about["width_m"] * about["height_m"], rel=0.01)


def test_coarse_run(case, tmp_path):
    sets = [part for entry in COARSE for part in ("--set", entry)]
    assert main(["run", str(case), "--quiet", "--out", str(tmp_path / "run"), *sets]) == 0
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    assert record["ended_well"] is True
    assert record["particles_lost"] == 0
    assert record["worst_residual"] < 1e-8
    assert len(list((tmp_path / "run" / "horizons").glob("*.geojson"))) == 2

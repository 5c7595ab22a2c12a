"""Every shipped case is an example and a test: it runs coarse, forward or backward."""

import json
import time
from pathlib import Path

import pytest

from restoration.cli import main
from restoration.resolve import load
from tests.vtk_reads import read_by_vtk

ROOT = Path(__file__).parents[1]
CASES = [p for p in sorted(ROOT.glob("cases/*/*.yaml")) if ".sweep" not in p.name]
COARSE = ("mesh.cells=10", "particles.per_cell=4", "particles.densify=4", "time.min_steps=3")


def names(path):
    return f"{path.parent.name}-{path.stem}"


def test_there_are_cases():
    assert len(CASES) >= 7


@pytest.mark.parametrize("path", CASES, ids=names)
def test_case_runs_coarse(path, tmp_path):
    scene = load(path).scene
    entries = *COARSE, f"time.courant={max(2, scene.time.courant)}"
    if scene.dim == 3:
        entries = *entries, "mesh.cells=3"
    # With faults every step has a mesh of its own, also those of all companions.
    if scene.faults:
        entries = *entries, "time.marks=[0 kyr, 10 kyr, 0 kyr]", "time.min_steps=1"
    overrides = [part for entry in entries for part in ("--set", entry)]
    code = main(["run", str(path), "--quiet", "--out", str(tmp_path / "run"), *overrides])
    record = json.loads((tmp_path / "run" / "run.json").read_text())
    assert code == 0
    assert record["ended_well"] is True
    assert record["particles_lost"] == 0
    if record["surface_relief_m"] is None:
        assert abs(record["area_change"]) < 1e-6
    assert record["worst_residual"] < 1e-8
    assert record["particles_born"] < 0.01 * record["particles"]
    series = read_by_vtk(tmp_path / "run")
    assert {"fields.xdmf", "particles.xdmf"} <= set(series)
    frames = len(scene.time.marks)
    if scene.time.stop:  # which may come before the last mark
        frames = len(list((tmp_path / "run" / "horizons").glob("*.geojson")))
    assert [found["frames"] for found in series.values()] == [frames] * len(series)
    assert series["fields.xdmf"]["arrays"] == frames * (1 + len(scene.output.fields))


@pytest.mark.parametrize("path", CASES, ids=names)
def test_case_is_explained(path):
    assert load(path).scene.title
    readme = (path.parent / "README.md").read_text(encoding="utf-8")
    assert path.name in readme
    pictures = [line for line in readme.splitlines() if line.startswith("![")]
    assert pictures
    for line in pictures:
        assert (path.parent / line.split("](")[1].split(")")[0]).is_file()


def run(case, out, *overrides):
    sets = [part for entry in overrides for part in ("--set", entry)]
    assert main(["run", str(ROOT / case), "--quiet", "--out", str(out), *sets]) == 0
    return json.loads((out / "run.json").read_text())


@pytest.mark.slow
def test_three_dimensions_come_back(tmp_path):
    begin = time.process_time()
    record = run("cases/diapir-3d/case.yaml", tmp_path / "run")
    assert time.process_time() - begin < 120
    assert record["particles_lost"] == 0
    assert record["there_and_back"]["mean_m"] < 0.5
    assert record["there_and_back"]["max_m"] < 20
    assert record["horizons"][0]["max_m"] < 10
    assert record["factorisations"] == 1
    assert all(abs(change) < 5e-3 for change in record["volume_by_rock_largest_change"].values())


@pytest.mark.slow
def test_demo_comes_back(tmp_path):
    """`make demo` without its certificate, against the figures of the paper (its sect. 4.1)."""
    begin = time.process_time()  # of this process: other work on the machine does not count
    case = "cases/diapir-isoviscous/case.yaml"
    record = run(case, tmp_path / "run", "certificate=off")  # that is tested by itself
    assert time.process_time() - begin < 120
    assert 8000 < record["cells"] < 9500
    assert 55_000 < record["particles"] < 66_000
    assert record["particles_lost"] == 0
    assert record["there_and_back"]["mean_m"] < 14
    assert record["there_and_back"]["max_m"] < 143
    assert record["horizons"][0]["max_m"] < 50
    if record["surface_relief_m"] is None:
        assert abs(record["area_change"]) < 1e-6
    assert all(abs(change) < 1e-3 for change in record["volume_by_rock_change"].values())
    # as the fields see it on the way; below the horizon it is rounding (docs/accuracy.md)
    assert all(abs(change) < 1e-3 for change in record["volume_by_rock_largest_change"].values())
    assert record["factorisations"] == 1

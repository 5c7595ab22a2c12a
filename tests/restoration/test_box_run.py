"""A run in three dimensions from its case file to its folder."""

import csv
import json

import numpy as np
import pytest

from restoration.cli import main
from restoration.errors import CaseError
from restoration.resolve import load
from restoration.saved import read_particles
from tests.restoration.test_xdmf import read_all

CASE = """
title: A dome
section:
  box: {width: 4 km, length: 3 km, height: 2 km}
  layers:
    - rock: salt
      top: {depth: 1.4 km, cosine: {amplitude: 0.2 km, wavelength: 8 km, wavelength_y: 6 km}}
    - {rock: sand, top: {depth: 0.7 km}}
    - rock: sediment
rocks:
  salt: {density: 2150 kg/m^3, viscosity: 1e18 Pa s}
  sand: {density: 2400 kg/m^3, viscosity: 1e19 Pa s}
  sediment: {density: 2600 kg/m^3, viscosity: 1e19 Pa s}
boundary: {base: no-slip, front: no-slip}
mesh: {cells: 3}
time: {marks: [0 Ma, 0.05 Ma, 0 Ma], min_steps: 2}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("box")
    (path / "case.yaml").write_text(CASE, encoding="utf-8")
    assert main(["run", str(path / "case.yaml"), "--quiet", "--out", str(path / "run")]) == 0
    return path


def test_the_record_tells_of_the_run(folder):
    record = json.loads((folder / "run/run.json").read_text())
    assert record["ended_well"]
    # 3 cubes along the shortest side, of 2/3 km
    assert record["cells"] == 12 * 6 * 4 * 3 + 4 * (6 * 4 + 4 * 3 + 3 * 6)
    assert record["particles_lost"] == 0
    assert record["worst_residual"] < 1e-8
    assert record["there_and_back"]["max_m"] < 1
    assert [row["name"] for row in record["horizons"]] == ["salt / sand", "sand / sediment"]
    assert all(row["max_m"] < 1 for row in record["horizons"])
    assert record["wall_by_part_s"]["solve"] > 0
    assert record["certificate"] is None
    assert sum(abs(v) for v in record["volume_by_rock_change"].values()) < 1e-3


def test_every_step_has_its_row(folder):
    rows = list(csv.DictReader((folder / "run/diagnostics.csv").read_text().splitlines()))
    assert len(rows) == json.loads((folder / "run/run.json").read_text())["steps"]
    assert float(rows[0]["flatness_m"]) > float(rows[1]["flatness_m"])  # restored, it is flatter


def test_paraview_reads_what_is_written(folder):
    times, frames = read_all(folder / "run/fields.xdmf")
    assert len(times) == 3
    assert (frames[0].celltypes == 24).all()  # VTK_QUADRATIC_TETRA
    assert frames[0].bounds == pytest.approx((0, 4e3, 0, 3e3, -2e3, 0), abs=1e-3)
    volume = frames[0].compute_cell_sizes()["Volume"].sum()
    assert volume == pytest.approx(24e9, rel=1e-6)
    assert frames[0].point_data["velocity"].shape[1] == 3
    _, clouds = read_all(folder / "run/particles.xdmf")
    assert set(np.unique(clouds[0].point_data["unit"])) == {0, 1, 2}
    _, sheets = read_all(folder / "run/horizons.xdmf")
    assert (sheets[0].celltypes == 5).all()  # VTK_TRIANGLE
    assert set(sheets[0].point_data["horizon"]) == {0, 1}
    assert sheets[0].bounds[4] == pytest.approx(-1600, abs=1)


def test_pictures_are_drawn(folder):
    names = {path.name for path in (folder / "run/figures").iterdir()}
    marks = {"section-0-0.000Ma.png", "section-1-0.050Ma.png", "section-2-0.000Ma.png"}
    assert names == marks | {"strip.png", "there-and-back.png"}


def test_the_resolved_case_is_the_case(folder, tmp_path):
    resolved = (folder / "run/resolved.yaml").read_text()
    again = tmp_path / "case.yaml"
    again.write_text(resolved, encoding="utf-8")
    assert load(again).resolved == resolved
    scene = load(again).scene
    assert scene.walls["front"].kind == "no-slip"
    assert scene.walls["back"].kind == "free-slip"


def test_a_check_tells_of_three_dimensions(folder, capsys):
    assert main(["check", str(folder / "case.yaml")]) == 0
    told = capsys.readouterr().out
    assert "4 km wide, 3 km long, 2 km high, 24 km^3" in told
    assert "6 x 4 x 3 cubes, 1080 tetrahedra" in told
    assert "three-dimensional Stokes flow" in told
    assert main(["check", str(folder / "case.yaml"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["length_m"] == 3000


def test_a_proof_is_refused(folder, capsys):
    assert main(["run", str(folder / "case.yaml"), "--prove"]) == 2
    assert "--prove is not possible in three dimensions" in capsys.readouterr().err


def test_unknowns_are_told_as_they_are(folder):
    """Before the run as after it, of the other element too."""
    from restoration.box_engine import BoxEngine
    from restoration.plan import unknowns

    for element in ("P2-P1", "P2b-P1dg"):
        scene = load(folder / "case.yaml", (f"mesh.element={element}",)).scene
        about = BoxEngine(scene).about()
        assert unknowns(scene.cells, element) == (about["cells"], about["unknowns"])


def test_particles_of_three_dimensions_are_no_section(folder):
    with pytest.raises(CaseError, match="three coordinates, and a section has two"):
        read_particles(folder / "run/particles.xdmf")

"""From a case to a scene: SI, names to rows, walls, and the resolved case that is a case again."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from ruamel.yaml import YAML

from restoration.check import describe, describe_text
from restoration.errors import CaseError
from restoration.resolve import load
from restoration.scene import RefinePlan, SolverPlan
from restoration.units import YEAR

ROOT = Path(__file__).parents[2]
CASES = [p for p in sorted(ROOT.glob("cases/*/*.yaml")) if ".sweep" not in p.name]
CASE = """\
section:
  box: {width: 10 km, height: 5 km}
  layers:
    - {rock: salt, top: {depth: 4 km, cosine: {amplitude: 0.2 km, wavelength: 5 km, phase: 1 km}}}
    - {rock: shale, top: {depth: 2 km}}
    - {rock: salt, name: roof}
rocks:
  salt: {density: 2160 kg/m^3, viscosity: 1e17 Pa s}
  shale: {density: 2.6 g/cm^3, viscosity: 1e19 Pa s, color: "#112233"}
  marl: {density: 2500 kg/m^3, viscosity: 1e19 Pa s}
time: {marks: [0 Ma, 2 Ma]}
"""


@pytest.fixture
def case(tmp_path):
    def write(text=CASE, *overrides):
        path = tmp_path / "folder" / "case.yaml"
        path.parent.mkdir(exist_ok=True)
        path.write_text(text, encoding="utf-8")
        return load(path, overrides)

    return write


def same(one, other):
    """Assert that two scenes are the same."""
    assert one.title == other.title
    for name in (
        "rocks",
        "units",
        "walls",
        "gravity",
        "cells",
        "particles",
        "transfer",
        "time",
        "mesh",
        "solver",
    ):
        assert getattr(one, name) == getattr(other, name)
    assert one.output == other.output
    assert [(line.name, line.kind) for line in one.lines] == [
        (line.name, line.kind) for line in other.lines
    ]
    for a, b in zip(one.lines, other.lines, strict=True):
        np.testing.assert_array_equal(a.points, b.points)
    np.testing.assert_array_equal(one.outline.surface, other.outline.surface)
    np.testing.assert_array_equal(one.outline.base, other.outline.base)
    low, high = one.outline.base.min(axis=0), one.outline.surface.max(axis=0)
    points = np.random.default_rng(0).uniform(low, high, (500, 2))
    assert one.length == other.length
    if one.length:
        points = np.insert(points, 1, one.length * points[:, 0] / high[0], axis=1)
    for a, b in zip(one.sheets, other.sheets, strict=True):
        np.testing.assert_array_equal(a.points, b.points)
    np.testing.assert_array_equal(one.unit_at(points), other.unit_at(points))


def test_a_box_of_layers(case):
    scene = case().scene
    assert scene.title == "folder"
    assert scene.outline.width == 10e3
    assert scene.outline.height == 5e3
    assert scene.outline.area == pytest.approx(50e6)
    assert [rock.name for rock in scene.rocks] == ["salt", "shale"]
    assert scene.rocks[1].density == 2600
    assert scene.rocks[1].color == "#112233"
    assert [(unit.name, unit.rock) for unit in scene.units] == [
        ("salt", 0),
        ("shale", 1),
        ("roof", 0),
    ]
    assert [line.name for line in scene.lines] == ["salt / shale", "shale / roof"]
    assert scene.time.marks == (0.0, -2e6 * YEAR)
    assert scene.gravity == 9.81
    assert any("marl" in note for note in scene.notes)


def test_units_of_layers(case):
    scene = case().scene
    points = np.array([[1e3, -3801.0], [1e3, -3799.0], [3.5e3, -4201.0], [3.5e3, -4199.0]])
    assert scene.unit_at(points).tolist() == [0, 1, 0, 1]
    assert scene.unit_at(points).dtype == np.int16
    assert scene.unit_at(np.array([[5e3, 0.0], [0.0, -5e3], [5e3, -1999.0]])).tolist() == [2, 0, 2]


def test_horizons_follow_short_waves(case):
    line = case(CASE, "section.layers.0.top.cosine.wavelength=100 m").scene.lines[0]
    assert len(line.points) >= 2000
    z = -4e3 + 200 * np.cos(2 * np.pi * (line.points[:, 0] - 1e3) / 100)
    np.testing.assert_allclose(line.points[:, 1], z, atol=1e-6)


@pytest.mark.parametrize("path", CASES, ids=lambda path: f"{path.parent.name}-{path.stem}")
def test_the_resolved_case_is_the_same_case(path, tmp_path):
    loaded = load(path)
    for section in path.parent.glob("*.geojson"):
        shutil.copy(section, tmp_path)
    again = tmp_path / path.name
    again.write_text(loaded.resolved, encoding="utf-8")
    twice = load(again)
    assert twice.resolved == loaded.resolved
    same(loaded.scene, twice.scene)


def test_defaults_and_their_values_written_out_resolve_alike(case):
    """The hash of a run is of the resolved case: it may not tell a default from its value."""
    plain = case().resolved
    given = [
        "particles.per_cell=4",
        "mesh.cells=[90, 45]",
        "time.min_steps=10",
        "time.courant=1.0",
        "section.layers.0.name=salt",
        "boundary.base=no-slip",
        "title=folder",
    ]
    assert case(CASE, *given).resolved == plain
    assert case(CASE, "particles.per_cell=5").resolved != plain


def test_resolved_names_every_default(case):
    entries = YAML(typ="safe", pure=True).load(case().resolved)
    assert list(entries) == [
        "title", "section", "rocks", "boundary", "gravity", "mesh", "particles", "transfer",
        "solver", "time", "accuracy", "output", "certificate",
    ]  # fmt: skip
    assert entries["mesh"] == {
        "cells": [90, 45],
        "element": "P2-P1",
        "interfaces": "particles",
    }
    assert entries["solver"] == {"name": "auto", "options": {}, "reproducible": True}
    assert entries["rocks"]["salt"]["color"].startswith("#")
    assert entries["section"]["layers"][2]["name"] == "roof"


def test_plans_of_mesh_and_solver(case):
    refine = "mesh.refine={levels: 3, where: [faults, velocity-gradient], every: 4}"
    scene = case(CASE, refine, "solver={name: fieldsplit, options: {ksp_rtol: 1e-10}}").scene
    assert scene.mesh.refine == RefinePlan(3, ("faults", "velocity-gradient"), 4)
    assert scene.solver == SolverPlan("fieldsplit", (("ksp_rtol", "1e-10"),))
    assert case(CASE, "mesh.refine={where: interfaces}").scene.mesh.refine.where == ("interfaces",)


def test_a_fitted_case_resolves_without_averages_to_a_case_again(case, tmp_path):
    loaded = case(CASE, "mesh.interfaces=fitted", "mesh.refine={levels: 1}")
    assert loaded.scene.mesh.interfaces == "fitted"
    again = tmp_path / "again.yaml"
    again.write_text(loaded.resolved, encoding="utf-8")
    assert load(again).resolved == loaded.resolved


@pytest.mark.parametrize(
    ("entry", "velocity", "traction"),
    [
        ("no-slip", (0.0, 0.0), (0.0, 0.0)),
        ("free-slip", (0.0, None), (0.0, 0.0)),
        ("{velocity: [10 mm/yr, free]}", (0.01 / YEAR, None), (0.0, 0.0)),
        ("{velocity: [0 mm/yr, -1 mm/yr]}", (0.0, -0.001 / YEAR), (0.0, 0.0)),
        ("{traction: [0 MPa, -5 MPa]}", (None, None), (0.0, -5e6)),
    ],
)
def test_walls(case, entry, velocity, traction):
    free = "boundary.surface={traction: [0 MPa, 0 MPa]}"
    wall = case(CASE, f"boundary.left={entry}", free).scene.walls["left"]
    assert wall.velocity == pytest.approx(velocity)
    assert wall.traction == traction


OPEN = ("boundary.surface={traction: [0 MPa, 0 MPa]}", "time.marks=[0 Myr, 2 Myr]")
TABLES = (
    "{velocity: [{at: [0 km, -1 km, -2 km], value: [10 mm/yr, 10 mm/yr, 0 mm/yr]}, free]}",
    "{velocity: [{time: [0 kyr, 20 kyr], value: [1 cm/yr, 0 mm/yr]}, free]}",
    "{velocity: [0 mm/yr, {at: [-4 km, 0 km], time: [0 yr, 9 yr], "
    "value: [[0 mm/yr, 1 mm/yr], [0 mm/yr, 2 mm/yr]]}]}",
    "{traction: [0 MPa, {time: [20 kyr, 0 kyr], value: [-5 MPa, 0 MPa]}]}",
)


@pytest.mark.parametrize("entry", TABLES)
def test_a_case_with_tables_resolves_to_a_case_again(case, tmp_path, entry):
    loaded = case(CASE, f"boundary.left={entry}", *OPEN)
    again = tmp_path / "again.yaml"
    again.write_text(loaded.resolved, encoding="utf-8")
    assert load(again).resolved == loaded.resolved
    assert load(again).scene.walls == loaded.scene.walls
    assert not loaded.scene.sealed
    json.dumps(describe(loaded), allow_nan=False)


def test_tables_are_read_along_the_wall_and_in_time(case):
    along, in_time, both, pushed = (
        case(CASE, f"boundary.left={entry}", *OPEN).scene.walls["left"] for entry in TABLES
    )
    points = np.array([[0, 0], [0, -1500], [0, -4000.0]])
    mm = 1e-3 / YEAR
    assert along.velocity[0](points) == pytest.approx(np.array([10, 5, 0]) * mm)
    assert in_time.velocity[0](points, 5e3 * YEAR) == pytest.approx(np.full(3, 7.5) * mm)
    assert in_time.velocity[0](points, 5e6 * YEAR) == pytest.approx(np.zeros(3))
    assert both.velocity[1](points, 4.5 * YEAR) == pytest.approx(np.array([1.5, 0.9375, 0]) * mm)
    assert pushed.traction[1](points, 5e3 * YEAR) == pytest.approx(np.full(3, -1.25e6))


def test_ages_of_a_table_count_back_as_those_of_the_marks(case):
    left = "boundary.left={velocity: [{time: [0 Ma, 2 Ma], value: [0 mm/yr, 4 mm/yr]}, free]}"
    loaded = case(CASE, left, OPEN[0])
    table = loaded.scene.walls["left"].velocity[0]
    assert table.times == pytest.approx((-2e6 * YEAR, 0))
    assert table(np.zeros((1, 2)), -1.5e6 * YEAR) == pytest.approx(3e-3 / YEAR)
    told = describe_text(loaded)
    assert "velocity [0 mm/yr to 4 mm/yr in time, free]" in told
    assert "active     walls that vary" in told


@pytest.mark.parametrize(
    ("boundary", "message"),
    [
        (
            "{base: free-slip, left: {traction: [0 Pa, 0 Pa]}, right: {traction: [0 Pa, 0 Pa]}}",
            "no wall holds the section from moving sideways",
        ),
        (
            "{base: {traction: [0 MPa, 0 MPa]}, surface: {traction: [0 MPa, 0 MPa]}}",
            "no wall holds the section from moving up or down",
        ),
        ("{left: {velocity: [10 mm/yr, free]}}", "let 50 m^2/yr more in than out"),
        ("{surface: {velocity: [free, 1 mm/yr]}}", "let 10 m^2/yr more out than in"),
    ],
)
def test_walls_that_cannot_be(case, boundary, message):
    with pytest.raises(CaseError) as caught:
        case(CASE, f"boundary={boundary}")
    assert message in str(caught.value)


def test_balanced_walls_pass(case):
    case(CASE, "boundary={left: {velocity: [1 cm/yr, free]}, right: {velocity: [1 cm/yr, free]}}")


@pytest.mark.parametrize("axis", [0, 1])
def test_cells_along_the_shorter_side(case, axis):
    scene = case(CASE, "mesh.cells=7", f"section.box={{width: {[3, 16][axis]} km, height: 6 km}}")
    assert scene.scene.cells == [(7, 14), (19, 7)][axis]


def test_a_cloud_of_particles(tmp_path):
    (tmp_path / "cloud.csv").write_text("x,z,unit\n1,4,salt\n1,1,shale\n3,1,shale\n")
    text = CASE[: CASE.index("  layers")] + "  particles: cloud.csv\n  vertical: down\n"
    text += "  coordinates: km\n" + CASE[CASE.index("rocks:") :]
    (tmp_path / "case.yaml").write_text(text)
    scene = load(tmp_path / "case.yaml").scene
    np.testing.assert_array_equal(scene.cloud.x, [[1e3, -4e3], [1e3, -1e3], [3e3, -1e3]])
    names = [scene.units[row].name for row in scene.cloud.unit]
    assert names == ["salt", "shale", "shale"]
    assert scene.unit_at(np.array([[0.0, -5e3]])) == [scene.cloud.unit[0]]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ("x,y,unit\n1,2,salt\n", "cloud.csv:1: the first line names x, y and unit"),
        ("x,z,unit\n1,nan,salt\n", "cloud.csv:2: '1,nan,salt' is not a finite x"),
        ("x,z,unit\n1,1\n", "cloud.csv:2: '1,1' is not a finite x"),
        ("x,z,unit\n", "cloud.csv: holds no particle"),
        ("x,z,unit\n1,-1,salt\n", "1 of 1 particles are outside the box"),
        ("x,z,unit\n1,1,slat\n", "units without a rock: slat"),
        ("", "cloud.csv: is empty"),
    ],
)
def test_clouds_that_are_wrong(tmp_path, rows, message):
    (tmp_path / "cloud.csv").write_text(rows)
    text = CASE[: CASE.index("  layers")] + "  particles: cloud.csv\n  vertical: down\n"
    text += "  coordinates: km\n" + CASE[CASE.index("rocks:") :]
    (tmp_path / "case.yaml").write_text(text)
    with pytest.raises(CaseError) as caught:
        load(tmp_path / "case.yaml")
    assert message in str(caught.value)
    assert "Traceback" not in str(caught.value)


@pytest.mark.parametrize("name", ["/etc/passwd", "../up.geojson", "link.geojson", "a/../../b"])
def test_no_file_outside_the_folder_is_opened(tmp_path, name):
    folder = tmp_path / "inner"
    folder.mkdir()
    (tmp_path / "up.geojson").write_text("{}")
    (folder / "link.geojson").symlink_to(tmp_path / "up.geojson")
    text = f"section: {{file: {name}}}\n" + CASE[CASE.index("rocks:") :]
    (folder / "case.yaml").write_text(text)
    with pytest.raises(CaseError, match="--allow-outside"):
        load(folder / "case.yaml")


def test_the_outline_is_that_of_the_mesh_and_what_it_cuts_off_is_told(tmp_path):
    """A sawtooth surface of 100 m: ten columns cannot carry it, a hundred can."""
    x = np.arange(0, 4001, 200)
    top = [[float(a), -100.0 * (i % 2)] for i, a in enumerate(x)]
    ring = [[0, -2000], [4000, -2000], *top[::-1], [0, -2000]]
    feature = {
        "type": "Feature",
        "properties": {"unit": "salt"},
        "geometry": {"type": "Polygon", "coordinates": [ring]},
    }
    collection = {"type": "FeatureCollection", "features": [feature]}
    (tmp_path / "s.geojson").write_text(json.dumps(collection))
    (tmp_path / "case.yaml").write_text(
        "section: {file: s.geojson}\n"
        "rocks: {salt: {density: 2160 kg/m^3, viscosity: 1e17 Pa s}}\n"
        "time: {marks: [0 Ma, 1 Ma]}\n"
    )
    coarse = load(tmp_path / "case.yaml", ["mesh.cells=[10, 5]"]).scene
    assert len(coarse.outline.surface) == 11
    assert any("cut off up to 100 m of the relief" in note for note in coarse.notes)
    fine = load(tmp_path / "case.yaml", ["mesh.cells=[100, 5]"]).scene
    assert not fine.notes
    assert fine.outline.area == pytest.approx(4000 * 1950, rel=1e-9)

"""Faults with a width and a rock: bands in the section, on meshes, as particles, in motion."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import shapely

from restoration.bands import areas, distance_to, mesh_lines, rings, section_of
from restoration.check import describe, describe_text
from restoration.diagnostics import line_distances
from restoration.engine import StokesEngine
from restoration.errors import CaseError, MeshError
from restoration.lines import begin
from restoration.mesher import Mesher
from restoration.particles import subset
from restoration.resolve import load
from restoration.run import march
from restoration.scene import Line
from restoration.seeding import seed_points
from tests.meshes.test_section import least_angle

ROCKS = """\
rocks:
  salt: {density: 2160 kg/m^3, viscosity: 1e17 Pa s}
  sand: {density: 2600 kg/m^3, viscosity: 1e20 Pa s}
  weak: {density: 2600 kg/m^3, viscosity: 1e18 Pa s}
time: {marks: [0 kyr, 100 kyr, 0 kyr], min_steps: 2}
"""
BOX = """\
section:
  box: {width: 6 km, height: 2 km}
  layers:
    - {rock: salt, top: {depth: 1.6 km}}
    - {rock: sand, top: {depth: 0.8 km}}
    - {rock: sand, name: cover}
boundary: {base: free-slip}
"""
SLOPE = "section: {file: slope.geojson}\n"
POLYGONS = {
    "salt": [[0, -2000], [6000, -2000], [6000, -1600], [0, -1600]],
    "sand": [[0, -1600], [6000, -1600], [6000, 200], [3000, 50], [0, -200]],
}
DRAWN = [[1000, 300], [2000, -1700]]
GRABEN = (
    "{name: west, rock: weak, width: 50 m, at: 2 km, dip: 60 deg, to: 1.6 km}",
    "{name: east, rock: weak, width: 50 m, at: 4 km, dip: -60 deg, to: 1.6 km}",
)
FAULTS = {
    "graben": (BOX, *GRABEN),
    "listric": (
        BOX,
        "{name: L, rock: weak, width: 50 m, at: 1 km, dip: 65 deg, detachment: 1.4 km}",
    ),
    "crossing": (
        BOX,
        "{name: a, rock: weak, width: 50 m, at: 2.5 km, dip: 60 deg, to: 1.6 km}",
        "{name: b, rock: salt, width: 80 m, at: 3.5 km, dip: -60 deg}",
        "{name: c, rock: weak, width: 30 m, at: 2.2 km, dip: 70 deg}",
    ),
    "tips": (
        BOX,
        "{name: a, rock: weak, width: 50 m, points: "
        "[[2 km, 300 m], [2.4 km, 1 km], [2.5 km, 1.4 km]]}",
        "{name: b, rock: weak, width: 50 m, at: 4 km, depth: 1 km, dip: 45 deg, "
        "from: 500 m, to: 1.8 km}",
    ),
    "thin": (BOX, *(fault.replace("50 m", "6 m") for fault in GRABEN)),
    "touching": (
        BOX,
        "{name: a, rock: weak, width: 50 m, at: 2 km, dip: 60 deg, to: 1599.9 m}",
        "{name: b, rock: weak, width: 50 m, at: 2.05774 km, dip: 60 deg, to: 1.6 km}",
        "{name: corner, rock: weak, width: 50 m, points: [[5.5 km, 0.3 km], [6 km, 0 km]]}",
        "{name: loop, rock: weak, width: 50 m, points: "
        "[[4 km, 0.3 km], [5 km, 0.3 km], [5 km, 1.2 km], [4 km, 1.2 km], [4 km, 0.32 km]]}",
    ),
    "slope": (
        SLOPE,
        "{rock: weak, width: 60 m, line: F1}",
        "{name: F2, rock: weak, width: 60 m, at: 4.5 km, dip: -55 deg, to: 1.6 km}",
        "{name: F3, rock: weak, width: 60 m, points: [[2.5 km, 0 km], [3.5 km, 1.2 km]]}",
    ),
}


@pytest.fixture
def case(tmp_path):
    """Return a function that loads a case of faults."""
    features = [
        {
            "type": "Feature",
            "properties": {"unit": unit},
            "geometry": {"type": "Polygon", "coordinates": [[*points, points[0]]]},
        }
        for unit, points in POLYGONS.items()
    ]
    drawn = {"type": "LineString", "coordinates": DRAWN}
    features.append({"type": "Feature", "properties": {"name": "F1"}, "geometry": drawn})
    text = json.dumps({"type": "FeatureCollection", "features": features})
    (tmp_path / "slope.geojson").write_text(text)

    def read(section, *faults, mesh="{cells: 20}", more=""):
        entries = "".join(f"  - {fault}\n" for fault in faults)
        path = tmp_path / "case.yaml"
        path.write_text(f"{section}{ROCKS}mesh: {mesh}\nfaults:\n{entries}{more}")
        return load(path)

    return read


def test_a_fault_is_a_unit_a_line_and_an_edge(case):
    scene = case(BOX, *GRABEN).scene
    assert [unit.name for unit in scene.units] == ["salt", "sand", "cover", "west", "east"]
    assert [scene.rocks[unit.rock].name for unit in scene.units[3:]] == ["weak", "weak"]
    assert [(fault.name, fault.unit, fault.width) for fault in scene.faults] == [
        ("west", 3, 50.0),
        ("east", 4, 50.0),
    ]
    kinds = [(line.name, line.kind) for line in scene.lines]
    assert kinds[2:] == [("west", "fault"), ("west", "edge"), ("east", "fault"), ("east", "edge")]
    assert all(np.ptp(line.points[:, 0]) == 6000 for line in scene.lines[:2])  # through the bands
    foot = 1600 / np.tan(np.pi / 3)
    assert scene.lines[2].points == pytest.approx(np.array([[2000, 0], [2000 + foot, -1600]]))
    half = 25 / np.sin(np.pi / 3) - 0.01
    at = [(2000 - half, -1e-6), (2000 + half, 0), (2000 - half - 0.02, 0), (4000, 0), (2000, -1000)]
    assert scene.unit_at(np.array(at)).tolist() == [3, 3, 2, 4, 1]
    area = areas(scene.lines)["west"]
    assert area.area == pytest.approx(1600 * 50 / np.sin(np.pi / 3))
    assert area.bounds[1] == -1600  # cut level, at the top of the salt


def test_dips_are_to_the_right_or_to_the_left(case):
    for dip, x in (
        ("60 deg", 2577.35),
        ("-60 deg", 1422.65),
        ("90 deg", 2000),
        ("-1.0472 rad", 1422.65),
    ):
        fault = f"{{name: F, rock: weak, width: 20 m, at: 2 km, dip: {dip}, to: 1 km}}"
        assert case(BOX, fault).scene.lines[2].points[-1] == pytest.approx((x, -1000), abs=0.01)


def test_a_listric_fault_is_level_at_its_detachment(case):
    points = case(*FAULTS["listric"]).scene.lines[2].points
    step = np.diff(points, axis=0)
    dip = -np.degrees(np.arctan2(*step.T[::-1]))
    assert dip[0] == pytest.approx(65, abs=2)
    assert dip[-1] == pytest.approx(0, abs=2)
    assert (np.diff(dip) < 0).all()
    assert points[-1, 1] == pytest.approx(-1400)


def test_the_later_band_is_on_top(case):
    section, *faults = FAULTS["crossing"]
    for order in (faults, faults[::-1]):
        scene = case(section, *order).scene
        named = areas(scene.lines)
        (a, b) = (named[name] for name in "ab")
        at = shapely.get_coordinates(a.intersection(b).centroid)
        last = scene.faults[1 if order is faults else 2].name if order is faults else "a"
        assert scene.units[scene.unit_at(at)[0]].name == last


def test_a_drawn_line_gets_a_width(case):
    scene = case(SLOPE, "{name: main, rock: weak, width: 60 m, line: F1}").scene
    assert [(line.name, line.kind) for line in scene.lines[1:]] == [
        ("main", "fault"),
        ("main", "edge"),
    ]
    surface = shapely.LineString(scene.outline.surface).buffer(1e-6)
    edge = areas(scene.lines)["main"].boundary
    between = np.arctan(2) + np.arctan(250 / 3000)
    assert edge.intersection(surface).length == pytest.approx(60 / np.sin(between), rel=1e-3)


@pytest.mark.parametrize(
    ("section", "fault", "message"),
    [
        (SLOPE, "{rock: weak, width: 60 m, line: F2}", "no fault line 'F2'; possible: F1"),
        ("section: {particles: a.csv, box: {width: 6 km, height: 2 km}}\n", GRABEN[0], "cloud of"),
    ],
)
def test_faults_that_cannot_be(case, section, fault, message):
    with pytest.raises(CaseError, match=message):
        case(section, fault)


@pytest.mark.parametrize("name", FAULTS)
def test_the_resolved_case_is_a_case_again(case, tmp_path, name):
    loaded = case(*FAULTS[name])
    again = tmp_path / "again.yaml"
    again.write_text(loaded.resolved)
    other = load(again)
    assert other.resolved.splitlines()[-40:] == loaded.resolved.splitlines()[-40:]
    assert other.scene.faults == loaded.scene.faults


@pytest.mark.parametrize("name", FAULTS)
def test_a_fitted_mesh_follows_bands(case, name):
    scene = case(*FAULTS[name], mesh="{cells: 20, interfaces: fitted}").scene
    mesher = Mesher(scene)
    section, points = mesher.mesh(begin(scene.lines, mesher.finest / 4))
    assert section.areas.sum() == pytest.approx(scene.outline.area)
    assert section.areas.min() > 0
    assert least_angle(section) > 15
    unit = scene.unit_at(points)[section.regions]
    middles = section.corners.mean(axis=1)
    above = shapely.Polygon()
    for fault in reversed(scene.faults):
        area = areas(scene.lines)[fault.name]
        own = area.difference(above)
        above = above.union(area)
        inside = unit == fault.unit
        assert section.areas[inside].sum() == pytest.approx(own.area, rel=2e-4)
        if name == "touching":  # where slivers between bands are closed
            continue
        assert np.array_equal(inside, shapely.contains_xy(own, *middles.T))
        sides = np.diff(section.corners[inside][:, [0, 1, 2, 0]], axis=1)
        assert np.hypot(*sides.T).max() < 0.8 * fault.width
    rock = np.array([one.rock for one in scene.units])
    expected = rock[scene.unit_at(middles)]
    assert section.areas[rock[unit] != expected].sum() < 1e-4 * scene.outline.area


def test_layers_of_one_rock_are_no_mesh_lines(case):
    mesher = Mesher(case(*FAULTS["crossing"]).scene)
    assert mesher.contacts == {"salt / sand"}


def test_a_mesh_refined_at_faults_is_finest_throughout_their_bands(case):
    wide = GRABEN[0].replace("50 m", "200 m")
    mesh = "{cells: 20, refine: {levels: 2, where: [faults]}}"
    scene = case(BOX, wide, GRABEN[1], mesh=mesh).scene
    mesher = Mesher(scene)
    section, _ = mesher.mesh(begin(scene.lines, mesher.finest / 4))
    inside = np.isin(scene.unit_at(section.corners.mean(axis=1)), [3, 4])
    assert np.sqrt(4 * section.areas[inside]).max() == pytest.approx(25)
    assert np.sqrt(4 * section.areas).max() == pytest.approx(100)
    x, unit, area = seed_points(scene)
    for fault in scene.faults:
        own = unit == fault.unit
        band = areas(scene.lines)[fault.name]
        assert area[own].sum() == pytest.approx(band.area, rel=0.02)
    cell = mesher.mesh(scene.lines)[0]
    assert own.sum() > 2 * np.isin(scene.unit_at(cell.corners.mean(axis=1)), [4]).sum()
    assert len(x) < 200_000


@pytest.mark.parametrize("width", ["50 m", "12 m", "3 m"])
def test_particles_lie_at_least_two_across_a_band(case, width):
    scene = case(BOX, *(fault.replace("50 m", width) for fault in GRABEN)).scene
    _, unit, area = seed_points(scene)
    assert area.sum() == pytest.approx(scene.outline.area)
    for fault in scene.faults:
        band = areas(scene.lines)[fault.name]
        own = unit == fault.unit
        assert own.sum() > 3.5 * band.area / fault.width**2
        assert area[own].sum() == pytest.approx(band.area, rel=0.03)


def test_a_band_thinner_than_the_cells_is_noted(case):
    assert "write mesh.refine: {levels: 1, where: [faults]}" in case(BOX, *GRABEN).scene.notes[-1]
    refined = "{cells: 20, refine: {levels: 1, where: [faults]}}"
    for mesh in (refined, "{cells: 50}", "{cells: 10, interfaces: fitted}"):
        assert case(BOX, *GRABEN, mesh=mesh).scene.notes == ()


def test_check_tells_of_faults_and_not_of_edges(case):
    loaded = case(BOX, *GRABEN)
    kinds = [(row["name"], row["kind"], row["width_m"]) for row in describe(loaded)["lines"]]
    assert kinds[-2:] == [("west", "fault", 50.0), ("east", "fault", 50.0)]
    assert len(kinds) == 4
    assert "fault      west, 1.85 km long, 50 m wide" in describe_text(loaded)


def test_edges_are_not_reported_as_horizons(case):
    lines = case(BOX, *GRABEN).scene.lines
    rows = [(row["name"], row["kind"]) for row in line_distances(lines, lines)]
    assert rows[2:] == [("west", "fault"), ("east", "fault")]


def test_distances_from_a_band_are_negative_inside():
    far = distance_to(shapely.box(0, 0, 100, 20), 1.0)
    assert far(np.array([[50.0, 10], [50, 25], [50, 18]])) == pytest.approx([-10, 5, -2], abs=0.03)


def test_a_line_that_creeps_along_a_band_is_led_onto_it():
    """As a horizon does that a fault has dragged."""
    outline = np.array([[0, 0], [1000, 0.0]]), np.array([[0, -500], [1000, -500.0]])
    section = section_of(SimpleNamespace(surface=outline[0], base=outline[1]))
    band = shapely.box(400, -500, 440, 0)
    dragged = np.array([[0, -300], [350, -300], [399.5, -250], [399.9, -100], [600, -100.0]])
    pieces = [
        piece for piece, size in mesh_lines([dragged], [(band, 40.0)], section, 50.0) if size == 50
    ]
    left, right = sorted(pieces, key=lambda piece: piece[0, 0])
    assert left[-1] == pytest.approx((400, -249.5), abs=1)
    assert right[0] == pytest.approx((440, -100), abs=1e-6)
    (ring,) = rings(band)
    edges = [piece for piece, size in mesh_lines([], [(band, 40.0)], section, 50.0)]
    assert {x for edge in edges for x in edge[:, 0]} == {400, 440}
    assert sum(shapely.LineString(edge).length for edge in edges) == pytest.approx(1000)
    assert len(ring) == 5


@pytest.mark.filterwarnings("ignore:invalid value")
def test_a_band_that_no_mesh_can_follow_ends_with_its_place(case):
    scene = case(BOX, *GRABEN, mesh="{cells: 20, interfaces: fitted}").scene
    mesher, lines = Mesher(scene), list(scene.lines)
    lines[0] = Line("salt / sand", "horizon", np.array([[0, -1600], [np.nan, -1500.0]]))
    with pytest.raises(MeshError, match="no mesh follows") as caught:
        mesher.mesh(lines)
    assert caught.value.exit_code == 4


def test_bands_move_with_the_rock_and_come_back(case):
    wavy = BOX.replace("1.6 km}", "1.5 km, cosine: {amplitude: 80 m, wavelength: 6 km}}")
    faults = [fault.replace("1.6 km", "1.4 km") for fault in GRABEN]
    scene = case(wavy, *faults, mesh="{cells: 10, interfaces: fitted}").scene
    engine, states = StokesEngine(scene), []
    march(engine.start(), engine, scene.time, at_marks=(lambda _, s: states.append(s),))
    west = next(fault.unit for fault in scene.faults if fault.name == "west")
    for state in states:  # by its edges: no particle of the bands is needed
        grid = state.grid
        weak = grid.index.area[grid.fields.unit == west].sum()
        assert weak == pytest.approx(areas(state.lines)["west"].area, rel=1e-2)
    first, moved, last = (areas(state.lines)["west"] for state in states)
    assert moved.symmetric_difference(first).area > 0.03 * first.area
    assert moved.area == pytest.approx(first.area, rel=3e-3)
    assert last.symmetric_difference(first).area < 0.005 * first.area
    assert states[-1].particles.lost == 0


def test_a_band_keeps_its_rock_without_particles(case):
    scene = case(*FAULTS["crossing"], mesh="{cells: 10, interfaces: fitted}").scene
    engine = StokesEngine(scene)
    state = engine.start()
    bands = [fault.unit for fault in scene.faults]
    bare = ~np.isin(state.particles.unit, bands)
    state = engine.with_flow(replace(state, particles=subset(state.particles, bare)))
    middles = state.grid.index.corners.mean(axis=1)
    expected = scene.unit_at(middles)
    off = (state.grid.fields.unit != expected) & (
        np.isin(expected, bands) | np.isin(state.grid.fields.unit, bands)
    )
    assert state.grid.index.area[off].sum() < 1e-4 * scene.outline.area

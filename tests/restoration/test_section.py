"""A drawn section: what is read from it, what is closed, and what each fault says."""

import json
import re
from pathlib import Path
from time import perf_counter

import numpy as np
import pytest

from restoration.errors import CaseError
from restoration.section import read_section, survey

ROOT = Path(__file__).parents[2]
REAL = sorted((ROOT.parent / "shared" / "data").glob("*/section.geojson"))
CRS84 = {"type": "name", "properties": {"name": "urn:ogc:def:crs:OGC:1.3:CRS84"}}


def feature(kind, coordinates, /, **properties):
    geometry = {"type": kind, "coordinates": coordinates}
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def polygon(unit, *points, holes=(), **properties):
    rings = [[*map(list, ring), list(ring[0])] for ring in (points, *holes)]
    return feature("Polygon", rings, unit=unit, **properties)


def box(unit, x0, z0, x1, z1, **properties):
    return polygon(unit, (x0, z0), (x1, z0), (x1, z1), (x0, z1), **properties)


def sand(*low, high=((5000, 0), (0, 0))):
    """The upper layer over a given lower border, from left to right."""
    return polygon("sand", (0, -1000), *low, (5000, -1000), *high)


SALT = box("salt", 0, -2000, 5000, -1000, kind="evaporite")
SAND = box("sand", 0, -1000, 5000, 0, kind="clastic")
FAULT = feature("LineString", [[1000, 0], [1500, -2000]], name="F1")
HOLE = [(1000, -800), (2000, -800), (2000, -200), (1000, -200)]


def collection(*features, **members):
    return {"type": "FeatureCollection", "features": list(features), **members}


def moved(item, scale, x=0.0, z=0.0):
    """The same feature with other coordinates."""
    rings = item["geometry"]["coordinates"]
    return feature(
        "Polygon",
        [[[a * scale + x, b * scale + z] for a, b in ring] for ring in rings],
        **item["properties"],
    )


@pytest.fixture
def read(tmp_path):
    """Return a function that reads features, a GeoJSON object, text or bytes as a section."""

    def read(*content, reader=read_section, **settings):
        (data,) = content if isinstance(content[0], (str, bytes)) else (collection(*content),)
        data = json.dumps(data) if isinstance(data, dict) else data
        path = tmp_path / "section.geojson"
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
        return reader(path, "my.geojson", **settings)

    return read


def names(section, points):
    return [section.units[row] for row in section.unit_at(np.array(points))]


def test_a_section_has_units_contacts_faults_and_a_frame(read):
    section = read(SAND, SALT, FAULT, rock_property="kind")
    assert section.units == ("salt", "sand")
    assert section.keys == {"salt": ("evaporite",), "sand": ("clastic",)}
    assert section.areas == {"salt": 5e6, "sand": 5e6}
    horizon, fault = section.lines
    assert (horizon.name, horizon.kind) == ("salt / sand", "horizon")
    assert sorted(horizon.points.tolist()) == [[0, -1000], [5000, -1000]]
    assert (fault.name, fault.kind) == ("F1", "fault")
    assert fault.points.tolist() == [[1000, 0], [1500, -2000]]
    assert section.outline.surface.tolist() == [[0, 0], [5000, 0]]
    assert section.outline.base.tolist() == [[0, -2000], [5000, -2000]]
    assert names(section, [(1, -1999), (1, -1)]) == ["salt", "sand"]
    assert section.unit_at(np.zeros((3, 2))).dtype == np.int16
    assert "the width and the rock" in section.notes[0]


def test_points_outside_belong_to_the_nearest_polygon(read):
    section = read(SAND, SALT)
    assert names(section, [(-50, -1800), (2500, 90), (9000, -400)]) == ["salt", "sand", "sand"]
    assert section.unit_at(np.empty((0, 2))).shape == (0,)


def test_kilometres_and_depth_are_turned_to_metres_up(read):
    drawn = [moved(SALT, 1e-3), moved(SAND, 1e-3)]
    for item in drawn:
        for ring in item["geometry"]["coordinates"]:
            for point in ring:
                point[1] = -point[1]
    section = read(*drawn, scale=1e3, sign=-1.0)
    assert section.units == ("salt", "sand")
    assert section.areas == pytest.approx({"salt": 5e6, "sand": 5e6})
    assert section.outline.base[:, 1].tolist() == [-2000, -2000]
    assert section.notes == ()


def test_a_unit_may_have_several_polygons_and_parts(read):
    parts = [moved(SALT, 0.4), moved(SALT, 0.4, x=3000)]
    rings = [[[[x, z - 1000] for x, z in p["geometry"]["coordinates"][0]]] for p in parts]
    rings = [[[[x, -2000 + 1000 * (z > -1700)] for x, z in r] for r in part] for part in rings]
    section = read(
        SAND, feature("MultiPolygon", rings, unit="salt"), box("shale", 2000, -2000, 3000, -1000)
    )
    assert names(section, [(1000, -1500), (2500, -1500), (4000, -1500)]) == [
        "salt",
        "shale",
        "salt",
    ]
    pieces = [line.name for line in section.lines]
    assert len([name for name in pieces if "sand" in name and "salt" in name]) == 2
    assert len([name for name in pieces if "shale" in name and "salt" in name]) == 2


def test_parts_that_share_an_edge_are_one_body(read):
    rings = [item["geometry"]["coordinates"] for item in (SALT, SAND)]
    section = read(feature("MultiPolygon", rings, unit="all"))
    assert (section.units, section.lines, section.areas) == (("all",), (), {"all": 1e7})


def test_a_hole_may_be_filled_by_another_polygon(read):
    section = read(
        SALT,
        polygon("sand", (0, -1000), (5000, -1000), (5000, 0), (0, 0), holes=[HOLE]),
        polygon("plug", *HOLE),
    )
    assert names(section, [(1500, -500), (500, -500)]) == ["plug", "sand"]
    ring = next(line.points for line in section.lines if "plug" in line.name)
    assert (ring[0] == ring[-1]).all()


@pytest.mark.parametrize(
    "upper",
    [
        sand((2000, -1000), (2500, -999), (3000, -1000)),  # a gap
        sand((2000, -1000), (2500, -1001), (3000, -1000)),  # an overlap
        box("sand", 0, -999, 5000, 0),  # a gap that is open at both sides
        box("sand", 0, -1001, 5000, 0),
    ],
)
def test_slivers_are_closed_with_a_note(read, upper):
    section = read(SALT, upper)
    assert sum(section.areas.values()) == pytest.approx(1e7, rel=1e-9)
    assert section.outline.area == pytest.approx(1e7, rel=1e-9)
    assert [line.name for line in section.lines] == ["salt / sand"]
    assert np.abs(section.lines[0].points[:, 1] + 1000).max() <= 1
    assert section.notes[0].startswith("1 sliver between polygons, narrower than 2 m, closed")
    with pytest.raises(CaseError):
        read(SALT, upper, tolerance=0.5)


def test_a_narrow_gap_open_to_the_surface_is_closed(read):
    section = read(SALT, box("w", 0, -1000, 2500, 0), box("e", 2501, -1000, 5000, 0))
    assert section.outline.surface[:, 1].tolist() == [0] * len(section.outline.surface)
    assert "e / w" in [line.name for line in section.lines]
    assert sum(section.areas.values()) == pytest.approx(1e7)


@pytest.mark.parametrize("depth", [-970, -985.3, -1012.34])
def test_the_tolerance_that_a_message_names_closes_the_flaw(read, depth):
    drawn = SALT, sand((2000, -1000), (2500, depth), (3000, -1000))
    (line,) = refused(read, *drawn)
    enough = float(re.search(r"tolerance: (\S+) m would close it", line)[1])
    assert read(*drawn, tolerance=enough).areas["salt"] == pytest.approx(5e6, rel=0.01)


def test_neighbours_with_different_vertices_share_one_contact(read):
    x = np.linspace(0, 5000, 51)
    wave = np.column_stack([x, -1000 + 100 * np.sin(x / 800)])
    coarse = np.array([np.interp(x[::2], x, wave[:, 1])]).T
    lower = [(0, -2000), (5000, -2000), *wave[::-1].tolist()]
    upper = [*np.hstack([x[::2, None], coarse]).tolist(), (5000, 0), (0, 0)]
    section = read(polygon("salt", *lower), polygon("sand", *upper), tolerance=3.0)
    assert [line.name for line in section.lines] == ["salt / sand"]
    assert sum(section.areas.values()) == pytest.approx(1e7)


def test_sides_are_straightened_within_the_tolerance(read):
    section = read(SALT, sand(high=((4999, 0), (0, 0))))
    assert section.outline.surface.tolist() == [[0, 0], [5000, 0]]
    assert "the right side was straightened by up to 1 m" in section.notes


def test_dense_surface_points_beside_a_side_are_kept(read):
    high = [(x, 5 * np.sin(x / 300)) for x in np.arange(5000, -0.5, -1.0)]
    section = read(SALT, sand(high=high))
    assert len(section.outline.surface) == 5001
    assert section.notes == ()


def test_faults_are_cut_at_the_frame(read):
    long = feature("MultiLineString", [[[1000, 500], [1000, -2500]]], unit="F2")
    section = read(SALT, SAND, long)
    assert sorted(section.lines[-1].points.tolist()) == [[1000, -2000], [1000, 0]]
    assert "fault 'F2' reaches beyond the section; it is cut there" in section.notes


def test_what_is_no_polygon_or_line_is_skipped_with_a_note(read):
    section = read(SALT, SAND, feature("Point", [1, 2]), {"type": "Feature", "geometry": None})
    assert "features[2] ('Point') is skipped" in section.notes[0]
    assert "features[3] (no geometry) is skipped" in section.notes[1]


def test_numbers_name_units_too(read):
    drawn = [SALT | {"properties": {"unit": 3.0}}, SAND | {"properties": {"unit": 4.5}}]
    assert read(*drawn).units == ("3", "4.5")


@pytest.mark.parametrize(
    ("drawn", "note"),
    [
        ([SALT, SAND | {"properties": {"unit": "Salt"}}], "units 'salt' and 'Salt' stay apart"),
        (
            [moved(SALT, 1e-3), moved(SAND, 1e-3)],
            "only 5 m wide and 2 m high; if it is drawn in km",
        ),
        ([SALT, SAND, SAND], "features[1] and features[2] overlap near x = 2.500 km"),
        (
            [
                SALT,
                feature(
                    "Polygon",
                    [[[0, -1000, 7], [5000, -1000, 7], [5000, 0, 7], [0, 0, 7], [0, -1000, 7]]],
                    unit="sand",
                ),
            ],
            "a third value; it is not used",
        ),
    ],
)
def test_notes(read, drawn, note):
    assert any(note in found for found in read(*drawn).notes)


def text(*features):
    return json.dumps(collection(*features), indent=1)


NOT_A_SECTION = {
    "empty": ("  \n", "is empty"),
    "binary": (b"SQLite format 3\0", "is a binary file"),
    "words": ("hello", "my.geojson:1:1: is not GeoJSON; export the layer"),
    "xml": ("<kml></kml>", "is XML"),
    "a comma": ('{"type": "FeatureCollection",\n "features": [,]}', "my.geojson:2:15: not JSON"),
    "cut off": (text(SALT)[:200], "was it cut off?"),
    "lines": (json.dumps(SALT) + "\n" + json.dumps(SAND), "my.geojson:2:1: a second text begins"),
    "deep": ("[" * 100_000, "nested too deeply"),
    "NaN": (text(SALT).replace("-2000", "NaN", 1), "holds NaN, which is no coordinate"),
    "Infinity": (text(SALT).replace("-2000", "-Infinity", 1), "holds -Infinity"),
    "digits": (text(SALT).replace("-2000", "9" * 5000, 1), "thousands of digits"),
    "geometry": (json.dumps(SALT["geometry"]), "is a bare Polygon without properties"),
    "topology": ('{"type": "Topology"}', "is TopoJSON"),
    "list": ("[1, 2]", "no GeoJSON FeatureCollection: it is a list of 2"),
    "no list": ('{"type": "FeatureCollection"}', "has no list of features"),
    "none": (text(), "holds no polygons"),
    "only lines": (text(FAULT), "holds no polygons, only 1 line"),
    "1e999": (
        text(SALT).replace("-2000", "1e999", 1),
        "a coordinate beyond 1e9 m; correct vertex 1",
    ),
    "500 digits": (text(SALT).replace("-2000", "9" * 500, 1), "a coordinate beyond 1e9 m"),
    "text": (text(SALT).replace("-2000", '"-2000"', 1), "holds '-2000' as a coordinate"),
    "a flag": (text(SALT).replace("-2000", "true", 1), "holds true as a coordinate"),
    "a flat list": (text(feature("Polygon", [[1, 2], [3]], unit="a")), "not a position [x, z]"),
    "no feature": (text(3), "features[0]: is '3', not a feature"),
    "bad properties": (text(SALT | {"properties": [1]}), "its properties are a list of 1"),
}
FAULTY = {
    "no size": (
        [feature("Polygon", [[[0, 0], [5000, 0], [5000, 1e-5], [0, 1e-5], [0, 0]]], unit="salt")],
        "the section is 5000 m wide and 1e-5 m high; at least 1 mm each way is needed",
    ),
    "dust beside a far point": (
        [
            moved(SALT, 1e-10),
            feature("Polygon", [[[0, 0], [1e-7, 0], [900, 1e-7], [0, 900], [0, 0]]], unit="sand"),
            feature("Polygon", [[[0, 0], [900, 900], [900, 900.0000001], [0, 0]]], unit="silt"),
        ],
        "my.geojson: ",
    ),
    "not closed": (
        [
            SAND,
            feature(
                "Polygon", [[[0, -2000], [5000, -2000], [5000, -1000], [0, -1000]]], unit="salt"
            ),
        ],
        "features[1]: a ring of polygon 'salt' is not closed: it starts at "
        "x = 0.000 km, z = -2.000 km",
    ),
    "too few": (
        [SAND, feature("Polygon", [[[0, 0], [1, 1], [0, 0]]], unit="a")],
        "only 3 positions",
    ),
    "crossing": (
        [SAND, polygon("salt", (0, -2000), (5000, -1000), (5000, -2000), (0, -1000))],
        "features[1]: polygon 'salt' crosses itself near x = 2.500 km, z = -1.500 km",
    ),
    "no area": ([SALT, SAND, polygon("thin", (0, -2000), (9, -2000), (5, -2000))], "has no area"),
    "hole outside": (
        [
            SALT,
            polygon(
                "sand",
                (0, -1000),
                (5000, -1000),
                (5000, 0),
                (0, 0),
                holes=[[(6000, 0), (7000, 0), (7000, 100)]],
            ),
        ],
        "has a hole outside of it near",
    ),
    "twice": (
        [SALT, SAND, SAND | {"properties": {"unit": "silt"}}],
        "features[2]: 'silt' is the same polygon as features[1] 'sand': delete one of them",
    ),
    "overlap": (
        [SALT, box("sand", 0, -1100, 5000, 0)],
        "features[1]: overlap near x = 2.500 km, "
        "z = -1.050 km (0.5 km^2, up to 100 m wide) of features[0] 'salt' and "
        "features[1] 'sand'",
    ),
    "drawn over": ([SALT, SAND, box("dyke", 2000, -1500, 2500, -500)], "up to 500 m wide"),
    "gap": (
        [SALT, sand((2000, -1000), (2500, -950), (3000, -1000))],
        "gap near x = 2.500 km, "
        "z = -0.975 km (0.025 km^2, up to 50 m wide) between features[0] 'salt' and "
        "features[1] 'sand': extend one of them over it",
    ),
    "empty hole": (
        [SALT, polygon("sand", (0, -1000), (5000, -1000), (5000, 0), (0, 0), holes=[HOLE])],
        "in features[1] 'sand': draw a polygon that fills it",
    ),
    "apart": (
        [SALT, box("sand", 0, -900, 5000, 0)],
        "is not in one piece: 4.5 km^2 near "
        "x = 2.500 km, z = -0.450 km lie apart, 100 m from the rest",
    ),
    "corner": ([SALT, box("e", 5000, -1000, 9000, 0)], "touching the rest at a point only"),
    "no unit": ([SALT, SAND | {"properties": {"unit": " "}}], "features[1]: has no unit"),
    "odd unit": ([SALT, SAND | {"properties": {"unit": [1]}}], "its 'unit' is a list of 1"),
    "other name": (
        [SALT | {"properties": {"Units": "a", "id": 3}}],
        "the property 'unit' is on none "
        "of the polygons; did you mean 'Units'? (possible: Units or id); name it as "
        "'property' in 'section' of the case",
    ),
    "no properties": ([SALT | {"properties": None}], "they have no properties"),
    "degrees": (
        [moved(SALT, 1e-5, 8, 49), moved(SAND, 1e-5, 8, 49)],
        "look like degrees (x from 8",
    ),
    "leaning": (
        [polygon("salt", (30, -2000), (5000, -2000), (5000, 0), (0, 0))],
        "the left side is not vertical: it runs 30 m off, to x = 0.030 km, z = -2.000 km",
    ),
    "leaning above": ([SALT, sand(high=((4800, 0), (0, 0)))], "the surface rises or falls 1000 m"),
    "stair": ([SALT, box("sand", 0, -1000, 4000, 0)], "near x = 4.000 km, z = -0.500 km"),
    "notch": (
        [SALT, box("b", 500, -1000, 5000, -500), box("c", 0, -500, 5000, 0)],
        "the left side is not one vertical line: it has a notch near x = 0.500 km, z = -0.500 km",
    ),
    "overhang": (
        [
            SALT,
            sand(
                high=(
                    (5000, 0),
                    (3000, 0),
                    (2500, 300),
                    (3200, 300),
                    (3300, 100),
                    (3400, 500),
                    (1000, 500),
                    (1000, 0),
                    (0, 0),
                )
            ),
        ],
        "the surface doubles back by 900 m",
    ),
    "a cleft": (
        [SALT, box("w", 0, -1000, 2500, 0), box("e", 2550, -1000, 5000, 0)],
        "the surface rises or falls 1000 m like a wall near x = 2.500 km",
    ),
}


def refused(read, *content, **settings):
    """Return the faults, each of one line, of what cannot be read."""
    start = perf_counter()
    with pytest.raises(CaseError) as caught:
        read(*content, **settings)
    assert perf_counter() - start < 3
    lines = str(caught.value).splitlines()
    assert len(lines) == len(caught.value.faults)
    assert all(line.startswith("my.geojson") for line in lines)
    return lines


@pytest.mark.parametrize("name", NOT_A_SECTION)
def test_what_is_no_section_is_refused(read, name):
    content, message = NOT_A_SECTION[name]
    assert message in "\n".join(refused(read, content))


@pytest.mark.parametrize("name", FAULTY)
def test_a_faulty_section_is_refused_with_its_place(read, name):
    drawn, message = FAULTY[name]
    assert message in "\n".join(refused(read, *drawn))
    assert read(*drawn, reader=survey)["polygons"] <= len(drawn)


def test_all_faults_are_told_at_once(read):
    drawn = [
        polygon("a", (0, -2000), (5000, -1000), (5000, -2000), (0, -1000)),
        feature("Polygon", [[[0, 0], [1, 1], [0, 0]]], unit="b"),
        SAND | {"properties": {"unit": None}},
    ]
    assert [line.split(": ")[1] for line in refused(read, *drawn)] == [
        f"features[{i}]" for i in range(3)
    ]


def test_an_unknown_rock_property_is_refused(read):
    (line,) = refused(read, SALT, SAND, rock_property="kinds")
    assert "the property 'kinds' is on none of the polygons; did you mean 'kind'?" in line


def test_a_claim_of_degrees_counts_only_where_they_could_be(read):
    small = [moved(SALT, 1e-3), moved(SAND, 1e-3)]
    assert read(json.dumps(collection(SALT, SAND, crs=CRS84))).notes == ()
    assert "degrees" in refused(read, json.dumps(collection(*small, crs=CRS84)))[0]
    assert read(json.dumps(collection(*small, crs=CRS84)), scale=1e3).areas["salt"] == 5e6


def test_many_gaps_are_told_as_a_number(read):
    holes = [[(x, -1800), (x + 100, -1800), (x + 100, -1500)] for x in range(100, 4000, 200)]
    corners = [(0, -2000), (5000, -2000), (5000, 0), (0, 0)]
    lines = refused(read, polygon("a", *corners, holes=holes))
    assert len(lines) == 11
    assert "and 10 smaller gaps or overlaps" in lines[-1]


def test_a_survey_tells_what_is_there(read):
    drawn = [moved(SALT, 1e-3, z=2), moved(SAND, 1e-3, z=2), FAULT]
    found = read(*drawn, reader=survey)
    assert (found["polygons"], found["fault_lines"], found["faults"]) == (2, 1, [])
    assert found["properties"] == {"unit": ["salt", "sand"], "kind": ["evaporite", "clastic"]}
    assert (found["unit_property"], found["coordinates"], found["vertical"]) == (
        "unit",
        "km",
        "down",
    )
    assert found["extent"] == {"x": (0.0, 5.0), "z": (0.0, 2.0)}
    assert len(found["hints"]) == 2
    json.dumps(found, allow_nan=False)


def test_a_survey_finds_the_property_of_the_unit(read):
    drawn = [
        item | {"properties": {"id": i, "Layer": f"L{i}"}} for i, item in enumerate((SALT, SAND))
    ]
    assert read(*drawn, reader=survey)["unit_property"] == "Layer"


def test_unit_at_is_fast_enough_for_a_demo(read):
    grid = [
        box(f"u{i}", 1000 * i, 400 * j, 1000 * i + 1000, 400 * j + 400)
        for i in range(10)
        for j in range(6)
    ]
    section = read(*grid)
    points = np.random.default_rng(1).uniform((0, 0), (10_000, 2400), (60_000, 2))
    start = perf_counter()
    found = names(section, points[:100]), section.unit_at(points)
    assert perf_counter() - start < 1
    assert found[0] == [f"u{int(x // 1000)}" for x, _ in points[:100]]


def check_whole(section):
    """Areas, frame and the map from points to units agree with each other."""
    outline = section.outline
    assert sum(section.areas.values()) == pytest.approx(outline.area, rel=1e-6)
    rng = np.random.default_rng(3)
    x = rng.uniform(outline.surface[0, 0], outline.surface[-1, 0], 20_000)
    low, high = np.interp(x, *outline.base.T), np.interp(x, *outline.surface.T)
    points = np.column_stack([x, rng.uniform(low, high)])
    weight = (high - low) / (high - low).mean()
    share = np.bincount(section.unit_at(points), weight, len(section.units)) / len(x)
    expected = np.array([section.areas[name] for name in section.units]) / outline.area
    assert np.abs(share - expected).max() < 0.015
    horizons = [line for line in section.lines if line.kind == "horizon"]
    assert all(len(line.points) > 1 and np.isfinite(line.points).all() for line in section.lines)
    for line in horizons:
        middle = line.points[:2].mean(axis=0)
        normal = np.diff(line.points[:2], axis=0)[0][::-1] * [1, -1]
        normal = normal / np.linalg.norm(normal) * 0.1
        sides = section.unit_at(np.array([middle + normal, middle - normal]))
        assert {section.units[row] for row in sides} == set(line.name.split(" / "))


def test_the_shipped_section():
    section = read_section(ROOT / "cases/salt-diapir/section.geojson", "section.geojson")
    assert section.units == ("salt", "A", "B", "C", "D", "E")
    assert section.notes == ()
    assert section.outline.area == pytest.approx(6e7)
    check_whole(section)


@pytest.mark.skipif(not REAL, reason="no real sections: ../shared/data is absent")
@pytest.mark.parametrize("path", REAL, ids=[path.parent.name for path in REAL])
def test_real_sections(path):
    section = read_section(path, path.name, rock_property="kind")
    check_whole(section)
    assert not [note for note in section.notes if "sliver" in note]
    found = survey(path, path.name)
    assert (found["unit_property"], found["coordinates"], found["vertical"]) == ("unit", "m", "up")
    assert found["faults"] == []
    faults = {line.name for line in section.lines if line.kind == "fault"}
    assert len(faults) == found["fault_lines"]


def mutated(value, rng):
    """Return GeoJSON with one part of it replaced, doubled or left out."""
    odd = (None, True, -1, 1e308, "", "x", [], {}, [[]], [[[]]], "Polygon", "LineString", 0.1)
    if isinstance(value, (dict, list)) and value and rng.random() < 0.93:
        keys = list(value) if isinstance(value, dict) else range(len(value))
        key = keys[rng.integers(len(keys))]
        copy = value.copy()
        if rng.random() < 0.1:
            del copy[key]
        elif isinstance(value, list) and rng.random() < 0.1:
            copy.insert(key, value[rng.integers(len(value))])
        else:
            copy[key] = mutated(value[key], rng)
        return copy
    if isinstance(value, (int, float)) and rng.random() < 0.7:
        return value + rng.choice([-1e4, -100, -1, 1, 100, 1e4])
    return odd[rng.integers(len(odd))]


@pytest.mark.parametrize("seed", range(4))
def test_a_spoilt_file_is_read_or_refused_and_nothing_else(read, seed):
    rng = np.random.default_rng(seed)
    for _ in range(100):
        data = collection(SALT, SAND, FAULT, crs=CRS84)
        for _ in range(rng.integers(1, 4)):
            data = mutated(data, rng) if isinstance(data, dict) else data
        for reader in (read_section, survey):
            try:
                found = read(json.dumps(data), reader=reader)
            except CaseError:
                continue
            if reader is read_section:
                outline = found.outline
                assert (outline.surface[1:, 0] > outline.surface[:-1, 0]).all()
                assert sum(found.areas.values()) == pytest.approx(outline.area, rel=0.01)

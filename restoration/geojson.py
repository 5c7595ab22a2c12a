"""A drawn section as GeoJSON: polygons with a unit, and fault lines; every fault with its place."""

import json
import re
from dataclasses import dataclass, field

import numpy as np

from restoration.errors import CaseError, Fault
from restoration.files import MB, read_text
from restoration.words import counted, hint, quoted, wrong_name

LARGEST = 50 * MB
MOST_VERTICES = 1_000_000
MOST_FEATURES = 30_000
# Lists, groups and values that so many features and vertices (of three numbers) can make: what is
# parsed takes memory for each of them.
MOST_BRACKETS = 2_000_000
MOST_COMMAS = 5_000_000
EXPORT = "export the layer as GeoJSON (in QGIS: Export, Save Features As)"
SKIPPED = "skipped: a section is drawn with polygons, and lines for faults"


@dataclass(frozen=True, eq=False)
class Patch:
    """One drawn polygon.

    Attributes:
        entry: where it is in the file, such as ``features[3]``.
        unit: name of its unit.
        key: value of the property that picks the rock; None without one.
        shape: shapely Polygon, m, z up; a MultiPolygon makes several patches.
    """

    entry: str
    unit: str
    key: str | None
    shape: object


@dataclass(eq=False)
class Drawing:
    """What a file draws.

    Attributes:
        shown: name of the file in messages.
        patches: the polygons that can be used.
        faults: (name, points (n, 2), m) of the fault lines.
        notes: remarks for the user.
        problems: a `Fault` for everything that is wrong.
        vertices: their number, all polygons and lines together.
        flattened: whether third coordinates were left out.
    """

    shown: str
    patches: list = field(default_factory=list)
    faults: list = field(default_factory=list)
    notes: list = field(default_factory=list)
    problems: list = field(default_factory=list)
    vertices: int = 0
    flattened: bool = False

    def refuse(self, entry, message):
        """Take down a fault."""
        self.problems.append(Fault(self.shown, None, None, entry, message))


def place(point):
    """Return a point (x, z), m, as messages name it."""
    x, z = (round(float(value) / 1e3, 3) + 0.0 for value in point)
    return f"x = {x:.3f} km, z = {z:.3f} km"


def read_collection(path, shown):
    """Return the GeoJSON FeatureCollection of a file as plain values, ``features`` being a list.

    Raises:
        CaseError: it is no such file; see `restoration.files.read_text`.
    """
    text = read_text(path, shown, LARGEST)
    if text.count("[") + text.count("{") > MOST_BRACKETS or text.count(",") > MOST_COMMAS:
        raise _refused(shown, f"has more than {MOST_VERTICES:,} vertices; simplify the lines")
    try:
        data = json.loads(text, parse_constant=_no_constant, object_pairs_hook=_no_double)
    except json.JSONDecodeError as error:
        fault = Fault(shown, error.lineno, error.colno, "", _syntax(text, error))
        raise CaseError([fault]) from None
    except RecursionError:
        raise _refused(shown, "is nested too deeply for GeoJSON") from None
    except ValueError as error:
        digits = "holds a number of thousands of digits; correct that vertex"
        raise _refused(shown, digits if "digits" in str(error) else str(error)) from None
    kind = data.get("type") if isinstance(data, dict) else None
    if kind == "Feature":
        data = {"type": "FeatureCollection", "features": [data], "crs": data.get("crs")}
    elif kind != "FeatureCollection":
        raise _refused(shown, _wrong_kind(data, kind))
    if not isinstance(data.get("features"), list):
        raise _refused(shown, f"has no list of features; {EXPORT}")
    if len(data["features"]) > MOST_FEATURES:
        number = len(data["features"])
        raise _refused(shown, f"has {number} features; at most {MOST_FEATURES} are read")
    return data


def _no_constant(name):
    raise ValueError(f"holds {name}, which is no coordinate; delete or correct that vertex")


def _no_double(pairs):
    """Return a group of entries, none of which is there twice: programs differ in which counts."""
    group = dict(pairs)
    if len(group) < len(pairs):
        names = [name for name, _ in pairs]
        double = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"gives {quoted(double)} twice in one group of entries; keep one")
    return group


def _syntax(text, error):
    """Return what a JSON error means."""
    start = text.lstrip()[:1]
    if start == "<":
        return f"is XML (KML, SVG, GML?), not GeoJSON; {EXPORT}"
    if error.msg == "Extra data" and start == "{":
        return f"a second text begins here (one feature per line?); {EXPORT}, not GeoJSONSeq"
    if start not in ("{", "["):
        return f"is not GeoJSON; {EXPORT}"
    cut = "; the file ends early: was it cut off?" if error.pos >= len(text.rstrip()) else ""
    return f"not JSON: {error.msg[0].lower()}{error.msg[1:]}{cut}"


def _wrong_kind(data, kind):
    """Return the message for JSON that is no collection of features."""
    if kind == "Topology":
        return f"is TopoJSON; {EXPORT}"
    if isinstance(kind, str) and ("coordinates" in data or "geometries" in data):
        return f"is a bare {kind[:40]} without properties, so its unit is not known; {EXPORT}"
    found = f"its type is {quoted(kind)}" if isinstance(data, dict) else f"it is {quoted(data)}"
    return f"is JSON but no GeoJSON FeatureCollection: {found}; {EXPORT}"


def read_drawing(data, shown, unit_property, rock_property=None, scale=1.0, sign=1.0):
    """Return the `Drawing` of a FeatureCollection; what is wrong is kept in its problems.

    Args:
        data: of `read_collection`.
        shown: name of the file in messages.
        unit_property: property that names the unit; None gives every polygon a unit of its own.
        rock_property: property whose values are kept as `Patch.key`; may be None.
        scale: m per unit of the coordinates.
        sign: 1 where the second coordinate points up, -1 where it is depth.
    """
    drawing = Drawing(shown)
    known = properties(data)
    for number, feature in enumerate(data["features"]):
        entry = f"features[{number}]"
        kind, values, parts = _feature(drawing, entry, feature)
        if kind is None:
            continue
        area = kind.endswith("Polygon")
        parts = _all_points(drawing, entry, parts if area else [parts], scale, sign)
        if drawing.vertices > MOST_VERTICES:
            raise _refused(shown, f"has more than {MOST_VERTICES:,} vertices; simplify the lines")
        if parts is None:
            continue
        if not area:
            name = _text(values.get("name") or values.get(unit_property)) or f"fault {number}"
            if wrong := wrong_name(name):
                drawing.refuse(entry, f"its name {quoted(name)} {wrong}")
            else:
                drawing.faults += [(name, line) for line in parts[0] if len(line) > 1]
            continue
        unit = entry if unit_property is None else _unit(drawing, entry, values, unit_property)
        for rings in parts:
            shape = _shape(drawing, entry, unit, rings)
            if shape is not None and unit is not None:
                drawing.patches.append(Patch(entry, unit, _text(values.get(rock_property)), shape))
    if drawing.flattened:
        drawing.notes.append("the coordinates have a third value; it is not used")
    _judge(drawing, known, unit_property, rock_property)
    return drawing


def properties(data):
    """Return the values of every property of the polygons, in order of their first use."""
    found = {}
    for feature in data["features"]:
        feature = feature if isinstance(feature, dict) else {}
        geometry, values = feature.get("geometry"), feature.get("properties")
        kind = geometry.get("type") if isinstance(geometry, dict) else None
        if kind in ("Polygon", "MultiPolygon") and isinstance(values, dict):
            for name, value in values.items():
                texts = found.setdefault(name, [])
                text = _text(value)
                if text and text not in texts:
                    texts.append(text)
    return found


def _judge(drawing, known, unit_property, rock_property):
    """Take down what is wrong with the whole, in place of one fault for each polygon."""
    for wanted, entry in ((unit_property, "property"), (rock_property, "rock_property")):
        nameless = [fault for fault in drawing.problems if "has no unit" in fault.message]
        if wanted is None or known.get(wanted) or not (drawing.patches or nameless):
            continue
        what = "is empty on all polygons" if wanted in known else "is on none of the polygons"
        others = [name for name in known if name != wanted and known[name]]
        advice = f"{hint(wanted, others)}; name it as '{entry}' in 'section' of the case"
        if not others:
            filled = "fill in the names"
            advice = (
                f"; {filled}"
                if wanted in known
                else f"; they have no properties: add it and {filled}"
            )
        drawing.problems = [fault for fault in drawing.problems if fault not in nameless]
        drawing.refuse("", f"the property '{wanted}' {what}{advice}")
    if not drawing.patches and not drawing.problems:
        lines = f", only {counted(len(drawing.faults), 'line')}" if drawing.faults else ""
        drawing.refuse("", f"holds no polygons{lines}; draw every unit as polygons, side by side")


def _feature(drawing, entry, feature):
    """Return type, properties and parts of a feature; the type is None where it is not used."""
    nothing = None, None, None
    if not isinstance(feature, dict):
        drawing.refuse(entry, f"is {quoted(feature)}, not a feature; {EXPORT}")
        return nothing
    geometry, values = feature.get("geometry"), feature.get("properties") or {}
    kind = geometry.get("type") if isinstance(geometry, dict) else None
    if not isinstance(values, dict):
        drawing.refuse(entry, f"its properties are {quoted(values)}, not a group of names")
        return nothing
    if geometry is None or (kind and not str(kind).endswith(("Polygon", "LineString"))):
        drawing.notes.append(f"{entry} ({quoted(kind) if kind else 'no geometry'}) is {SKIPPED}")
        return nothing
    parts = geometry.get("coordinates") if isinstance(geometry, dict) else None
    if kind not in ("Polygon", "MultiPolygon", "LineString", "MultiLineString") or not isinstance(
        parts, list
    ):
        drawing.refuse(entry, f"has no usable geometry; {EXPORT}")
        return nothing
    if not parts:
        drawing.notes.append(f"{entry} (an empty {kind}) is {SKIPPED}")
        return nothing
    parts = [parts] if kind in ("Polygon", "LineString") else parts
    if kind.endswith("Polygon") and not all(isinstance(part, list) and part for part in parts):
        drawing.refuse(entry, f"a part of it is no polygon; {EXPORT}")
        return nothing
    return kind, values, parts


def _all_points(drawing, entry, parts, scale, sign):
    """Return the points of all rings or lines of a feature, part by part; None where one is bad."""
    result = []
    for part in parts:
        result.append([])
        for ring in part:
            points = _points(drawing, entry, ring, scale, sign)
            if points is None:
                return None
            drawing.vertices += len(points)
            result[-1].append(points)
    return result


def _points(drawing, entry, ring, scale, sign):
    """Return the points of a ring or line, shape (n, 2), m; None where they are bad."""
    wrong = "a position" if isinstance(ring, list) else "a list of positions"
    if not isinstance(ring, list) or not all(
        isinstance(point, list) and len(point) > 1 for point in ring
    ):
        drawing.refuse(entry, f"holds something that is not {wrong} [x, z]; {EXPORT}")
        return None
    for value in (value for point in ring for value in point[:2]):
        if type(value) not in (int, float):
            drawing.refuse(entry, f"holds {quoted(value)} as a coordinate; correct that vertex")
            return None
    try:
        points = np.array([point[:2] for point in ring], dtype=float).reshape(-1, 2)
    except OverflowError:
        points = np.array([[min(abs(value), 1e300) for value in point[:2]] for point in ring])
    near = np.abs(points) < 1e9 / scale
    if not near.all():
        far = ~near.all(axis=1)
        vertex = f"vertex {far.argmax() + 1}"
        drawing.refuse(
            entry, f"holds a coordinate beyond 1e9 m; correct {vertex} of a ring or line"
        )
        return None
    drawing.flattened |= any(len(point) > 2 for point in ring)
    points[np.abs(points) < 1e-12] = 0.0  # which the exact arrangement could not divide by
    return points * [scale, scale * sign] + 0.0


def _unit(drawing, entry, values, name):
    """Return the name of the unit; None where there is none."""
    value = values.get(name)
    unit = _text(value)
    if isinstance(value, (dict, list)):
        drawing.refuse(entry, f"its '{name}' is {quoted(value)}; write the name of the unit")
    elif not unit:
        drawing.refuse(entry, f"has no unit: its property '{name}' is missing or empty; fill it in")
    elif wrong := wrong_name(unit):
        drawing.refuse(entry, f"its unit {quoted(unit)} {wrong}")
    return unit


def _text(value):
    """Return a property as text: ``3.0`` is ``3``; None where it is empty or no plain value."""
    if isinstance(value, float) and value.is_integer():
        value = int(value)
    if value is None or isinstance(value, (dict, list)):
        return None
    text = str(value).lower() if isinstance(value, bool) else str(value)
    return " ".join(text.split()) or None


def _shape(drawing, entry, unit, rings):
    """Return the shapely shape of a polygon; None, with its faults taken down, where it is bad."""
    import shapely

    name = f"polygon {quoted(unit)}" if unit and unit != entry else "polygon"
    for ring in rings:
        if len(ring) < 4:
            found = f"{counted(len(ring), 'position')}; it needs 4, the last one like the first"
            return drawing.refuse(entry, f"a ring of {name} has only {found}")
        if np.abs(ring[0] - ring[-1]).max() > 1e-9 * np.ptp(ring, axis=0).max():
            ends = f"it starts at {place(ring[0])} and ends at {place(ring[-1])}"
            return drawing.refuse(
                entry, f"a ring of {name} is not closed: {ends}; repeat the first position"
            )
        ring[-1] = ring[0]
    shape = shapely.Polygon(rings[0], rings[1:])
    reason = shapely.is_valid_reason(shape)
    if reason.startswith("Ring Self-intersection"):
        shape = shapely.make_valid(shape, method="structure")
    elif not shape.convex_hull.area > 0 or reason.startswith("Too few"):
        return drawing.refuse(entry, f"{name} has no area, near {place(rings[0][0])}; delete it")
    elif reason != "Valid Geometry":
        return drawing.refuse(entry, f"{name} {_invalid(reason)}")
    return shape


INVALID = (  # (what GEOS says, what it means)
    ("Self-intersection", "crosses itself near {}; move the vertices apart there"),
    ("Hole lies outside shell", "has a hole outside of it near {}; make that ring a polygon"),
    ("Holes are nested", "has a hole within a hole near {}; make the inner ring a polygon"),
    ("Interior is disconnected", "is cut in two by its hole near {}; split it"),
    ("Duplicate Rings", "has the same ring twice near {}; delete one"),
)


def _invalid(reason):
    """Return what a GEOS validity reason such as ``Self-intersection[5 5]`` means."""
    match = re.search(r"\[(\S+) ([^\s\]]+)", reason)
    where = place((float(match[1]), float(match[2]))) if match else "an unknown place"
    for sign, meaning in INVALID:
        if reason.startswith(sign):
            return meaning.format(where)
    return f"is not a valid polygon near {where} ({reason.split('[')[0].lower()}); redraw it"


def _refused(shown, message):
    return CaseError([Fault(shown, None, None, "", message)])

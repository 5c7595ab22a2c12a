"""A section from a GeoJSON file: units, contacts, faults and the frame, in m, z up."""

import re
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from restoration.errors import CaseError
from restoration.geojson import properties, read_collection, read_drawing
from restoration.scene import Line, Outline
from restoration.tree import shortened
from restoration.units import number
from restoration.words import listed, quoted

TOLERANCE = 1e-3  # of the height: narrower gaps and overlaps are closed
MOST_ALIKE = 10  # notes on units of like names
LEAST = 1e-3  # m, of width and height
SMALL = 100.0  # m; a section less high, and less than ten times as wide, may be in km
SEPARATORS = re.compile("[ _-]+")
GEOGRAPHIC = ("CRS84", "EPSG::4326", "EPSG:4326", "EPSG::4258", "EPSG:4258")


@dataclass(frozen=True, eq=False)
class Section:
    """What a section file holds, in m, z up.

    Attributes:
        units: names, in order of mean depth from the base up.
        keys: values of the rock property found on each unit, by its name.
        outline: the frame.
        lines: contacts between different units (``horizon``) and faults (``fault``).
        unit_at: maps points (n, 2), m, to rows of `units`, shape (n,), int16.
        areas: area of each unit by its name, m^2.
        notes: remarks for the user.
    """

    units: tuple[str, ...]
    keys: dict[str, tuple[str, ...]]
    outline: Outline
    lines: tuple[Line, ...]
    unit_at: Callable[[np.ndarray], np.ndarray]
    areas: dict[str, float]
    notes: tuple[str, ...]


def read_section(
    path, shown, unit_property="unit", scale=1.0, sign=1.0, tolerance=None, rock_property=None
):
    """Return the `Section` of a GeoJSON file.

    Args:
        path: of the file.
        shown: its name in messages.
        unit_property: property of the polygons that names the unit.
        scale: m per unit of the coordinates, 1000 for km.
        sign: 1 where the second coordinate points up, -1 where it is depth.
        tolerance: gaps and overlaps narrower than this are closed, sides and lines straightened
            by less, m; 0.001 of the height unless given.
        rock_property: property whose values are listed in `Section.keys`.

    Raises:
        CaseError: with every fault of the file.
    """
    data = read_collection(path, shown)
    drawing = read_drawing(data, shown, unit_property, rock_property, scale, sign)
    drawing.notes += _units_alike(drawing)
    _degrees(drawing, data, scale)
    if drawing.problems:
        raise CaseError(shortened(drawing.problems))
    arrangement, outline, tolerance = _arranged(drawing, tolerance)
    if drawing.problems:
        raise CaseError(shortened(drawing.problems))
    return _section(drawing, arrangement, outline, tolerance)


def _arranged(drawing, tolerance):
    """Return arrangement, outline (or None) and tolerance; faults go to the drawing."""
    import shapely

    from restoration.arrangement import arrange, tell_flaws, tell_pieces
    from restoration.frame import find_outline

    shapes = [patch.shape for patch in drawing.patches]
    low_x, low, high_x, high = shapely.total_bounds(shapes)
    if min(high_x - low_x, high - low) < LEAST:
        size = f"{number(high_x - low_x)} m wide and {number(high - low)} m high"
        drawing.refuse("", f"the section is {size}; at least 1 mm each way is needed")
        return None, None, tolerance
    if tolerance is None:
        tolerance = TOLERANCE * (high - low)
    if _small(high_x - low_x, high - low):
        size = f"{number(high_x - low_x)} m wide and {number(high - low)} m high"
        drawing.notes.append(
            f"the section is only {size}; if it is drawn in km, write coordinates: km in 'section'"
        )
    arrangement = arrange(shapes, tolerance)
    tell_flaws(drawing, arrangement, tolerance)
    pieces = shapely.get_parts(arrangement.whole)
    if not len(pieces):
        drawing.refuse("", "its polygons are slivers that leave no area; draw them to scale")
        return arrangement, None, tolerance
    if len(pieces) > 1:
        tell_pieces(drawing, pieces)
        return arrangement, None, tolerance
    outline, wrong, notes = find_outline(
        pieces[0], max(tolerance, 10 * arrangement.grid), arrangement.grid
    )
    for message in wrong:
        drawing.refuse("", message)
    drawing.notes += notes
    return arrangement, outline, tolerance


def _section(drawing, arrangement, outline, tolerance):
    """Return the `Section` of an arrangement without flaws."""
    import shapely

    from restoration.arrangement import UnitAt, contacts, grouped

    faces = arrangement.faces
    names, unit = np.unique(
        [drawing.patches[i].unit for i in arrangement.owner], return_inverse=True
    )
    areas, z = shapely.area(faces), shapely.get_y(shapely.centroid(faces))
    total = np.bincount(unit, areas)
    order = np.argsort(np.bincount(unit, areas * z) / total, kind="stable")
    units, total = tuple(names[order].tolist()), total[order].tolist()
    unit = np.argsort(order)[unit]
    lines = [
        Line(f"{units[lower]} / {units[upper]}", "horizon", points)
        for (lower, upper), pieces in contacts(arrangement, unit, tolerance).items()
        for points in pieces
    ]
    lines += _faults(drawing, arrangement.whole, tolerance)
    parts = [
        shapely.get_parts(shapely.coverage_union_all(faces[rows]))
        for rows in grouped(unit, len(units))
    ]
    keys = {name: {} for name in units}
    for patch in drawing.patches:
        if patch.key and patch.unit in keys:
            keys[patch.unit][patch.key] = None
    return Section(
        units,
        {name: tuple(found) for name, found in keys.items()},
        outline,
        tuple(lines),
        UnitAt(np.concatenate(parts), np.repeat(np.arange(len(units)), [*map(len, parts)])),
        dict(zip(units, total, strict=True)),
        tuple(dict.fromkeys(drawing.notes)),
    )


def _faults(drawing, whole, tolerance):
    """Return the fault lines, cut where they leave the section, with notes on them."""
    import shapely

    lines = []
    for name, points in drawing.faults:
        line = shapely.linestrings(points)
        within = shapely.intersection(line, whole)
        pieces = shapely.get_parts(shapely.line_merge(within))
        pieces = [piece for piece in pieces if piece.geom_type == "LineString" and piece.length]
        if line.length - within.length > tolerance:
            drawing.notes.append(
                f"fault {quoted(name)} reaches beyond the section; it is cut there"
            )
        lines += [Line(name, "fault", shapely.get_coordinates(piece)) for piece in pieces]
    if drawing.faults:
        count = len(drawing.faults)
        drawing.notes.append(
            f"faults ({count}) move with the rock; each has the width and the rock that 'faults' "
            "in the case gives it, or none"
        )
    return lines


def _units_alike(drawing):
    """Return notes on units whose names differ only by case or spaces."""
    alike = {}
    for name in dict.fromkeys(patch.unit for patch in drawing.patches):
        alike.setdefault(SEPARATORS.sub(" ", name).casefold(), []).append(name)
    return [
        f"units {listed(map(quoted, names), 'and')} stay apart; if they are one, name them alike"
        for names in alike.values()
        if len(names) > 1
    ][:MOST_ALIKE]


def _degrees(drawing, data, scale):
    """Take down coordinates that look like longitude and latitude."""
    if scale != 1 or not drawing.patches:
        return
    import shapely

    bounds = shapely.total_bounds([patch.shape for patch in drawing.patches])
    west, south, east, north = bounds
    if max(abs(west), abs(east)) > 180 or max(abs(south), abs(north)) > 90:
        return
    if (east - west < 1 and north - south < 1) or _crs(data).endswith(GEOGRAPHIC):
        drawing.refuse(
            "", f"its coordinates look like degrees (x from {west:g} to {east:g}, z from {south:g} "
            f"to {north:g}); export the section in m along and up, or, if it is drawn in km, write "
            "coordinates: km in 'section' of the case",
        )  # fmt: skip


def _small(width, height):
    """Return whether a section is so small, m, that it may have been drawn in km."""
    return width < 10 * SMALL and height < SMALL


def _crs(data):
    """Return the name of the coordinate system a file claims; empty without one."""
    crs = data.get("crs")
    values = crs.get("properties") if isinstance(crs, dict) else None
    return str(values.get("name", "")) if isinstance(values, dict) else ""


def survey(path, shown):
    """Return what a section file holds, for a user who has no case yet.

    Args:
        path: of the file.
        shown: its name in messages.

    Returns:
        polygons, fault_lines, vertices (counts); properties {name: values}; extent {x: (low, high),
        z: (low, high)} as given, or None; crs (or None); unit_property (the one that most likely
        names the unit, or None), coordinates and vertical: what a case would say; hints and
        faults, as text.

    Raises:
        CaseError: it is not a GeoJSON FeatureCollection.
    """
    data = read_collection(path, shown)
    known = properties(data)
    chosen = _likely(known)
    drawing = read_drawing(data, shown, chosen)
    _degrees(drawing, data, 1.0)
    extent, coordinates, vertical, hints = _guess(drawing)
    if drawing.patches and not any("degrees" in fault.message for fault in drawing.problems):
        scales = 1e3 if coordinates == "km" else 1.0, -1.0 if vertical == "down" else 1.0
        drawing = read_drawing(data, shown, chosen, None, *scales)
        _arranged(drawing, None)
    return {
        "polygons": len(drawing.patches),
        "fault_lines": len(drawing.faults),
        "vertices": drawing.vertices,
        "properties": known,
        "extent": extent,
        "crs": _crs(data) or None,
        "unit_property": chosen,
        "coordinates": coordinates,
        "vertical": vertical,
        "hints": list(dict.fromkeys(hints + drawing.notes + _units_alike(drawing))),
        "faults": [str(fault) for fault in shortened(drawing.problems)],
    }


def _guess(drawing):
    """Return the extent as given, and what coordinates and vertical may be, with hints on it."""
    import shapely

    if not drawing.patches:
        return None, "m", "up", []
    shapes = [patch.shape for patch in drawing.patches]
    west, south, east, north = shapely.total_bounds(shapes).tolist()
    coordinates, vertical, hints = "m", "up", []
    if _small(east - west, north - south):
        coordinates = "km"
        hints.append(f"{east - west:g} wide and {north - south:g} high: taken as km")
    if south >= 0:
        vertical = "down"
        hints.append(f"z runs from {south:g} to {north:g}, never below 0: taken as depth")
    return {"x": (west, east), "z": (south, north)}, coordinates, vertical, hints


def _likely(known):
    """Return the property that most likely names the unit, or None."""
    usual = ("unit", "layer", "formation", "name", "lithology", "rock", "kind")
    folded = {name.casefold(): name for name in reversed(known) if known[name]}
    for name in usual:
        if name in folded:
            return folded[name]
    texts = [name for name, values in known.items() if any(not _is_number(v) for v in values)]
    return texts[0] if texts else next(iter(folded.values()), None)


def _is_number(text):
    return text.replace(".", "", 1).lstrip("-").isdigit()

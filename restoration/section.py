"""A section from a GeoJSON file: units, contacts, faults and the frame, in m, z up."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from restoration.errors import CaseError
from restoration.geojson import place, properties, read_collection, read_drawing
from restoration.scene import Line, Outline
from restoration.tree import shortened
from restoration.units import number
from restoration.words import counted, listed, quoted

TOLERANCE = 1e-3  # of the height: narrower gaps and overlaps are closed
MOST_FLAWS = 10  # gaps and overlaps that are named one by one
SMALL = 100.0  # m; a section below it may have been drawn in km
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


class UnitAt:
    """Maps points to units; a point in no polygon belongs to the nearest one.

    Args:
        shapes: shapely Polygons that do not overlap, shape (n,).
        rows: unit of each, shape (n,).
    """

    def __init__(self, shapes, rows):
        import shapely

        self.shapes, self.rows = shapes, np.asarray(rows, dtype=np.int16)
        self.bounds = shapely.bounds(shapes)
        self.tree = shapely.STRtree(shapes)
        shapely.prepare(shapes)

    def __call__(self, points):
        """Return the unit of points (n, 2), m, as rows, shape (n,), int16."""
        import shapely

        points = np.asarray(points, dtype=float).reshape(-1, 2)
        order = np.argsort(points[:, 0], kind="stable")
        x, z = points[order].T
        found = np.full(len(points), -1, dtype=np.int16)
        starts = np.searchsorted(x, self.bounds[:, 0], "left")
        stops = np.searchsorted(x, self.bounds[:, 2], "right")
        for shape, row, (_, low, _, high), start, stop in zip(
            self.shapes, self.rows, self.bounds, starts, stops, strict=True
        ):
            span = slice(start, stop)
            near = start + np.flatnonzero((found[span] < 0) & (z[span] >= low) & (z[span] <= high))
            found[near[shapely.intersects_xy(shape, x[near], z[near])]] = row
        lost = np.flatnonzero(found < 0)
        if len(lost):
            beyond = shapely.points(x[lost], z[lost])
            pairs = self.tree.query_nearest(beyond, all_matches=False)
            found[lost[pairs[0]]] = self.rows[pairs[1]]
        result = np.empty_like(found)
        result[order] = found
        return result


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

    from restoration.arrangement import arrange, frame

    shapes = [patch.shape for patch in drawing.patches]
    low_x, low, high_x, high = shapely.total_bounds(shapes)
    if tolerance is None:
        tolerance = TOLERANCE * (high - low)
    if max(high_x - low_x, high - low) < SMALL:
        size = f"{number(high_x - low_x)} m wide and {number(high - low)} m high"
        drawing.notes.append(f"the section is only {size}: are its coordinates in km?")
    arrangement = arrange(shapes, tolerance)
    _tell_flaws(drawing, arrangement, tolerance)
    pieces = shapely.get_parts(arrangement.whole)
    if len(pieces) > 1:
        _tell_pieces(drawing, pieces)
        return arrangement, None, tolerance
    outline, wrong, notes = frame(
        pieces[0], max(tolerance, 10 * arrangement.grid), arrangement.grid
    )
    for message in wrong:
        drawing.refuse("", message)
    drawing.notes += notes
    return arrangement, outline, tolerance


def _tell_flaws(drawing, arrangement, tolerance):
    """Take down the gaps and overlaps, the greatest first, and the slivers that were closed."""
    flaws = []
    for flaw in arrangement.flaws:
        patches = [drawing.patches[row] for row in flaw.patches]
        if flaw.gap or len({patch.unit for patch in patches}) > 1:
            flaws.append((flaw, patches))
        else:
            names = listed([patch.entry for patch in patches], "and")
            drawing.notes.append(
                f"{names} overlap near {flaw.at}; both are {quoted(patches[0].unit)}"
            )
    for flaw, patches in flaws[:MOST_FLAWS]:
        names = listed([f"{patch.entry} {quoted(patch.unit)}" for patch in patches], "and")
        size = f"{_area(flaw.shape.area)}, up to {number(flaw.width, 2)} m wide"
        fill = f"a tolerance above {number(flaw.width, 2)} m closes it"
        fill = f" ({fill})" if flaw.width < 20 * tolerance else ""
        if flaw.gap:
            message = f"gap near {flaw.at} ({size}) between {names}: extend one of them{fill}"
            drawing.refuse("", message)
        elif _same(patches):
            drawing.refuse(patches[1].entry, f"is the same polygon as {names}: delete one")
        else:
            message = f"overlap near {flaw.at} ({size}) of {names}: cut one of them there{fill}"
            drawing.refuse(patches[-1].entry, message)
    if len(flaws) > MOST_FLAWS:
        drawing.refuse("", f"and {counted(len(flaws) - MOST_FLAWS, 'smaller gap or overlap')}")
    if arrangement.closed:
        number_ = len(arrangement.closed)
        total = _area(sum(flaw.shape.area for flaw in arrangement.closed))
        what = counted(number_, "sliver")
        drawing.notes.append(
            f"{what} between polygons, narrower than {number(tolerance, 2)} m, closed ({total})"
        )


def _same(patches):
    """Return whether two polygons are one drawn twice."""
    return patches[0].shape.equals(patches[1].shape)


def _tell_pieces(drawing, pieces):
    """Take down a section that is not in one piece."""
    pieces = sorted(pieces, key=lambda piece: -piece.area)
    for piece in pieces[1 : MOST_FLAWS + 1]:
        off = min(piece.distance(other) for other in pieces if other is not piece)
        away = f"{number(off, 2)} m from the rest" if off else "touching the rest at a point only"
        near = place(piece.representative_point().coords[0])
        drawing.refuse(
            "", f"is not in one piece: {_area(piece.area)} near {near} lie apart, {away}; fill the "
            "space between with polygons, or keep one section in a file",
        )  # fmt: skip


def _area(area):
    """Return an area as messages give it."""
    return f"{number(area / 1e6)} km^2" if area >= 1e4 else f"{number(area)} m^2"


def _section(drawing, arrangement, outline, tolerance):
    """Return the `Section` of an arrangement without flaws."""
    import shapely

    from restoration.arrangement import contacts

    names = np.array([drawing.patches[row].unit for row in arrangement.owner])
    areas = shapely.area(arrangement.faces)
    z = shapely.get_y(shapely.centroid(arrangement.faces))
    total = {name: float(areas[names == name].sum()) for name in np.unique(names).tolist()}
    depth = {name: (areas * z)[names == name].sum() / total[name] for name in total}
    units = tuple(sorted(total, key=lambda name: (depth[name], name)))
    row = {name: index for index, name in enumerate(units)}
    unit = np.array([row[name] for name in names.tolist()])
    lines = [
        Line(f"{units[lower]} / {units[upper]}", "horizon", points)
        for (lower, upper), pieces in contacts(arrangement, unit, tolerance).items()
        for points in pieces
    ]
    lines += [Line(name, "fault", points) for name, points in drawing.faults]
    parts = [shapely.get_parts(shapely.coverage_union_all(arrangement.faces[unit == index]))
             for index in range(len(units))]  # fmt: skip
    rows = np.repeat(np.arange(len(units)), [len(part) for part in parts])
    keys = {name: {} for name in units}
    for patch in drawing.patches:
        if patch.key and patch.unit in keys:
            keys[patch.unit][patch.key] = None
    return Section(
        units,
        {name: tuple(found) for name, found in keys.items()},
        outline,
        tuple(lines),
        UnitAt(np.concatenate(parts), rows),
        {name: total[name] for name in units},
        tuple(dict.fromkeys(drawing.notes + _remarks(drawing))),
    )


def _remarks(drawing):
    """Return notes on what the section holds."""
    notes = []
    if drawing.faults:
        found = counted(len(drawing.faults), "fault")
        notes.append(f"{found} move with the rock; they have no mechanical effect yet")
    return notes


def _units_alike(drawing):
    """Return notes on units whose names differ only by case or spaces."""
    alike = {}
    for patch in drawing.patches:
        alike.setdefault("".join(patch.unit.casefold().split("_")).replace(" ", ""), {})[
            patch.unit
        ] = None
    return [
        f"{listed(map(quoted, names), 'and')} are taken as different units; is it one?"
        for names in alike.values()
        if len(names) > 1
    ]


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
            f"to {north:g}); export it in the coordinates of the section, m along it and m up, or "
            "say that they are in km",
        )  # fmt: skip


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
        polygons, fault_lines, vertices (counts); properties {name: values}; unit_property (the
        most likely one, or None); extent {x: (low, high), z: (low, high)} as given, or None; crs;
        hints (units, depth, degrees) and faults, as text.

    Raises:
        CaseError: it is not a GeoJSON FeatureCollection.
    """
    import shapely

    data = read_collection(path, shown)
    known = properties(data)
    chosen = _likely(known)
    drawing = read_drawing(data, shown, chosen)
    _degrees(drawing, data, 1.0)
    shapes = [patch.shape for patch in drawing.patches]
    extent = None
    if shapes:
        west, south, east, north = shapely.total_bounds(shapes).tolist()
        extent = {"x": (west, east), "z": (south, north)}
        _arranged(drawing, None)
    return {
        "polygons": len(shapes),
        "fault_lines": len(drawing.faults),
        "vertices": int(shapely.get_num_coordinates(shapes).sum()) if shapes else 0,
        "properties": known,
        "unit_property": chosen,
        "extent": extent,
        "crs": _crs(data) or None,
        "hints": list(dict.fromkeys(drawing.notes + _hints(extent))),
        "faults": [str(fault) for fault in shortened(drawing.problems)],
    }


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


def _hints(extent):
    """Return what the extent of the coordinates suggests."""
    if extent is None:
        return []
    low, high = extent["z"]
    if low >= 0 and high > 0:
        return ["no z is below 0: is the second coordinate a depth, positive downwards?"]
    return []

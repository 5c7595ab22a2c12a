"""Faults with a width and a rock: from the entries of a case to bands in the section."""

from dataclasses import replace

import numpy as np
import shapely

from restoration.bands import rings, section_of, widened
from restoration.errors import CaseError
from restoration.scene import Fault, Line
from restoration.units import number, show
from restoration.words import hint, listed, quoted

SLACK = 1e-6  # of the height: what is less out of the section is in it
ARC = np.radians(2)  # between the vertices of a fault that flattens
CELLS_ALONG = 60  # of a fitted mesh, along a width of a band and beside it
MOST_CELLS = 1_000_000  # as `resolve` has it
MOST_LEVELS = 8  # of a mesh that is refined
LEAST = 1e-9  # of the section, that a band has to cover


def with_faults(case, shape, outline, tree):
    """Return a shape with the bands of the faults of a case on top, and the faults.

    Args:
        case: the entries.
        shape: `shapes.Shape` without them.
        outline: as the mesh carries it.
        tree: knows the place of every entry.

    Returns:
        (`Shape`, tuple of `scene.Fault`): every fault adds a unit of its name.

    Raises:
        CaseError: with all faults that no band can be made of.
    """
    if not case.faults:
        return shape, ()
    wrong, bands, lines = [], [], [*shape.lines]
    names = _names(case.faults)
    for i, (name, entry) in enumerate(zip(names, case.faults, strict=True)):
        try:
            if name in shape.names or name in names[:i]:
                message = f"{quoted(name)} is the name of a unit already; give it "
                if entry.name is None:
                    raise _Wrong("", f"has no name of its own, and {message}one")
                raise _Wrong("name", f"{message}another")
            drawn = [line.points for line in shape.lines if line.kind == "fault"]
            known = [line.name for line in shape.lines if line.kind == "fault"]
            centres, band = _band(entry, outline, dict(_grouped(known, drawn)))
        except _Wrong as error:
            wrong.append(tree.fault(("faults", i, *error.entry), str(error)))
            continue
        bands.append(band)
        if entry.line is None:
            lines += [Line(name, "fault", points) for points in centres]
        elif name != entry.line:
            lines = [
                replace(line, name=name)
                if (line.kind, line.name) == ("fault", entry.line)
                else line
                for line in lines
            ]
        inside = band.intersection(section_of(outline))
        lines += [Line(name, "edge", ring) for ring in rings(inside)]
    if wrong:
        raise CaseError(wrong)
    first = len(shape.names)
    faults = tuple(
        Fault(name, first + i, entry.width.si)
        for i, (name, entry) in enumerate(zip(names, case.faults, strict=True))
    )
    return replace(
        shape,
        names=(*shape.names, *names),
        rocks=(*shape.rocks, *(entry.rock for entry in case.faults)),
        unit_at=_on_top(shape.unit_at, bands, first),
        lines=tuple(lines),
    ), faults


class _Wrong(ValueError):
    """What is wrong with an entry of a fault."""

    def __init__(self, entry, message):
        super().__init__(message)
        self.entry = (entry,) if entry else ()


def slim_notes(faults, cells, outline, plan):
    """Return a note on faults that are thinner than the cells of a mesh that does not follow them.

    Args:
        faults: `scene.Fault`s.
        cells: columns and rows of squares.
        outline: `Outline`.
        plan: `scene.MeshPlan`.
    """
    if plan.interfaces != "particles":
        return []
    coarse = np.sqrt(outline.area / np.prod(cells))
    refined = plan.refine is not None and "faults" in plan.refine.where
    cell = coarse / 2 ** (plan.refine.levels if refined else 0)
    slim = [fault for fault in faults if fault.width < cell]
    if not slim:
        return []
    least = min(fault.width for fault in slim)
    levels = int(np.ceil(np.log2(coarse / least) - 1e-9))
    more = "raise mesh.cells"
    if levels <= MOST_LEVELS:
        more = f"write mesh.refine: {{levels: {levels}, where: [faults]}}, raise mesh.cells"
    return [
        f"{'fault' if len(slim) == 1 else 'faults'} {listed([f.name for f in slim], 'and')}: "
        f"{show(least, 'length')} wide where the finest cells are {show(cell, 'length')}, so that "
        f"the flow sees them about as broad as those; {more}, or write mesh.interfaces: fitted"
    ]


def too_thin(faults, lines, tree):
    """Return the faults of bands along which a fitted mesh would have cells without end.

    Args:
        faults: `scene.Fault`s.
        lines: `scene.Line`s.
        tree: knows the place of every entry.
    """
    found = []
    for i, fault in enumerate(faults):
        edges = [line for line in lines if (line.name, line.kind) == (fault.name, "edge")]
        length = sum(np.hypot(*np.diff(line.points, axis=0).T).sum() for line in edges) / 2
        cells = CELLS_ALONG * length / fault.width
        if cells > MOST_CELLS:
            message = f"{show(fault.width, 'length')} takes about {number(cells, 2)} cells along "
            message += f"{show(length, 'length')}; at most {MOST_CELLS} are possible: take "
            message += f"{show(CELLS_ALONG * length / MOST_CELLS, 'length', 2)} or more"
            found.append(tree.fault(("faults", i, "width"), message))
    return found


def _names(entries):
    """Return the names of faults: their own, their line's, or their rock's, numbered."""
    given = [entry.name or entry.line or entry.rock for entry in entries]
    return [
        f"{name} {given[: i + 1].count(name)}" if given.count(name) > 1 else name
        for i, name in enumerate(given)
    ]


def _grouped(names, values):
    """Yield every name with the values that belong to it."""
    for name in dict.fromkeys(names):
        yield name, [value for other, value in zip(names, values, strict=True) if other == name]


def _on_top(unit_at, bands, first):
    """Return a function from points to units where bands are on top, the last one uppermost."""
    shapely.prepare(bands)

    def found(points):
        unit = np.array(unit_at(points), np.int16)
        for row, band in enumerate(bands, start=first):
            unit[shapely.contains_xy(band, points[:, 0], points[:, 1])] = row
        return unit

    return found


def _band(entry, outline, drawn):
    """Return the centre lines of a fault in the section, and its polygon, which may go beyond.

    Args:
        entry: of the fault.
        outline: `Outline`.
        drawn: pieces of the lines of the section file, by name.
    """
    section, width = section_of(outline), entry.width.si
    most = min(outline.width, outline.height)
    if width >= most:
        found = f"{quoted(entry.width.text)} is not less than the section"
        raise _Wrong("width", f"{found}, which is {show(most, 'length')} at its least")
    if entry.line is not None:
        if entry.line not in drawn:
            message = f"the section file has no fault line {quoted(entry.line)}"
            raise _Wrong("line", message + hint(entry.line, drawn))
        pieces = drawn[entry.line]
    elif entry.points is not None:
        pieces = [_given(entry, section, outline)]
    else:
        pieces = [_dipping(entry, section, outline)]
    band = shapely.union_all([widened(points, width, section) for points in pieces])
    centres = shapely.MultiLineString(pieces)
    if entry.dip is not None:
        low, high = _depths(entry, outline)
        west, _, east, _ = band.bounds
        between = shapely.box(west - width, low, east + width, high)
        band, centres = band.intersection(between), centres.intersection(between)
    if band.intersection(section).area < LEAST * section.area:
        raise _Wrong("", "lies out of the section")
    within = shapely.line_merge(centres.intersection(section))
    parts = [part for part in shapely.get_parts(within) if part.geom_type == "LineString"]
    return [shapely.get_coordinates(part) for part in parts], band


def _given(entry, section, outline):
    """Return the points of a fault as they are given."""
    points = np.array([(x.si, -depth.si) for x, depth in entry.points])
    slack = max(SLACK * outline.height, entry.width.si / 2)
    for i, (x, z) in enumerate(points):
        if section.distance(shapely.Point(x, z)) > slack:
            where = f"point {i + 1}, at x = {show(x, 'length')} and depth {show(-z, 'length')}"
            reach = f"x from {show(outline.surface[0, 0], 'length')} to "
            reach += show(outline.surface[-1, 0], "length")
            top, low = -outline.surface[:, 1].max(), -outline.base[:, 1].min()
            reach += f", depth from {show(top + 0.0, 'length')} to {show(low, 'length')}"
            raise _Wrong("points", f"{where}, is out of the section ({reach})")
    if (np.diff(points, axis=0) == 0).all(axis=1).any():
        raise _Wrong("points", "a point comes twice in a row; give each once")
    if not shapely.LineString(points).is_simple:
        raise _Wrong("points", "the line crosses itself; give its points in order")
    return points


def _dipping(entry, section, outline):
    """Return the line of a fault that is given by its dip, far beyond the section."""
    x, dip = entry.at.si, entry.dip.si
    west, east = outline.surface[[0, -1], 0]
    if not west <= x <= east:
        reach = f"x from {show(west, 'length')} to {show(east, 'length')}"
        raise _Wrong("at", f"{quoted(entry.at.text)} is out of the section ({reach})")
    z = -entry.depth.si if entry.depth else np.interp(x, *outline.surface.T)
    far = 4 * (outline.width + outline.height)
    side = np.sign(dip)
    down = np.array([side * np.cos(dip), -abs(np.sin(dip))])
    start = np.array([x, z])
    if entry.detachment is None:
        return np.array([start - far * down, start + far * down])
    fall = z + entry.detachment.si
    if fall <= 0:
        message = f"{quoted(entry.detachment.text)} is not below where the fault passes 'at'"
        raise _Wrong("detachment", message)
    angle = np.linspace(abs(dip), 0, 2 + int(abs(dip) / ARC))
    radius = fall / (1 - np.cos(dip))
    arc = radius * np.column_stack(
        [side * (np.sin(abs(dip)) - np.sin(angle)), np.cos(dip) - np.cos(angle)]
    )
    return np.vstack([start - far * down, start + arc])


def _depths(entry, outline):
    """Return the least and the greatest height of a fault, m."""
    given = [getattr(entry, name) for name in ("from", "to")]
    top, base = outline.surface[:, 1].max(), outline.base[:, 1].min()
    high, low = (None if depth is None else -depth.si for depth in given)
    if low is not None and low < base - SLACK * outline.height:
        message = f"{quoted(given[1].text)} is below the base ({show(-base, 'length')})"
        raise _Wrong("to", message)
    if low is not None and low >= (top if high is None else high):
        above = "the surface" if high is None else f"'from' ({given[0].text})"
        raise _Wrong("to", f"{quoted(given[1].text)} is not below {above}")
    beyond = 2 * outline.height
    return base - beyond if low is None else low, top + beyond if high is None else high

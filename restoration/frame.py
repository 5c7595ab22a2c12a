"""The frame of a section: vertical sides, and one z of surface and base at every x."""

import numpy as np
import shapely

from restoration.geojson import place
from restoration.scene import Outline
from restoration.units import number

STEEP = ((20, 5e-3), (3, 0.1))  # slopes and drops (parts of the height) too steep for a surface


def find_outline(whole, tolerance, grid):
    """Return the `Outline` of a section, or None, with what is wrong and what was straightened.

    Args:
        whole: one shapely Polygon.
        tolerance: deviations below it are straightened, m.
        grid: deviations below it are not mentioned, m.

    Returns:
        The outline or None; a list of faults as text; a list of notes as text.
    """
    ring = shapely.get_coordinates(shapely.orient_polygons(whole).exterior)[:-1]
    x0, x1 = ring[:, 0].min(), ring[:, 0].max()
    if x1 - x0 < 10 * tolerance:
        found = (
            f"the section is {number(x1 - x0)} m wide, but the tolerance is {number(tolerance)} m"
        )
        return None, [f"{found}; give a tolerance below a tenth of the width"], []
    wrong, notes = [], []
    corners = []
    for name, edge, off in (
        ("left", x0, ring[:, 0] - x0),
        ("right", x1, x1 - ring[:, 0]),
    ):
        start, stop = _run(off <= tolerance)
        if start is None or abs(ring[start, 1] - ring[stop, 1]) <= 2 * tolerance:
            wrong.append(_leaning(name, edge, ring))
            continue
        side = np.arange(start, stop + 1 if stop >= start else stop + len(ring) + 1) % len(ring)
        side = _upright(side, ring)
        start, stop = side[0], side[-1]
        if (moved := off[side].max()) > 2 * grid:
            notes.append(f"the {name} side was straightened by up to {number(moved)} m")
        corners.append((start, stop))
    if wrong:
        return None, wrong, []
    (left_top, left_base), (right_base, right_top) = corners
    lines = {
        "base": _between(ring, left_base, right_base),
        "surface": _between(ring, right_top, left_top)[::-1],
    }
    for name, line in lines.items():
        line[0, 0], line[-1, 0] = x0, x1
        lines[name], problem = _single_valued(name, line, tolerance, np.ptp(ring[:, 1]))
        wrong += [problem] if problem else []
    return (None if wrong else Outline(lines["surface"], lines["base"])), wrong, notes


def _run(near):
    """Return first and last row of the one run of true values on a closed ring, or None twice."""
    starts = np.flatnonzero(near & ~np.roll(near, 1))
    stops = np.flatnonzero(near & ~np.roll(near, -1))
    return (starts[0], stops[0]) if len(starts) == 1 else (None, None)


def _upright(side, ring):
    """Return the rows of a side without the points of surface and base that begin it and end it."""
    dx, dz = np.abs(np.diff(ring[side], axis=0)).T
    steep = np.flatnonzero(dz > dx)
    return side[steep[0] : steep[-1] + 2] if len(steep) else side


def _between(ring, start, stop):
    """Return the points of a closed ring from one row to another."""
    stop = stop if stop > start else stop + len(ring)
    return ring[np.arange(start, stop + 1) % len(ring)].copy()


def _single_valued(name, line, tolerance, height):
    """Return a line of strictly ascending x, and what is wrong with it or None."""
    reach = np.maximum.accumulate(line[:, 0])
    back = reach - line[:, 0]
    if back.max() > tolerance:
        where = f"{number(back.max())} m near {place(line[back.argmax()])}"
        advice = (
            "fill the space under the overhang" if name == "surface" else "cut it at a level base"
        )
        return line, f"the {name} doubles back by {where}; it must have one z at every x: {advice}"
    rough = shapely.get_coordinates(shapely.simplify(shapely.linestrings(line), tolerance))
    dx, dz = np.abs(np.diff(rough, axis=0)).T
    for slope, drop in STEEP:
        fall = np.where(dz > slope * dx, dz, 0)
        if fall.max() > max(drop * height, 5 * tolerance):
            middle = place(rough[fall.argmax() : fall.argmax() + 2].mean(axis=0))
            return line, (
                f"the {name} rises or falls {number(fall.max())} m like a wall near {middle}: fill "
                "it if it is a gap, or cut the section at one vertical line from base to surface"
            )
    return line[np.append(True, reach[1:] > reach[:-1])], None


def _leaning(name, edge, ring):
    """Return how far a side is from vertical, and what to do."""
    low, high = ring.min(axis=0), ring.max(axis=0)
    x, z = ((ring - low) / (high - low)).T
    x = x if name == "left" else 1 - x
    corners = ring[[np.argmin(x + z), np.argmin(x + 1 - z)]]
    off = np.abs(corners[:, 0] - edge)
    far = corners[off.argmax()]
    if off.max() == 0:
        runs = ring[np.abs(ring[:, 0] - edge) > 0]
        far = runs[np.argmin(np.abs(runs[:, 0] - edge))]
        return (
            f"the {name} side is not one vertical line: it has a notch near {place(far)}; fill it"
        )
    return (
        f"the {name} side is not vertical: it runs {number(off.max())} m off, to {place(far)}; "
        f"cut the section at a vertical line"
    )

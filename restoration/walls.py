"""From the walls of a case to those of a scene, and what walls cannot do together."""

import numpy as np

from restoration.entries import TableEntry, is_age
from restoration.scene import WALLS, Table, Wall, normal_axis, normal_velocity, value_at
from restoration.units import YEAR, show


def wall_of(name, entry, dim=2):
    """Return a wall of the scene; a wall that is not given is free-slip."""
    zero = (0.0,) * dim
    if entry is None or entry.kind == "free-slip":
        held = [None] * dim
        held[normal_axis(name, dim)] = 0.0
        return Wall("free-slip", tuple(held), zero)
    if entry.kind == "no-slip":
        return Wall("no-slip", zero, zero)
    if entry.kind == "free":
        return Wall("free", (None, None), zero)
    values = tuple(_value_of(value, 1 - normal_axis(name, 2)) for value in entry.values)
    if entry.kind == "velocity":
        return Wall("velocity", values, zero)
    return Wall("traction", (None, None), values)


def _value_of(entry, axis):
    """Return a number, a `Table` along an axis, or None."""
    if not isinstance(entry, TableEntry):
        return None if entry is None else entry.si
    rows = entry.value if entry.at and entry.time else [entry.value]
    values = np.array([[quantity.si for quantity in row] for row in rows])
    at, time = np.zeros(1), np.zeros(1)
    if entry.at:
        at = np.array([quantity.si for quantity in entry.at])
    if entry.time:
        time = np.array([-mark.si if is_age(mark) else mark.si for mark in entry.time])
        values = values.reshape(len(time), -1)
    by_time, along = np.argsort(time), np.argsort(at)
    values = values[by_time][:, along]
    return Table(
        axis, tuple(at[along].tolist()), tuple(time[by_time].tolist()), _tuples(values.tolist())
    )


def _tuples(rows):
    return tuple(map(tuple, rows))


def side(name, outline):
    """Return the line of a wall, shape (n, 2), m: surface and base rightwards, sides upwards."""
    if name in ("surface", "base"):
        return getattr(outline, name)
    end = 0 if name == "left" else -1
    return np.array([outline.base[end], outline.surface[end]])


def misplaced(boundary, walls, outline, marks):
    """Return (wall, message) about tables beside their wall, or that count time as no mark does.

    Args:
        boundary: `entries.Boundary`.
        walls: `scene.Wall` by name.
        outline: `scene.Outline`.
        marks: of the case.
    """
    found = []
    for name in WALLS:
        entry, line = getattr(boundary, name), side(name, outline)
        tables = [value for value in entry.values or () if isinstance(value, TableEntry)]
        ages = {is_age(table.time[0]) for table in tables if table.time}
        if ages and ages != {is_age(marks[0])}:
            counted = "ages (Ma)" if is_age(marks[0]) else "times (Myr)"
            found.append((name, f"the marks are {counted}; write the times of a table so too"))
        for table in (*walls[name].velocity, *walls[name].traction):
            if not isinstance(table, Table) or len(table.positions) == 1:
                continue
            low, high = line[:, table.axis].min(), line[:, table.axis].max()
            if table.positions[-1] <= low or table.positions[0] >= high:
                ends = f"from {show(low, 'length')} to {show(high, 'length')}"
                along = "x" if table.axis == 0 else "z (up, below 0 under the surface of a box)"
                found.append((name, f"the table lies beside the wall, which is {ends} in {along}"))
    return list(dict.fromkeys(found))


def loose(walls):
    """Return messages about motions that no wall holds, for which Stokes has no single answer."""
    messages = []
    for axis, way in enumerate(("sideways", "up or down")):
        if all(wall.velocity[axis] is None for wall in walls.values()):
            messages.append(
                f"no wall holds the section from moving {way}; make one no-slip or free-slip"
            )
    turning = any(
        wall.velocity[normal_axis(name, 2)] is not None or None not in wall.velocity
        for name, wall in walls.items()
    )
    if not turning and not messages:
        messages.append("no wall holds the section from turning; make one no-slip or free-slip")
    return messages


def unbalanced(walls, outline):
    """Return the message about a closed section whose walls let more in than out."""
    if any(normal_velocity(name, wall, outline) is None for name, wall in walls.items()):
        return []
    # linear in time between the times of the tables, so that these tell all
    tables = [v for wall in walls.values() for v in wall.velocity if isinstance(v, Table)]
    times = sorted({time for table in tables for time in table.times}) or [0.0]
    fluxes = [[outward(name, wall, outline, t) for name, wall in walls.items()] for t in times]
    net, gross = np.sum(fluxes, axis=1), np.abs(fluxes).sum(axis=1)
    worst = np.argmax(np.abs(net) - 1e-6 * gross)
    net, gross = net[worst], gross[worst]
    if abs(net) <= 1e-6 * gross:
        return []
    moment = show(times[worst], "time") if times[worst] >= 0 else show(-times[worst], "age")
    when = f" at {moment}" if len(times) > 1 else ""
    more, less = ("out", "in") if net > 0 else ("in", "out")
    return [
        f"the walls let {abs(net) * YEAR:.3g} m^2/yr more {more} than {less}{when}, and rock keeps "
        "its volume; balance them, or leave one wall to itself, such as surface: {traction: [0 "
        "MPa, 0 MPa]}"
    ]


def outward(name, wall, outline, time):
    """Return the flux that the velocity of a wall lets out at a model time, m^2/s.

    Args:
        name: of the wall.
        wall: `scene.Wall` whose normal velocity is held.
        outline: `scene.Outline`.
        time: s.
    """
    if wall.kind == "free-slip":
        return 0.0
    points = side(name, outline)
    for table in wall.velocity:
        if isinstance(table, Table):
            points = _with_vertices(points, table)
    u, w = (value_at(value or 0.0, points, time) for value in wall.velocity)
    run, rise = np.diff(points, axis=0).T
    sign = 1 if name in ("surface", "left") else -1
    # along the surface rightwards rock leaves to the left hand, along the left side upwards too
    return sign * float(((w[1:] + w[:-1]) / 2 * run - (u[1:] + u[:-1]) / 2 * rise).sum())


def _with_vertices(points, table):
    """Return a line with vertices where a table has its positions too."""
    along = points[:, table.axis]
    inner = [p for p in table.positions if along[0] < p < along[-1]]
    at = np.unique(np.r_[along, inner])
    return np.column_stack([np.interp(at, along, axis) for axis in points.T])

"""What a case would solve, told before anything is solved."""

from itertools import pairwise

import numpy as np

from restoration.advection import SCHEMES
from restoration.layered import restorable
from restoration.measured import expected
from restoration.plan import active, solved_directly, time_label, unknowns
from restoration.scene import Table
from restoration.seeding import count_points
from restoration.stopping import asked
from restoration.units import show

# Memory of a run: a base, MB, and bytes for each unknown and each particle; fitted to the table of
# `docs/measure.py memory`.
BASE_MB, PER_UNKNOWN, PER_PARTICLE = 400, 2400, 300
# In three dimensions: a base, and bytes for each unknown by solver; the entries of factors grow as
# the power 4/3 of the unknowns. Fitted to the table of `docs/boxes.py memory`.
BOX_BASE_MB, PER_UNKNOWN_FIELDSPLIT = 550, 3300
PER_FACTOR = {"P2-P1": 280, "P2b-P1dg": 120}  # bubbles fill little


def describe(loaded, forecast=None):
    """Return what a case would solve, as plain values in SI.

    Args:
        loaded: `resolve.Loaded`.
        forecast: `forecast.Forecast`, or None where nothing was rehearsed.
    """
    scene = loaded.scene
    cells, count = unknowns(scene.cells, scene.mesh.element)
    particles = count_points(scene) if scene.cloud is None else len(scene.cloud.x)
    spans = [b - a for a, b in pairwise(scene.time.marks)]
    steps = scene.time.min_steps * len(spans)
    return {
        "title": scene.title,
        "width_m": scene.outline.width,
        "length_m": scene.length,
        "height_m": scene.outline.height,
        "area_m2": scene.outline.area,
        "rocks": [
            {"name": r.name, "density": r.density, "viscosity": r.viscosity, "color": r.color}
            for r in scene.rocks
        ],
        "units": [{"name": unit.name, "rock": scene.rocks[unit.rock].name} for unit in scene.units],
        "lines": _lines(scene),
        "walls": {
            name: {
                "kind": scene.walls[name].kind,
                "velocity_m_per_s": _wall_numbers(scene.walls[name].velocity),
                "traction_pa": _wall_numbers(scene.walls[name].traction),
            }
            for name in scene.walls
        },
        "marks_s": list(scene.time.marks),
        "stop": scene.time.stop and dict(vars(scene.time.stop)),
        "scheme": scene.time.scheme,
        "cells": cells,
        "mesh_varies": scene.mesh.refine is not None or scene.mesh.interfaces != "particles",
        "unknowns": count,
        "particles": particles,
        "memory_mb_about": _memory(scene, count, particles),
        "steps_at_least": steps,
        "stokes_solves_at_least": steps * SCHEMES[scene.time.scheme].solves + 1,
        "viscosity_contrast": float(scene.unit_viscosity.max() / scene.unit_viscosity.min()),
        "active": active(scene),
        "notes": list(scene.notes),
        "time_forecast_s": forecast and round(forecast.seconds, 1),
        "forecast": forecast and vars(forecast),
        "restorability": restorable(scene),
        "expected": (told := expected(scene)) and vars(told),
    }


def _memory(scene, unknowns, particles):
    """Return the memory of a run, about, MB."""
    base, size = BASE_MB, unknowns * PER_UNKNOWN
    if scene.dim == 3:
        base, direct = BOX_BASE_MB, solved_directly(scene)
        size = PER_UNKNOWN_FIELDSPLIT * unknowns
        size = PER_FACTOR[scene.mesh.element] * unknowns ** (4 / 3) if direct else size
    return round(base + (size + particles * PER_PARTICLE) / 1e6)


def describe_text(loaded, forecast=None):
    """Return what a case would solve, for people; arguments as `describe`."""
    scene, about = loaded.scene, describe(loaded, forecast)
    lines = [scene.title, _size_text(scene)]
    for rock in scene.rocks:
        of = [unit.name for unit in scene.units if scene.rocks[unit.rock] is rock]
        lines.append(
            f"rock       {rock.name}: {show(rock.density, 'density')}, "
            f"{show(rock.viscosity, 'viscosity')}"
            + ("" if of == [rock.name] else f"; units {', '.join(of)}")
        )
    for sheet in scene.sheets:
        lines.append(f"{sheet.kind:<10} {sheet.name}, a sheet of {len(sheet.points)} points")
    for line in about["lines"] if scene.dim == 2 else ():
        pieces = f" in {line['pieces']} pieces" if line["pieces"] > 1 else ""
        length = show(line["length_m"], "length")
        wide = f", {show(line['width_m'], 'length')} wide" if line["width_m"] else ""
        lines.append(f"{line['kind']:<10} {line['name']}, {length} long{pieces}{wide}")
    for name in scene.walls:
        lines.append(f"{name:<10} {_wall_text(scene.walls[name])}")
    lines.append(f"gravity    {scene.gravity:g} m/s^2, downwards")
    for a, b in pairwise(scene.time.marks):
        way = "forward" if b > a else "restoring"
        ends = f"from {time_label(scene, a)} to {time_label(scene, b)}"
        lines.append(f"march      {ends}, {way}")
    if scene.time.stop:
        lines.append(f"stop       {asked(scene.time.stop)}")
    shape = "squares" if scene.mesh.element.startswith("Q") else "triangles"
    base = "squares" if scene.dim == 2 else "cubes"
    shape = shape if scene.dim == 2 else "tetrahedra"
    refined = scene.mesh.refine is not None
    about_text = " and more where it is finer" if refined else ""
    rough = "about " if scene.mesh.interfaces != "particles" else ""
    lines += [
        f"mesh       {' x '.join(map(str, scene.cells))} {base}, {rough}{about['cells']} {shape}, "
        f"{rough}{about['unknowns']} unknowns{about_text}",
        f"particles  {about['particles']}",
        f"work       at least {about['steps_at_least']} steps and "
        f"{about['stokes_solves_at_least']} Stokes solves; more where the flow is fast "
        f"(courant {scene.time.courant:g})",
        f"memory     about {about['memory_mb_about']} MB",
        *_forecast_lines(forecast),
        *_expected_lines(about["expected"]),
    ]
    if scene.free:
        lines.append(f"surface    {about['restorability']['verdict']}")
    lines += [f"active     {part}" for part in about["active"]]
    lines += [f"note       {note}" for note in scene.notes]
    lines += ["", "# the case with every default", loaded.resolved.rstrip()]
    return "\n".join(lines)


def _size_text(scene):
    """Return how large the section or the box is, in words."""
    width, height = (show(side, "length") for side in (scene.outline.width, scene.outline.height))
    if scene.dim == 2:
        return f"section    {width} wide, {height} high, {scene.outline.area / 1e6:.4g} km^2"
    volume = scene.outline.area * scene.length / 1e9
    long = show(scene.length, "length")
    return f"box        {width} wide, {long} long, {height} high, {volume:.4g} km^3"


def _forecast_lines(forecast):
    """Return what a rehearsal told, for people."""
    if forecast is None:
        return ["time       restore check --forecast rehearses the run and tells"]
    presets = ", ".join(f"{name} {_duration(s)}" for name, s in forecast.presets.items())
    certificate = ""
    if forecast.certificate_s:
        certificate = f", {_duration(forecast.certificate_s)} of it for the certificate"
    return [
        f"forecast   {_duration(forecast.seconds)}{certificate}; about {forecast.steps} steps and "
        f"{forecast.solves} Stokes solves, {forecast.memory_mb:.0f} MB",
        f"presets    cost, with their cells and steps: {presets}",
    ]


def _expected_lines(told):
    """Return what the presets may give, for people."""
    if told is None:
        return []
    lines = [
        f"presets    {what}: {_errors_text(errors)}"
        for what, errors in (
            ("give horizons off by, in the mean", told["carried"]),
            ("the same with mesh.interfaces: fitted", told["fitted"]),
        )
        if errors
    ]
    kind = "a case of its kind" if told["like"] else "a case of another kind, for want of its own"
    command = told["command"].removesuffix(" --json")
    return [
        *lines,
        f"           as measured by `{command}`, {kind}, and scaled by height: a guess that knows "
        "nothing of how far a scene goes; the certificate of a run replaces it",
    ]


def _errors_text(errors):
    """Return errors by preset in words, two figures."""
    return ", ".join(f"{name} {show(float(f'{e:.2g}'), 'length')}" for name, e in errors.items())


def _duration(seconds):
    """Return a duration in words, two figures."""
    for unit, length in (("d", 86400), ("h", 3600), ("min", 60)):
        if seconds >= 1.5 * length:
            return f"{float(f'{seconds / length:.2g}'):g} {unit}"
    return f"{float(f'{seconds:.2g}'):g} s"


def _lines(scene):
    """Return horizons and faults by name with their length and pieces."""
    rows, widths = {}, {fault.name: fault.width for fault in scene.faults}
    for line in scene.lines:
        if line.kind == "edge":
            continue
        width = widths.get(line.name) if line.kind == "fault" else None
        row = rows.setdefault(
            (line.name, line.kind),
            {"name": line.name, "kind": line.kind, "length_m": 0.0, "pieces": 0, "width_m": width},
        )
        row["length_m"] += float(np.linalg.norm(np.diff(line.points, axis=0), axis=1).sum())
        row["pieces"] += 1
    sheets = [
        {"name": sheet.name, "kind": sheet.kind, "points": len(sheet.points)}
        for sheet in scene.sheets
    ]
    return [*rows.values(), *sheets]


def _wall_text(wall):
    """Return a wall in words."""
    if wall.kind == "velocity":
        return f"velocity [{', '.join(_value_text(v, 'velocity') for v in wall.velocity)}]"
    if wall.kind == "traction":
        return f"traction [{', '.join(_value_text(t, 'pressure') for t in wall.traction)}]"
    return wall.kind


def _value_text(value, kind):
    """Return one value of a wall in words."""
    if not isinstance(value, Table):
        return "free" if value is None else show(value, kind)
    ways = ["along the wall"] * (len(value.positions) > 1) + ["in time"] * (len(value.times) > 1)
    low, high = (show(end, kind) for end in value.span)
    return f"{low} to {high} {' and '.join(ways)}"


def _wall_numbers(values):
    """Return the values of a wall as plain ones."""
    return [
        {"at_m": value.positions, "time_s": value.times, "value": value.values}
        if isinstance(value, Table)
        else value
        for value in values
    ]

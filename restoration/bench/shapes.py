"""Sections that no geologist would draw, made at random: each is solved, or refused with a reason.

They are read and marched in a child process, so that one that ends it, or never ends, is a finding:
``python -m restoration.bench.shapes FIRST LAST`` prints a line of JSON before and after each.
"""

import json
import math
import subprocess
import sys
import tempfile
import threading
from itertools import pairwise
from pathlib import Path

import numpy as np
import shapely

from restoration.bench.rows import Clock, Row
from restoration.engine import StokesEngine
from restoration.environment import use_jit_cache, use_numba_cache
from restoration.errors import RestorationError
from restoration.guards import drawn_shares
from restoration.lines import surface_of
from restoration.resolve import load
from restoration.run import march
from restoration.surface import line_area

SHAPES, QUICK = 64, 40
PATIENCE = 120  # s that a shape may take; the slowest took a tenth of that
RESIDUAL, AREA = 1e-8, 1e-6  # true relative residual; change of the area in two steps
CUT = 2e-3  # of the area, that the cells below a free surface may cut off or add
ROCK = 0.02  # of the section: what no rock may differ by between mesh and drawing
WIDTH, HEIGHT, FLAT = 4000.0, 1000.0, 4e-3
LONG = "long and flat"  # a thousand times, by `FLAT`
KINDS = (
    "waves",
    "wedge of one degree",
    "horizons that touch",
    "sliver",
    "steep relief",
    "spikes in the surface",
    "faults at small angles",
    "many layers",
    "points given twice",
    "vertex through its neighbour",
    "base above the surface",
    "lenses joined by a weld",
    "gaps and overlaps",
    LONG,
    "horizon out of the surface",
    "tips of faults at contacts",
)


def horizons(rng, x, count, amplitude=0.03):
    """Return ``count`` wavy lines one above the other inside the section, each of shape (n,), m."""
    levels = (np.arange(count) + 1.0) / (count + 1) + 0.3 / (count + 1) * rng.uniform(-1, 1, count)
    waves = []
    for level in levels:
        k, phase = rng.uniform(1, 9) * math.pi / WIDTH, rng.uniform(0, 6)
        waves.append(-HEIGHT * (1 - level) + amplitude * HEIGHT / count * np.cos(k * x + phase))
    return waves


def drawn(number):
    """Return the shape of a number.

    Returns:
        (kind, polygons, faults): its kind; the units ``u0``, ``u1`` ..., from the base up; lines
        (n, 2), m.
    """
    rng = np.random.default_rng(number)
    kind = KINDS[number % len(KINDS)]
    x = np.linspace(0, WIDTH, int(rng.integers(9, 90)))
    top, base = np.zeros_like(x), np.full_like(x, -HEIGHT)
    lines, tiny = horizons(rng, x, int(rng.integers(1, 5))), 10.0 ** rng.uniform(-8, -3)
    if kind == "wedge of one degree":
        tip = rng.uniform(0.2, 0.9) * WIDTH
        lines.insert(1, lines[0] + np.tan(np.radians(rng.uniform(0.3, 1.5))) * (tip - x).clip(0))
    elif kind == "horizons that touch":
        at = rng.choice(x)
        lines.insert(1, lines[0] + ((x - at) / WIDTH) ** 2 * HEIGHT)
    elif kind == "sliver":
        lines.insert(1, lines[0] + tiny * HEIGHT * rng.uniform(0.2, 1, len(x)))
    elif kind == "steep relief":
        top = HEIGHT * rng.uniform(0.02, 0.3) * np.sin(x / rng.uniform(60, 300))
        lines = [line - 0.35 * HEIGHT for line in lines[:1]]
    elif kind == "spikes in the surface":
        rows = rng.integers(1, len(x) - 1, int(rng.integers(1, 6)))
        top[rows] += HEIGHT * 10.0 ** rng.uniform(-4, 0.2, len(rows))
    elif kind == "many layers":
        lines = horizons(rng, x, int(rng.integers(12, 40)))
    elif kind == LONG:
        lines, base = [line * FLAT for line in lines], base * FLAT
    elif kind == "horizon out of the surface":
        lines[-1] = lines[-1] + (x / WIDTH) * 2 * HEIGHT
    elif kind == "base above the surface":
        base = base + rng.uniform(0.5, 2.2) * HEIGHT * np.exp(-(((x - 0.6 * WIDTH) / 300) ** 2))
    elif kind == "vertex through its neighbour":
        row = int(rng.integers(1, len(x) - 2))
        lines[0][row] = lines[-1][row] + HEIGHT * 0.1 * rng.uniform(-2, 2)
    z = [base, *lines, top]
    if kind not in ("vertex through its neighbour", "gaps and overlaps"):
        z = list(np.maximum.accumulate(np.minimum(z, top), axis=0))
        if kind == "base above the surface":
            z[-1] = top
    rings = [
        np.vstack([np.column_stack([x, low]), np.column_stack([x, high])[::-1]])
        for low, high in pairwise(z)
    ]
    if kind == "points given twice":
        rings = [np.repeat(ring, rng.integers(1, 4, len(ring)), axis=0) for ring in rings]
        off = tiny * rng.uniform(-1, 1, 2)
        rings = [ring + np.where(rng.random((len(ring), 1)) < 0.3, off, 0) for ring in rings]
    elif kind == "gaps and overlaps":
        rings[0] = rings[0] + [0.0, HEIGHT * 10.0 ** rng.uniform(-7, -2) * rng.choice([-1, 1])]
    polygons = [shapely.Polygon(ring) for ring in rings]
    if kind == "lenses joined by a weld":
        bell = _dumb_bell(rng, max(tiny * HEIGHT, 1e-5))
        polygons = [*(polygon.difference(bell) for polygon in polygons), bell]
    return kind, polygons, _fault_lines(rng, kind, x, lines)


def _dumb_bell(rng, neck):
    """Return two round bodies joined by a layer ``neck`` thick, m."""
    at = np.array([[1300.0, -500.0], [2400.0, -500.0 + rng.uniform(-200, 200)]])
    bodies = shapely.buffer(shapely.points(at), rng.uniform(20, 200))
    return shapely.union_all([*bodies, shapely.buffer(shapely.linestrings(at), neck / 2)])


def _fault_lines(rng, kind, x, lines):
    """Return faults that cross at angles of a degree or so, or end at and beside contacts."""
    if kind not in ("faults at small angles", "tips of faults at contacts"):
        return []
    if kind == "faults at small angles":
        at, depth = rng.uniform(0.3, 0.7) * WIDTH, rng.uniform(-0.8, -0.2) * HEIGHT
        slopes = np.radians(rng.uniform(-60, 60) + np.cumsum(rng.uniform(0.1, 3, 3)))
        reach = np.array([-1, 1]) * rng.uniform(0.05, 0.2) * HEIGHT
        return [
            np.column_stack([at + reach * math.cos(a), depth + reach * math.sin(a)]) for a in slopes
        ]
    row = int(rng.integers(2, len(x) - 2))
    tip = np.array([x[row], lines[0][row]])
    off = np.array([0.0, HEIGHT * 10.0 ** rng.uniform(-9, -2) * rng.choice([-1, 0, 1])])
    return [
        np.vstack([tip + off, tip + [30.0, 0.05 * HEIGHT]]),
        np.vstack([tip, tip + [-40.0, 0.06 * HEIGHT]]),
    ]


def written(number, folder):
    """Write the case of a shape and its section; return (kind, choices, path of the case)."""
    kind, polygons, faults = drawn(number)
    rng = np.random.default_rng([number, 1])
    features = [_feature({"unit": f"u{i}"}, shape) for i, shape in enumerate(polygons)]
    features += [
        _feature({"name": f"f{i}"}, shapely.linestrings(line)) for i, line in enumerate(faults)
    ]
    section = {"type": "FeatureCollection", "features": features}
    (folder / "section.geojson").write_text(json.dumps(section), encoding="utf-8")
    rocks = {
        f"u{i}": f"{{density: {2200 + 400 * rng.random():.0f} kg/m^3, "
        f"viscosity: {10 ** rng.uniform(17, 20):.3g} Pa s}}"
        for i in range(len(polygons))
    }
    interfaces = ("fitted", "particles", "auto")[int(rng.integers(3))]
    surface = ("free-slip", "free")[int(rng.integers(2))]
    element = ("P2-P1", "P2b-P1dg")[int(rng.integers(2))]
    cells = "[30, 2]" if kind == LONG else "6"
    where = "[interfaces, faults]" if faults else "interfaces"
    refine = f", refine: {{levels: {int(rng.integers(1, 3))}, where: {where}}}"
    refine = refine if rng.random() < 0.3 else ""
    lines = [
        f"section: {{file: section.geojson, property: unit, tolerance: {_tolerance(rng)}}}",
        "rocks:",
        *(f"  {name}: {rock}" for name, rock in rocks.items()),
        f"boundary: {{surface: {surface}}}",
        f"mesh: {{cells: {cells}, element: {element}, interfaces: {interfaces}{refine}}}",
        "time: {marks: [0 kyr, 0.1 kyr], scheme: midpoint, courant: 0.5, min_steps: 2}",
        "certificate: off",
    ]
    if faults and interfaces == "fitted" and rng.random() < 0.5:
        lines += ["faults:", "  - {rock: u0, width: 20 m, line: f0}"]
    path = folder / "case.yaml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return kind, f"{interfaces}, {surface}, {element}{', refined' if refine else ''}", path


def _tolerance(rng):
    """Return a tolerance of the section, as text."""
    return f"{10 ** rng.uniform(-4, 0.5):.2g} m"


def _feature(properties, shape):
    geometry = json.loads(shapely.to_geojson(shape))
    return {"type": "Feature", "properties": properties, "geometry": geometry}


def marched(path):
    """March a case and return its numbers.

    Returns:
        residual: worst true relative one; cut: area of the mesh against that of the section; area:
        change of the section, below its surface line where that is free; rock: greatest difference
        of a rock between a fitted mesh and the drawing, over the section; cells; fastest: m/s.
    """
    scene = load(path).scene
    engine = StokesEngine(scene)
    state = engine.with_flow(engine.start())
    rock = _rock_error(scene, state.grid) if engine.fitted else 0.0
    begin = state.grid.section.area
    state = march(state, engine, scene.time)
    if scene.free:
        change = line_area(surface_of(state.lines).points) - line_area(scene.outline.surface)
        change /= scene.outline.area
    else:
        change = state.grid.section.area / begin - 1
    finite = np.isfinite(state.flow.u).all() and np.isfinite(state.flow.p).all()
    return {
        "residual": engine.counts.worst_residual,
        "cut": begin / scene.outline.area - 1,
        "area": float(change),
        "rock": rock,
        "cells": state.grid.section.cell_count,
        "fastest": state.grid.speeds(state.flow)[1] if finite else math.nan,
        "bound": CUT if scene.free else AREA,
    }


def _rock_error(scene, grid):
    """Return the greatest difference of a rock between mesh and drawing, over the section."""
    rock = np.array([unit.rock for unit in scene.units])[grid.fields.unit]
    found = np.bincount(rock, grid.index.area, len(scene.rocks)) / grid.index.area.sum()
    return float(np.abs(found - drawn_shares(scene, 400)).max())


def judged(number):
    """Return what becomes of a shape: a dict with ``verdict`` solved, refused or silent."""
    with tempfile.TemporaryDirectory() as folder:
        kind, choices, path = written(number, Path(folder))
        about = {"number": number, "kind": kind, "choices": choices}
        try:
            found = marched(path)
        except RestorationError as error:
            message = str(error).replace(folder, "").strip()
            good = error.exit_code in (2, 3, 4) and message
            verdict = "refused" if good else "silent"
            return about | {"verdict": verdict, "code": error.exit_code, "why": message}
        except Exception as error:  # a finding: nothing else may come out of the program
            return about | {"verdict": "silent", "why": f"{type(error).__name__}: {error}"}
    wrong = [
        name
        for name, bad in (
            ("not finite", not math.isfinite(found["fastest"])),
            ("residual", not found["residual"] <= RESIDUAL),
            ("area not as drawn", not abs(found["cut"]) <= found["bound"]),
            ("area lost", not abs(found["area"]) <= AREA),
            ("rocks not as drawn", not found["rock"] <= ROCK),
        )
        if bad
    ]
    verdict = "silent" if wrong else "solved"
    return about | {"verdict": verdict, "why": ", ".join(wrong)} | found


def told(first, last):
    """Yield what becomes of the shapes from ``first`` to before ``last``, each a dict."""
    number = first
    while number < last:
        command = [sys.executable, "-m", "restoration.bench.shapes", str(number), str(last)]
        quiet = {"stdout": subprocess.PIPE, "stderr": subprocess.DEVNULL}
        with subprocess.Popen(command, text=True, **quiet) as child, Watch(child) as watch:
            for line in child.stdout:
                watch.begin()
                found = json.loads(line)
                if found is not None:
                    number += 1
                    yield found
            code = child.wait()
        if number < last:
            yield {
                "number": number,
                "kind": KINDS[number % len(KINDS)],
                "choices": "",
                "verdict": "silent",
                "why": f"the process ended with {code}, by itself or after {PATIENCE} s",
            }
            number += 1


class Watch:
    """Ends a process that says nothing for `PATIENCE`, and any at the end of its context."""

    def __init__(self, process):
        self._process, self._timer = process, None

    def begin(self):
        """Begin to wait, anew."""
        self._cancel()
        self._timer = threading.Timer(PATIENCE, self._process.kill)
        self._timer.start()

    def _cancel(self):
        if self._timer is not None:
            self._timer.cancel()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._cancel()
        self._process.kill()


def run_shapes(quick):
    """Sections made at random, at the limits of what can be drawn: solved, or refused."""
    clock = Clock()
    rows = list(told(0, QUICK if quick else SHAPES))
    for kind in KINDS:
        some = [row for row in rows if row["kind"] == kind]
        solved = [row for row in some if row["verdict"] == "solved"]
        refused = [row for row in some if row["verdict"] == "refused"]
        silent = [row for row in some if row["verdict"] == "silent"]
        counts = {"solved": len(solved), "refusals": len(refused), "silent": len(silent)}
        worst = {
            name: max((abs(row[name]) for row in solved), default=None)
            for name in ("residual", "cut", "area", "rock")
        }
        reasons = list(dict.fromkeys(row["why"].splitlines()[0] for row in refused))
        yield Row(
            "shapes",
            kind,
            f"of {len(some)} neither solved nor refused",
            len(silent),
            0.0,
            None,
            0.0,
            wall_s=clock.seconds,
            parameters=counts | worst | {"why": reasons, "wrong": silent},
        )


def panels(rows):
    """Return the panel of the figure, see `pictures.draw`: what became of the shapes by kind."""
    series = {
        name: (
            [1 + KINDS.index(row.case) for row in rows],
            [row.parameters[name] for row in rows],
            "",
        )
        for name in ("solved", "refusals", "silent")
    }
    series |= {f"{i}: {kind}": ([], [], "line") for i, kind in enumerate(KINDS, 1)}
    return [("sections made at random", "kind", "shapes", ("linear", "linear"), series)]


def main(first, last):
    """Print a line before the first shape, and one for each."""
    use_jit_cache()
    use_numba_cache()
    print(json.dumps(None), flush=True)
    for number in range(first, last):
        print(json.dumps(judged(number)), flush=True)


if __name__ == "__main__":
    main(*map(int, sys.argv[1:]))

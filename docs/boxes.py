"""The measurements of docs/boxes.md: ``.venv/bin/python docs/boxes.py NAME``.

Each prints a table. Seconds are CPU seconds of one process; they take some minutes together.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from performance import ROOT, head, main, row

from meshes.body_centred import body_centred_mesh
from meshes.box import box_mesh
from restoration import box_engine
from restoration.box_engine import BoxEngine
from restoration.check import describe
from restoration.layered import Layer, rates
from restoration.resolve import load
from restoration.run import march

DIAPIR = ROOT / "cases" / "diapir-3d" / "case.yaml"
SMOOTH = 8  # degree of the curve that a ripple is measured from
SIDE, DEPTH, HEIGHT, AMPLITUDE = 10e3, 3.5e3, 5e3, 200.0  # m, of the box and the wave in it
WAVE = """
section:
  box: {width: 10 km, length: 10 km, height: 5 km}
  layers:
    - rock: salt
      top: {depth: 3.5 km, cosine: {amplitude: 0.2 km, wavelength: 20 km, wavelength_y: 20 km}}
    - {rock: sediment}
rocks:
  salt: {density: 2150 kg/m^3, viscosity: 1e19 Pa s}
  sediment: {density: 2600 kg/m^3, viscosity: 1e19 Pa s}
particles: {densify: 20}
time: {marks: [0 Myr, 1 Myr]}
"""


def begun(*overrides):
    """Return the engine of the wave, its first state with the flow, and the seconds they took."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "case.yaml"
        path.write_text(WAVE, encoding="utf-8")
        scene = load(path, overrides).scene
    begin = time.process_time()
    engine = BoxEngine(scene)
    state = engine.with_flow(engine.start())
    return engine, state, time.process_time() - begin


def vertical(engine, state, points):
    """Return the vertical velocity at points, m/s."""
    grid = engine.grid
    cell, hats = grid.index.locate(points, grid.index.guess(points))
    return grid.sampler(grid.sampler.coefficients(state.flow.u), cell, hats)[:, 2]


def rate(engine, state):
    """Return the growth rate of the wave, 1/s: how fast the mode grows over its amplitude."""
    sheet, k = engine.scene.sheets[0], np.pi / SIDE
    mode = np.cos(k * sheet.points[:, 0]) * np.cos(k * sheet.points[:, 1])
    weight = np.ones(sheet.shape)
    weight[[0, -1]] *= 0.5
    weight[:, [0, -1]] *= 0.5
    moved = np.average(vertical(engine, state, sheet.points) * mode, weights=weight.ravel())
    return moved / np.average(AMPLITUDE * mode**2, weights=weight.ravel())


def grows(engine, state):
    """Return how far the growth rate is from linear theory, in words."""
    layers = [Layer(HEIGHT - DEPTH, 2150.0, 1e19), Layer(DEPTH, 2600.0, 1e19)]
    (exact,) = rates(layers, np.sqrt(2) * np.pi / SIDE, 9.81, "no-slip", "free-slip")
    return f"{100 * (rate(engine, state) / exact - 1):+.1f} %"


def growth():
    """Growth rate of a dome of 0.2 km against linear theory, by cubes up, element and transfer."""
    head("element", "density by", "cubes", "unknowns", "rate is off by", "first flow, CPU s")
    for element, density, sizes in (
        ("P2-P1", "hat", (5, 6, 8, 10)),
        ("P2-P1", "projection", (5, 6, 8, 10)),
        ("P2b-P1dg", "hat", (4, 5, 6, 8)),
        ("P2b-P1dg", "projection", (4, 5, 6, 8)),
    ):
        for up in sizes:
            cells = f"mesh.cells=[{up}, {up}, {up}]"
            entries = cells, f"mesh.element={element}", f"transfer.density={density}"
            engine, state, seconds = begun(*entries)
            off, unknowns = grows(engine, state), engine.grid.spaces.unknowns
            row(element, density, f"{up} x {up} x {up}", unknowns, off, f"{seconds:.1f}")


def around_diagonals(low, high, cells, comm):
    """Return the mesh whose cubes are all alike, each around a diagonal."""
    return box_mesh(low, high, cells, comm=comm)


def diagonals():
    """What centred cubes are worth: how far the flow of a symmetric dome is from symmetric."""
    head("cubes", "density by", "growth is off by", "x mirrored, %", "x and y exchanged, %")
    line = np.linspace(0.05, 0.95, 19)
    x, y = (SIDE * axis.ravel() for axis in np.meshgrid(line, line))
    at = np.column_stack([x, y, np.full(x.size, -DEPTH)])
    middle = "section.layers.0.top.cosine"
    symmetric = f"{middle}.phase=5 km", f"{middle}.phase_y=5 km"
    for name, made in (("around a diagonal", around_diagonals), ("centred", body_centred_mesh)):
        box_engine.body_centred_mesh = made
        for density in ("hat", "projection"):
            entries = "mesh.cells=[8, 8, 6]", f"transfer.density={density}"
            engine, state, _ = begun(*entries, *symmetric)
            w = vertical(engine, state, at)
            others = np.column_stack([SIDE - x, y, at[:, 2]]), at[:, [1, 0, 2]]
            off = [np.linalg.norm(vertical(engine, state, other) - w) for other in others]
            grown = grows(*begun(*entries)[:2])
            row(name, density, grown, *(f"{100 * o / np.linalg.norm(w):.1f}" for o in off))
    box_engine.body_centred_mesh = body_centred_mesh


def ripples():
    """What cells do to the horizon of the case in 1 Myr: its relief, and its roughness."""
    head("cubes", "element", "density by", "relief, m", "off a smooth curve, m", "CPU s")
    for cells, element, density in (
        ([8, 8, 4], "P2-P1", "projection"),
        ([12, 12, 6], "P2-P1", "projection"),
        ([16, 16, 8], "P2-P1", "projection"),
        ([8, 8, 4], "P2b-P1dg", "projection"),
        ([8, 8, 4], "P2-P1", "hat"),
        ([12, 12, 6], "P2-P1", "hat"),
    ):
        entries = f"mesh.cells={cells}", f"mesh.element={element}", f"transfer.density={density}"
        scene = load(DIAPIR, (*entries, "time.marks=[0 Myr, 1 Myr]")).scene
        begin, engine = time.process_time(), BoxEngine(scene)
        (sheet,) = march(engine.start(), engine, scene.time).lines
        x, _, z = sheet.points.reshape(*sheet.shape, 3)[sheet.shape[0] // 2].T / SIDE
        off = SIDE * (z - np.polyval(np.polyfit(x, z, SMOOTH), x)).std()
        seconds = time.process_time() - begin
        shape = " x ".join(map(str, cells))
        row(shape, element, density, f"{SIDE * np.ptp(z):.0f}", f"{off:.1f}", f"{seconds:.0f}")


def solvers():
    """A step of rk4 of two viscosities by solver: salt 100 times weaker, CPU s."""
    head("cubes", "element", "unknowns", "direct", "fieldsplit", "iterations a solve")
    for cells, element in (
        ((8, 8, 6), "P2-P1"),
        ((10, 10, 8), "P2-P1"),
        ((12, 12, 10), "P2-P1"),
        ((8, 8, 6), "P2b-P1dg"),
    ):
        told = []
        for solver in ("direct", "fieldsplit"):
            salt = "rocks.salt.viscosity=1e17 Pa s"
            mesh = f"mesh.cells={list(cells)}", f"mesh.element={element}"
            engine, state, _ = begun(salt, *mesh, f"solver.name={solver}")
            before, begin = engine.counts.krylov_iterations, time.process_time()
            solved = engine.counts.solves
            dt = engine.stable_step(state, engine.scene.time.marks[1])
            engine.with_flow(engine.advance(state, state.time + dt))
            told.append(f"{time.process_time() - begin:.1f}")
            solved = engine.counts.solves - solved
        iterations = (engine.counts.krylov_iterations - before) / solved
        unknowns = engine.grid.spaces.unknowns
        row(" x ".join(map(str, cells)), element, unknowns, *told, f"{iterations:.0f}")


def memory():
    """Greatest resident memory of a run of one step, against what `restore check` says before."""
    head("cubes", "element", "solver", "unknowns", "peak, MB", "forecast, MB")
    for cells, element, solver in (
        ([8, 8, 6], "P2-P1", "direct"),
        ([8, 8, 6], "P2b-P1dg", "direct"),
        ([12, 12, 10], "P2-P1", "direct"),
        ([12, 12, 10], "P2-P1", "fieldsplit"),
        ([12, 12, 10], "P2b-P1dg", "fieldsplit"),
    ):
        entries = f"mesh.cells={cells}", f"mesh.element={element}", f"solver.name={solver}"
        entries = *entries, "time.marks=[0 Myr, 1 kyr]", "time.min_steps=1"
        with tempfile.TemporaryDirectory() as folder:
            sets = [part for entry in entries for part in ("--set", entry)]
            command = [sys.executable, "-m", "restoration.cli", "run", str(DIAPIR), *sets]
            command += ["--quiet", "--out", folder]
            subprocess.run(command, check=True, capture_output=True, cwd=ROOT)
            record = json.loads((Path(folder) / "run.json").read_text())
        told = describe(load(DIAPIR, entries))["memory_mb_about"]
        shape = " x ".join(map(str, cells))
        row(shape, element, solver, record["unknowns"], f"{record['peak_rss_mb']:.0f}", told)


TABLES = {f.__name__: f for f in (growth, diagonals, ripples, solvers, memory)}


if __name__ == "__main__":
    main(__doc__, TABLES, {})

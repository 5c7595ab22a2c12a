"""The measurements of docs/accuracy.md: ``.venv/bin/python docs/measure.py NAME``.

Each prints a table. They take from one to some ten minutes on two cores.
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from functools import partial
from itertools import product
from pathlib import Path

import numpy as np
from dolfinx import fem

from restoration import transfer
from restoration.acceptance import Divergence
from restoration.bench.boxes import Solved, unit_square
from restoration.check import describe
from restoration.diagnostics import line_distances, there_and_back, volume_by_rock
from restoration.engine import StokesEngine
from restoration.environment import use_jit_cache
from restoration.errors import SolveError
from restoration.lines import as_drawn
from restoration.particles import born_in, empty_cells, joined
from restoration.resolve import load
from restoration.run import march
from restoration.units import YEAR

ROOT = Path(__file__).parents[1]
DEMO = ROOT / "cases" / "diapir-isoviscous" / "case.yaml"
WEAK = ROOT / "cases" / "diapir-two-viscosities" / "case.yaml"
MYR = 1e6 * YEAR
FITTED = ("mesh.interfaces=fitted", "particles.per_cell=1")


class BirthsEverywhere(StokesEngine):
    """Gives every cell that runs empty a particle, as most particle codes do."""

    def _settled(self, particles):
        empty = empty_cells(particles, len(self.grid.index.area))
        return joined(particles, born_in(empty, particles, self.grid.index))


def journey(case, *overrides, engine=StokesEngine):
    """Run a case in memory; return the engine and its states at the marks."""
    engine = engine(load(case, overrides).scene)
    states = []
    march(
        engine.start(), engine, engine.scene.time, at_marks=(lambda _, state: states.append(state),)
    )
    return engine, states


def row(*cells):
    """Print a row of a table."""
    print("| " + " | ".join(str(cell) for cell in cells) + " |", flush=True)


def back(engine, states):
    """Return how a journey there and back ended, as cells of a table."""
    stats = there_and_back(states[-1].particles)[1]
    (line, *_) = line_distances(as_drawn(states[0].lines), as_drawn(states[-1].lines))
    return (
        f"{stats['mean_m']:.2f} / {stats['p99_m']:.1f} / {stats['max_m']:.1f}",
        f"{line['mean_m']:.2f} / {line['max_m']:.1f}",
        engine.counts.solves,
    )


def reversibility():
    """There and back with one scheme: steps, projection, particles."""
    row("case", "particles back: mean / p99 / max, m", "horizon: mean / max, m", "solves")
    for name, overrides in {
        "the demo (courant 0.5)": (),
        "courant 1": ("time.courant=1",),
        "midpoint": ("time.scheme=midpoint",),
        "the paper's steps": ("time.scheme=paper",),
        "the paper's steps and projection": (
            "time.scheme=paper",
            "transfer={density: quadrature, viscosity: cell, mean: harmonic}",
        ),
        "rk4 with means per cell": ("transfer={density: cell, viscosity: cell, mean: harmonic}",),
    }.items():
        row(name, *back(*journey(DEMO, *overrides)))
    row("a birth in every empty cell", *back(*journey(DEMO, engine=BirthsEverywhere)))
    for weight in (1e-4,):
        transfer.BACKGROUND, kept = weight, transfer.BACKGROUND
        row(f"background {weight:g} instead of {kept:g}", *back(*journey(DEMO)))
        transfer.BACKGROUND = kept


# What was the default when `truth` was measured.
SMOOTHED = ("transfer.density=hat", "particles.velocity=plain")


def truth():
    """The forward run against one on a mesh twice as fine with other particles and steps."""
    for age in (2, 4, 6):
        marks = f"time.marks=[0 Myr, {age} Myr]"
        fine = (*SMOOTHED, marks, "mesh.cells=90", "particles.seed=7", "time.min_steps=40")
        fine = journey(DEMO, *fine)[1][-1]
        for cells in (22, 45):
            end = journey(DEMO, *SMOOTHED, marks, f"mesh.cells={cells}")[1][-1]
            line = line_distances(fine.lines, end.lines)[0]
            row(
                f"{age} Myr",
                f"{cells} against 90 cells",
                *(f"{line[k]:.0f}" for k in ("mean_m", "max_m")),
            )


# Initial rms velocity of the demo, and with salt ten times weaker, over drho g H^2 / eta: a Fourier
# series at finite amplitude.
INITIAL = {"1e19 Pa s": 0.00018529497938115516, "1e18 Pa s": 0.0006729607400473148}


def initial(salt, *overrides):
    """Return the rms velocity of the first instant over drho g H^2 / eta."""
    scene = load(DEMO, (f"rocks.salt.viscosity={salt}", *overrides)).scene
    engine = StokesEngine(scene)
    rms, _ = engine.grid.speeds(engine.with_flow(engine.start()).flow)
    drho, eta = np.ptp(scene.unit_density), scene.unit_viscosity.max()
    return rms / (drho * scene.gravity * scene.outline.height**2 / eta)


def rock():
    """Initial rms velocity against theory, or a fitted mesh, by how the rock goes to the mesh."""
    cells = (16, 32, 64)
    row("salt", "density", "viscosity", *(f"{n} cells" for n in cells))
    for salt, exact in (*INITIAL.items(), ("5e16 Pa s", None)):
        exact = exact or initial(salt, "mesh.cells=64", *FITTED)
        for density, viscosity, mean in (
            ("hat", "hat", "harmonic"),
            ("projection", "hat", "harmonic"),
            ("projection", "hat", "geometric"),
            ("projection", "linear", "harmonic"),
            ("projection", "quadrature", "harmonic"),
            ("lines", "hat", "harmonic"),
            ("lines", "linear", "harmonic"),
            ("lines", "lines", "harmonic"),
            ("lines", "lines", "geometric"),
        ):
            if salt == "1e19 Pa s" and (viscosity, mean) != ("hat", "harmonic"):
                continue
            transfer = f"transfer={{density: {density}, viscosity: {viscosity}, mean: {mean}}}"
            found = (initial(salt, f"mesh.cells={n}", transfer) for n in cells)
            off = (f"{100 * (v / exact - 1):+.2f} %" for v in found)
            row(salt, density, f"{viscosity}, {mean}", *off)


def seeds():
    """The horizon by density and seed, against mesh lines on it, on 32 cells."""
    marks = "time.marks=[0 Myr, 2 Myr, 4 Myr]"
    fine = (marks, "time.scheme=rk4", "time.courant=5", "time.min_steps=40", "mesh.cells=32")
    exact = journey(DEMO, *fine, *FITTED)[1]
    row("cells", "density", "seed", "2 Myr: mean / max, m", "4 Myr: mean / max, m", "CPU s")
    for cells, density, seed in (
        (45, "fitted", 1),
        (32, "lines", 1),
        (45, "lines", 1),
        (45, "lines", 3),
        (32, "projection", 1),
        (45, "projection", 1),
        (45, "projection", 3),
        (32, "hat", 1),
        (45, "hat", 1),
    ):
        plan = (marks, "time.scheme=rk3", "time.courant=1", f"transfer.density={density}")
        if density == "fitted":
            plan = (*fine, *FITTED)
        begin = cpu()
        states = journey(DEMO, *plan, f"mesh.cells={cells}", f"particles.seed={seed}")[1]
        took = f"{cpu() - begin:.0f}"
        pairs = list(zip(exact, states, strict=True))[1:]
        lines = [line_distances(a.lines, b.lines)[0] for a, b in pairs]
        off = (f"{line['mean_m']:.2f} / {line['max_m']:.1f}" for line in lines)
        row(cells, density, seed, *off, took)


def transfers():
    """There and back from 2 Myr by density."""
    gaps = "particles back: mean / p99 / max, m", "horizon: mean / max, m"
    row("cells", "density", *gaps, "solves")
    for cells in (12, 24):
        for density in ("hat", "projection", "lines"):
            marks = "time.marks=[0 Myr, 2 Myr, 0 Myr]"
            overrides = (f"mesh.cells={cells}", f"transfer.density={density}", marks)
            row(cells, density, *back(*journey(DEMO, *overrides)))


def restored():
    """Back from 4 Myr, 45 cells, of what mesh lines on the horizon led there on 32 cells."""
    steps = ("time.scheme=rk4", "time.courant=5", "time.min_steps=40")
    engine = StokesEngine(
        load(DEMO, (*steps, "time.marks=[0 Myr, 4 Myr]", "mesh.cells=32", FITTED[0])).scene
    )
    start = engine.start()
    end = march(start, engine, engine.scene.time)
    gaps = "particles: mean / p99 / max, m", "horizon: mean / max, m"
    row("density", *gaps, "solves")
    for density in ("lines", "projection"):
        plan = (*steps, "time.marks=[4 Myr, 0 Myr]", f"transfer.density={density}")
        engine = StokesEngine(load(DEMO, plan).scene)
        last = march(engine.taken_over(end), engine, engine.scene.time)
        row(density, *back(engine, [start, last]))


def independent():
    """As the independent row of `restore bench paper` at 4 Myr, on other meshes and steps."""
    row("cells and steps there", "back", "particles: mean / p99 / max, m", "horizon: mean / max, m")
    steps = ("time.scheme=rk4", "time.courant=1000")
    for there, ways in (((32, 120), ((45, 60), (64, 60))), ((40, 200), ((64, 100), (90, 100)))):
        plan = (f"mesh.cells={there[0]}", f"time.min_steps={there[1]}", "mesh.interfaces=auto")
        engine = StokesEngine(load(DEMO, (*steps, *plan, "time.marks=[0 Myr, 4 Myr]")).scene)
        start = engine.start()
        end = march(start, engine, engine.scene.time)
        for cells, count in ways:
            plan = (f"mesh.cells={cells}", f"time.min_steps={count}", "transfer.density=lines")
            engine = StokesEngine(load(DEMO, (*steps, *plan, "time.marks=[4 Myr, 0 Myr]")).scene)
            last = march(engine.taken_over(end), engine, engine.scene.time)
            row(f"{there[0]}, {there[1]}", f"{cells}, {count}", *back(engine, [start, last])[:2])


def volume():
    """Area of salt as the fields see it, and below the horizon, against the start."""
    row("mark", "salt in the fields, change", "salt below the horizon, change")
    engine, states = journey(DEMO)
    width, height = engine.scene.outline.width, engine.scene.outline.height

    def below(state):
        points = state.lines[0].points
        x, z = np.r_[points, [[width, -height], [0, -height]]].T
        return 0.5 * abs(np.dot(x, np.roll(z, 1)) - np.dot(z, np.roll(x, 1)))

    seen = [volume_by_rock(engine.scene, engine.grid, state.particles)["salt"] for state in states]
    for state, v in zip(states, seen, strict=True):
        row(
            f"{state.time / MYR:.0f} Myr",
            f"{v / seen[0] - 1:+.2e}",
            f"{below(state) / below(states[0]) - 1:+.2e}",
        )


def velocity():
    """There and back from 2 Myr in the velocity of the elements, and free of divergence."""
    gaps = "particles back: mean / p99 / max, m", "horizon: mean / max, m"
    row("cells", "velocity", *gaps, "solves")
    for cells in (12, 24):
        for way in ("plain", "conservative"):
            marks = "time.marks=[0 Myr, 2 Myr, 0 Myr]"
            overrides = (f"mesh.cells={cells}", f"particles.velocity={way}", marks)
            row(cells, way, *back(*journey(DEMO, *overrides)))


def weak():
    """The case of two viscosities there and back."""
    row("case", "particles back: mean / p99 / max, m", "horizon: mean / max, m", "solves")
    row("as shipped", *back(*journey(WEAK)))


def cpu():
    """Return the processor time used so far, s."""
    used = resource.getrusage(resource.RUSAGE_SELF)
    return used.ru_utime + used.ru_stime


def leg(marks, cells, scheme, courant, state=None):
    """Run the demo with mesh lines on its horizon; return both ends and what it took."""
    entries = {"marks": marks, "scheme": scheme, "courant": courant}
    overrides = [f"time.{name}={value}" for name, value in entries.items()]
    scene = load(DEMO, [*overrides, f"mesh.cells={cells}", *FITTED]).scene
    begin, engine, salt = cpu(), StokesEngine(scene), []

    def note(_, state):
        salt.append(volume_by_rock(scene, state.grid, state.particles)["salt"])

    start = engine.start() if state is None else engine.taken_over(state)
    end = march(start, engine, scene.time, every_step=(note,))
    drift = max(abs(one / salt[0] - 1) for one in salt)
    return start, end, (engine._steps, engine.meshes, f"{cpu() - begin:.0f}", f"{drift:.0e}")


def fitted():
    """The horizon of a fitted run restored from a forward run of another mesh, step and scheme."""
    row("from", "cells", "scheme", "horizon: mean / max, m", "steps, meshes, CPU s, area drift")
    for age in (1, 1.5):
        for there, back_again in ((32, 40), (45, 56)):
            start, end, _ = leg(f"[0 Myr, {age} Myr]", there, "rk4", 0.5)
            for scheme, courant in (("midpoint", 0.25), ("rk3", 0.35)):
                marks = f"[{age} Myr, 0 Myr]"
                _, last, cost = leg(marks, back_again, scheme, courant, end)
                line = line_distances(as_drawn(start.lines), as_drawn(last.lines))[0]
                error = f"{line['mean_m']:.3f} / {line['max_m']:.3f}"
                row(
                    f"{age} Myr", f"{there}, {back_again}", scheme, error, ", ".join(map(str, cost))
                )


def memory():
    """Greatest resident memory of a run of one step, against what `restore check` says before."""
    row("unknowns", "particles", "peak, MB", "forecast, MB")
    for cells in (20, 45, 90, 180):
        overrides = (f"mesh.cells={cells}", "time.marks=[0 Myr, 1 kyr]", "time.min_steps=1")
        with tempfile.TemporaryDirectory() as folder:
            sets = [part for entry in overrides for part in ("--set", entry)]
            command = [sys.executable, "-m", "restoration.cli", "run", str(WEAK), *sets, "--quiet"]
            subprocess.run([*command, "--out", folder], check=True, capture_output=True, cwd=ROOT)
            record = json.loads((Path(folder) / "run.json").read_text())
        told = describe(load(WEAK, overrides))["memory_mb_about"]
        row(record["unknowns"], record["particles"], f"{record['peak_rss_mb']:.0f}", told)


def divergence():
    """Print what sound solves leave of the divergence, over the speed across the section."""
    row("element", "rock", "contrast", "relative divergence", "residual")
    for element in ("P2-P1", "P2b-P1dg", "P2-P1dg", "MINI", "Q2-Q1", "Q2-P1dg"):
        section = unit_square(element, 16)
        middle = section.corners.mean(axis=1)
        rocks = {
            "halves": middle[:, 0] >= 0.5,
            "every cell by chance": np.random.default_rng(1).random(len(middle)) < 0.5,
            "block": (np.abs(middle - 0.5) < 0.2).all(axis=1),
        }
        for (name, stiff), contrast in product(rocks.items(), (1.0, 1e6, 1e12)):

            def rock(spaces, values):
                field = fem.Function(spaces.D)
                field.x.array[:] = values
                return field

            eta, rho = np.where(stiff, contrast, 1.0), np.where(stiff, 2.0, 1.0)
            fields = (partial(rock, values=values) for values in (eta, rho))
            try:
                solved = Solved(section, element, *fields)
            except SolveError:
                row(element, name, f"{contrast:.0e}", "refused", "")
                continue
            off = Divergence(section, solved.spaces)(solved.flow.u)
            row(element, name, f"{contrast:.0e}", f"{off:.1e}", f"{solved.flow.residual:.1e}")


TABLES = {f.__name__: f for f in (reversibility, truth, volume, velocity, weak, fitted, memory)}
TABLES |= {f.__name__: f for f in (rock, seeds, transfers, restored, independent, divergence)}


def main():
    """Print the tables that are asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", default=list(TABLES), choices=[*TABLES, []])
    use_jit_cache()
    for name in parser.parse_args().names:
        print(f"\n## {name}: {TABLES[name].__doc__}\n")
        TABLES[name]()


if __name__ == "__main__":
    main()

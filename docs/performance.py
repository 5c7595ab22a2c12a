"""The measurements of docs/performance.md: ``.venv/bin/python docs/performance.py NAME``.

Each prints a table. Seconds are wall seconds unless CPU is said; let nothing else run meanwhile.
"""

import argparse
import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from restoration import assembly, solvers
from restoration.engine import StokesEngine
from restoration.environment import use_jit_cache, use_numba_cache
from restoration.particles import subset
from restoration.resolve import load
from restoration.run import next_time

ROOT = Path(__file__).parents[1]
CASES = ROOT / "cases"
WEAK = CASES / "diapir-two-viscosities" / "case.yaml"
ONE = CASES / "diapir-isoviscous" / "case.yaml"
# Cases that `make profile` runs, and what shortens them. The certificate is a third of a run, and
# solves as the run does.
SHORT = ("time.marks=[0 Myr, 1 Myr]", "certificate=off")
PROFILED = {
    "diapir, two viscosities": (WEAK, "certificate=off"),
    "the same, mesh lines on the contact, before it folds": (
        WEAK,
        "time.marks=[0 Myr, 0.6 Myr]",
        "certificate=off",
        "mesh.interfaces=fitted",
    ),
    "diapir, one viscosity": (ONE, *SHORT),
    "diapir in three dimensions": (CASES / "diapir-3d" / "case.yaml", "time.marks=[0 Myr, 1 Myr]"),
    "graben": (CASES / "graben" / "case.yaml", "time.marks=[0 kyr, 17.5 kyr]", "certificate=off"),
    "three dimensions, salt ten times weaker, field split": (
        CASES / "diapir-3d" / "case.yaml",
        "rocks.salt.viscosity=1e18 Pa s",
        "solver={}",
        "mesh.cells=[12, 12, 6]",
        "time={marks: [0 Myr, 0.5 Myr], min_steps: 4}",
    ),
}
SOLVING = "solve"


def row(*cells):
    """Print a row of a table."""
    print("| " + " | ".join(str(cell) for cell in cells) + " |", flush=True)


def head(*cells):
    """Print the head of a table."""
    row(*cells)
    row(*["---"] * len(cells))


class Walk:
    """A case that is marched through step by step.

    Args:
        case: path.
        overrides: texts ``a.b=value``.
        engine: makes the engine of a scene.
    """

    def __init__(self, case, *overrides, engine=StokesEngine):
        self.engine = engine(load(case, overrides).scene)
        self.state = self.engine.with_flow(self.engine.start())
        plan = self.engine.scene.time
        self.mark = plan.marks[1]
        self._longest = abs(self.mark - self.state.time) / plan.min_steps

    def step(self):
        """Take a step."""
        engine, state = self.engine, self.state
        stable = min(engine.stable_step(state, self.mark), self._longest)
        self.state = engine.with_flow(
            engine.advance(state, next_time(state.time, self.mark, stable))
        )

    def timed(self, steps):
        """Take one step, then more; return seconds a step: wall, CPU, and wall by part."""
        self.step()
        before, wall, cpu = dict(self.engine.seconds), time.perf_counter(), time.process_time()
        for _ in range(steps):
            self.step()
        wall, cpu = (time.perf_counter() - wall) / steps, (time.process_time() - cpu) / steps
        parts = {name: (s - before[name]) / steps for name, s in self.engine.seconds.items()}
        return wall, cpu, parts


def run(case, *overrides):
    """Run a case by the command and return its record."""
    with tempfile.TemporaryDirectory() as folder:
        sets = [part for entry in overrides for part in ("--set", entry)]
        command = [sys.executable, "-m", "restoration.cli", "run", str(case), *sets, "--quiet"]
        subprocess.run([*command, "--out", folder], check=True, capture_output=True, cwd=ROOT)
        return json.loads((Path(folder) / "run.json").read_text())


def profile():
    """Where runs spend their time, per cent of the wall time, and outside the linear solves."""
    for name, (case, *overrides) in PROFILED.items():
        record = run(case, *overrides)
        parts = record["wall_by_part_s"]
        print(
            f"\n{name}: {record['unknowns']} unknowns, {record['particles']} particles, "
            f"{record['steps']} steps, {record['stokes_solves']} solves, "
            f"{record['factorisations']} factorisations, {record['meshes']} meshes, "
            f"{record['wall_s']:.0f} s\n"
        )
        head("part", "s", "%")
        for part, seconds in parts.items():
            if seconds:
                row(part, f"{seconds:.1f}", f"{100 * seconds / record['wall_s']:.0f}")
        outside = 1 - parts[SOLVING] / record["wall_s"]
        row("**all but solve**", "", f"**{100 * outside:.0f}**")


def particles():
    """Particle-stages a second: locate, fill the fields, velocity; by threads and order."""
    head("particles", "order", "threads", "locate", "fill", "velocity", "together, M/s")
    import numba  # not before restoration has chosen its threads

    rng = np.random.default_rng(0)
    for per_cell in (8, 40):
        walk = Walk(WEAK, f"particles.per_cell={per_cell}", "mesh.cells=75")
        cloud = walk.state.particles
        order = {
            "as seeded": np.arange(len(cloud.x)),
            "by cell": np.argsort(cloud.cell, kind="stable"),
            "at random": rng.permutation(len(cloud.x)),
        }
        for name, rows in order.items():
            for threads in sorted({1, numba.config.NUMBA_NUM_THREADS}):
                numba.set_num_threads(threads)
                seconds = stage_seconds(walk, rows)
                rates = [len(rows) / s / 1e6 for s in (*seconds, sum(seconds))]
                row(len(rows), name, threads, *(f"{rate:.1f}" for rate in rates))


def stage_seconds(walk, rows):
    """Return the seconds that particles in an order take: locate, fill the fields, velocity."""
    engine, grid, p = walk.engine, walk.state.grid, walk.state.particles
    coefficients = grid.sampler.coefficients(walk.state.flow.u)
    p = subset(p, rows)
    x = p.x + 0.1 * grid.sizes.min()
    cell, hats = grid.index.locate(engine.within(x), p.cell)
    work = (
        lambda: grid.index.locate(engine.within(x), p.cell),
        lambda: grid.fields.hat_means(grid.fields.table, cell, hats, p.unit, p.area),
        lambda: grid.sampler(coefficients, cell, hats),
    )
    return [fastest(part) for part in work]


def fastest(work, of=min, repeats=9):
    """Return the least seconds that some work takes, or another number of several times."""
    took = []
    work()
    for _ in range(repeats):
        begin = time.perf_counter()
        work()
        took.append(time.perf_counter() - begin)
    return of(took)


def solves():
    """What a step of rk4 costs, two viscosities: factors kept or not, and how it is assembled."""
    head(
        "interfaces",
        "cells",
        "unknowns",
        "factors",
        "factorisations / solves",
        "iterations",
        "assembly, CPU s",
        "solves, CPU s",
    )
    kept, serves = solvers.FACTOR_COST, assembly.CellAssembler.serves
    for interfaces in ("particles", "fitted"):
        for cells in (45, 75):
            for name, cost, known in (
                ("new for every solve, general assembly", -np.inf, False),
                ("as they are", kept, True),
            ):
                solvers.FACTOR_COST = cost
                assembly.CellAssembler.serves = serves if known else staticmethod(never)
                walk = Walk(WEAK, f"mesh.interfaces={interfaces}", f"mesh.cells={cells}")
                counts = walk.engine.counts
                walk.step()
                before = counts.factorisations, counts.solves, counts.krylov_iterations
                begin = dict(walk.engine.seconds)
                for _ in range(8):
                    walk.step()
                seconds = walk.engine.seconds
                factors, solved, iterations = (
                    now - earlier
                    for now, earlier in zip(
                        (counts.factorisations, counts.solves, counts.krylov_iterations),
                        before,
                        strict=True,
                    )
                )
                row(
                    interfaces,
                    cells,
                    walk.engine.grid.spaces.unknowns,
                    name,
                    f"{factors} / {solved}",
                    iterations,
                    *(f"{(seconds[p] - begin[p]) / 8:.2f}" for p in ("assemble", "solve")),
                )
    solvers.FACTOR_COST, assembly.CellAssembler.serves = kept, serves


def never(*_):
    """Tell that no assembly by known places is wanted."""
    return False


def peak_mb():
    """Return the greatest resident memory so far, MB; that of ``getrusage`` is a parent's too."""
    lines = Path("/proc/self/status").read_text().splitlines()
    (line,) = (line for line in lines if line.startswith("VmHWM"))
    return int(line.split()[1]) / 1024


def apart(work, *arguments):
    """Return what a function of the script that runs prints as JSON in a process of its own."""
    command = [sys.executable, sys.argv[0], "--apart", work, *map(str, arguments)]
    done = subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT)
    return json.loads(done.stdout.splitlines()[-1])


def steady():
    """One viscosity on a fixed mesh: a step over its particle work and one solve a stage."""
    head("cells", "step, s", "particle work, s", "one back-substitution, s", "ratio")
    for cells in (45, 90):
        walk = Walk(ONE, f"mesh.cells={cells}")
        wall, _, parts = walk.timed(24)
        stokes = walk.engine.grid.stokes
        solver = stokes.solver
        back = fastest(lambda solver=solver, s=stokes: solver.apply(None, s.b, s.x), np.median)
        work = parts["fields"] + parts["advect"]
        row(
            cells,
            f"{wall:.3f}",
            f"{work:.3f}",
            f"{back:.4f}",
            f"{wall / (work + 4 * back):.2f}",
        )


def forecasts():
    """What `restore check --forecast` tells of the shipped cases, and what they then take."""
    head("case", "told, s", "took, s", "ratio", "told, MB", "took, MB", "ratio")
    for case in sorted([*CASES.glob("*/case.yaml"), *CASES.glob("*/exp?.yaml")]):
        command = [sys.executable, "-m", "restoration.cli", "check", str(case), "--forecast"]
        done = subprocess.run(
            [*command, "--json"], check=True, capture_output=True, text=True, cwd=ROOT
        )
        told = json.loads(done.stdout)["forecast"]
        record = run(case)
        pairs = (
            (told["run_s"] + told["certificate_s"], record["wall_s"]),
            (told["memory_mb"], record["peak_rss_mb"]),
        )
        name = case.parent.name if case.stem == "case" else f"{case.parent.name}/{case.stem}"
        row(name, *(text for a, b in pairs for text in (f"{a:.0f}", f"{b:.0f}", f"{a / b:.2f}")))


TABLES = {f.__name__: f for f in (profile, particles, solves, steady, forecasts)}


def main(description, tables, apart_works):
    """Print the tables that are asked for.

    Args:
        description: of the script.
        tables: functions by name, which print a table each.
        apart_works: functions that run in a process of their own, by name.
    """
    parser = argparse.ArgumentParser(description=description.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(tables)}")
    parser.add_argument("--apart", nargs="+", help=argparse.SUPPRESS)
    use_numba_cache()
    use_jit_cache()
    given = parser.parse_args()
    if given.apart:
        work, *arguments = given.apart
        apart_works[work](*arguments)
        return
    if wrong := [name for name in given.names if name not in tables]:
        parser.error(f"no measurement {wrong[0]!r}; there are {', '.join(tables)}")
    for name in given.names or tables:
        print(f"\n## {name}: {tables[name].__doc__}\n")
        tables[name]()


if __name__ == "__main__":
    main(__doc__, TABLES, {})

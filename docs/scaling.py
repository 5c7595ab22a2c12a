"""What a step costs against size and ranks: ``.venv/bin/python docs/scaling.py NAME``.

Each prints a table of docs/performance.md; docs/scaling.json keeps the numbers, which the last
one reckons with. Seconds are wall seconds unless CPU is said; let nothing else run meanwhile.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
from performance import ROOT, SOLVING, WEAK, Walk, apart, head, main, peak_mb, row

from restoration import grid
from restoration.box_engine import BoxEngine
from restoration.engine import StokesEngine
from restoration.ranks import world
from restoration.resolve import load

KEPT = Path(__file__).with_suffix(".json")
BOX = ROOT / "cases" / "diapir-3d" / "case.yaml"
# Salt ten times weaker, so that the matrix changes in every step.
BOX_SETS = ("rocks.salt.viscosity=1e18 Pa s", "solver={}", "certificate=off")
RANKS = 64
LARGE = 1e8  # unknowns
NODE = 4.0  # GB of memory for every rank, as nodes of clusters have


def exponent(sizes, costs):
    """Return the exponent of the power of the size that a cost goes with."""
    return float(np.polyfit(np.log(sizes), np.log(costs), 1)[0])


def keep(**numbers):
    """Keep numbers for `reckoned`."""
    kept = json.loads(KEPT.read_text()) if KEPT.exists() else {}
    KEPT.write_text(json.dumps(kept | numbers, indent=1) + "\n")


def size_of(dim, cells, per_cell, steps):
    """Print what a step costs on the ranks there are, as JSON."""
    base = peak_mb()
    sets = [f"mesh.cells={cells}", f"particles.per_cell={per_cell}", "time.courant=0.5"]
    case, engine = (WEAK, StokesEngine) if dim == "2" else (BOX, BoxEngine)
    walk = Walk(case, *sets, *(BOX_SETS if dim == "3" else ()), engine=engine)
    before = walk.engine.counts.krylov_iterations, walk.engine.counts.solves
    wall, cpu, parts = walk.timed(int(steps))
    iterations, solves = walk.engine.counts.krylov_iterations, walk.engine.counts.solves
    ranks = world()
    count = int(ranks.sum(np.array(len(walk.state.particles.x))))
    found = {
        "unknowns": walk.engine.grid.spaces.unknowns,
        "particles": count,
        "wall": wall,
        "cpu": float(ranks.sum(np.array(cpu))),
        "peak_mb": float(ranks.most(np.array(peak_mb()))),
        "base_mb": base,
        "iterations": (iterations - before[0]) / (solves - before[1]),
        "load": walk.engine.sharing.load,
        "parts": parts,
    }
    if ranks.first:
        print(json.dumps(found))


def whole_of(dim, cells):
    """Print what each rank holds whole, as JSON: mesh, spaces, fields, and few particles."""
    base = peak_mb()
    sets, case = [f"mesh.cells={cells}", "particles.per_cell=1"], WEAK
    if dim == "3":
        sets, case = [*sets, *BOX_SETS], BOX
    grid.StokesProblem = NoStokes
    engine = (StokesEngine if dim == "2" else BoxEngine)(load(case, sets).scene)
    engine.start()
    print(json.dumps({"mb": peak_mb() - base, "unknowns": engine.grid.spaces.unknowns}))


class NoStokes:
    """Stands where the Stokes problem would, and has no matrix."""

    def __init__(self, *_, **__):
        pass


def on_ranks(ranks, threads, *arguments):
    """Return what `size_of` prints on ranks with threads."""
    names = ("OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
    environment = os.environ | dict.fromkeys(names, str(threads))
    environment |= {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    command = ["mpirun", "--quiet", "--bind-to", "none", "--oversubscribe", "-n", str(ranks)]
    command += [sys.executable, __file__, "--apart", "size_of", *map(str, arguments)]
    done = subprocess.run(
        command, check=True, capture_output=True, text=True, cwd=ROOT, env=environment
    )
    return json.loads(done.stdout.splitlines()[-1])


def unknowns():
    """A step of rk4 against unknowns: two viscosities, four particles a cell, 2-D."""
    head("unknowns", "particles", "wall, s", "CPU, s", "solve, s", "peak, MB", "kB per unknown")
    found = [apart("size_of", 2, cells, 4, 2) for cells in (32, 72, 125, 225)]
    for got in found:
        row(
            got["unknowns"],
            got["particles"],
            f"{got['wall']:.2f}",
            f"{got['cpu']:.2f}",
            f"{got['parts'][SOLVING]:.2f}",
            f"{got['peak_mb']:.0f}",
            f"{1024 * (got['peak_mb'] - got['base_mb']) / got['unknowns']:.1f}",
        )
    print(f"\nexponent of the CPU seconds: {_fitted(found, 'cpu'):.2f}")
    keep(plane=found)


def boxes():
    """A step of rk4 in three dimensions against unknowns, by the field split."""
    head(
        "cubes",
        "unknowns",
        "particles",
        "wall, s",
        "solve, s",
        "iterations a solve",
        "peak, MB",
        "kB per unknown",
    )
    found = []
    for n in (6, 8, 10, 12):
        got = apart("size_of", 3, f"[{2 * n}, {2 * n}, {n}]", 4, 1)
        found.append(got)
        row(
            f"{2 * n} x {2 * n} x {n}",
            got["unknowns"],
            got["particles"],
            f"{got['wall']:.1f}",
            f"{got['parts'][SOLVING]:.1f}",
            f"{got['iterations']:.0f}",
            f"{got['peak_mb']:.0f}",
            f"{1024 * (got['peak_mb'] - got['base_mb']) / got['unknowns']:.1f}",
        )
    print(f"\nexponent of the CPU seconds: {_fitted(found, 'cpu'):.2f}")
    keep(box=found)


def _fitted(found, name):
    return exponent([got["unknowns"] for got in found], [got[name] for got in found])


def cloud():
    """A step of rk4 against particles: two viscosities, 40 000 unknowns."""
    head("particles", "wall, s", "CPU, s", "all but Stokes, wall s", "peak, MB", "B per particle")
    sizes, costs, least = [], [], None
    for per_cell in (8, 80, 800):
        got = apart("size_of", 2, 45, per_cell, 2)
        least = least or got
        others = sum(got["parts"][part] for part in ("fields", "advect"))
        sizes.append(got["particles"])
        costs.append(others)
        more = got["particles"] - least["particles"]
        row(
            got["particles"],
            f"{got['wall']:.2f}",
            f"{got['cpu']:.2f}",
            f"{others:.2f}",
            f"{got['peak_mb']:.0f}",
            f"{2**20 * (got['peak_mb'] - least['peak_mb']) / more:.0f}" if more else "",
        )
    print(f"\nexponent of the particle work: {exponent(sizes[1:], costs[1:]):.2f}")


def ranks():
    """A step of rk4 on one and two ranks, with one and two threads."""
    head("run", "unknowns", "particles", "ranks", "threads", "wall, s", "solve, s", "fields, s",
         "advect, s", "load")  # fmt: skip
    for name, arguments in (
        ("2-D, two viscosities", (2, 75, 26, 2)),
        ("2-D, many particles", (2, 45, 400, 2)),
        ("3-D", (3, "[14, 14, 7]", 4, 1)),
    ):
        for count, threads in ((1, 1), (1, 2), (2, 1)):
            got = on_ranks(count, threads, *arguments)
            parts = got["parts"]
            row(
                name,
                got["unknowns"],
                got["particles"],
                count,
                threads,
                f"{got['wall']:.2f}",
                *(f"{parts[part]:.2f}" for part in (SOLVING, "fields", "advect")),
                f"{got['load']:.3f}",
            )


def reckoned():
    """What 64 ranks would make of 1e8 unknowns, reckoned from the tables before: no measurement."""
    kept, reaches = json.loads(KEPT.read_text()), []
    head("", "what grows", "power", f"at {LARGE:.0e} unknowns", f"for each of {RANKS} ranks")
    for name, found, whole in (
        ("2-D, direct", kept["plane"], apart("whole_of", 2, 225)),
        ("3-D, field split", kept["box"], apart("whole_of", 3, "[24, 24, 12]")),
    ):
        last = found[-1]
        size = LARGE / last["unknowns"]
        held = 1024 * whole["mb"] / whole["unknowns"]
        shared = 1024 * (last["peak_mb"] - last["base_mb"]) / last["unknowns"] - held
        power = _fitted(found, "cpu")
        cpu = last["cpu"] * size**power
        row(
            name,
            "CPU time of a step",
            f"{power:.2f}",
            f"{cpu / 3600:.1f} h",
            f"{cpu / RANKS / 60:.0f} min if all of it were shared",
        )
        row("", "held whole by each rank", "1", f"{held:.1f} kB per unknown",
            f"{held * LARGE / 2**20:.0f} GB, of {NODE:.0f} GB that a rank has")  # fmt: skip
        row("", "matrix and factors or levels", "1", f"{shared:.1f} kB per unknown",
            f"{shared * LARGE / 2**20 / RANKS:.0f} GB, if shared evenly")  # fmt: skip
        reach = NODE * 2**20 / (held + shared / RANKS)
        reaches.append(f"{name}: {RANKS} ranks of {NODE:.0f} GB reach {reach:.1e} unknowns")
    print("", *reaches, sep="\n")


TABLES = {f.__name__: f for f in (unknowns, boxes, cloud, ranks, reckoned)}


if __name__ == "__main__":
    main(__doc__, TABLES, {"size_of": size_of, "whole_of": whole_of})

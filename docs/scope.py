"""What only some scenes require, with and without: ``.venv/bin/python docs/scope.py NAME``.

Each prints a table of docs/performance.md.
"""

import json
import tempfile
import time
from pathlib import Path

import numpy as np
import shapely
from performance import ONE, WEAK, Walk, apart, head, main, peak_mb, row

from restoration import grid
from restoration.box_engine import BoxEngine
from restoration.engine import StokesEngine
from restoration.errors import SolveError
from restoration.units import YEAR

# What a scene requires, and the same with more than it requires or without: overrides of a case.
WAY = "time.marks=[0 Myr, 0.4 Myr]", "mesh.cells=20"
SCOPE = (
    ("a top that does not move", ONE, ("boundary.surface=free-slip",), "stands still"),
    ("", ONE, ("boundary.surface=free",), "a free surface: it moves the mesh"),
    ("one viscosity, a mesh that stands", ONE, (), "one factorisation"),
    ("", ONE, ("rocks.salt.viscosity=1.000001e19 Pa s",), "as if there were two"),
    ("two viscosities, clean horizons", WEAK, ("mesh.interfaces=fitted",), "mesh lines"),
    ("", WEAK, ("mesh.interfaces=particles",), "particles"),
    ("", WEAK, ("transfer={density: lines, viscosity: lines}",), "particles, rock by lines"),
    ("detail near the contact", WEAK, ("mesh={cells: 10, refine: {levels: 1}}",), "refined there"),
    ("", WEAK, ("mesh.cells=20",), "fine everywhere"),
    ("", WEAK, ("mesh.cells=10",), "coarse everywhere"),
)
# A section of two dimensions, and the same as a box that is one cube wide.
PLANE = """
section:
  box: {{width: 10 km, {length}height: 5 km}}
  layers:
    - {{rock: salt, top: {{depth: 4 km, cosine: {{amplitude: 0.3 km, wavelength: 20 km}}}}}}
    - {{rock: sediment}}
rocks:
  salt: {{density: 2150 kg/m^3, viscosity: 1e18 Pa s}}
  sediment: {{density: 2600 kg/m^3, viscosity: 1e19 Pa s}}
boundary: {{base: no-slip}}
mesh: {{cells: {cells}}}
particles: {{velocity: plain}}
time: {{marks: [0 Myr, 0.5 Myr], min_steps: 5}}
certificate: off
"""
PLANES = (("", "[24, 12]", "two dimensions"), ("length: 0.4167 km, ", "[24, 1, 12]", "three"))


def ended(case, *overrides):
    """Print where the horizon of a case ends, and what that took, as JSON."""
    walk = Walk(case, *overrides)
    wall, cpu = time.perf_counter(), time.process_time()
    steps = 0
    while walk.state.time != walk.mark:
        walk.step()
        steps += 1
    (line,) = (line for line in walk.state.lines if line.kind == "horizon")
    print(
        json.dumps(
            {
                "line": line.points.tolist(),
                "steps": steps,
                "wall": time.perf_counter() - wall,
                "cpu": time.process_time() - cpu,
                "unknowns": walk.engine.grid.spaces.unknowns,
                "factorisations": walk.engine.counts.factorisations,
                "peak_mb": peak_mb(),
            }
        )
    )


def plane(length, cells):
    """Print what the section costs in two dimensions, or as a box one cube wide, as JSON."""
    with tempfile.TemporaryDirectory() as folder:
        case = Path(folder) / "case.yaml"
        case.write_text(PLANE.format(length=length, cells=cells))
        walk = Walk(case, engine=BoxEngine if length else StokesEngine)
    fastest = walk.state.grid.speeds(walk.state.flow)[1]
    wall, cpu, _ = walk.timed(4)
    spaces, state = walk.engine.grid.spaces, walk.state
    print(
        json.dumps(
            {
                "unknowns": spaces.unknowns,
                "particles": len(state.particles.x),
                "wall": wall,
                "cpu": cpu,
                "fastest": fastest,
                "peak_mb": peak_mb(),
            }
        )
    )


def planes():
    """A section in two dimensions, and as a box one cube wide: a step of rk4."""
    head(
        "mesh",
        "unknowns",
        "particles",
        "CPU s a step",
        "peak, MB",
        "greatest velocity at first, mm/yr",
    )
    for length, cells, name in PLANES:
        got = apart("plane", length, cells)
        row(
            name,
            got["unknowns"],
            got["particles"],
            f"{got['cpu']:.2f}",
            f"{got['peak_mb']:.0f}",
            f"{got['fastest'] * 1e3 * YEAR:.3f}",
        )


def closed():
    """A closed box: the pressure, known up to a constant, held at a point or not; a solve."""
    head("the pressure is", "relative residual", "pressure, greatest, MPa", "what became of it")
    make = grid.StokesProblem

    def unheld(*arguments, **options):
        """Take the section for one that is open somewhere."""
        return make(*arguments[:7], False, *arguments[8:], **options)

    for held in (True, False):
        grid.StokesProblem = make if held else unheld
        try:
            flow = Walk(ONE, "mesh.cells=32").state.flow
            row(
                "held" if held else "left alone",
                f"{flow.residual:.0e}",
                f"{np.abs(flow.p).max() / 1e6:.3g}",
                "solved",
            )
        except SolveError as error:
            row("held" if held else "left alone", "", "", str(error).partition(";")[0])
        finally:
            grid.StokesProblem = make


def scope():
    """What only some scenes require, with and without: 0.4 Myr forward on 20 cells.

    The error is the greatest distance of the horizon from one on mesh lines, a third finer.
    """
    head("the scene has", "then", "unknowns", "factors", "CPU s", "peak, MB", "horizon off, m")
    truths = {}
    for scene, case, overrides, how in SCOPE:
        free = "boundary.surface=free" if "boundary.surface=free" in overrides else None
        if case == ONE and overrides[:1] == ("boundary.surface=free-slip",):
            free = overrides[0]
        if (case, free) not in truths:
            finer = [*WAY, "mesh.interfaces=fitted", "mesh.cells=30", *([free] if free else [])]
            truths[case, free] = shapely.LineString(apart("ended", case, *finer)["line"])
        got = apart("ended", case, *WAY, *overrides)
        off = shapely.distance(shapely.points(got["line"]), truths[case, free]).max()
        row(
            scene,
            how,
            got["unknowns"],
            got["factorisations"],
            f"{got['cpu']:.1f}",
            f"{got['peak_mb']:.0f}",
            f"{off:.2f}",
        )


TABLES = {f.__name__: f for f in (scope, planes, closed)}


if __name__ == "__main__":
    main(__doc__, TABLES, {"ended": ended, "plane": plane})

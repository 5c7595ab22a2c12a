"""The graben of the paper (sect. 4.3): restored from a forward run of another mesh and step."""

from pathlib import Path

import numpy as np

from restoration.bench.rows import Clock, Row
from restoration.diagnostics import line_distances, there_and_back
from restoration.engine import StokesEngine
from restoration.errors import CaseError
from restoration.lines import as_drawn, surface_of
from restoration.resolve import load
from restoration.run import march
from restoration.units import show

CASE = Path(__file__).parents[2] / "cases/graben/case.yaml"
SOURCE = "Schuh-Senlis et al. (2020), table 1"
# Mean and greatest error of every interface in the paper, m, from the salt up, the surface last.
PAPER_MEAN = (1.5, 1.7, 1.9, 2.1, 2.3, 2.4, 2.6, 2.7, 2.9)
PAPER_MAX = (16.5, 7.2, 10.9, 9.8, 9.1, 8.6, 8.5, 7.1, 31.4)
WIDTH, PROFILE = 6e3, 241  # m, and points of the profiles along it
MEAN, MOST = 0.5, 6.25  # m: what is held to; the latter is one of the paper's finest cells
# Across the finest cells of the paper, 6.25 m, at Courant number 0.0085 with 10 mm/yr for 35 kyr.
PAPER_STEPS = 350 / (0.0085 * 6.25)
# Cells and steps there and back, by whether it is to be quick.
WAYS = {True: (([36, 12], 8), ([42, 14], 7)), False: (([36, 12], 28), ([42, 14], 20))}
SPANS = {True: 15, False: 35}  # kyr, by the same


def run_graben(quick=False):
    """Graben of the paper, sect. 4.3: errors of every interface against another forward run."""
    there, back = WAYS[quick]
    span = SPANS[quick]
    # So coarse the surface comes back with a spike where a band crops out: its rows only inform.
    held = ("horizon",) if quick else ("horizon", "surface")
    yield from _rows("independent", *scenes(there, back, span), held)
    if not quick:
        # Cells so small that they divide the bands otherwise: what limits the figures above.
        there, back = ([45, 15], 18), ([54, 18], 16)
        case = "bands divided otherwise"
        yield from _rows(case, *scenes(there, back, span), held=())


def scenes(there, back, span):
    """Return the scenes that deform the section and restore it.

    Args:
        there, back: squares and steps of each.
        span: how long, kyr.
    """
    return (
        scene(*there, f"[0 kyr, {span} kyr]"),
        scene(*back, f"[{span} kyr, 0 kyr]"),
    )


def scene(cells, steps, marks):
    """Return the scene of the case with other cells, steps and marks."""
    if not CASE.is_file():
        raise CaseError(f"{CASE}: is missing; the graben needs the cases of a checkout")
    entries = {"mesh.cells": cells, "time.min_steps": steps, "time.marks": marks}
    return load(CASE, [f"{name}={value}" for name, value in entries.items()]).scene


def restored(forward, backward):
    """Return where a section began, turned and came back to, and the engines there and back."""
    engine, restorer = StokesEngine(forward), StokesEngine(backward)
    start = engine.start()
    deformed = march(start, engine, forward.time)
    end = march(restorer.taken_over(deformed), restorer, backward.time)
    return start, deformed, end, engine, restorer


def _profile(start, end, name):
    """Return how much too high an interface came back along the section (paper, fig. 14)."""
    x = np.linspace(0, WIDTH, PROFILE)
    heights = []
    for state in (start, end):
        points = np.concatenate([q.points for q in state.lines if q.name == name])
        points = points[np.argsort(points[:, 0], kind="stable")]
        heights.append(np.interp(x, *points.T))
    rise = np.round(heights[1] - heights[0], 3)
    return {"x_km": np.round(x / 1e3, 3).tolist(), "rise_m": rise.tolist()}


def _rows(case, forward, backward, held):
    """Yield the errors of a section that one scene deforms and another restores.

    Args:
        case: name of the rows.
        forward, backward: the scenes.
        held: kinds of the lines whose errors are held to a bound.
    """
    clock = Clock()
    start, deformed, end, engine, restorer = restored(forward, backward)
    scarp = float(np.ptp(surface_of(deformed.lines).points[:, 1]))
    about = {
        "unknowns": restorer.grid.spaces.unknowns,
        "cells": restorer.section.cell_count,
        "stokes_solves": restorer.counts.solves,
        "wall_s": clock.seconds,
    }
    name = "graben"
    turn = show(forward.time.marks[-1], "time")
    yield Row(name, case, f"relief at {turn}, m", scarp, **about)
    distances = line_distances(as_drawn(start.lines), as_drawn(end.lines))
    lines = [line for line in distances if line["kind"] != "fault"]
    for i, line in enumerate(lines):
        about_line = {"interface": i, "case": case} | _profile(start, end, line["name"])
        for metric, bound, paper in (("mean", MEAN, PAPER_MEAN[i]), ("max", MOST, PAPER_MAX[i])):
            yield Row(
                name,
                f"{case}, {line['name']}",
                f"{metric} error, m",
                line[f"{metric}_m"],
                bound=bound if line["kind"] in held else None,
                source=SOURCE,
                parameters=about_line | {"paper_m": paper, "metric": metric},
            )
    particles = there_and_back(end.particles)[1]
    yield Row(name, case, "mean error of the particles, m", particles["mean_m"])
    share = restorer.counts.solves / PAPER_STEPS
    yield Row(
        name,
        case,
        "Stokes solves over those at Courant number 0.0085",
        share,
        bound=0.25,
        parameters={"case": case},
    )
    fallen = engine.fallen + restorer.fallen
    yield Row(name, case, "rock fallen from cliffs, m^2", fallen)

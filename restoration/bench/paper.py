"""The paper's models (sects. 4.1 to 4.3) restored, against themselves and against another run.

``same_scheme`` goes there and back with one mesh, step and scheme, as the paper does: it measures
reversibility. ``independent`` restores what another mesh, step, scheme and way to carry the
interfaces has deformed: it measures the truth as far as two codes of one family can. A section that
is drawn (sect. 4.2) has no known past: it is restored first and deformed back to what was drawn.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from restoration.bench import graben
from restoration.bench.rows import Clock, Row
from restoration.diagnostics import LEAST, LOG_BINS, line_distances, summary, there_and_back
from restoration.engine import StokesEngine
from restoration.errors import CaseError
from restoration.lines import as_drawn
from restoration.resolve import load
from restoration.run import march
from restoration.stopping import Stopping, flatness_of, measured
from restoration.units import YEAR
from restoration.welds import welds

CASES = Path(__file__).parents[2] / "cases"
SOURCE = "Schuh-Senlis et al. (2020), sect. 4"
AXIS = "0, 1: one viscosity; 2, 3: two; 4 to 8: drawn; 9: graben"  # models in their order
# Where it is to be quick: half of the first, and one of the drawn diapirs, are run all the same.
LEFT_OUT = ("diapir-two-viscosities-full", *(f"salt-diapir-{number}" for number in range(2, 6)))
LONG = 1000  # Courant number that leaves the steps to `min_steps`


@dataclass(frozen=True)
class Way:
    """How a section is moved one way.

    Attributes:
        cells: squares along its shorter side.
        steps: number of steps, at least.
        scheme: name of one of `advection.SCHEMES`.
        courant: number of cells that a step crosses at most.
        more: further entries of the case, as text.
    """

    cells: int
    steps: int
    scheme: str = "implicit-midpoint"
    courant: float = LONG
    more: tuple[str, ...] = ()

    def entries(self, marks):
        """Return the entries of a case that make it go this way between marks, as text."""
        time = {
            "marks": marks,
            "scheme": self.scheme,
            "courant": self.courant,
            "min_steps": self.steps,
        }
        given = [f"time.{entry}={value}" for entry, value in time.items()]
        return [f"mesh.cells={self.cells}", *given, *self.more]


@dataclass(frozen=True)
class Model:
    """A model of the paper and the ways it goes.

    Attributes:
        name: of its rows.
        file: of its case, below `CASES`.
        marks: the times where it begins, where it turns, where it began, as text.
        same: the `Way` there and back.
        there, back: the ways of two independent runs.
        bounds: of its rows, by metric; None informs.
        paper: the paper's numbers, by metric of ``same_scheme``.
        drawn: whether it begins with the section that is given, so that it is restored first.
    """

    name: str
    file: str
    marks: tuple[str, str]
    same: Way
    there: Way
    back: Way
    bounds: dict
    paper: dict
    drawn: bool = False


def models(quick):
    """Return the models of sects. 4.1 and 4.2."""
    iso, two = "diapir-isoviscous/case.yaml", "diapir-two-viscosities/case.yaml"
    close, density = ("time.tolerance=2 mm",), "transfer.density=lines"
    lines, follow = (density, "transfer.viscosity=lines"), ("mesh.interfaces=auto",)
    same, there, back = (16, 18, 22) if quick else (45, 40, 64)
    more = 0.3 if quick else 1.0  # of the steps
    # What comes back most: the iterations of an implicit step do not settle in salt this weak.
    smooth = ("transfer.density=hat", "particles.velocity=plain")

    def steps(number):
        return round(more * number)

    reversible = {"mean_m": 0.1, "max_m": 2.0, "horizon_max_m": 1.0}
    welded = {} if quick else {"mean_m": 5.0, "p99_m": 50.0, "horizon_max_m": 25.0}
    true = {} if quick else {"mean_m": 3.0, "horizon_mean_m": 1.0}
    yield Model(
        "diapir-isoviscous",
        iso,
        ("0 Myr", "4 Myr"),
        Way(same, 34, more=close),
        Way(there, steps(200), "rk4", more=follow),
        Way(back, steps(100), "rk4", more=(density,)),
        {"same_scheme": reversible, "independent": true},
        {},
    )
    yield Model(
        "diapir-isoviscous-full",
        iso,
        ("0 Myr", "6 Myr"),
        Way(same, 50, more=close),
        Way(there, steps(200), "rk4", more=follow),
        Way(back, steps(100), "rk4", more=(density,)),
        {"same_scheme": reversible},
        {"mean_m": 14, "max_m": 143, "horizon_max_m": 50},
    )
    yield Model(
        "diapir-two-viscosities",
        two,
        ("0 Myr", "1 Myr"),
        Way(same, 10, "rk4", 0.5, smooth),
        Way(there, steps(120), "rk4", more=follow),
        Way(back, steps(80), "rk4", more=lines),
        {"same_scheme": welded},
        {},
    )
    yield Model(
        "diapir-two-viscosities-full",
        two,
        ("0 Myr", "1.5 Myr"),
        Way(same, 10, "rk4", 0.5, smooth),
        Way(there, steps(160), "rk4", more=follow),
        Way(back, steps(120), "rk4", more=lines),
        {"same_scheme": welded},
        {"mean_m": 201, "max_m": 4947, "horizon_max_m": 125},
    )
    ends = ("45 ka", "17.4 ka", "170 ka", "2.7 Ma", "1.04 Ma")  # the last: the salt is flat before
    for number, end in enumerate(ends, start=1):
        cells, other, count = (12, 15, 24) if quick else (30, 36, 60)
        yield Model(
            f"salt-diapir-{number}",
            f"salt-diapir/exp{number}.yaml",
            ("0 Ma", end),
            Way(cells, count, "rk4"),
            Way(cells, count, "rk3", more=("mesh.interfaces=particles",)),
            Way(other, count + 10, "rk4"),
            {},
            {},
            drawn=True,
        )


def run_paper(quick):
    """The paper's three models, there and back and against independent runs."""
    for model in models(quick):
        if quick and model.name in LEFT_OUT:
            continue
        yield from rows_of(model, "same_scheme", model.same, model.same)
        ways = (model.back, model.there) if model.drawn else (model.there, model.back)
        yield from rows_of(model, "independent", *ways)
    yield from graben_rows(quick)


def scene(file, entries):
    """Return the scene of a case of the checkout with other entries."""
    path = CASES / file
    if not path.is_file():
        raise CaseError(f"{path}: is missing; the paper's models need the cases of a checkout")
    return load(path, entries).scene


def rows_of(model, kind, one, other):
    """Yield the rows of a model that goes there one way and back another.

    Args:
        model: `Model`.
        kind: ``same_scheme`` or ``independent``.
        one, other: the `Way`s there and back; the same one is gone in one run.
    """
    begin, turn = model.marks
    clock = Clock()
    engine = StokesEngine(scene(model.file, one.entries(f"[{begin}, {turn}]")))
    stopping = Stopping(engine.scene.time)
    start, middle = journey(engine, stopping=stopping)
    other_engine = engine
    if one != other:
        other_engine = StokesEngine(scene(model.file, other.entries(f"[{turn}, {begin}]")))
    _, end = journey(other_engine, middle, start.time)
    about = {
        "unknowns": other_engine.grid.spaces.unknowns,
        "cells": other_engine.section.cell_count,
        "stokes_solves": max(engine.counts.solves, other_engine.counts.solves),
        "wall_s": clock.seconds,
    }
    given, restorer = (start, engine) if model.drawn else (middle, other_engine)
    yield from compared(model, kind, restorer, start, given, end, about)
    if model.drawn:
        yield from restored_rows(model, kind, engine, middle, stopping)


def journey(engine, state=None, until=None, stopping=None):
    """March through the marks of an engine's scene; return the states there.

    Args:
        engine: `StokesEngine`.
        state: of an engine to go on from; None begins.
        until: model time to go to from there, s; None goes through the marks.
        stopping: `stopping.Stopping` that may end it.
    """
    begin = engine.start() if state is None else engine.taken_over(state)
    plan, passed = engine.scene.time, []
    if until is not None:
        plan = replace(plan, marks=(state.time, until))
    march(begin, engine, plan, (), (lambda _, state: passed.append(state),), stopping)
    return passed


def restored_rows(model, kind, engine, state, stopping):
    """Yield how long a drawn section was restored, and how flat it was then.

    Args:
        model: `Model`.
        kind: ``same_scheme`` or ``independent``.
        engine: of the way back.
        state: where that ended.
        stopping: `stopping.Stopping` of it.
    """
    met = stopping.time is not None
    about = {"kind": kind, "met": met, "wanted_m": stopping.plan.value}
    numbers = {
        "restored_kyr": abs(state.time) / (1e3 * YEAR),
        "top_of_salt_m": measured(state.lines, stopping.plan),
        "all_horizons_m": flatness_of(state.lines),
    }
    for metric, value in numbers.items():
        yield Row("paper", model.name, f"{kind}.{metric}", value, parameters=about)


def compared(model, kind, engine, start, given, end, about):
    """Yield the distances between where a section began and where it came back to.

    Args:
        model: `Model`.
        kind: ``same_scheme`` or ``independent``.
        engine: the one that restored; what is thinner than its cells is welded.
        start, given, end: states where it began, where it is given, and where it came back to.
        about: entries of the rows.
    """
    weld = welds(engine.scene, given.lines, engine.cell_size, given.particles)
    distance, _ = there_and_back(end.particles)
    count = len(given.particles.x)  # those born later have no place in the given section
    distance = distance[:count]
    kept = ~np.isnan(distance) & ~weld.holds(given.particles.x)
    found = summary(distance[kept])
    outside = [~weld.holds(line.points) for line in as_drawn(given.lines)]
    lines = line_distances(as_drawn(start.lines), as_drawn(end.lines), outside)
    lines = [line for line in lines if line["kind"] == "horizon"]
    found["horizon_mean_m"] = max(line["mean_m"] for line in lines)
    found["horizon_max_m"] = max(line["max_m"] for line in lines)
    bounds = model.bounds.get(kind, {})
    for metric, value in found.items():
        paper = model.paper.get(metric) if kind == "same_scheme" else None
        yield Row(
            "paper",
            model.name,
            f"{kind}.{metric}",
            value,
            bound=bounds.get(metric),
            source=SOURCE,
            parameters={"kind": kind, "metric": metric, "paper": paper},
            **about,
        )
    whole = summary(distance[~np.isnan(distance)])
    yield Row("paper", model.name, f"{kind}.weld_share", weld.share, parameters={"kind": kind})
    yield Row(
        "paper",
        model.name,
        f"{kind}.max_with_welds_m",
        whole["max_m"],
        parameters={"kind": kind} | _histogram(distance[kept]),
    )


def _histogram(distance):
    """Return the share of particles by how far they are off, as the paper's figs. 6 and 7."""
    counts = np.histogram(np.log10(np.maximum(distance, LEAST)), bins=LOG_BINS)[0]
    return {"log10_m": LOG_BINS[:-1].tolist(), "share": (counts / counts.sum()).tolist()}


def graben_rows(quick):
    """Yield the rows of the graben (sect. 4.3), whose horizons count and not its surface."""
    there, back = graben.WAYS[False]
    ways = {"same_scheme": (there, there), "independent": (there, back)}
    if quick:  # the benchmark `graben` has it against an independent run
        ways = {"same_scheme": (([24, 8], 3), ([24, 8], 3))}
    for kind, pair in ways.items():
        forward, backward = graben.scenes(*pair, graben.SPANS[quick])
        clock = Clock()
        start, _, end, _, restorer = graben.restored(forward, backward)
        lines = line_distances(as_drawn(start.lines), as_drawn(end.lines))
        lines = [line for line in lines if line["kind"] == "horizon"]
        found = there_and_back(end.particles)[1] | {
            "horizon_mean_m": max(line["mean_m"] for line in lines),
            "horizon_max_m": max(line["max_m"] for line in lines),
        }
        bounds = {} if quick else {"horizon_mean_m": graben.MEAN, "horizon_max_m": graben.MOST}
        means, most = graben.PAPER_MEAN[:-1], graben.PAPER_MAX[:-1]  # the last is the surface
        paper = {"horizon_mean_m": max(means), "horizon_max_m": max(most)}
        for metric, value in found.items():
            yield Row(
                "paper",
                "graben",
                f"{kind}.{metric}",
                value,
                bound=bounds.get(metric),
                source=SOURCE,
                unknowns=restorer.grid.spaces.unknowns,
                cells=restorer.section.cell_count,
                stokes_solves=restorer.counts.solves,
                wall_s=clock.seconds,
                parameters={"kind": kind, "metric": metric, "paper": paper.get(metric)},
            )


def panels(rows):
    """Return the panels of the figure: errors beside the paper's, and their distributions."""
    found = []
    numbers = [row for row in rows if "metric" in row.parameters]
    for metric in ("mean_m", "horizon_max_m"):
        some = [row for row in numbers if row.parameters["metric"] == metric]
        names = list(dict.fromkeys(row.case for row in some))
        series = {}
        for kind in ("same_scheme", "independent"):
            chosen = [row for row in some if row.parameters["kind"] == kind]
            at = [names.index(row.case) for row in chosen]
            series[kind] = (at, [max(row.value, 1e-6) for row in chosen], "")
        told = [row for row in some if row.parameters["paper"]]
        series["paper"] = (
            [names.index(r.case) for r in told],
            [r.parameters["paper"] for r in told],
            "",
        )
        title = "particles, mean" if metric == "mean_m" else "horizons, greatest"
        found.append((title, AXIS, "m", ("linear", "log"), series))
    spread = [row for row in rows if "log10_m" in row.parameters and row.case.startswith("diapir")]
    for kind in ("same_scheme", "independent"):
        series = {
            row.case.removeprefix("diapir-"): (
                row.parameters["log10_m"],
                np.where(np.array(row.parameters["share"]) > 0, row.parameters["share"], np.nan),
                "-",
            )
            for row in spread
            if row.parameters["kind"] == kind
        }
        title = f"particles off by, {kind.replace('_', ' ')} (figs. 6 and 7)"
        found.append((title, "log10 of m", "share", ("linear", "log"), series))
    return found

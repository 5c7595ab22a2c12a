"""Trials of settings, the Pareto front among them, and what it recommends. Nothing is run here."""

import math
from dataclasses import asdict, dataclass, field

import numpy as np

from restoration.units import number

BETTER = 1.05  # times less error, or cost, that counts as a gain
SLOPES = (-3.0, -0.25)  # of log(error) against log(cost) with the cells: bounds of the believable
ROUND = (1, 2, 5)  # errors that people ask for, times powers of ten


@dataclass(frozen=True)
class Trial:
    """One choice of settings and what came of it.

    Attributes:
        label: what differs from the settings that were given, in words.
        axes: which kinds of settings differ, such as ``mesh`` and ``step``.
        entries: the entries of the case that were set, by name.
        error, most: mean and greatest error, m, or relative; None where it failed.
        cpu_s, wall_s: seconds, from the scene to the answer.
        memory_mb: greatest resident memory of the process.
        unknowns, steps, solves, factorisations: size and work; None where it failed.
        failed: why there is no answer; empty where there is one.
        note: what happened on the way that a reader should know; may be empty.
    """

    label: str
    axes: tuple[str, ...] = ()
    entries: dict = field(default_factory=dict)
    error: float | None = None
    most: float | None = None
    cpu_s: float | None = None
    wall_s: float | None = None
    memory_mb: float | None = None
    unknowns: int | None = None
    steps: int | None = None
    solves: int | None = None
    factorisations: int | None = None
    failed: str = ""
    note: str = ""

    def plain(self):
        """Return the trial as plain values for JSON; what is not finite is None."""
        return {
            name: None if isinstance(value, float) and not math.isfinite(value) else value
            for name, value in asdict(self).items()
        }


def done(trials):
    """Return the trials that have an answer and a cost."""
    return [t for t in trials if not t.failed and t.error is not None and math.isfinite(t.error)]


def front(trials):
    """Return the trials that none other beats in both cost and error, the cheapest first."""
    best, kept = math.inf, []
    for trial in sorted(done(trials), key=lambda t: (t.cpu_s, t.error)):
        if trial.error < best:
            best = trial.error
            kept.append(trial)
    return kept


def asked_for(error):
    """Return the least round number (1, 2 or 5 times a power of ten) not below an error."""
    if error <= 0:
        return 0.0
    power = math.floor(math.log10(error))
    steps = [float(f"{k}e{p}") for p in (power, power + 1) for k in ROUND]
    return next(step for step in steps if step >= error * (1 - 1e-12))


def recommended(trials):
    """Return what to take for which error, as pairs of a round error and a trial of the front.

    Of trials that serve the same round error the cheapest is taken.
    """
    chosen = {}
    for trial in front(trials):
        chosen.setdefault(asked_for(trial.error), trial)
    return list(chosen.items())


def mesh_slope(trials):
    """Return d log(error) / d log(cost) as the number of cells alone changes.

    Args:
        trials: those that were given and others; only what differs in the mesh alone counts.
    """
    points = [t for t in done(trials) if set(t.axes) <= {"mesh"} and t.error > 0]
    if len({t.cpu_s for t in points}) < 2:
        return SLOPES[1]
    cost, error = np.log([[t.cpu_s, t.error] for t in points]).T
    return float(np.clip(np.polyfit(cost, error, 1)[0], *SLOPES))


def gain(trial, given, slope):
    """Return how many times less error a trial has than other cells would at the same cost.

    Args:
        trial, given: `Trial` and the one it departs from.
        slope: see `mesh_slope`.
    """
    if not trial.error:
        return math.inf
    expected = given.error * (trial.cpu_s / given.cpu_s) ** slope
    return expected / trial.error


def promising(trials, given):
    """Return, by axis, the trial that gains most against a change of cells, where one does.

    Args:
        trials: with one axis changed each.
        given: `Trial` with nothing changed.

    Returns:
        Trials by name of the axis, the greatest gain first.
    """
    slope, best = mesh_slope([given, *trials]), {}
    for trial in done(trials):
        if len(trial.axes) != 1 or trial.axes == ("mesh",):
            continue
        gained = gain(trial, given, slope)
        (axis,) = trial.axes
        if gained > max(BETTER, best.get(axis, (0.0, None))[0]):
            best[axis] = gained, trial
    found = sorted(best.items(), key=lambda entry: -entry[1][0])
    return {axis: trial for axis, (_, trial) in found}


def effects(trials, given):
    """Return in words what every single change did to error and cost, the greatest gain first.

    Args:
        trials, given: as of `promising`.
    """
    slope = mesh_slope([given, *trials])
    singles = [t for t in done(trials) if len(t.axes) == 1 and t.axes != ("preset",)]
    singles.sort(key=lambda t: -gain(t, given, slope))
    return [
        f"{t.label}: error {_times(t.error, given.error)}, cost {_times(t.cpu_s, given.cpu_s)}"
        for t in singles
    ]


def _times(value, given):
    """Return in words how a value compares with what was given."""
    ratio = value / given
    if 1 / BETTER < ratio < BETTER:
        return "as before"
    return f"x {number(ratio, 2)}" if ratio > 1 else f"/ {number(1 / ratio, 2)}" if ratio else "0"

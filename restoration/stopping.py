"""Where a run stops by itself, how long it took to there, and the viscosities a known age asks for.

A criterion measures horizons by the heights of their lines: how flat they are (root mean square of
the height about its mean), their relief, or how deep their highest point lies. For flatness a line
counts by how far it goes across: by its length, the scar that a diapir leaves would outweigh all
else. Where the measure passes the value asked for, the last step is taken anew to just that moment.

Stokes flow has no inertia. Where gravity and constant tractions alone drive it, viscosities that
are all f times as high give the same way f times as slowly, with a free surface too. So what a
known age asks of the viscosities needs no search.
"""

from dataclasses import replace

import numpy as np

from restoration.entries import is_age
from restoration.lines import surface_of
from restoration.retry import stepped
from restoration.scene import Line, StopPlan, Table
from restoration.units import number, show
from restoration.words import hint, listed

PRECISE = 1e-9  # of the change in the last step, that the measure may be off where the run stops
MOST_TRIALS = 6  # of landing there; each comes nearer by orders of magnitude, down to roughness
# Past its least the measure is rising again, and not just rough, where it is so many times as large
# and as many steps have gone.
RISEN, STEPS_PAST = 1.2, 4
UPRIGHT = 1e-9  # that a line counts by its length too, so that an upright one counts at all
ALL, SURFACE = "all", "surface"
NOTED = "over", "history", "time", "value", "_least"  # of a march, beside states


def flatness(surfaces):
    """Return the root mean square of the height of horizons about the mean of each, m.

    Args:
        surfaces: a list for each horizon, of its pieces, each of shape (n, 2), m.
    """
    across = square = 0.0
    for pieces in surfaces:
        ends = np.concatenate([np.column_stack([p[:-1, 1], p[1:, 1]]) for p in pieces])
        run, rise = np.abs(np.concatenate([np.diff(p, axis=0) for p in pieces])).T
        weight = run + UPRIGHT * np.hypot(run, rise)
        a, b = (ends - weight @ ends.mean(axis=1) / weight.sum()).T
        square += weight @ (a * a + a * b + b * b) / 3
        across += weight.sum()
    return float(np.sqrt(square / across))


def relief(surfaces):
    """Return the greatest difference in height on one horizon, m; argument as `flatness`."""
    return max(float(np.ptp(np.concatenate(pieces)[:, 1])) for pieces in surfaces)


def depth(surfaces):
    """Return the depth of the highest point of all horizons, m; argument as `flatness`."""
    return -max(float(p[:, 1].max()) for pieces in surfaces for p in pieces)


MEASURES = {"flat": flatness, "relief": relief, "depth": depth, "flattest": flatness}
WORDS = {
    "flat": "flat to {}",
    "relief": "relief {}",
    "depth": "highest point at a depth of {}",
    "flattest": "flat to {}",
}


def surfaces_of(lines, names=None):
    """Return the pieces of horizons.

    Args:
        lines: `scene.Line`s.
        names: a tuple for each horizon, of the names of its lines; None for all, by name.
    """
    if names is None:
        names = _each(lines)
    found = [
        [line.points for line in lines if line.name in group and line.kind in ("horizon", SURFACE)]
        for group in names
    ]
    return [pieces for pieces in found if pieces]


def _each(lines):
    return tuple((n,) for n in dict.fromkeys(x.name for x in lines if x.kind == "horizon"))


def flatness_of(lines, plan=None):
    """Return how flat the horizons of a criterion are, or all where there is none; None of none."""
    surfaces = surfaces_of(lines, plan.names if plan else None)
    return flatness(surfaces) if surfaces else None


def measured(lines, plan):
    """Return what a `StopPlan` measures of lines, m; NaN where no line is left of its horizons."""
    surfaces = surfaces_of(lines, plan.names)
    return MEASURES[plan.criterion](surfaces) if surfaces else np.nan


def find_stop(case, shape, walls, tree):
    """Return the `StopPlan` of a case, or None, and the faults of what it asks for.

    Args:
        case: `entries.Case`.
        shape: `shapes.Shape`.
        walls: `scene.Wall` by name.
        tree: `tree.Tree` of the case file.
    """
    entry, at = case.time.stop, ("time", "stop")
    if entry is None:
        return None, []
    lines = shape.lines
    if walls["surface"].kind == "free":
        lines = (*lines, Line(SURFACE, SURFACE, shape.outline.surface))
    names, faults = _named(entry.horizon, lines, shape.names, tree)
    known, wrong = _known(case, walls, tree)
    faults += wrong
    if faults:
        return None, faults
    text = listed([f"top of {n}" if n in shape.names else n for n in entry.horizon], last="and")
    text = "all horizons" if entry.horizon == (ALL,) else text
    criterion = next(name for name in MEASURES if getattr(entry, name) is not None)
    value = None if criterion == "flattest" else getattr(entry, criterion).si
    plan = StopPlan(criterion, text, names, value, known)
    start = measured(lines, plan)
    if value is not None and abs(start - value) <= 1e-9 * abs(value):
        message = f"{text} begins with {show(value, 'length')}; give another value"
        return None, [tree.fault((*at, criterion), message)]
    return replace(plan, start=start), []


def notes(plan):
    """Return the notes for the user on a `StopPlan` or None."""
    if plan is None or plan.criterion not in ("flat", "relief") or plan.start > plan.value:
        return ()
    value, start = show(plan.value, "length"), _state(plan, plan.start)
    return (f"{start} to begin with: the run stops where that grows to {value}",)


def asked(plan):
    """Return what a `StopPlan` asks for, in words."""
    wanted = "flattest"
    if plan.value is not None:
        wanted = WORDS[plan.criterion].format(show(plan.value, "length"))
    return f"{plan.horizon}: {wanted} (now {show(plan.start, 'length')})"


def _named(given, lines, units, tree):
    """Return the names of the lines of each horizon that is named, and the faults of names."""
    each = [name for (name,) in _each(lines)]
    if not each and not surface_of(lines):
        return (), [tree.fault(("time", "stop"), "the section has no horizons", at="key")]
    if given == (ALL,):
        return tuple((name,) for name in each), []
    tops = {unit: [n for n in each if n.startswith(f"{unit} / ")] for unit in units}
    known = {name: [name] for name in each} | {unit: top for unit, top in tops.items() if top}
    if surface_of(lines) is not None:
        known[SURFACE] = [SURFACE]
    faults = [
        tree.fault(
            ("time", "stop", "horizon"),
            f"there is no horizon '{name}'{hint(name, [*known, ALL])}",
        )
        for name in given
        if name not in known
    ]
    return tuple(tuple(known.get(name, ())) for name in dict.fromkeys(given)), faults


def _known(case, walls, tree):
    """Return the duration that is known, s, or None, and the faults of asking for it."""
    entry, at = case.time.known_age, ("time", "known_age")
    if entry is None:
        return None, []
    held = [
        name
        for name, wall in walls.items()
        if any(np.any(_values(value)) for value in wall.velocity)
    ]
    varied = [
        name
        for name, wall in walls.items()
        if any(isinstance(value, Table) and len(value.times) > 1 for value in wall.traction)
    ]
    reason = "so viscosities do not just change the pace; remove it"
    faults = [
        tree.fault(at, f"{what} of the {listed(walls, last='and')} {keeps}, {reason}")
        for what, walls, keeps in (
            ("the velocity", held, "is given"),
            ("the traction", varied, "varies in time"),
        )
        if walls
    ]
    duration, begin = entry.si, case.time.marks[0]
    if is_age(entry) != is_age(begin) and is_age(entry):
        faults.append(tree.fault(at, f"'{entry.text}' is an age and the marks are times"))
    elif is_age(entry):
        way = np.sign(case.time.marks[1].si - begin.si)
        duration = way * (entry.si - begin.si)
        if duration <= 0:
            message = f"'{entry.text}' is not on the way from {begin.text}, the first mark"
            faults.append(tree.fault(at, message))
    return float(duration), faults


def _values(value):
    return value.values if isinstance(value, Table) else value or 0.0


def _state(plan, value):
    """Return in words what is measured."""
    return f"{plan.horizon}: {WORDS[plan.criterion].format(show(value, 'length'))}"


class Stopping:
    """Ends a march where a criterion is met.

    Args:
        plan: `scene.TimePlan`; without one, or a ``stop`` in it, nothing ends the march.

    Attributes:
        plan: `scene.StopPlan`, or None.
        over: whether the march has ended here.
        history: a row for every state: model time, s, and what was measured, m; among them the one
            where the march ended.
        time, value: where the criterion was met, s, and what was measured there, m; None if not.
    """

    def __init__(self, plan=None):
        self.plan, self._end = (plan.stop, plan.marks[-1]) if plan else (None, None)
        self.over, self.history, self.time, self.value = False, [], None, None
        self._least, self._near = 0, ()  # row of the history; the states up to that one

    def memory(self, memory_of_rock):
        """Return what was noted so far, for a checkpoint; see `recall`.

        Args:
            memory_of_rock: of a state, such as that of the engine.
        """
        noted = {name: getattr(self, name) for name in NOTED}
        return noted | {"near": [memory_of_rock(state) for state in self._near]}

    def recall(self, memory, rock_of):
        """Go on from what `memory` returned.

        Args:
            memory: of `memory`.
            rock_of: gives a state back.
        """
        for name in NOTED:
            setattr(self, name, memory[name])
        self.history = [tuple(row) for row in self.history]
        self._near = tuple(rock_of(state) for state in memory["near"])

    def begin(self, state):
        """Note the state at the first mark."""
        if self.plan is not None:
            self._note(state)

    def landed(self, engine, before, state):
        """Return the state after a step, or the one where the march ends.

        Args:
            engine: see `run.march`; ``taken_over(state)`` gives an earlier state back to it.
            before, state: before and after the step.
        """
        if self.plan is None:
            return state
        ended = self._flattest if self.plan.criterion == "flattest" else self._passed
        found = ended(engine, before, state)
        if found is None:
            return state
        self.over, self.time, self.value = True, found.time, self._of(found)
        self._note(found)
        return found

    def _of(self, state):
        return measured(state.lines, self.plan)

    def _note(self, state):
        self.history.append((state.time, self._of(state)))

    def _passed(self, engine, before, state):
        """Return the state where the measure is as asked for; None if it is not yet."""
        (start, first), last = self.history[-1], self._of(state)
        wanted = self.plan.value
        points, best = [(first - wanted, start), (last - wanted, state.time)], abs(last - wanted)
        if not min(first, last) <= wanted <= max(first, last):
            self._note(state)
            return None
        found, begin = state, _bare(before)
        for _ in range(MOST_TRIALS):
            if best <= PRECISE * abs(last - first):
                break
            trial = _marched(engine, begin, _crossing(points))
            points.append((self._of(trial) - wanted, trial.time))
            if abs(points[-1][0]) >= best:
                return _marched(engine, _bare(found), found.time)  # the mesh may have moved
            found, best = trial, abs(points[-1][0])
        return found

    def _flattest(self, engine, before, state):
        """Return the state where the measure was least, once it has risen; None before."""
        self._note(state)
        values = [value for _, value in self.history]
        if values[-1] < values[self._least]:
            self._least, self._near = len(values) - 1, (_bare(before), _bare(state))
        least, past = values[self._least], len(values) - 1 - self._least
        risen = values[-1] > RISEN * least and past >= STEPS_PAST
        if not self._near or not past or not (risen or state.time == self._end):
            return None
        rows = self.history[self._least - 1 : self._least + 2]
        time = _lowest(rows)
        later = abs(time - rows[0][0]) > abs(rows[1][0] - rows[0][0])
        return _marched(engine, self._near[later], time)

    def verdict(self, label):
        """Return in words where the march ended, after its end.

        Args:
            label: gives a model time as text.
        """
        plan, (time, value) = self.plan, self.history[-1]
        if self.time is not None:
            took = show(abs(time - self.history[0][0]), "time")
            least = ", at its flattest" if plan.criterion == "flattest" else ""
            return f"{_state(plan, value)} at {label(time)}, after {took}{least}"
        begun = show(self.history[0][1], "length")
        told = f"{_state(plan, value)} at {label(time)}, the last mark, after {begun} at the first"
        if plan.criterion == "flattest":
            return f"not met: {told}; there is no least in between"
        return f"not met: {told}; {show(plan.value, 'length')} was asked for"

    def about(self, label):
        """Return what the run record tells of it; argument as `verdict`."""
        plan = self.plan
        return {
            "criterion": plan.criterion,
            "horizon": plan.horizon,
            "wanted_m": plan.value,
            "value_m": self.history[-1][1] if self.value is None else self.value,
            "time_s": self.time,
            "duration_s": None if self.time is None else abs(self.time - self.history[0][0]),
            "met": self.time is not None,
            "verdict": self.verdict(label),
        }

    def fitting(self, scene):
        """Return the entries of the run record on the viscosities that a known age asks for."""
        if self.plan.known is None or self.time is None:
            return {}
        factor = self.plan.known / abs(self.time - self.history[0][0])
        fit = {rock.name: factor * rock.viscosity for rock in scene.rocks}
        if scene.air:
            fit["surface.air"] = factor * scene.air.viscosity
        return {"viscosity_factor": factor, "fitting_viscosity": fit}


def fitting_text(plan, entries):
    """Return in words what `Stopping.fitting` found."""
    rocks = listed(
        [f"{name} {show(eta, 'viscosity')}" for name, eta in entries["fitting_viscosity"].items()],
        last="and",
    )
    factor = number(entries["viscosity_factor"], 4)
    return f"{show(plan.known, 'time')}, {factor} times that; viscosities that fit: {rocks}"


def _bare(state):
    """Return a state without its flow and mesh, which are large."""
    return replace(state, flow=None, grid=None)


def _marched(engine, state, until):
    """Return a state of before, marched to a time."""
    state = engine.with_flow(engine.taken_over(state))
    engine.watch(state)
    while state.time != until:
        state = stepped(engine, state, until)
    return state


def _crossing(points):
    """Return where a function passes 0: the inverse polynomial through its last three points.

    Args:
        points: value and argument; among them some on both sides. What leaves those next to 0 is
            replaced by the chord between them.
    """
    low = max((p for p in points if p[0] <= 0), key=lambda p: p[0])
    high = min((p for p in points if p[0] > 0), key=lambda p: p[0], default=low)
    sides = sorted((low[1], high[1]))
    time, used = 0.0, points[-3:]
    for i, (value, t) in enumerate(used):
        others = [v for k, (v, _) in enumerate(used) if k != i]
        if value in others:
            break
        time += t * np.prod([v / (v - value) for v in others])
    else:
        if sides[0] < time < sides[1]:
            return float(time)
    return float(low[1] + (high[1] - low[1]) * low[0] / (low[0] - high[0]))


def _lowest(rows):
    """Return where the parabola through three (time, value) is lowest; the middle one is least."""
    (a, fa), (b, fb), (c, fc) = rows
    down, up = (b - a) * (fb - fc), (b - c) * (fb - fa)
    if down == up:
        return b
    return float(b - ((b - a) * down - (b - c) * up) / (2 * (down - up)))

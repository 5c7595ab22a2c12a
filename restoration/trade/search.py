"""The search: what was given, one change at a time, then what promises to go well together."""

import json
import os
import select
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from restoration.errors import CaseError, SolveError
from restoration.launch import child_environment
from restoration.measured import kind_of
from restoration.plan import time_label
from restoration.trade.choices import (
    FINER,
    Choice,
    choices_of,
    presets_of,
    references_of,
    together,
)
from restoration.trade.trials import BETTER, Trial, gain, mesh_slope, promising

# CPU seconds of a trial until it is ended: so many times what was given took, and the least.
PATIENCE, LEAST_S = 20.0, 300.0
LOOK_S = 1.0  # between two looks at that
TOO_DEAR = 12.0  # times what was given cost, as far as the cells tell, that are not tried,
CHEAP_S = 200.0  # but where that is less than this
# Exponent of the cost of a march against cells along a side: as in 2-D with shorter steps, until
# it is known; and bounds of the believable.
GROWTH, GROWTHS = 2.8, (2.2, 3.2)
# Kinds of settings that are changed once more, one at a time, of what goes best together.
AGAIN = ("mesh", "element", "particles", "stepper", "step")
ORDER = 2  # of the error against cells, as the reference is judged
MEASURED = ("error", "most", "cpu_s", "wall_s", "memory_mb", "unknowns", "steps", "solves")
MEASURED += ("factorisations", "failed", "note")


class Worker:
    """A process of its own that measures, see `worker`; begun anew where it dies.

    Attributes:
        limit: CPU seconds after which a trial is ended, or None.
    """

    def __init__(self):
        self._process, self.limit = None, None

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self._end()

    def ask(self, request):
        """Return the answer to a request; ``failed`` says why there is none.

        Args:
            request: see `worker.answer`.
        """
        process = self._process = self._process or _begun()
        with suppress(BrokenPipeError):  # that it has died is told below
            process.stdin.write(json.dumps(request) + "\n")
            process.stdin.flush()
        begin = _cpu_s(process.pid)
        while not select.select([process.stdout], [], [], LOOK_S)[0]:
            if self.limit and _cpu_s(process.pid) - begin > self.limit:
                self._end()
                return {"failed": f"ended after {self.limit:.0f} CPU s"}
        line = process.stdout.readline()
        if line:
            return json.loads(line)
        code = process.wait()
        self._end()
        return {"failed": f"the process ended with code {code}; out of memory?"}

    def _end(self):
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            for pipe in (self._process.stdin, self._process.stdout):
                with suppress(BrokenPipeError):  # what was never sent
                    pipe.close()
            self._process = None


def _cpu_s(process):
    """Return the CPU seconds of a process by its id, 0 where it has ended."""
    with suppress(OSError):
        fields = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()
        return sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK")
    return 0.0


def _begun():
    """Return a worker that is one thread and hears no Ctrl-C: the parent answers that."""
    return subprocess.Popen(
        [sys.executable, "-m", "restoration.trade.worker"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
        env=child_environment(one_thread=True),
    )


@dataclass
class Subject:
    """What is searched: a case or a benchmark.

    Attributes:
        name, title: of it.
        unit: of its errors, ``m``, or empty for relative ones.
        columns: what its two errors are.
        truth: what they are errors against, in words; of a case known after `prepare`.
        good_to: error of that, as far as it is known; None where it is exact.
        about: what kind of scene it is, as plain values; empty of a benchmark.
    """

    name: str
    title: str
    unit: str
    columns: tuple[str, str]
    truth: str = ""
    good_to: float | None = None
    about: dict = field(default_factory=dict)

    def prepare(self, ask, tell):
        """Do what must be done before the first trial; yield the trials of that."""
        yield from ()

    def judged(self, answer):
        """Return an answer with its errors."""
        return answer


class BenchmarkSubject(Subject):
    """A benchmark with a known answer.

    Args:
        name: in `questions.QUESTIONS`.
        question: `questions.Question`.
        settings: that replace its own, by entry.
    """

    def __init__(self, name, question, settings=None):
        super().__init__(name, question.title, question.unit, question.columns, question.truth)
        self.question, self.settings = question, settings or {}

    def choices(self, quick):
        """Return the choices that depart from what was given."""
        found = [c for c in self.question.choices if not c.entries.items() <= self._base.items()]
        return found[::3] if quick else found

    def presets(self):
        """Return the presets: a benchmark has none."""
        return []

    @property
    def _base(self):
        return self.question.base | self.settings

    def request(self, entries):
        """Return the request for settings."""
        return {"benchmark": self.name, "entries": self.settings | entries}

    def finer(self, entries):
        """Return how many times smaller cells settings have; of a benchmark none is too dear."""
        return 1.0


class CaseSubject(Subject):
    """A case, measured against a reference of its own on its first way.

    Args:
        path: the case file.
        scene: `scene.Scene` of it.
        sets: overrides that were given, texts ``a.b=value``.
        outside: whether it may name files outside its folder.
    """

    def __init__(self, path, scene, sets=(), outside=False):
        name = path.absolute().parent.name if path.stem == "case" else path.stem
        super().__init__(name, scene.title, "m", ("mean", "greatest"))
        if scene.dim == 3:
            raise CaseError(f"{path}: settings are traded in two dimensions only so far")
        if not any(line.kind == "horizon" for line in scene.lines) and not scene.free:
            raise CaseError(f"{path}: has no horizon and no free surface whose way can be compared")
        self.scene, self.about = scene, kind_of(scene)
        self.case = {"path": str(path), "sets": list(sets), "outside": outside, "end": None}
        self._lines = None

    def choices(self, quick):
        """Return the choices that depart from what was given."""
        return choices_of(self.scene, quick)

    def presets(self):
        """Return the presets as choices."""
        return presets_of(self.scene)

    def request(self, entries):
        """Return the request for settings."""
        return {"case": self.case, "entries": entries}

    def finer(self, entries):
        """Return how many times smaller cells settings have than what was given."""
        cells = entries.get("mesh.cells")
        return min(cells) / min(self.scene.cells) if cells else 1.0

    def prepare(self, ask, tell):
        """Yield the trials of the reference: those that failed, it, and the same on larger cells.

        Raises:
            SolveError: there is no reference.
        """
        for choice in references_of(self.scene):
            tell(f"reference: {choice.name}")
            answer = ask(self.request(choice.entries))
            if "lines" in answer:
                break
            tell(f"  {why(answer)}")
        else:
            raise SolveError("there is no reference to compare with: all of its settings failed")
        self._lines, self.case["end"] = answer["lines"], answer["end"]
        self.truth = f"a run of its own to {time_label(self.scene, answer['end'])}: {choice.name}"
        yield _trial(Choice("reference", f"reference: {choice.name}"), self.judged(answer))
        coarser = {"mesh.cells": list(self.scene.cells)}
        same = Choice("reference", "as the reference, on the cells given", choice.entries | coarser)
        trial = _trial(same, self.judged(ask(self.request(same.entries))))
        if not trial.failed:
            self.good_to = trial.error / (FINER**ORDER - 1)
        yield trial

    def judged(self, answer):
        """Return an answer with the distance of its lines from those of the reference."""
        if "lines" not in answer:
            return answer
        from restoration.diagnostics import line_distances
        from restoration.scene import Line

        sets = [
            [Line(q["name"], q["kind"], np.array(q["points"])) for q in lines]
            for lines in (self._lines, answer["lines"])
        ]
        names = [{line.name for line in lines} for lines in sets]
        if names[0] != names[1]:
            return {"failed": "lost a horizon on the way"}
        rows = line_distances(*sets)
        return answer | {
            "error": sum(row["mean_m"] for row in rows) / len(rows),
            "most": max(row["max_m"] for row in rows),
        }


def why(answer):
    """Return why an answer is none."""
    return answer.get("failed") or answer.get("refused")


def _trial(choice, answer):
    """Return the trial of a choice by its judged answer."""
    axes = tuple(choice.axis.split("+")) if choice.axis else ()
    known = {name: answer[name] for name in MEASURED if name in answer}
    return Trial(choice.name, axes, choice.entries, **known)


def search(subject, worker, quick=False, tell=None):
    """Yield trials one by one as they are measured.

    Args:
        subject: `Subject`.
        worker: offers ``ask(request)`` and takes a ``limit``, CPU s.
        quick: few of them.
        tell: function of a text.
    """
    tell = tell or (lambda text: None)
    yield from subject.prepare(worker.ask, tell)
    seen, given, meshes = set(), None, []

    def tried(choice):
        key = json.dumps(choice.entries, sort_keys=True)
        if key in seen:
            return None
        seen.add(key)
        if given:
            dearer = subject.finer(choice.entries) ** growth(subject, meshes)
            seconds = dearer * given.cpu_s
            if dearer > TOO_DEAR and seconds > CHEAP_S:
                return _trial(choice, {"failed": f"not tried: would cost about {seconds:.0f} s"})
        answer = worker.ask(subject.request(choice.entries))
        if "refused" in answer and choice.axis:
            tell(f"  {choice.name}: does not apply: {answer['refused']}")
            return None
        return _trial(choice, subject.judged(answer | {"failed": why(answer) or ""}))

    nothing = Choice("", "as given")
    given = tried(nothing)
    yield given
    if given.failed:
        raise SolveError(f"what was given cannot be compared with: {given.failed}")
    worker.limit = max(LEAST_S, PATIENCE * given.cpu_s)
    choices = subject.choices(quick)
    found = singles = yield from _around(nothing, choices, tried)
    meshes += [given, *(trial for _, trial in found if trial.axes == ("mesh",))]
    for choice in [] if quick else subject.presets():
        trial = tried(choice)
        if trial:
            yield trial
    winner, best = yield from _together(nothing, given, found, tried)
    if best is given:
        return
    again = [c for c in choices if c.axis in (AGAIN[:1] if quick else AGAIN)]
    found = yield from _around(winner, again, tried)
    winner, best = yield from _together(winner, best, found, tried)
    yield from _around(winner, [c for c in choices if c.axis == "mesh"], tried)
    # The second best way of rock to the mesh goes where the best may not.
    for choice in [] if quick else _second(singles, given):
        yield from _around(choice, [c for c in choices if c.axis in ("mesh", "step")], tried)


def _second(singles, given):
    """Return the second best way of rock to the mesh, alone in a list, where it gains."""
    slope = mesh_slope([given, *(trial for _, trial in singles)])
    ways = [(gain(t, given, slope), c) for c, t in singles if c.axis == "rock"]
    ways = sorted((way for way in ways if way[0] > BETTER), key=lambda way: -way[0])
    return [choice for _, choice in ways[1:2]]


def growth(subject, meshes):
    """Return the exponent of the cost against cells along a side, by the finest two meshes."""
    points = sorted((subject.finer(t.entries), t.cpu_s) for t in meshes)[-2:]
    if len(points) < 2 or points[0][0] == points[1][0]:
        return GROWTH
    (coarse, less), (fine, more) = points
    return float(np.clip(np.log(more / less) / np.log(fine / coarse), *GROWTHS))


def _around(start, choices, tried):
    """Yield trials that depart from a start by one choice each; return them with that choice.

    Args:
        start: `Choice`.
        choices: list of `Choice`.
        tried: function of a choice that gives a trial, or None.
    """
    found = []
    for choice in choices:
        trial = tried(together(start, choice))
        if trial:
            yield trial
            if not trial.failed:
                found.append((choice, trial))
    return found


def _together(start, given, found, tried):
    """Yield trials of what gains most by itself put together; return what gains most of all.

    Args:
        start, given: `Choice` and its `Trial`.
        tried: as of `_around`.
        found: pairs of choices and trials of it.

    Returns:
        A `Choice` and its `Trial`: those of the start where nothing gains.
    """
    # Its axes are those that differ from the start.
    alone = [replace(trial, axes=(choice.axis,)) for choice, trial in found]
    start_alone = replace(given, axes=())
    slope = mesh_slope([start_alone, *alone])
    labels = [trial.label for trial in promising(alone, start_alone).values()]
    parts = [next(c for c, t in found if t.label == label) for label in labels]
    ranked = [(1.0, start, given)]
    ranked += [(gain(t, given, slope), together(start, c), t) for c, t in found if c in parts]
    for count in sorted({len(parts), 3, 2} - {0, 1}, reverse=True):
        if count > len(parts):
            continue
        choice = together(start, *parts[:count])
        trial = tried(choice)
        if trial:
            yield trial
            if not trial.failed:
                ranked.append((gain(trial, given, slope), choice, trial))
    return max(ranked, key=lambda entry: entry[0])[1:]

"""A process that answers one request after another, so that a crash is a finding and no end.

Requests and answers are lines of JSON. Every kind of work is done once in the small before it is
measured, so that what is compiled or loaded once in a process is in no figure.
"""

import gc
import json
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

from restoration.engine import StokesEngine
from restoration.environment import give_memory_back, use_jit_cache
from restoration.errors import RestorationError
from restoration.resolve import load
from restoration.run import march
from restoration.stopping import Stopping
from restoration.trade.questions import QUESTIONS

SMALL = 8  # squares along the shorter side of what is done once beforehand
WARMED = (
    "mesh.element",
    "mesh.interfaces",
    "mesh.refine",
    "transfer.density",
    "transfer.viscosity",
    "solver",
)


class Meter:
    """Cost of what is done in its context: CPU and wall seconds, greatest memory.

    What earlier trials have left in memory does not count.
    """

    base_mb = None  # of the process before its first trial

    def __enter__(self):
        gc.collect()
        give_memory_back()
        with open("/proc/self/clear_refs", "w") as peak:
            peak.write("5")  # the greatest memory counts from now on
        self.before = memory_mb("VmRSS")
        Meter.base_mb = Meter.base_mb or self.before
        self.wall, self.cpu = time.perf_counter(), time.process_time()
        return self

    def __exit__(self, *_):
        self.wall_s = time.perf_counter() - self.wall
        self.cpu_s = time.process_time() - self.cpu
        self.memory_mb = memory_mb("VmHWM") - self.before + Meter.base_mb

    @property
    def cost(self):
        """What it took, as entries of a `trials.Trial`."""
        return {
            "cpu_s": round(self.cpu_s, 3),
            "wall_s": round(self.wall_s, 3),
            "memory_mb": round(self.memory_mb),
        }


def memory_mb(name):
    """Return a number of the memory of this process, MB: ``VmRSS`` now, ``VmHWM`` at most."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(name)) / 1024


def one_way(marks):
    """Return the marks up to where they first turn back."""
    for i in range(2, len(marks)):
        if (marks[i] - marks[i - 1]) * (marks[1] - marks[0]) < 0:
            return marks[:i]
    return marks


def scene_of(case, entries):
    """Return the scene of a request, on its first way only.

    Args:
        case: mapping of ``path``, ``sets``, ``outside`` and ``end``, s; an end replaces the last
            mark and what may stop the march before.
        entries: values by entry of the case.
    """
    overrides = (*case["sets"], *(f"{name}={value}" for name, value in entries.items()))
    scene = load(case["path"], overrides, case["outside"]).scene
    plan = replace(scene.time, marks=one_way(scene.time.marks))
    if case["end"] is not None:
        way = plan.marks[1] - plan.marks[0]
        before = (mark for mark in plan.marks if (case["end"] - mark) * way > 0)
        plan = replace(plan, marks=(*before, case["end"]), stop=None)
    return replace(scene, time=plan)


def marched(scene):
    """March through a scene and return where its lines end, as entries of an answer."""
    engine, passed = StokesEngine(scene), []
    end = march(
        engine.start(),
        engine,
        scene.time,
        every_step=(lambda _, state: passed.append(state.time),),
        stopping=Stopping(scene.time),
    )
    wanted = scene.mesh.interfaces != "particles"
    answer = {
        "lines": [
            {"name": line.name, "kind": line.kind, "points": line.points.tolist()}
            for line in end.lines
            if line.kind in ("horizon", "surface")
        ],
        "end": end.time,
        "unknowns": engine.grid.spaces.unknowns,
        "steps": len(passed),
        "solves": engine.counts.solves,
        "factorisations": engine.counts.factorisations,
        "note": "went over to particles" if wanted and not engine.fitted else "",
    }
    engine.grid.stokes.release()
    return answer


def warm(case, entries):
    """Take a few small steps of a kind of work; whether they succeed does not matter."""
    coarse = {name: value for name, value in entries.items() if name in WARMED}
    scene = scene_of(case, coarse | {"mesh.cells": SMALL})
    marks = (
        scene.time.marks[0],
        scene.time.marks[0] + 1e-3 * (scene.time.marks[1] - scene.time.marks[0]),
    )
    marched(replace(scene, time=replace(scene.time, marks=marks, min_steps=2, stop=None)))


def answer(request, warmed):
    """Return the answer to a request: what it gave and cost, or why it gave nothing.

    Args:
        request: mapping of ``case`` (see `scene_of`) or ``benchmark`` (a name), and ``entries``.
        warmed: set of the kinds of work that were done before.
    """
    entries = request["entries"]
    kind = request.get("benchmark"), *(str(entries.get(name)) for name in WARMED)
    try:
        if "benchmark" in request:
            question = QUESTIONS[request["benchmark"]]
            if kind not in warmed:
                question.answer(question.base | entries | question.small)
                warmed.add(kind)
            with Meter() as meter:
                found = question.answer(question.base | entries)
        else:
            scene = scene_of(request["case"], entries)
            if kind not in warmed:
                try_quietly(warm, request["case"], entries)
                warmed.add(kind)
            with Meter() as meter:
                found = marched(scene)
    except RestorationError as error:
        refused = error.exit_code == 2
        return {"refused" if refused else "failed": str(error).splitlines()[0]}
    except MemoryError:
        return {"failed": "out of memory"}
    except Exception as error:  # whatever it is, it is what these settings lead to
        return {"failed": f"{type(error).__name__}: {error}".splitlines()[0]}
    return found | meter.cost


def try_quietly(work, *arguments):
    """Do something whose failure will show again where it matters."""
    try:
        work(*arguments)
    except Exception:
        return


def main():
    """Answer requests from the standard input until it ends."""
    use_jit_cache()
    answers = os.fdopen(os.dup(sys.stdout.fileno()), "w")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())  # libraries print there
    warmed = set()
    for line in sys.stdin:
        answers.write(json.dumps(answer(json.loads(line), warmed)) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()

"""The tasks of a run: what is written after a step, at a mark and at the end.

On several ranks all of them go through the tasks, with the particles of all; the first one writes.
"""

import resource
import subprocess
import time
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from restoration.canvas import time_text
from restoration.certificate import certified, failed, outside_welds, report, sentences
from restoration.certificate_figure import draw_certificate
from restoration.checkpoint import Checkpoints
from restoration.companions import Follower, accompany, prove
from restoration.diagnostics import compared, relief, there_and_back, volume_by_rock
from restoration.engine import StokesEngine
from restoration.environment import versions
from restoration.errors import (
    MeshError,
    OutputError,
    RestorationError,
    SolveError,
    StoppedError,
    TooLargeError,
    out_of_memory,
)
from restoration.figures import draw_flatness, draw_section, draw_strip, draw_there_and_back
from restoration.layered import restorable
from restoration.lines import as_drawn
from restoration.output import (
    Diagnostics,
    MeshSeries,
    ParticleSeries,
    write_json,
    write_lines,
    write_record,
)
from restoration.plan import counts_back, time_label
from restoration.ranks import world
from restoration.stopping import Stopping, fitting_text, flatness_of
from restoration.topography import dynamic_topography
from restoration.units import MYR, show
from restoration.welds import welds
from restoration.writing import disk_faults, write_text

COLUMNS = (
    "step",
    "time_Myr",
    "dt_kyr",
    "stokes_solves",
    "residual",
    "rms_velocity_m_per_s",
    "max_velocity_m_per_s",
    "cells",
    "particles",
    "particles_lost",
    "particles_born",
    "particles_left",
    "particles_entered",
    "empty_cells",
    "held_on_wall",
    "steps_retried",
    "flatness_m",
    "surface_relief_m",
    "surface_shift_m",
    "horizon_shift_m",
    "surface_fallen_m2",
    "surface_modes_slaved",
    "wall_s",
)
# What a recorder counts, and what of its record is made on the way.
COUNTED = (
    "steps",
    "elapsed",
    "_output_s",
    "checkpoints_s",
    "_volumes",
    "_framed",
    "_told",
    "_load",
    "_counts",
)
CARRIED = "dynamic_topography_m", "resumed_after_steps"
BUG = 1  # exit code of what is not a RestorationError


class Recorder:
    """Writes the run folder of one job.

    Args:
        job: `run_folder.Job`.
        folder: the run folder, made and empty.
        progress: `progress.Progress`, or None.
        engine: makes the engine of a scene.
        memory: of an earlier recorder of the same run, to go on from; None to begin.

    Attributes:
        engine: the engine, after `begin`.
        record: what run.json will hold.
        stopping: `Stopping` of the march.
        checkpoints_s: wall time that checkpoints took, s.
    """

    def __init__(self, job, folder, progress=None, memory=None, engine=StokesEngine):
        self.job, self.scene, self.folder = job, job.scene, Path(folder)
        self._memory = memory
        self.ranks = world()
        self.progress = progress if self.ranks.first else None
        self._make_engine = engine
        self.engine, self.stopping = None, Stopping(self.scene.time)
        self.steps, self.elapsed = 0, 0.0
        self._began, self._output_s, self.checkpoints_s = time.perf_counter(), 0.0, 0.0
        self._marks, self._volumes = [], []  # states at the marks passed, and area by rock
        self._kept = []  # states that checkpoints refer to, and their names
        self._last = None
        self._framed = -1.0  # elapsed time of the last frame
        self._told = 0  # notes of the engine
        self._follower = Follower(self.scene, self._whole) if self.scene.certificate else None
        self._certificate_s = None
        self._path = float(np.abs(np.diff(self.scene.time.marks)).sum())
        self._load, self._counts = 1.0, {}
        self._log = self.ranks.alone(self._open_log)
        self.record = {
            "ended_well": False,
            "case_sha256": job.sha256,
            "ranks": self.ranks.size,
            "seed": self.scene.particles.seed,
            "resumed_after_steps": [],
        }
        if memory:
            self._began -= memory["wall_s"]
            for name in COUNTED:
                setattr(self, name, memory[name])
            self.record |= memory["record"]
            self.record["resumed_after_steps"] = [*self.record["resumed_after_steps"], self.steps]

    def _open_log(self):
        with disk_faults(self.folder / "log.txt"):
            return (self.folder / "log.txt").open("a" if self._memory else "w", encoding="utf-8")

    def _whole(self, state):
        """Return the state with the particles of all ranks."""
        return self.engine.whole(state)

    def begin(self):
        """Make the engine and open the files."""
        self.say(f"{self.scene.title}: run folder {self.folder}")
        self.record |= {"commit": self.ranks.alone(commit), "versions": versions()}
        engine = self.engine = self._make_engine(self.scene)
        scene = self.scene
        self.ranks.alone(self._open_series)
        self.record |= engine.about() | {"restorability": restorable(scene)}
        if scene.free:
            self.say(f"surface: {self.record['restorability']['verdict']}")
        self.say(
            f"{self.record['cells']} cells, {self.record['unknowns']} unknowns, "
            f"marks {', '.join(time_label(scene, mark) for mark in scene.time.marks)}"
        )

    @property
    def _until(self):
        """Elapsed time up to which the series of an interrupted run are kept, s; None of none."""
        return self._framed if self._memory else None

    def start(self):
        """Return the state that the run begins with, or goes on from."""
        memory = self._memory
        if not memory:
            return self.engine.start()
        states = {name: self.engine.rock_of(rock) for name, rock in memory["rock"].items()}
        self._marks = [states[name] for name in memory["marks"]]
        self._kept = [(state, name) for name, state in states.items()]
        self.stopping.recall(memory["stopping"], self.engine.rock_of)
        if self._follower:
            self._follower.recall(memory["follower"], states.get)
        self._last = self.engine.recalled(memory["engine"])
        self.say(f"going on {self.reached()}")
        self._mend()
        return self._last

    @property
    def last(self):
        """The `State` after the last step, None before the first mark."""
        return self._last

    def memory(self, state, engine=None):
        """Return all that the run depends on from here on; collective.

        Args:
            state: `State` of now.
            engine: what the engine has remembered of it; None to ask it now.

        Returns:
            A dict for a checkpoint, whose entry ``rock`` holds states by name: those that are kept
            for the end of the run, the same ones from now on.
        """
        engine, remembered = self.engine, engine
        memory = {
            "time": state.time,
            "engine": remembered or engine.memory(state),
            "marks": [self._name_of(kept) for kept in self._marks],
            "follower": self._follower and self._follower.memory(self._name_of),
            "stopping": self.stopping.memory(engine.memory_of_rock),
            "record": {n: self.record[n] for n in CARRIED if n in self.record},
            "wall_s": time.perf_counter() - self._began,
        }
        memory |= {name: getattr(self, name) for name in COUNTED}
        return memory | {"rock": {name: engine.memory_of_rock(s) for s, name in self._kept}}

    def _name_of(self, state):
        """Return the name of a state that is kept for the end of the run."""
        for kept, name in self._kept:
            if kept.particles is state.particles and kept.lines is state.lines:
                return name
        self._kept.append((state, f"kept-{len(self._kept)}"))
        return self._kept[-1][1]

    def _open_series(self):
        scene, until = self.scene, self._until
        self.fields = MeshSeries(self.folder / "fields.xdmf", until=until)
        frame = {
            "unit_names": [unit.name for unit in scene.units],
            "surface": scene.outline.surface,
            "base": scene.outline.base,
        }
        until = until if scene.output.particles else None
        self.cloud = ParticleSeries(self.folder / "particles.xdmf", frame, until)
        self.table = Diagnostics(self.folder / "diagnostics.csv", COLUMNS, self.steps)

    def step(self, before, state):
        """Write the row of a step and, where the case asks for steps, a frame."""
        begin = time.perf_counter()
        dt = state.time - before.time
        self.steps += 1
        self.elapsed += abs(dt)
        self._last = state
        row = self._counts = self.engine.numbers(state)
        self._load = max(self._load, self.engine.sharing.load)
        row |= {
            "step": self.steps,
            "time_Myr": state.time / MYR,
            "dt_kyr": dt / MYR * 1e3,
            "flatness_m": self._flatness(state),
            "wall_s": time.perf_counter() - self._began,
        }
        self.ranks.alone(lambda: self.table.write(**row))
        if self._follower:
            self._follower.step(state)
        self._tell(state, dt)
        at = self.scene.output.at
        arrived = state.time == self.scene.time.marks[len(self._marks)]  # the mark writes its own
        arrived = arrived or self.stopping.over
        if at != "marks" and self.steps % at == 0 and not arrived:
            self._frame(state)
        self._output_s += time.perf_counter() - begin

    def mark(self, number, state):
        """Write a frame, the lines and a picture at a mark."""
        begin = time.perf_counter()
        self._volumes.append(volume_by_rock(self.scene, state.grid, state.particles))
        self._last, state = state, self._whole(state)
        if number == 0:
            self.say(f"{len(state.particles.x)} particles")
            self._count(state.particles)
        if self._follower:
            self._follower.mark(number, state)
        before = self._marks[-1].time if self._marks else None
        self._note_topography(state)
        self._marks.append(replace(state, flow=None, grid=None))  # large, and not compared
        self._frame(state)
        self._picture(self._name_at(number, state.time), state, before)
        self.say(f"mark {number}: {time_label(self.scene, state.time)} after {self.steps} steps")
        self._output_s += time.perf_counter() - begin

    def _name_at(self, number, t):
        """Return the name that the files of a mark have in common."""
        myr = t / MYR
        return f"{number}-{abs(myr):.3f}Ma" if counts_back(self.scene) else f"{number}-{myr:.3f}Myr"

    def _mend(self):
        """Make anew what a mark has left in the folder and is gone since."""
        before, begin = None, time.perf_counter()
        for number, state in enumerate(self._marks):
            name = self._name_at(number, state.time)
            made = self.folder / "figures" / f"section-{name}.png", self._lines_path(name)
            if not self.ranks.same(all(path is None or _there(path) for path in made)):
                self._picture(name, state, before)
                less = " without arrows" if self.scene.output.arrows else ""
                self.say(f"note: horizons or picture of mark {number} were gone; made anew{less}")
            before = state.time
        self._output_s += time.perf_counter() - begin

    def _lines_path(self, name):
        return self.folder / "horizons" / f"{name}.geojson"

    def _flatness(self, state):
        return flatness_of(state.lines, self.stopping.plan)

    def _picture(self, name, state, before):
        """Write the lines and a picture at a mark."""
        about = {"mark": int(name.partition("-")[0]), "model_time_Myr": state.time / MYR}
        self.ranks.alone(write_lines, self._lines_path(name), state.lines, about)
        self.ranks.alone(
            draw_section,
            self.folder / "figures" / f"section-{name}.png",
            self.scene,
            state.time,
            state.particles.x,
            state.particles.unit,
            state.lines,
            _arrows(state) if self.scene.output.arrows and state.flow else None,
            label=time_text(self.scene, state.time, before),
        )

    def end(self, error=None):
        """Write the record, and where a run was stopped the frame it has reached.

        Args:
            error: what ended the run early, or None.

        Returns:
            The record.
        """
        if isinstance(error, (StoppedError, KeyboardInterrupt)):
            code = StoppedError.exit_code
        elif error is None:
            code = 0
        else:
            code = error.exit_code if isinstance(error, RestorationError) else BUG
            code = TooLargeError.exit_code if out_of_memory(error) else code
        if error is not None and code in (SolveError.exit_code, MeshError.exit_code):
            self._dump(error)
        if code in (SolveError.exit_code, MeshError.exit_code) and self._follower:
            self.record["certificate"] = failed(self.scene, self._follower, error)
        try:
            # a second Ctrl-C may come in the middle of a step, with fields of one of its stages
            if isinstance(error, StoppedError) and self._last and self.elapsed > self._framed:
                self._frame(self.engine.with_flow(self._last))
        finally:
            self._end_record(code)
            if error is None:
                self.ranks.alone(self._close, error)
            elif self.ranks.first:  # the others may not have come here
                self._close(error)
        return self.record

    def _dump(self, error):
        """Leave what a developer needs to see why a run has ended; the error then names it."""
        if not self.ranks.first:  # the others may not have come here
            return
        folder = self.folder / "failure"
        about = {"error": f"{type(error).__name__}: {error}", "steps": self.steps}
        about |= {name: self.record.get(name) for name in ("case_sha256", "commit", "versions")}
        with suppress(OutputError):
            write_json(folder / "facts.json", about | (error.facts or {}))
            if error.memory is not None:
                Checkpoints(folder).write(self.steps, error.memory | {"rock": {}})
            error.args = (f"{error}; what a developer needs is in {folder}",)

    def _close(self, error):
        write_record(self.folder / "run.json", self.record)
        if error is not None:
            self._write_log(f"{type(error).__name__}: {error}")
        self._log.close()

    def reached(self):
        """Return how far the run came, in words."""
        if self._last is None:
            return "before the first step"
        return (
            f"at {time_label(self.scene, self._last.time)} after {self.steps} steps "
            f"({100 * self.elapsed / self._path:.0f} % of the way)"
        )

    def say(self, line, aloud=True):
        """Write a line to the log and, aloud, to the user."""
        self.ranks.alone(self._write_log, line)
        if aloud and self.progress:
            self.progress.say(line)

    def _tell(self, state, dt):
        for note in self.engine.notes[self._told :]:
            self.say(note)
        self._told = len(self.engine.notes)
        share = min(self.elapsed / self._path, 1.0)
        wall = time.perf_counter() - self._began
        line = (
            f"step {self.steps}  {time_label(self.scene, state.time)}  dt {show(dt, 'time')}  "
            f"{self.engine.counts.solves} solves  {100 * share:.0f} %  "
            f"about {wall * (1 - share) / share:.0f} s left"
        )
        self.ranks.alone(self._write_log, line)
        if self.progress:
            self.progress.update(line)

    def _write_log(self, line):
        with disk_faults(self.folder / "log.txt"):
            print(line, file=self._log, flush=True)

    def _count(self, particles):
        """Note how many particles there are, of all ranks."""
        self._counts = {"particles": len(particles.x), "particles_lost": particles.lost}

    def _frame(self, state):
        self._framed = self.elapsed
        self.ranks.alone(self._write_frame, self._whole(state))

    def _write_frame(self, state):
        scene, particles = self.scene, state.particles
        snapshot = state.grid.snapshot
        point, cell = snapshot.read(state.flow, scene.output.fields)
        self.fields.write(self.elapsed, snapshot.points, snapshot.cells, point, cell, state.time)
        if scene.output.particles:
            rock = np.array([unit.rock for unit in scene.units], np.int16)[particles.unit]
            distance, _ = there_and_back(particles)
            data = {
                "unit": particles.unit,
                "rock": rock,
                "area": particles.area,
                "displacement": distance,
                "lost": (~particles.inside).astype(np.int16),
            }
            self.cloud.write(self.elapsed, particles.x, data, state.time)

    def _note_topography(self, state):
        """Note the relief that a surface of free slip would have at this mark if it were free."""
        found = dynamic_topography(self.scene, state.grid, state.flow)
        if found is not None:
            self.record.setdefault("dynamic_topography_m", []).append(float(np.ptp(found[1])))

    def compare(self):
        """Compare the marks, and draw them side by side and against where the run began."""
        begin = time.perf_counter()
        figures, first, last = self.folder / "figures", self._marks[0], self._marks[-1]
        self._note_stop()
        panels = [
            (self.scene, s.time, s.particles.x, s.particles.unit, s.lines) for s in self._marks
        ]
        self.ranks.alone(draw_strip, figures / "strip.png", panels)
        found = compared(self._marks, self._volumes)
        self.record |= found
        if "there_and_back" in found:
            self._leave_out_welds(found)
            self.ranks.alone(
                draw_there_and_back,
                figures / "there-and-back.png",
                self.scene,
                np.where(last.particles.inside[:, None], last.particles.start, np.nan),
                last.particles.x,
                last.particles.unit,
                as_drawn(first.lines),
                as_drawn(last.lines),
                found["there_and_back"] | {"horizons": found["horizons"]},
            )
        self._output_s += time.perf_counter() - begin

    def _leave_out_welds(self, found):
        """Add the distances outside of the welds of the given section to those compared."""
        if not self._follower or not self._follower.states:
            return
        given = self._follower.states[0]
        thin = welds(self.scene, given.lines, self.engine.cell_size, given.particles)
        particles, horizons = outside_welds(thin, self._marks[0], given, self._marks[-1])
        found["there_and_back"]["outside_welds"] = particles
        for row in found["horizons"]:
            row["outside_welds"] = horizons and horizons[row["name"]]

    def certify(self, march, check=None):
        """Say what of a restoration can be trusted, by companions that restore it once more.

        Args:
            march: `run.march`.
            check: called after every step of theirs.
        """
        follower = self._follower
        if not follower or not follower.finished(self._last):
            return
        begin = time.perf_counter()
        growth = accompany(
            follower, self._make_engine, march, self.scene.certificate.noise, check=check
        )
        found = certified(self.scene, follower, growth, self.engine.cell_size)
        self.record["certificate"] = found
        path = self.folder / "figures/certificate.png"
        self.ranks.alone(draw_certificate, path, self.scene, growth, found)
        self.ranks.alone(write_text, self.folder / "certificate.md", report(self.scene, found))
        for line in sentences(found):
            self.say(line)
        self._certificate_s = round(time.perf_counter() - begin, 3)

    def prove(self, march, check=None):
        """Go forward again from where the way back ended, and compare; see `companions.prove`."""
        follower = self._follower or Follower(self.scene, self._whole)
        if not follower.states or not follower.done:
            self.say("no proof: this run restores nothing, or its certificate is off")
            return
        proof = prove(follower, follower.states[-1], self._make_engine, march, check)
        self.record["proof"] = proof
        if proof["failure"]:
            self.say(f"proof: the way forward again ends early: {proof['failure']}")
            return
        self.say(
            f"proof: forward again on {proof['cells'][0]} x {proof['cells'][1]} squares by "
            f"{proof['scheme']}, particles come to {proof['mean_m']:.2f} m of the given section on "
            f"average, p99 {proof['p99_m']:.2f} m"
        )
        for row in proof["horizons"]:
            self.say(
                f"  {row['name']}: {row['mean_m']:.2f} m on average, {row['max_m']:.2f} at most"
            )

    def _note_stop(self):
        """Note, say and draw where the march has stopped by itself."""
        stopping, plan = self.stopping, self.stopping.plan
        if plan is None:
            return
        label = partial(time_label, self.scene)
        self.record |= {"stopped": stopping.about(label)} | (fit := stopping.fitting(self.scene))
        self.say(f"stop: {stopping.verdict(label)}")
        if fit:
            self.say(f"known age: {fitting_text(plan, fit)}")
        path = self.folder / "figures" / "flatness.png"
        self.ranks.alone(draw_flatness, path, self.scene, stopping)

    def _end_record(self, code):
        if self.engine is not None:
            work = self.engine.work()
            work["wall_by_part_s"] |= {
                "output": round(self._output_s, 3),
                "checkpoints": round(self.checkpoints_s, 3),
                "certificate": self._certificate_s,
            }
            self.record |= work
        if self._last is not None:
            self.record |= relief(self._last.lines)
            counts = {name: self._counts.get(name) for name in ("particles", "particles_lost")}
            self.record |= counts | {"time_reached_s": self._last.time}
            self.record["particle_load"] = round(self._load, 4)
        self.record |= {
            "ended_well": code == 0,
            "exit_code": code,
            "steps": self.steps,
            "wall_s": round(time.perf_counter() - self._began, 3),
            "peak_rss_mb": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024, 1),
        }


def _there(path):
    """Return whether a file is there; after a loss of power an empty one may be left of it."""
    return path.is_file() and path.stat().st_size > 0


def _arrows(state):
    """Return points and the velocity there, for the arrows of a picture."""
    snapshot = state.grid.snapshot
    return snapshot.points, snapshot.read(state.flow, ["velocity"])[0]["velocity"]


def commit():
    """Return the commit of the code; None where it is not in a checkout."""
    try:
        done = subprocess.run(
            ["git", "-C", str(Path(__file__).parent), "rev-parse", "HEAD"],
            capture_output=True,
            text=True,
            timeout=5,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()

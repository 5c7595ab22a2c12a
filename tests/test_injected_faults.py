"""Faults put into runs on purpose: each is made good or ends the run with the right exit code.

A fault strikes at one call of a method, at some calls, or at all of them. What the ladder of the
solver makes good leaves the answer as it was; what takes a shorter step leaves it near.
"""

import csv
import errno
import json
from dataclasses import dataclass, replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from restoration import assembly, engine, output, solvers, stokes
from restoration.checkpoint import Checkpoints
from restoration.errors import (
    MeshError,
    OutputError,
    ParticleError,
    RestorationError,
    SolveError,
)
from restoration.grid import Grid
from restoration.particles import OUTSIDE
from restoration.run import march, run_job
from restoration.run_folder import Job
from restoration.scene import OutputPlan, SolverPlan, TimePlan
from tests.restoration.conftest import HEIGHT, MYR, diapir_scene
from tests.test_mpi import ROOT, on_ranks
from tests.torture import tries

SAME = 1e-9 * HEIGHT  # m, between answers that are the same
NEAR = 1e-3 * HEIGHT  # m, between answers of other steps
SOLVES = 7  # of the run below
FIRST, ALWAYS = {1}, range(1, 10**9)
MEMORY, DISK = 6, 5


def scene(**plans):
    """A section of two viscosities: a new matrix for every solve, of which there are seven."""
    time = TimePlan((0.0, 0.3 * MYR), "midpoint", 1.0, 3)
    return diapir_scene(**{"cells": (7, 8), "viscosity": (1e19, 1e21), "time": time} | plans)


def run(the_scene):
    """Return where the particles end, and the engine."""
    made = engine.StokesEngine(the_scene)
    return march(made.start(), made, the_scene.time).particles.x, made


@pytest.fixture(scope="module")
def sound():
    return run(scene())[0]


@dataclass
class Strike:
    """Lets something go wrong at some calls of a method.

    Attributes:
        owner, method: the method.
        harm: function of what the method has returned and of its arguments; returns what it is to
            return; an error that it raises is that of the method.
        calls: numbers of the calls, from 1, at which it does.
        instead: whether the method is not called there.
    """

    owner: object
    method: str
    harm: object
    calls: object = frozenset(FIRST)
    instead: bool = False

    def arm(self, monkeypatch):
        method, self.made, self.struck = getattr(self.owner, self.method), 0, 0

        def faulty(*arguments, **options):
            self.made += 1
            strikes = self.made in self.calls
            self.struck += strikes
            skipped = strikes and self.instead
            found = None if skipped else method(*arguments, **options)
            return self.harm(found, *arguments) if strikes else found

        monkeypatch.setattr(self.owner, self.method, faulty)


def assembled(harm, **options):
    """A fault of the matrix, after it was assembled."""

    def harmed(found, made, *_):
        harm(made)
        made.A.stateIncrease()
        return found

    return Strike(assembly.CellAssembler, "assemble", harmed, **options)


def put_nan(made):
    made._values[len(made._values) // 2] = np.nan


def diagonal(made):
    """Return the diagonal of the matrix: one where the velocity is held, zero of a pressure."""
    row = np.repeat(np.arange(len(made._rows) - 1), np.diff(made._rows))
    return made._values[made._columns == row], row


def empty_row(made):
    """Leave a row and column of the velocity without entries: nothing holds it."""
    size, row = diagonal(made)
    loose = np.flatnonzero((size != 0) & (size != 1))[0]
    made._values[(row == loose) | (made._columns == loose)] = 0.0


def negated(upper, lower, viscous=False):
    """Return what turns the sign of blocks of the matrix."""

    def harm(made):
        size, row = diagonal(made)
        pressure = size == 0
        rows, columns = pressure[row], pressure[made._columns]
        turned = (
            (upper & ~rows & columns) | (lower & rows & ~columns) | (viscous & ~rows & ~columns)
        )
        made._values[turned] *= -1

    return harm


def loaded(found, problem):
    problem.b.array_w[problem.b.getLocalSize() // 3] = np.nan
    return found


def solved(harm, **options):
    """A fault of what the solver returns."""

    def harmed(found, solver, b, x, *_):
        harm(x, solver)
        return found

    return Strike(solvers.DirectSolver, "solve", harmed, **options)


def failing(error, owner=solvers.DirectSolver, method="solve", **options):
    def harm(*_):
        raise error

    return Strike(owner, method, harm, instead=True, **options)


def mumps(end, **options):
    """A factorisation that ends with a number of MUMPS, and with nothing to use."""

    def harm(*_):
        return end

    return Strike(solvers, "_infog", harm, **options)


def advanced(harm, **options):
    """A fault of the state after a step."""

    def harmed(state, made, *_):
        return harm(state, made)

    return Strike(engine.StokesEngine, "advance", harmed, **options)


def positions(state, _engine):
    x = state.particles.x.copy()
    x[7, 1] = np.nan
    return replace(state, particles=replace(state.particles, x=x))


def lost(state, made):
    x, cell = state.particles.x.copy(), state.particles.cell.copy()
    x[7], cell[7] = (-5.0, -50.0), OUTSIDE
    return replace(state, particles=replace(state.particles, x=x, cell=cell))


def dropped(state, _engine):
    rows = {n: getattr(state.particles, n)[1:] for n in ("x", "unit", "area", "start", "cell")}
    return replace(state, particles=replace(state.particles, **rows))


def swept(state, _engine):
    """All particles of a part of the section lie where one of them is."""
    x, cell = state.particles.x.copy(), state.particles.cell.copy()
    near = (np.abs(x - [4500.0, -5000.0]) < 3500).all(axis=1)
    first = np.flatnonzero(~near)[0]
    x[near], cell[near] = x[first], cell[first]
    return replace(state, particles=replace(state.particles, x=x, cell=cell))


def line(state, _engine):
    points = state.lines[0].points.copy()
    points[5, 0] = np.nan
    return replace(state, lines=(replace(state.lines[0], points=points), *state.lines[1:]))


def vertex(by):
    """Return what moves a vertex of the mesh, by a share of the way to a neighbour."""

    def harm(state, made):
        x = made.section.mesh.geometry.x
        inner = np.flatnonzero((x[:, 0] > 100) & (x[:, 0] < 9000) & (np.abs(x[:, 1] + 5e3) < 4e3))
        gap = np.linalg.norm(x - x[inner[0]], axis=1)
        other = np.argsort(gap)[1]
        x[inner[0]] += by * (x[other] - x[inner[0]])
        return state

    return advanced(harm, calls=FIRST)


def flow_of(what):
    def harm(flow, *_):
        values = getattr(flow, what).copy()
        values[3] = np.nan
        return replace(flow, **{what: values})

    return harm


def rock(value, **options):
    def harm(found, grid, *_):
        grid.fields.theta.x.array[5] = value
        return found

    return Strike(Grid, "fill", harm, **options)


def keep_factors(_found, solver, *_):
    """Let PETSc go on with the factors it has, and say nothing of it."""
    if solver.ksp is not None:
        solver.ksp.getPC().setReusePreconditioner(True)


def scaled(x, _solver):
    x.scale(1 + 1e-3)


def another(x, solver):
    """Leave the answer of an earlier call."""
    before = getattr(solver, "before", None)
    solver.before = x.copy()
    if before is not None:
        before.copy(x)


FULL = OSError(errno.ENOSPC, "No space left on device", "diagnostics.csv")
STALLED = SolveError("PETSc reason -3")
# Name: the strikes, and what becomes of the run: "same" answer, one "near" it by shorter steps, or
# the class of the error that ends it.
FAULTS = {
    "NaN in the matrix": ([assembled(put_nan)], "same"),
    "NaN in the matrix, always": ([assembled(put_nan, calls=ALWAYS)], SolveError),
    "NaN in the load": ([Strike(stokes.StokesProblem, "assemble", loaded)], "same"),
    "NaN in positions": ([advanced(positions)], "near"),
    "NaN in positions, always": ([advanced(positions, calls=ALWAYS)], ParticleError),
    "NaN in the velocity": ([Strike(stokes.StokesProblem, "solve", flow_of("u"), {3})], "near"),
    "NaN in the pressure": ([Strike(stokes.StokesProblem, "solve", flow_of("p"), {3})], "near"),
    "NaN in the viscosity": ([rock(np.nan, calls={3})], "near"),
    "infinite viscosity, always": ([rock(np.inf, calls=range(3, 10**9))], SolveError),
    "singular matrix": ([assembled(empty_row, calls=ALWAYS)], SolveError),
    "MUMPS -9": ([mumps(-9)], "same"),
    "MUMPS -9, always": ([mumps(-9, calls=ALWAYS)], SolveError),
    "MUMPS -10": ([mumps(-10)], "same"),
    "MUMPS -13": ([mumps(-13)], MEMORY),
    "iterations at their end": ([failing(STALLED)], "same"),
    "iterations at their end, always": ([failing(STALLED, calls=ALWAYS)], SolveError),
    "sign of one block of the pressure": ([assembled(negated(True, False))], "same"),
    "sign of both blocks of the pressure": ([assembled(negated(True, True))], "same"),
    "sign of the viscous block": ([assembled(negated(False, False, True))], "same"),
    "answer off by a thousandth, always": ([solved(scaled, calls=ALWAYS)], "same"),
    "zero for an answer": ([solved(lambda x, _: x.set(0))], "same"),
    "answer with the other sign": ([solved(lambda x, _: x.scale(-1))], "same"),
    "answer of another stage": ([solved(another, calls={2, 3})], "same"),
    "factors of another matrix": (
        [Strike(solvers.DirectSolver, "update", keep_factors, calls={2, 3})],
        "same",
    ),
    "cell turned over": ([vertex(1.5)], "near"),
    "vertex nearly in its neighbour": ([vertex(0.95)], "near"),
    "particle lost": ([advanced(lost)], "near"),
    "particle lost, always": ([advanced(lost, calls=ALWAYS)], ParticleError),
    "particle dropped": ([advanced(dropped)], "near"),
    "no particles in cells": ([advanced(swept)], "near"),
    "no particles in cells, always": ([advanced(swept, calls=ALWAYS)], ParticleError),
    "NaN in a line": ([advanced(line)], "near"),
    "NaN in a line, always": ([advanced(line, calls=ALWAYS)], MeshError),
    "one after the other": (
        [mumps(-10), Strike(stokes.StokesProblem, "assemble", loaded, calls={6})],
        "same",
    ),
    "again when taken anew": ([advanced(positions, calls={1, 2, 3})], "near"),
    "another when taken anew": ([advanced(positions), advanced(lost, calls={2})], "near"),
    "out of memory": ([failing(MemoryError(), engine.StokesEngine, "solve", calls={3})], MEMORY),
}


CALLS = {"advance": 3}  # that there are in the run; of the others six and more


def later(strike, by):
    """Return a strike, that of single calls so many calls later, or at the first ones again."""
    if not isinstance(strike.calls, (set, frozenset)):
        return strike
    calls = CALLS.get(strike.method, 6)
    return replace(strike, calls={(call - 1 + by) % calls + 1 for call in strike.calls})


def ended(the_scene):
    """Return where the particles end, the error that has ended the run or None, steps retried."""
    try:
        x, made = run(the_scene)
    except (RestorationError, MemoryError) as error:
        return None, error, 0
    return x, None, made.retried


def meets(x, error, end, sound):
    """Return whether a run has ended as it was to end."""
    if isinstance(end, str):
        off = np.inf if error else np.abs(x - sound).max()
        return off <= {"same": SAME, "near": NEAR}[end]
    return isinstance(error, MemoryError) or getattr(error, "exit_code", None) == (
        end if isinstance(end, int) else end.exit_code
    )


@pytest.mark.torture
@pytest.mark.parametrize("by", range(tries(1, 6)))
@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_is_made_good_or_told(name, by, monkeypatch, sound):
    strikes, end = FAULTS[name]
    strikes = [later(strike, by) for strike in strikes]
    for strike in strikes:
        strike.arm(monkeypatch)
    x, error, retried = ended(scene())
    assert (retried > 0) == (end == "near")
    assert all(strike.struck for strike in strikes)
    assert meets(x, error, end, sound), error
    assert error is None or "\n" not in str(error)


@pytest.mark.slow
def test_faults_on_two_ranks_are_told_by_both():
    found = on_ranks(ROOT / "tests" / "mpi_faults.py", 2)
    for name in ("step True", "step False"):  # solved by the first rank, and by all
        assert found[name][0].startswith("refused; shorter steps")
        assert found[name][0].endswith("with facts")
    assert found["none"] == ["solved"]
    assert "the load is not what the ranks have made of it" in found["load"][0]
    assert "relative divergence" in found["solution"][0]
    assert all(len(texts) == 1 for texts in found.values())  # all ranks say the same


def split(**options):
    """A scene that is solved by the field split."""
    options = tuple((name, str(value)) for name, value in options.items())
    return scene(solver=SolverPlan("fieldsplit", options))


def test_a_field_split_that_stagnates_is_told():
    _, error, _ = ended(split(ksp_max_it=2))
    assert error.exit_code == SolveError.exit_code
    assert "solver: {name: direct}" in str(error)


def test_a_field_split_that_stagnates_gives_way(monkeypatch, sound):
    monkeypatch.setattr(solvers, "FIELDSPLIT_FROM", {2: 0, 3: 0})
    monkeypatch.setitem(solvers.FIELDSPLIT, "ksp_max_it", 2)
    x, error, _ = ended(scene())
    assert meets(x, error, "same", sound), error


def test_a_fault_in_the_direct_solver_that_a_field_split_gives_way_to(monkeypatch, sound):
    monkeypatch.setattr(solvers, "FIELDSPLIT_FROM", {2: 0, 3: 0})
    monkeypatch.setitem(solvers.FIELDSPLIT, "ksp_max_it", 2)
    strike = solved(lambda x, _: x.set(0))
    strike.arm(monkeypatch)
    x, error, _ = ended(scene())
    assert strike.struck
    assert meets(x, error, "same", sound), error


def job(folder, **plans):
    return Job(Path("x/case.yaml"), "title: x\n", "resolved: 1\n", scene(**plans), folder / "run")


def test_a_run_that_fails_for_good_leaves_what_a_developer_needs(tmp_path, monkeypatch):
    advanced(lost, calls=range(2, 10**9)).arm(monkeypatch)
    with pytest.raises(ParticleError, match="x = -5 m and z = -50 m") as caught:
        run_job(job(tmp_path))
    folder = tmp_path / "run"
    assert str(folder / "failure") in str(caught.value)
    facts = json.loads((folder / "failure" / "facts.json").read_text())
    assert facts["mumps_infog_1"] == 0
    assert facts["steps"] == 1
    assert facts["viscosity_Pa_s"] == pytest.approx([1e19, 1e21], rel=1e-2)
    assert len(facts["worst_rows_at_m"]) == len(facts["worst_rows"]) == stokes.WORST_ROWS
    memory, _ = Checkpoints(folder / "failure").newest()
    made = engine.StokesEngine(scene())
    state = made.recalled(memory)
    assert state.time == pytest.approx(0.1 * MYR)
    assert sum(path.stat().st_size for path in (folder / "failure").iterdir()) < 3e6
    assert json.loads((folder / "run.json").read_text())["exit_code"] == MeshError.exit_code
    monkeypatch.undo()
    run_job(job(tmp_path))
    assert not (folder / "failure").exists()


def test_a_run_that_failed_goes_on_from_the_step_before(tmp_path, monkeypatch):
    with monkeypatch.context() as patch:
        advanced(lost, calls=range(3, 10**9)).arm(patch)
        with pytest.raises(ParticleError):
            run_job(replace(job(tmp_path), checkpoint=10**6))
    record, folder = run_job(job(tmp_path))
    assert record["resumed_after_steps"] == [2]
    assert not list(folder.glob("failure/*"))
    whole, other = run_job(replace(job(tmp_path), out=tmp_path / "whole"))
    assert record["steps"] == whole["steps"]
    names = [path.name for path in sorted((other / "horizons").iterdir())]
    for name in names:
        assert (folder / "horizons" / name).read_bytes() == (other / "horizons" / name).read_bytes()


def test_a_step_taken_anew_is_noted(tmp_path, monkeypatch):
    advanced(positions, calls={1, 2}).arm(monkeypatch)
    record, folder = run_job(job(tmp_path))
    assert record["steps_retried"] == 2
    rows = list(csv.DictReader((folder / "diagnostics.csv").read_text().splitlines()))
    assert [row["steps_retried"] for row in rows][:2] == ["2", "2"]
    lengths = [float(row["dt_kyr"]) for row in rows]
    assert lengths[:3] == pytest.approx([25, 275 / 6, 275 / 3.6])  # equal ones to the mark, longer
    assert sum(lengths) == pytest.approx(300)
    log = (folder / "log.txt").read_text()
    assert "a step of 100 kyr has failed: 1 of " in log
    assert "a step of 50 kyr has failed" in log


def test_nothing_is_written_of_a_state_that_is_not_finite(tmp_path, monkeypatch):
    Strike(stokes.StokesProblem, "solve", flow_of("p"), range(4, 10**9)).arm(monkeypatch)
    with pytest.raises(SolveError, match="the pressure at 1 of"):
        run_job(job(tmp_path, output=OutputPlan(1, ("pressure",), True, False, 1.0)))
    with h5py.File(tmp_path / "run" / "fields.h5", "r") as h5:
        frames = [group["point/pressure"][()] for group in h5["frames"].values()]
    assert len(frames) == 2  # the first mark and the first step
    assert np.isfinite(frames).all()


def test_a_full_disk_in_a_step_is_told(tmp_path, monkeypatch):
    def full(*_):
        raise FULL

    Strike(output, "_write_rows", full, {3}, instead=True).arm(monkeypatch)
    with pytest.raises(OutputError, match="the disk is full") as caught:
        run_job(job(tmp_path))
    assert caught.value.exit_code == DISK
    assert len((tmp_path / "run" / "diagnostics.csv").read_text().splitlines()) == 2

import csv
import errno
import itertools
import json
import os
import signal
import time
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from restoration import run_folder
from restoration.cli import main
from restoration.errors import CaseError, MeshError, OutputError, SolveError, StoppedError
from restoration.output import RECORD
from restoration.run import MOST_STEPS, march, next_time, run_job
from restoration.run_folder import LOCK, Job, claimed, locked
from restoration.saved import read_particles
from restoration.scene import OutputPlan, TimePlan, Wall
from restoration.stop_request import StopRequest
from tests.restoration.conftest import MYR, PlainEngine, diapir_scene


@dataclass(frozen=True)
class FakeState:
    time: float


class FakeEngine(PlainEngine):
    """An engine without physics: the loop must not need any."""

    def __init__(self, stable):
        self.stable = stable

    def stable_step(self, state, mark):
        return self.stable

    def advance(self, state, until):
        return FakeState(until)


@pytest.mark.parametrize("marks", [(0, 10, 0), (0, -10), (5, 5.25, 100, -3)])
@pytest.mark.parametrize("stable", [0.7, 3.0, 1e9])
def test_the_march_passes_every_mark_exactly(marks, stable):
    seen, passed = [marks[0]], []
    march(
        FakeState(marks[0]),
        FakeEngine(stable),
        TimePlan(marks, "rk4", 1.0, 4),
        every_step=(lambda before, state: seen.append(state.time),),
        at_marks=(lambda number, state: passed.append((number, state.time)),),
    )
    assert passed == list(enumerate(marks))
    steps = np.abs(np.diff(seen))
    assert steps.max() <= stable * (1 + 1e-12)
    for a, b in itertools.pairwise(marks):
        between = [t for t in seen if min(a, b) <= t <= max(a, b)]
        assert len(between) >= 5  # min_steps


class WeldingEngine(FakeEngine):
    """An engine that cannot go beyond a time, however short its steps are."""

    def stable_step(self, state, mark):
        return min(self.stable, self.longest)

    def guard(self, state):
        if state.time > np.pi:
            raise MeshError("a cell has turned over")


def test_steps_that_fail_before_a_time_end_the_march_by_what_has_failed():
    engine = WeldingEngine(1.0)
    with pytest.raises(MeshError, match=r"turned over; shorter steps, down to .*") as caught:
        march(FakeState(0), engine, TimePlan((0, 1000), "rk4", 1.0, 4))
    assert caught.value.memory.time == pytest.approx(np.pi, abs=3 * 1000 / MOST_STEPS)
    assert engine.retried < 100


def test_no_sliver_steps():
    assert next_time(0, 10, 9.99) == 5
    assert next_time(0, -10, 100) == -10


def job(tmp_path, scene=None, **entries):
    scene = scene or diapir_scene(cells=(8, 9), marks=(0, 0.5, 0))
    made = Job(Path("x/case.yaml"), "title: as given\n", "resolved: 1\n", scene, tmp_path / "run")
    return replace(made, **entries)


def test_a_run_leaves_its_whole_folder(tmp_path):
    record, folder = run_job(job(tmp_path))
    written = json.loads((folder / "run.json").read_text())
    assert list(written)[: len(RECORD)] == list(RECORD)
    assert written["ended_well"] is True
    assert written["exit_code"] == 0
    assert written["particles_lost"] == 0
    assert 0 < written["wall_by_part_s"]["guards"] < written["wall_by_part_s"]["solve"]
    assert written["wall_by_part_s"]["checkpoints"] > 0
    assert written["area_change"] == pytest.approx(0, abs=1e-14)  # sums over the rocks
    assert written["there_and_back"]["mean_m"] == record["there_and_back"]["mean_m"] < 14
    assert written["horizons"][0]["name"] == "salt / sediment"
    assert abs(written["volume_by_rock_change"]["salt"]) < 0.05
    assert sum(written["there_and_back"]["histogram"]["count"]) == written["particles"]
    assert written["versions"]["dolfinx"]
    assert written["surface_relief_m"] is None
    assert (folder / "case.yaml").read_text() == "title: as given\n"
    rows = list(csv.DictReader((folder / "diagnostics.csv").read_text().splitlines()))
    assert len(rows) == written["steps"] == 10
    assert [float(row["dt_kyr"]) > 0 for row in rows] == [True] * 5 + [False] * 5
    assert float(rows[-1]["time_Myr"]) == 0
    assert len(list((folder / "horizons").glob("*.geojson"))) == 3
    assert len(list((folder / "figures").glob("section-*.png"))) == 3
    assert (folder / "figures" / "there-and-back.png").stat().st_size > 10_000
    assert (folder / "figures" / "strip.png").exists()
    assert "step 10" in (folder / "log.txt").read_text()


def test_paraview_sees_the_run(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    scene = diapir_scene(
        cells=(8, 9),
        marks=(0, 0.5, 0),
        output=OutputPlan(
            2, ("velocity", "pressure", "density", "viscosity", "strain_rate"), True, False, 1.0
        ),
    )
    _, folder = run_job(job(tmp_path, scene))
    reader = pyvista.XdmfReader(str(folder / "fields.xdmf"))
    times = np.array(reader.time_values) / MYR
    # a frame every 2 steps of 0.1 Myr, and the marks
    assert times == pytest.approx([0, 0.2, 0.4, 0.5, 0.6, 0.8, 1.0])
    reader.set_active_time_value(reader.time_values[-1])
    mesh = reader.read()
    block = mesh[0] if isinstance(mesh, pyvista.MultiBlock) else mesh
    assert block["velocity"].shape == (block.n_points, 3)
    assert block["pressure"].max() == pytest.approx(2600 * 9.81 * 8e3 + 2150 * 9.81 * 2e3, rel=0.05)
    assert block["viscosity"] == pytest.approx(1e19)
    assert block["density"].min() < 2200 < 2500 < block["density"].max()
    saved = read_particles(folder / "particles.h5")
    assert len(saved.x) == json.loads((folder / "run.json").read_text())["particles"]


def test_ctrl_c_ends_within_a_step_and_tells_how_far(tmp_path, monkeypatch):
    from restoration import recorder

    row = recorder.Diagnostics.write

    def interrupt(self, **values):
        row(self, **values)
        if values["step"] == 3:
            os.kill(os.getpid(), signal.SIGINT)

    before = signal.getsignal(signal.SIGINT)
    monkeypatch.setattr(recorder.Diagnostics, "write", interrupt)
    with pytest.raises(StoppedError, match=r"at 300 kyr after 3 steps \(30 % of the way\)"):
        run_job(job(tmp_path))
    written = json.loads((tmp_path / "run" / "run.json").read_text())
    assert written["ended_well"] is False
    assert written["exit_code"] == 75
    assert written["steps"] == 3
    assert written["there_and_back"] is None
    assert written["time_reached_s"] == pytest.approx(0.3 * MYR)
    assert len((tmp_path / "run" / "diagnostics.csv").read_text().splitlines()) == 4
    saved = read_particles(tmp_path / "run" / "particles.h5")
    assert len(saved.x) == written["particles"]
    assert signal.getsignal(signal.SIGINT) is before


def test_ctrl_c_on_a_step_that_wrote_a_frame(tmp_path, monkeypatch):
    from restoration import recorder

    row = recorder.Diagnostics.write

    def interrupt(self, **values):
        row(self, **values)
        if values["step"] == 2:
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(recorder.Diagnostics, "write", interrupt)
    scene = diapir_scene(
        cells=(8, 9), marks=(0, 0.5, 0), output=OutputPlan(2, ("velocity",), True, False, 1.0)
    )
    with pytest.raises(StoppedError, match="after 2 steps"):
        run_job(job(tmp_path, scene))
    assert json.loads((tmp_path / "run" / "run.json").read_text())["exit_code"] == 75


def test_a_picture_that_cannot_be_written_is_no_good_end(tmp_path, monkeypatch):
    from restoration import recorder

    def full(*_):
        raise OutputError("strip.png: the disk is full")

    monkeypatch.setattr(recorder, "draw_strip", full)
    with pytest.raises(OutputError):
        run_job(job(tmp_path))
    written = json.loads((tmp_path / "run" / "run.json").read_text())
    assert written["ended_well"] is False
    assert written["exit_code"] == 5


def test_a_step_too_short_to_arrive_is_refused():
    with pytest.raises(SolveError, match="the flow is so fast"):
        march(FakeState(0), FakeEngine(1e-30), TimePlan((0, 10), "rk4", 1.0, 4))


@pytest.mark.parametrize("arrows", [False, True])
def test_what_marks_have_left_and_is_gone_is_made_anew(tmp_path, monkeypatch, arrows):
    from restoration import recorder

    plan = OutputPlan("marks", ("velocity",), True, arrows, 1.0)
    scene = diapir_scene(cells=(4, 4), marks=(0, 0.1, 0), output=plan)
    whole = job(tmp_path, scene, out=tmp_path / "whole")
    run_job(whole)
    row = recorder.Diagnostics.write

    def interrupt(self, **values):
        row(self, **values)
        if len(list(tmp_path.glob("run/horizons/*.geojson"))) == 2:  # on the way back
            os.kill(os.getpid(), signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(recorder.Diagnostics, "write", interrupt)
        with pytest.raises(StoppedError):
            run_job(job(tmp_path, scene))
    (lines,) = tmp_path.glob("run/horizons/0-*.geojson")
    (picture,) = tmp_path.glob("run/figures/section-1-*.png")
    lines.write_text("")  # as it may be left by a loss of power
    picture.unlink()
    run_job(job(tmp_path, scene))
    assert picture.is_file()
    for path in whole.folder.glob("horizons/*.geojson"):
        assert (tmp_path / "run/horizons" / path.name).read_bytes() == path.read_bytes()
    log = (tmp_path / "run" / "log.txt").read_text()
    assert log.count("were gone; made anew") == 2
    assert log.count("without arrows") == (2 if arrows else 0)


def test_files_of_the_user_survive_a_fresh_run(tmp_path):
    run_job(job(tmp_path))
    kept = [tmp_path / "run" / name for name in ("figures/mine.svg", "horizons/mine.geojson")]
    for path in kept:
        path.write_text("mine")
    run_job(job(tmp_path, fresh=True))
    assert all(path.read_text() == "mine" for path in kept)


def test_a_second_ctrl_c_ends_at_once():
    with StopRequest():
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)


def test_a_failing_solve_leaves_a_record(tmp_path, monkeypatch):
    from restoration import stokes

    monkeypatch.setattr(stokes, "RESIDUAL", 1e-40)
    monkeypatch.setattr(stokes, "RESIDUAL_BY_ROUNDING", 1e-40)
    with pytest.raises(SolveError, match="relative residual"):
        run_job(job(tmp_path))
    written = json.loads((tmp_path / "run" / "run.json").read_text())
    assert written["exit_code"] == 3
    assert written["ended_well"] is False


def test_a_finished_run_is_not_run_again(tmp_path):
    run_job(job(tmp_path))
    stamp = (tmp_path / "run" / "run.json").stat().st_mtime_ns
    record, _ = run_job(job(tmp_path))
    assert record is None
    assert (tmp_path / "run" / "run.json").stat().st_mtime_ns == stamp
    record, _ = run_job(job(tmp_path, fresh=True))
    assert record["ended_well"]


def test_rock_that_left_is_counted_and_not_averaged(tmp_path):
    speed = 1e-3 / 31557600
    walls = diapir_scene().walls | {
        "right": Wall("velocity", (speed, None), (0.0, 0.0)),
        "surface": Wall("traction", (None, None), (0.0, 0.0)),
    }
    scene = diapir_scene(cells=(8, 9), marks=(0, 0.3, 0), walls=walls)
    record, _ = run_job(job(tmp_path, scene))
    assert record["particles_left"]["right"] > 0
    assert record["particles_entered"]["right"] > 0
    assert record["particles_lost"] == 0
    assert record["there_and_back"]["max_m"] < 500
    assert sum(record["there_and_back"]["histogram"]["count"]) < record["particles"]


def test_other_folders_are_left_alone(tmp_path):
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "thesis.tex").write_text("years of work")
    for fresh in (False, True):
        with pytest.raises(CaseError, match="is not a run folder and not empty"):
            run_job(job(tmp_path, fresh=fresh))
    assert (tmp_path / "run" / "thesis.tex").read_text() == "years of work"


def test_a_run_of_another_case_is_not_overwritten(tmp_path):
    run_job(job(tmp_path))
    with pytest.raises(CaseError, match="holds the run of another case"):
        run_job(job(tmp_path, resolved="resolved: 2\n"))


def test_two_runs_do_not_share_a_folder(tmp_path):
    with locked(tmp_path / "run"), pytest.raises(CaseError, match="another run is at work"):
        run_job(job(tmp_path))


@pytest.mark.parametrize("other", ["link", "run/../run", "link/."])
def test_a_folder_in_use_is_known_by_other_names(tmp_path, other):
    (tmp_path / "run").mkdir()
    (tmp_path / "link").symlink_to("run")
    refused = pytest.raises(CaseError, match="another run is at work")
    with locked(tmp_path / "run"), refused, locked(tmp_path / other):
        pass


def test_a_run_of_another_machine_keeps_its_folder(tmp_path, monkeypatch):
    """Another machine has a temporary folder of its own, but shares the disk of the runs."""
    scene = diapir_scene(cells=(4, 4), marks=(0, -0.01))
    run_job(job(tmp_path, scene))
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "elsewhere"))
    with claimed(tmp_path / "run"):
        before = set(tmp_path.rglob("*"))
        with pytest.raises(CaseError, match="at work in it, of another machine or user"):
            run_job(job(tmp_path, scene, fresh=True))
    assert set(tmp_path.rglob("*")) >= before
    assert run_job(job(tmp_path, scene, fresh=True))[0]["ended_well"]


def test_a_run_that_begins_keeps_its_folder_from_other_machines(tmp_path, monkeypatch):
    from restoration import recorder

    begin, tried = recorder.Recorder.begin, []

    def try_it(self):
        with pytest.raises(CaseError, match="another run is at work"), claimed(self.folder):
            pass
        tried.append(self.folder)
        begin(self)

    monkeypatch.setattr(recorder.Recorder, "begin", try_it)
    run_job(job(tmp_path, diapir_scene(cells=(4, 4), marks=(0, -0.01))))
    assert tried == [tmp_path / "run"]


def test_a_run_that_ends_well_while_another_waits_for_its_folder_stays(tmp_path, monkeypatch):
    """Whether it has ended is looked at once nobody else can change it."""
    task = job(tmp_path, diapir_scene(cells=(4, 4), marks=(0, -0.01)))
    run_job(task)
    record = task.folder / "run.json"
    well = record.read_text()
    record.write_text(well.replace('"ended_well": true', '"ended_well": false'))

    @contextmanager
    def ends(folder):
        (folder / "run.json").write_text(well)
        yield

    monkeypatch.setattr(run_folder, "claimed", ends)
    assert run_job(task) == (None, task.folder)
    assert list(task.folder.glob("horizons/1-*.geojson"))


def test_a_result_that_nobody_can_change_is_told_of(tmp_path, monkeypatch):
    task = job(tmp_path, diapir_scene(cells=(4, 4), marks=(0, -0.01)))
    run_job(task)
    left = task.folder / "failure"
    left.mkdir()
    (left / "facts.json").write_text("{}")

    def refused(*_, **__):
        raise PermissionError(errno.EACCES, "Permission denied")

    monkeypatch.setattr("pathlib.Path.unlink", refused)
    opened = partial(open, os.devnull, "w")
    monkeypatch.setattr(run_folder, "_opened", lambda _, mode=0: refused() if mode else opened())
    assert run_job(task) == (None, task.folder)


def test_the_wall_time_counts_what_came_before_the_march(tmp_path, monkeypatch):
    """Of the command line the age of the process, of a run the loading of its libraries."""
    from restoration import run

    began = []

    class Noting(run.Keeper):
        def __init__(self, *arguments):
            began.append(arguments[6])
            super().__init__(*arguments)

    monkeypatch.setattr(run, "Keeper", Noting)
    before = time.monotonic()
    run_job(job(tmp_path, diapir_scene(cells=(4, 4), marks=(0, -0.01))))
    assert before <= began[0] <= time.monotonic()

    asked = []
    monkeypatch.setattr(run, "run_job", lambda job, *_: asked.append(job) or (None, job.folder))
    case = Path(__file__).parents[2] / "cases" / "diapir-isoviscous" / "case.yaml"
    with monkeypatch.context() as patch:
        patch.setattr("restoration.keeper.age", lambda: 40.0)
        assert main(["run", str(case), "--walltime", "90 s", "--out", str(tmp_path / "x")]) == 0
    assert main(["run", str(case), "--out", str(tmp_path / "x")]) == 0
    assert [task.walltime for task in asked] == [50.0, None]


def test_a_disk_without_locks_keeps_nobody_out(tmp_path, monkeypatch):
    def no_locks(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr("fcntl.flock", no_locks)
    with claimed(tmp_path):
        assert (tmp_path / LOCK).exists()


def test_folder_name_follows_the_case():
    made = Job(Path("a/salt/case.yaml"), "", "", None)
    assert made.folder.name == f"salt-{made.sha256[:8]}"
    assert Job(Path("a/exp1.yaml"), "", "", None).folder.name.startswith("exp1-")


def test_a_restored_section_is_proved_by_going_forward_again(tmp_path):
    scene = diapir_scene(cells=(8, 9), marks=(0, -0.3))
    run_job(job(tmp_path, scene))
    with pytest.raises(CaseError, match="--fresh --prove runs it again with one"):
        run_job(job(tmp_path, scene, prove=True))
    record, _ = run_job(job(tmp_path, scene, prove=True, fresh=True))
    proof = record["proof"]
    assert proof["cells"] == [10, 11]
    assert proof["scheme"] == "midpoint"
    assert proof["mean_m"] < 60
    assert proof["horizons"][0]["mean_m"] < 60
    assert record["certificate"]["rocks"][0]["name"] == "salt"
    assert (tmp_path / "run" / "certificate.md").read_text().startswith("# Can this restoration")
    assert run_job(job(tmp_path, scene, prove=True))[0] is None


def test_no_certificate_where_it_is_off(tmp_path):
    scene = diapir_scene(cells=(8, 9), marks=(0, -0.1), certificate=None)
    record, folder = run_job(job(tmp_path, scene))
    assert "certificate" not in record
    assert not (folder / "certificate.md").exists()

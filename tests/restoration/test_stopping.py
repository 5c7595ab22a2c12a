"""Where a run stops by itself: measures, exact landing, linear theory, the pace of viscosities."""

import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from restoration.engine import StokesEngine
from restoration.errors import CaseError
from restoration.layered import Layer, growth_matrix
from restoration.lines import begin
from restoration.resolve import load
from restoration.run import march, run_job
from restoration.run_folder import Job
from restoration.scene import Line, Outline, StopPlan, TimePlan, Wall
from restoration.state import State
from restoration.stopping import Stopping, depth, flatness, relief
from tests.restoration.conftest import HEIGHT, MYR, WIDTH, PlainEngine, diapir_scene

SLIP = Wall("free-slip", (0.0, None), (0.0, 0.0))
STUCK = Wall("no-slip", (0.0, 0.0), (0.0, 0.0))
TOP = (("salt / sediment",),)
ROOT = Path(__file__).parents[2]


def flat_to(value, criterion="flat", known=None):
    return StopPlan(criterion, "salt / sediment", TOP, value, known)


def stopped(scene, **plan):
    """March a scene with a stop; return the stopping, the last state and the times of the marks."""
    time = replace(scene.time, **plan)
    engine, stopping, passed = StokesEngine(replace(scene, time=time)), Stopping(time), []
    last = march(
        engine.start(),
        engine,
        time,
        at_marks=(lambda number, state: passed.append((number, state.time)),),
        stopping=stopping,
    )
    return stopping, last, passed


# -- measures -------------------------------------------------------------------------------------


def test_measures_of_a_wave():
    x = np.linspace(0, 1, 2001)
    wave = [np.column_stack([1e4 * x, 50 * np.cos(2 * np.pi * x) - 3000])]
    assert flatness([wave]) == pytest.approx(50 / np.sqrt(2), rel=1e-3)
    assert relief([wave]) == pytest.approx(100)
    assert depth([wave]) == pytest.approx(2950)


def test_flatness_is_exact_on_a_slope_in_pieces():
    """A slope is off its mean by rise / sqrt(12), however it is cut."""
    whole = [np.array([[0, 0], [3, 30.0]])]
    pieces = [np.array([[0, 0], [1, 10.0], [1.5, 15]]), np.array([[1.5, 15], [3, 30.0]])]
    assert flatness([whole]) == pytest.approx(30 / np.sqrt(12), rel=1e-14)
    assert flatness([pieces]) == pytest.approx(30 / np.sqrt(12), rel=1e-14)


def test_horizons_count_by_how_far_they_go_and_each_about_its_own_mean():
    level = [np.array([[0, 5.0], [270, 5.0]])]
    slope = [np.array([[0, 0.0], [30, 40.0]])]
    assert flatness([level, slope]) == pytest.approx(np.sqrt(0.1 * 40**2 / 12), rel=1e-8)
    assert relief([level, slope]) == 40
    upright = [np.array([[0, 0.0], [0, 40.0]])]
    assert flatness([upright]) == pytest.approx(40 / np.sqrt(12))


def test_a_scar_does_not_outweigh_what_is_flat():
    flat = [np.array([[0, 0.0], [500, 0], [500, 2000], [500, 0], [1000, 0]])]
    assert flatness([flat]) < 0.1


# -- landing --------------------------------------------------------------------------------------


class Waves(PlainEngine):
    """An engine without physics: a wave whose amplitude is a function of time."""

    def __init__(self, amplitude, step):
        self.amplitude, self.step, self.solved = amplitude, step, 0

    def state(self, time):
        x = np.linspace(0, 1, 101)
        points = np.column_stack([x, self.amplitude(time) * np.cos(np.pi * x)])
        return State(time, None, begin([Line("salt / sediment", "horizon", points)], np.inf))

    def stable_step(self, state, mark):
        return self.step

    def advance(self, state, until):
        self.solved += 1
        return self.state(until)


def wave_stop(amplitude, marks, plan, step=1.0):
    engine, seen, passed = Waves(amplitude, step), [], []
    stopping = Stopping(TimePlan(marks, "rk4", 1.0, 4, stop=plan))
    last = march(
        engine.state(marks[0]),
        engine,
        TimePlan(marks, "rk4", 1.0, 4),
        every_step=(lambda before, state: seen.append((before.time, state.time)),),
        at_marks=(lambda number, state: passed.append((number, state.time)),),
        stopping=stopping,
    )
    return stopping, last, seen, passed, engine


@pytest.mark.parametrize("marks", [(0.0, -20.0), (0.0, 20.0), (3.0, 4.0, 33.0)])
def test_the_march_lands_where_the_relief_is_as_asked(marks):
    """exp(-t / 7) is 1/3 after 7 ln 3, whatever the steps."""
    stopping, last, seen, passed, engine = wave_stop(
        lambda t: 100 * np.exp(-abs(t - marks[0]) / 7), marks, flat_to(200 / 3, "relief")
    )
    assert abs(last.time - marks[0]) == pytest.approx(7 * np.log(3), rel=1e-9)
    assert stopping.over
    assert stopping.value == pytest.approx(200 / 3, rel=1e-9)
    assert passed[-1] == (len(marks) - 1, last.time)
    assert seen[-1][1] == last.time
    assert [before for before, _ in seen[1:]] == [after for _, after in seen[:-1]]
    assert engine.solved <= len(seen) + 5


def test_what_grows_stops_where_it_has_grown():
    _, last, *_ = wave_stop(lambda t: np.exp(t), (0.0, 10.0), flat_to(200.0, "relief"))
    assert last.time == pytest.approx(np.log(100), rel=1e-9)
    _, last, *_ = wave_stop(lambda t: 30 + t, (0.0, 10.0), flat_to(-35.5, "depth"))
    assert last.time == pytest.approx(5.5, rel=1e-9)


def test_a_step_that_ends_just_there_is_not_taken_anew():
    _, last, seen, _, engine = wave_stop(lambda t: 10 - t, (0.0, 8.0), flat_to(10.0, "relief"))
    assert last.time == 5
    assert engine.solved == len(seen) == 5


def test_the_flattest_moment_is_gone_back_to():
    stopping, last, seen, passed, _ = wave_stop(
        lambda t: 5 + (t - 6.3) ** 2, (0.0, 60.0), flat_to(None, "flattest")
    )
    assert last.time == pytest.approx(6.3, rel=1e-9)
    assert stopping.value == pytest.approx(flatness([[last.lines[0].points]]))
    assert seen[-1] == (9, last.time)  # back from the step that was the fourth beyond
    assert passed[-1] == (1, last.time)
    assert max(t for t, _ in stopping.history) < 11


def test_roughness_is_not_taken_for_a_least():
    """A rise of a tenth, or of three steps, is none."""
    rough = lambda t: 20 - t + (1 if int(t) % 4 else 0)  # noqa: E731
    stopping, last, *_ = wave_stop(rough, (0.0, 16.0), flat_to(None, "flattest"))
    assert not stopping.over
    assert last.time == 16


@pytest.mark.parametrize(
    ("plan", "words"),
    [
        (flat_to(1.0, "relief"), "not met: salt / sediment: relief 4 m at 8 s, the last mark"),
        (flat_to(None, "flattest"), "there is no least in between"),
    ],
)
def test_what_is_not_met_goes_on_to_the_last_mark_and_says_so(plan, words):
    stopping, _, _, passed, _ = wave_stop(lambda t: 10 - t, (0.0, 4.0, 8.0), plan)
    assert not stopping.over
    assert [time for _, time in passed] == [0, 4, 8]
    about = stopping.about(lambda time: f"{time:g} s")
    assert words in about["verdict"]
    assert about["met"] is False
    assert about["time_s"] is None
    assert about["value_m"] is not None
    assert stopping.fitting(diapir_scene()) == {}


# -- Stokes ---------------------------------------------------------------------------------------


def test_the_time_of_a_two_layer_instability_is_that_of_linear_theory():
    """Two layers between no-slip walls: how flat they are falls as exp(-s t) backward."""
    x = np.linspace(0, WIDTH, 201)
    scene = diapir_scene(cells=(16, 18), viscosity=(1e19, 2e18))
    top = lambda x: -7000 + 40 * np.cos(np.pi * x / WIDTH)  # noqa: E731
    scene = replace(
        scene,
        unit_at=lambda p: (p[:, 1] > top(p[:, 0])).astype(np.int16),
        lines=(Line("salt / sediment", "horizon", np.column_stack([x, top(x)])),),
        walls={"left": SLIP, "right": SLIP, "base": STUCK, "surface": STUCK},
        outline=Outline(
            np.array([[0, 0], [WIDTH, 0.0]]), np.array([[0, -HEIGHT], [WIDTH, -HEIGHT]])
        ),
        mesh=replace(scene.mesh, interfaces="fitted"),
    )
    layers = [Layer(3000.0, 2150.0, 1e19), Layer(7000.0, 2600.0, 2e18)]
    rate = float(growth_matrix(layers, np.pi / WIDTH, 9.81, surface="no-slip")[0, 0])
    stopping, last, _ = stopped(
        scene, marks=(0.0, -3 / rate), min_steps=20, stop=flat_to(40 / np.sqrt(2) / np.e)
    )
    assert abs(last.time) * rate == pytest.approx(1, rel=5e-3)
    assert stopping.value == pytest.approx(40 / np.sqrt(2) / np.e, rel=1e-4)  # a mesh that moves


def free_top(factor=1.0, **plan):
    """A diapir below a free surface, restored, with viscosities times a factor."""
    free = Wall("free", (None, None), (0.0, 0.0))
    return diapir_scene(
        cells=(8, 9),
        viscosity=(1e19 * factor, 1e20 * factor),
        walls={"left": SLIP, "right": SLIP, "base": STUCK, "surface": free},
        **plan,
    )


def held_top(factor=1.0, **plan):
    return diapir_scene(cells=(8, 9), viscosity=(1e19 * factor, 1e20 * factor), **plan)


@pytest.mark.parametrize("made", [held_top, free_top])
def test_viscosities_that_fit_meet_the_criterion_at_the_known_age(made):
    """Stokes flow has no inertia: f times the viscosity is f times the time, step by step."""
    plan = flat_to(115.0, known=2.5 * MYR)
    first, last, _ = stopped(made(), marks=(0.0, -4 * MYR), stop=plan)
    fit = first.fitting(made())
    assert first.over
    assert fit["viscosity_factor"] == pytest.approx(2.5 * MYR / abs(first.time))
    factor = fit["viscosity_factor"]
    assert fit["fitting_viscosity"]["salt"] == pytest.approx(1e19 * factor)
    again, there, _ = stopped(made(factor), marks=(0.0, -4 * MYR * factor), stop=plan)
    assert len(again.history) == len(first.history)
    assert again.time == pytest.approx(-2.5 * MYR, rel=1e-6)
    assert np.abs(there.particles.x - last.particles.x).max() < 0.01


def test_a_run_that_stops_tells_it_everywhere(tmp_path):
    scene = held_top(time=TimePlan((0.0, -4.0 * MYR, -8.0 * MYR), "rk4", 1.0, 5))
    scene = replace(scene, time=replace(scene.time, stop=flat_to(115.0, known=3 * MYR)))
    job = Job(Path("x/case.yaml"), "title: as given\n", "resolved: 1\n", scene, tmp_path / "run")
    _, folder = run_job(job)
    written = json.loads((folder / "run.json").read_text())
    told = written["stopped"]
    assert told["met"] is True
    assert told["criterion"] == "flat"
    assert told["horizon"] == "salt / sediment"
    assert told["value_m"] == pytest.approx(115, rel=1e-8)
    assert told["time_s"] == written["time_reached_s"] == -told["duration_s"]
    assert written["viscosity_factor"] == pytest.approx(3 * MYR / told["duration_s"])
    assert set(written["fitting_viscosity"]) == {"salt", "sediment"}
    rows = list(csv.DictReader((folder / "diagnostics.csv").read_text().splitlines()))
    assert float(rows[-1]["flatness_m"]) == pytest.approx(115, rel=1e-8)
    assert float(rows[-1]["time_Myr"]) * MYR == pytest.approx(told["time_s"])
    assert len(list((folder / "figures").glob("section-*.png"))) == 2  # the start and the stop
    assert (folder / "figures" / "flatness.png").stat().st_size > 5_000
    log = (folder / "log.txt").read_text()
    assert f"stop: {told['verdict']}" in log
    assert "known age: 3 Myr" in log


# -- case files -----------------------------------------------------------------------------------


CASE = """section:
  box: {{width: 4 km, height: 3 km}}
  layers:
    - {{rock: salt, top: {{depth: 2 km, cosine: {{amplitude: 100 m, wavelength: 8 km}}}}}}
    - {{rock: mud, top: {{depth: 1 km}}}}
    - {{rock: sand}}
rocks:
  salt: {{density: 2150 kg/m^3, viscosity: 1e19 Pa s}}
  mud: {{density: 2500 kg/m^3, viscosity: 1e19 Pa s}}
  sand: {{density: 2600 kg/m^3, viscosity: 1e19 Pa s}}
{}time: {{marks: {}{}}}
"""
STOP = ", stop: {horizon: salt / mud, flat: 50 m}"


def case(tmp_path, entries="", marks="[0 Ma, 1 Ma]", head=""):
    path = tmp_path / "case.yaml"
    path.write_text(CASE.format(head, marks, entries), encoding="utf-8")
    return load(path)


@pytest.mark.parametrize(
    ("horizon", "names", "text"),
    [
        ("salt / mud", (("salt / mud",),), "salt / mud"),
        ("salt", (("salt / mud",),), "top of salt"),
        ("[salt, mud]", (("salt / mud",), ("mud / sand",)), "top of salt and top of mud"),
        ("all", (("salt / mud",), ("mud / sand",)), "all horizons"),
    ],
)
def test_horizons_go_by_their_name_or_the_unit_below(tmp_path, horizon, names, text):
    plan = case(tmp_path, f", stop: {{horizon: {horizon}, relief: 10 m}}").scene.time.stop
    assert plan.names == names
    assert plan.horizon == text
    assert plan.start > 99


def test_the_resolved_case_stops_alike(tmp_path):
    loaded = case(tmp_path, STOP + ", known_age: 4 Ma")
    path = tmp_path / "resolved.yaml"
    path.write_text(loaded.resolved, encoding="utf-8")
    again = load(path)
    assert again.scene.time == loaded.scene.time
    assert again.resolved == loaded.resolved
    assert loaded.scene.time.stop.known == pytest.approx(4 * MYR)


@pytest.mark.parametrize(
    ("marks", "known", "duration"),
    [
        ("[1 Ma, 3 Ma]", "4 Ma", 3),
        ("[1 Ma, 3 Ma]", "4 Myr", 4),
        ("[0 Myr, 3 Myr]", "4 Myr", 4),
        ("[5 Ma, 3 Ma]", "4 Ma", 1),
    ],
)
def test_known_ages_count_from_the_first_mark(tmp_path, marks, known, duration):
    plan = case(tmp_path, STOP + f", known_age: {known}", marks).scene.time.stop
    assert plan.known == pytest.approx(duration * MYR)


def test_a_horizon_flatter_than_asked_is_noted(tmp_path):
    notes = case(tmp_path, ", stop: {horizon: salt, flat: 300 m}").scene.notes
    assert any("stops where that grows to 300 m" in note for note in notes)


@pytest.mark.parametrize(
    ("entries", "marks", "head", "message"),
    [
        (", stop: {horizon: salt / mdu, flat: 50 m}", None, "", "did you mean 'salt / mud'"),
        (", stop: {horizon: surface, flat: 50 m}", None, "", "there is no horizon 'surface'"),
        (", stop: {horizon: all}", None, "", "no criterion; write one of flat: 50 m"),
        (", stop: {horizon: all, flat: 5 m, depth: 1 km}", None, "", "flat and depth together"),
        (", stop: {horizon: all, flattest: false}", None, "", "flattest is true or not given"),
        (", stop: {horizon: all, relif: 5 m}", None, "", "did you mean 'relief'"),
        (", stop: {horizon: all, flat: 0 m}", None, "", "must be above 0 km"),
        (STOP, "[0 Myr, 1 Myr, 0 Myr]", "", "these turn at 1 Myr"),
        (", stop: {horizon: mud, depth: 1 km}", None, "", "top of mud begins with 1 km"),
        (", known_age: 4 Ma", None, "", "give time.stop too"),
        (STOP + ", known_age: 0 Ma", None, "", "must be above 0"),
        (STOP + ", known_age: 4 Ma", "[5 Ma, 6 Ma]", "", "is not on the way from 5 Ma"),
        (STOP + ", known_age: 4 Ma", "[0 Myr, 6 Myr]", "", "is an age and the marks are times"),
        (
            STOP + ", known_age: 4 Ma",
            None,
            "boundary: {left: {velocity: [1 mm/yr, free]}, right: {velocity: [1 mm/yr, free]}}\n",
            "the velocity of the left and right is given",
        ),
        (
            STOP + ", known_age: 4 Ma",
            None,
            "boundary: {surface: {traction: [0 MPa, {time: [0 Ma, 1 Ma],"
            " value: [0 MPa, -5 MPa]}]}}\n",
            "the traction of the surface varies in time",
        ),
    ],
)
def test_what_cannot_be_is_refused(tmp_path, entries, marks, head, message):
    with pytest.raises(CaseError) as caught:
        case(tmp_path, entries, marks or "[0 Ma, 1 Ma]", head)
    assert message in str(caught.value)
    assert len(caught.value.faults) == 1


def test_walls_at_rest_and_loads_keep_the_pace(tmp_path):
    head = "boundary: {left: {velocity: [0 mm/yr, free]}, surface: {traction: [0 MPa, -5 MPa]}}\n"
    assert case(tmp_path, STOP + ", known_age: 4 Ma", head=head).scene.time.stop.known > 0


def test_the_paper_diapir_has_a_top_of_salt():
    path = ROOT / "cases" / "salt-diapir" / "exp1.yaml"
    scene = load(path, ["time.stop={horizon: salt, flat: 300 m}"]).scene
    assert scene.time.stop.names[0] == ("salt / A", "salt / B", "salt / C", "salt / D")

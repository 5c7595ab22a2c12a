"""The forecast of a run against the run."""

import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from restoration.box_engine import BoxEngine
from restoration.cli import main
from restoration.engine import StokesEngine
from restoration.forecast import Pace, certificate_seconds, forecast, rehearsal, steps_of
from restoration.resolve import load
from restoration.run import march
from restoration.stopping import Stopping

ROOT = Path(__file__).parents[2]
DEMO = ROOT / "cases" / "diapir-isoviscous" / "case.yaml"
SMALL = ("mesh.cells=20", "certificate=off", "particles.densify=5")


def plan(**given):
    scene = load(DEMO, ["time.marks=[0 kyr, 100 kyr, 0 kyr]"]).scene
    return replace(scene.time, **given)


def test_steps_are_bounded_by_flow_surface_and_way():
    year = plan().marks[1] / 100e3
    paces = [Pace(1, 60e3 * year, 1e-3 / year, np.inf), Pace(1, 40e3 * year, 1e-4 / year, np.inf)]
    back = [replace(pace, leg=2) for pace in paces]
    # half a cell a step at 1 and 0.1 cells in 1000 years, at most a twentieth of 100 000 years
    assert steps_of(paces + back, plan(), 1.0) == [60 / 0.5 + 40 / 5, 60 / 0.5 + 40 / 5]
    assert steps_of(paces, plan(), 2.0) == [60 / 0.25 + 40 / 2.5]
    bound = [replace(pace, bound=100 * year) for pace in paces]
    assert steps_of(bound, plan(), 1.0) == [1000]


def test_a_rehearsal_goes_the_whole_way():
    scene = load(DEMO, [*SMALL, "time.marks=[0 Myr, 1 Myr, 0 Myr]"]).scene
    paces, first = rehearsal(scene)
    for leg in (1, 2):
        length = sum(pace.dt for pace in paces if pace.leg == leg)
        assert length == pytest.approx(scene.time.marks[1])
    assert first == paces[0].fastest > 0


def test_a_march_that_stops_by_itself_is_rehearsed_as_far():
    stop = "time.stop={horizon: salt, relief: 1 km}"
    scene = load(DEMO, [*SMALL, "time.marks=[0 Myr, 5 Myr]", stop]).scene
    gone = sum(pace.dt for pace in rehearsal(scene)[0])
    engine = StokesEngine(scene)
    end = march(engine.start(), engine, scene.time, stopping=Stopping(scene.time))
    assert end.time < 0.3 * scene.time.marks[1]
    assert gone == pytest.approx(end.time, rel=0.1)


def test_steps_and_time_are_those_of_the_run(monkeypatch):
    """Within a factor 1.5: the run goes through a rise that is 40 times as fast as its start.

    Both are told in CPU seconds here, which other tests beside this one do not spoil.
    """
    monkeypatch.setattr(time, "perf_counter", time.process_time)
    scene = load(DEMO, [*SMALL, "time.marks=[0 Myr, 6 Myr, 3 Myr]"]).scene
    told = forecast(scene)
    engine, steps = StokesEngine(scene), []
    begin = time.process_time()
    march(engine.start(), engine, scene.time, (lambda *_: steps.append(1),))
    took = time.process_time() - begin
    assert told.steps == pytest.approx(len(steps), rel=0.25)
    assert told.solves == pytest.approx(engine.counts.solves, rel=0.25)
    assert told.steps * told.step_s == pytest.approx(took, rel=0.5)
    assert told.presets["draft"] < told.presets["balanced"] < told.presets["fine"]


def test_a_certificate_costs_by_the_way_back():
    scene = load(DEMO).scene
    forward = replace(scene, time=replace(scene.time, marks=scene.time.marks[:2]))
    assert certificate_seconds(forward, [20], 1.0) == 0
    assert certificate_seconds(replace(scene, certificate=None), [20, 20, 20, 20], 1.0) == 0
    whole = certificate_seconds(scene, [20, 20, 100, 100], 1.0)
    assert 20 < whole < 200


def test_the_forecast_is_told_by_the_command(capsys):
    sets = [part for entry in SMALL for part in ("--set", entry)]
    sets += ["--set", "time.marks=[0 Myr, 0.2 Myr]"]
    assert main(["check", str(DEMO), "--forecast", "--json", *sets]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["time_forecast_s"] > 0
    assert told["forecast"]["steps"] >= 20
    assert main(["check", str(DEMO), "--forecast", *sets]) == 0
    text = capsys.readouterr().out
    assert "forecast   " in text
    assert "presets    cost" in text


def test_a_box_is_rehearsed_too():
    case = ROOT / "cases" / "diapir-3d" / "case.yaml"
    scene = load(case, ["mesh.cells=[6, 6, 3]", "time.marks=[0 Myr, 1 Myr, 0 Myr]"]).scene
    told = forecast(scene)
    engine = BoxEngine(scene)
    march(engine.start(), engine, scene.time)
    assert told.solves == pytest.approx(engine.counts.solves, rel=0.35)
    assert told.presets["draft"] < told.presets["fine"]

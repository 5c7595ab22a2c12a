"""Runs that are killed, stopped and cut short: nothing is lost, and they end as if unbroken."""

import csv
import hashlib
import json
import random
import re
import shutil
import time
from dataclasses import replace
from pathlib import Path

import h5py
import pytest

from restoration import recorder
from restoration.checkpoint import Checkpoints
from restoration.errors import RestorationError
from restoration.run import Job, run_job
from restoration.scene import MeshPlan, StopPlan, TimePlan
from tests.forked import Forked
from tests.restoration.conftest import MYR, diapir_scene
from tests.torture import tries

pytestmark = [pytest.mark.slow, pytest.mark.torture]
TIMES = "wall_s"  # column that no two runs share
CLOCKS = ("wall_s", "wall_by_part_s", "peak_rss_mb", "resumed_after_steps", "commit")


def small(**plans):
    """Return a small diapir of two viscosities, there and back."""
    plans.setdefault("time", TimePlan((0.0, 0.4 * MYR, 0.0), "midpoint", 1.0, 6))
    return diapir_scene(cells=(6, 7), viscosity=(1e18, 1e20), certificate=None, **plans)


SCENES = {
    "particles": small,
    "fitted": lambda: small(mesh=MeshPlan(interfaces="fitted")),
    "flattest": lambda: small(
        time=TimePlan(
            (0.0, -0.4 * MYR),
            "midpoint",
            1.0,
            8,
            stop=StopPlan("flattest", "salt / sediment", (("salt / sediment",),), None, None, 0.0),
        )
    ),
}


def job(folder, scene, **entries):
    """Return the job of a scene that writes a checkpoint after every step."""
    made = Job(Path("x/case.yaml"), "title: as given\n", "resolved: 1\n", scene, folder)
    return replace(made, checkpoint=1, **entries)


def run(task):
    """Run a job, and return the exit code of the command line."""
    try:
        run_job(task)
    except RestorationError as error:
        print(error)
        return error.exit_code
    return 0


def ends(folder):
    """Return all that a run leaves but its clocks: a digest of every file that is no picture."""
    record = json.loads((folder / "run.json").read_text())
    table = list(csv.DictReader((folder / "diagnostics.csv").read_text().splitlines()))
    found = {"record": {k: v for k, v in record.items() if k not in CLOCKS}}
    found["table"] = [{k: v for k, v in row.items() if k != TIMES} for row in table]
    for path in sorted(folder.glob("horizons/*.geojson")):
        found[path.name] = hashlib.sha256(path.read_bytes()).hexdigest()
    for path in sorted(folder.glob("*.xdmf")):
        digest = hashlib.sha256()
        for file, name in re.findall(r">([^<>]+\.h5):([^<]+)<", path.read_text()):
            with h5py.File(folder / file, "r") as h5:
                digest.update(h5[name][()].tobytes())
        found[path.name] = digest.hexdigest()
    pictures = [path.name for path in sorted(folder.glob("figures/*.png"))]
    return found | {"pictures": pictures}


def acknowledged(folder):
    """Return the step of the checkpoint that was written last, -1 before the first one."""
    try:
        return json.loads((folder / "checkpoints" / "latest.json").read_text())["step"]
    except FileNotFoundError:
        return -1


def steps_told(folder):
    """Return the number of steps whose rows are in the table."""
    try:
        return len((folder / "diagnostics.csv").read_text().splitlines()) - 1
    except FileNotFoundError:
        return 0


@pytest.fixture(scope="module")
def no_pictures():
    """Let runs write empty pictures, which take most of the time of small ones."""
    with pytest.MonkeyPatch.context() as patch:
        for name in ("draw_section", "draw_strip", "draw_there_and_back", "draw_flatness"):
            patch.setattr(recorder, name, lambda path, *_, **__: path.write_bytes(b""))
        yield


@pytest.fixture(scope="module", params=SCENES)
def unbroken(request, tmp_path_factory, no_pictures):
    """Return a scene, and what its unbroken run leaves and takes, s."""
    folder = tmp_path_factory.mktemp("unbroken") / "run"
    scene = SCENES[request.param]()
    run_job(job(folder, scene))  # compiles
    begin = time.monotonic()
    assert Forked(lambda: run(job(folder, scene, fresh=True))).wait() == 0
    return scene, ends(folder), time.monotonic() - begin


def test_killed_at_random_a_run_ends_as_if_unbroken(unbroken, tmp_path):
    scene, end, seconds = unbroken
    chance, folder, kills, rounds = random.Random(1), tmp_path / "run", 0, 0
    while kills < tries(20, 334):
        process = Forked(lambda: run(job(folder, scene)))
        time.sleep(chance.uniform(0.0, 0.6 * seconds))
        process.kill()
        kills += 1
        last, told = acknowledged(folder), steps_told(folder)
        assert told - last <= 1 or last == -1  # at most the step that was being made is lost
        memory, notes = Checkpoints(folder / "checkpoints").newest()
        assert notes == []  # no file is damaged
        assert last < 0 or memory["steps"] >= last
        if kills % 5 == 0:
            assert Forked(lambda: run(job(folder, scene))).wait() == 0
            rounds += 1
            assert ends(folder) == end
            assert not (folder / "checkpoints").exists()
            shutil.rmtree(folder)
    assert rounds >= 4

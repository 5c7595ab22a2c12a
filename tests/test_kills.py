"""Runs that are killed, stopped and cut short: nothing is lost, and they end as if unbroken."""

import csv
import errno
import hashlib
import json
import os
import random
import re
import shutil
import signal
import sys
import time
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from restoration import recorder
from restoration.checkpoint import Checkpoints
from restoration.errors import OutputError, RestorationError, StoppedError
from restoration.run import run_job
from restoration.run_folder import Job
from restoration.scene import MeshPlan, StopPlan, TimePlan
from restoration.writing import write_text
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


def shortest():
    """Return a scene of two steps."""
    return small(time=TimePlan((0.0, 0.1 * MYR), "midpoint", 1.0, 2))


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


def ended_well(folder):
    """Return whether the run in a folder has come to its end."""
    path = folder / "run.json"
    return path.is_file() and json.loads(path.read_text())["ended_well"]


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
            patch.setattr(recorder, name, lambda path, *_, **__: write_text(path, ""))
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
        memory, notes = Checkpoints(folder / "checkpoints").newest()
        assert notes == []  # no file is damaged
        if not ended_well(folder):  # and was killed while it removed its checkpoints
            reached = memory["steps"] if memory else -1
            # A checkpoint may be newer than the last one acknowledged: whole when the run died.
            assert reached >= last
            assert told <= max(reached, 0) + 1  # at most the step that was being made is lost
        if kills % 5 == 0:
            assert Forked(lambda: run(job(folder, scene))).wait() == 0
            rounds += 1
            assert ends(folder) == end
            assert not (folder / "checkpoints").exists()
            shutil.rmtree(folder)
    assert rounds >= 4


class Disk:
    """What a run does to its folder, counted, and cut short at one of its points.

    Installed in a process of its own, since an audit hook stays.

    Args:
        folder: the run folder.
        point: number of the call at which to act, from 1; 0 for never.
        act: called with the arguments of the event.
    """

    EVENTS = ("open", "os.rename", "os.remove", "os.mkdir", "os.fsync")

    def __init__(self, folder, point=0, act=None):
        self.folder, self.point, self.act, self.count = str(folder), point, act, 0
        fsync = os.fsync

        def counted(descriptor):
            self("os.fsync", (os.readlink(f"/proc/self/fd/{descriptor}"),))
            fsync(descriptor)

        os.fsync = counted
        sys.addaudithook(self)

    def __call__(self, event, arguments):
        """Count an event that changes the folder, and act where it is the one."""
        if event not in self.EVENTS or not str(arguments[0]).startswith(self.folder):
            return
        if event == "open" and (arguments[2] or 0) & (os.O_WRONLY | os.O_RDWR) == 0:
            return
        self.count += 1
        if self.count == self.point:
            self.act(*arguments)


def killed(*_):
    """End this process as SIGKILL does."""
    os.kill(os.getpid(), signal.SIGKILL)


def refused(number):
    """Return what makes a call fail with an error of the system."""

    def act(*_):
        raise OSError(number, os.strerror(number))

    return act


@pytest.fixture(scope="module")
def two_steps(tmp_path_factory, no_pictures):
    """Return a scene, what its unbroken run leaves, and how often that changes its folder."""
    scene, counted = shortest(), tmp_path_factory.mktemp("counted") / "count"
    folder = tmp_path_factory.mktemp("unbroken") / "run"
    run_job(job(folder.with_name("first"), scene))  # compiles

    def counting():
        disk = Disk(folder)
        code = run(job(folder, scene))
        counted.write_text(str(disk.count))
        return code

    assert Forked(counting).wait() == 0
    return scene, ends(folder), int(counted.read_text())


def broken_at(point, act, folder, scene):
    """Run a job whose disk acts at a point, and return the exit code."""

    def breaking():
        Disk(folder, point, act)
        return run(job(folder, scene))

    return Forked(breaking).wait()


def test_killed_at_every_write_a_run_ends_as_if_unbroken(two_steps, tmp_path):
    scene, end, points = two_steps
    assert points > 40
    for point in range(1, points + 1, tries(2, 1)):
        folder = tmp_path / f"{point}"
        assert broken_at(point, killed, folder, scene) == -signal.SIGKILL
        assert Checkpoints(folder / "checkpoints").newest()[1] == []
        assert Forked(lambda folder=folder: run(job(folder, scene))).wait() == 0
        assert ends(folder) == end, point


@pytest.mark.parametrize("number", [errno.EIO, errno.ENOSPC])
def test_refused_at_a_write_a_run_tells_so_and_ends_as_if_unbroken(two_steps, tmp_path, number):
    scene, end, points = two_steps
    for point in range(1 + number % 2, points + 1, tries(7, 1)):
        folder = tmp_path / f"{point}"
        code = broken_at(point, refused(number), folder, scene)
        assert code == OutputError.exit_code or (code == 0 and ends(folder) == end), point
        assert Forked(lambda folder=folder: run(job(folder, scene))).wait() == 0
        assert ends(folder) == end, point


def test_a_disk_that_loses_the_end_of_a_checkpoint_costs_no_more_than_that(two_steps, tmp_path):
    scene, end, _ = two_steps

    def stopped(*_):
        raise StoppedError("before the end")

    for kept in (0, 100, 511, 512, 5000):  # bytes of the newest one
        folder = tmp_path / f"{kept}"

        def stopping(folder=folder):
            pytest.MonkeyPatch().setattr(recorder.Recorder, "compare", stopped)
            return run(job(folder, scene))

        assert Forked(stopping).wait() == StoppedError.exit_code
        os.truncate(max(folder.glob("checkpoints/step-*.h5")), kept)
        assert Forked(lambda folder=folder: run(job(folder, scene))).wait() == 0
        assert ends(folder) == end
        assert "is damaged" in (folder / "log.txt").read_text()


@pytest.fixture(scope="module")
def three_checkpoints(tmp_path_factory):
    """Return a folder with three checkpoints of arrays and texts."""
    checkpoints = Checkpoints(tmp_path_factory.mktemp("checkpoints"))
    for step in range(3):
        rock = {"kept-0": {"x": np.arange(50.0)}}
        memory = {"time": 1.0, "step": step, "text": "\u00e4", "x": np.arange(400.0), "rock": rock}
        checkpoints.write(step, memory)
    return checkpoints.folder


def test_every_damage_of_a_checkpoint_is_found(three_checkpoints):
    newest = max(three_checkpoints.glob("step-*.h5"))
    content, chance = newest.read_bytes(), random.Random(2)
    assert Checkpoints(three_checkpoints).newest()[0]["step"] == 2
    for number in range(tries(512, 10_000)):
        damaged = bytearray(content)
        if number % 4 == 3:
            del damaged[chance.randrange(len(content)) :]
        else:
            damaged[chance.randrange(len(content))] ^= 1 << chance.randrange(8)
        newest.write_bytes(damaged)
        memory, notes = Checkpoints(three_checkpoints).newest()
        assert memory["step"] == 1
        assert len(notes) == 1
        assert newest.name in notes[0]
    newest.write_bytes(content)


def _huge(path):
    path.touch()
    os.truncate(path, 10**11)


@pytest.mark.parametrize(
    ("make", "told"),
    [
        (os.mkdir, "Is a directory"),
        (os.mkfifo, "is not a regular file"),
        (_huge, "is damaged"),
        (lambda path: path.symlink_to("nowhere"), "No such file"),
    ],
    ids=["folder", "pipe", "huge", "link"],
)
def test_what_stands_where_a_checkpoint_was_costs_neither_time_nor_memory(
    three_checkpoints, tmp_path, make, told
):
    folder = shutil.copytree(three_checkpoints, tmp_path / "checkpoints")
    newest = max(folder.glob("step-*.h5"))
    newest.unlink()
    make(newest)
    memory, notes = Checkpoints(folder).newest()
    assert memory["step"] == 1
    assert notes[0].startswith(f"checkpoint {newest.name}: {told}")


def test_what_checkpoints_share_is_verified_too(three_checkpoints):
    kept = three_checkpoints / "kept-0.h5"
    content = kept.read_bytes()
    kept.write_bytes(content[:-1] + b"!")
    assert Checkpoints(three_checkpoints).newest()[0] is None
    kept.write_bytes(content)
    assert Checkpoints(three_checkpoints).newest()[0]["rock"]["kept-0"]["x"][49] == 49.0

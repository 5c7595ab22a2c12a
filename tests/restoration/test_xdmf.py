"""The series: read back by VTK as written, whole after a kill, a full disk or a resume."""

import json
import os
import signal
import subprocess
import sys
import time

import h5py
import numpy as np
import pytest

from restoration import writing, xdmf
from restoration.errors import CaseError, OutputError
from restoration.saved import read_particles
from restoration.units import YEAR
from restoration.xdmf import MeshSeries, ParticleSeries

os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkOSOpenGLRenderWindow")
MYR = 1e6 * YEAR
SQUARE = 1e3 * np.array(
    [[0, 0], [1, 0], [0, 1], [1, 1], [0.5, 0], [0.5, 0.5], [0, 0.5], [1, 0.5], [0.5, 1]]
)
QUADRATIC = np.array([[0, 1, 2, 4, 5, 6], [1, 3, 2, 7, 8, 5]])


def read_all(path):
    """Return the times of a series and its frames."""
    pyvista = pytest.importorskip("pyvista")
    reader = pyvista.get_reader(path)
    frames = []
    for moment in reader.time_values:
        reader.set_active_time_value(moment)
        frames.append(reader.read())
    return reader.time_values, frames


def test_quadratic_mesh_comes_back(tmp_path):
    rng = np.random.default_rng(1)
    series = MeshSeries(tmp_path / "fields.xdmf")
    ages, sent = [0.0, 3 * MYR, 0.0], []
    for i, age in enumerate(ages):
        points = SQUARE * (1 + 0.1 * i)
        u, p = rng.normal(size=(9, 2)), rng.normal(size=9)
        rock, eta = np.array([i, 300], dtype=np.int16), rng.normal(size=2)
        series.write(
            i * MYR, points, QUADRATIC, {"velocity": u, "p": p}, {"rock": rock, "eta": eta}, age
        )
        sent.append((points, u, p, rock, eta, age))
    times, frames = read_all(tmp_path / "fields.xdmf")
    assert times == [0, MYR, 2 * MYR]
    for frame, (points, u, p, rock, eta, age) in zip(frames, sent, strict=True):
        assert (frame.celltypes == 22).all()  # VTK_QUADRATIC_TRIANGLE
        np.testing.assert_array_equal(frame.points[:, :2], points.astype(frame.points.dtype))
        np.testing.assert_array_equal(frame.cells.reshape(2, 7)[:, 1:], QUADRATIC)
        np.testing.assert_array_equal(frame.point_data["velocity"], np.c_[u, np.zeros(9)])
        np.testing.assert_array_equal(frame.point_data["p"], p)
        np.testing.assert_array_equal(frame.cell_data["rock"], rock)
        np.testing.assert_array_equal(frame.cell_data["eta"], eta)
        assert frame.cell_data["rock"].dtype == np.int16
        assert frame.cell_data["eta"].dtype == np.float64
        assert frame.field_data["model_time_Myr"][0] == pytest.approx(age / MYR, abs=0)


def test_midpoints_lie_on_their_edges(tmp_path):
    """A quadratic field is reproduced inside: the order of the nodes is VTK's."""
    series = MeshSeries(tmp_path / "fields.xdmf")
    series.write(0, SQUARE, QUADRATIC, {"f": SQUARE[:, 0] * SQUARE[:, 1]})
    _, [frame] = read_all(tmp_path / "fields.xdmf")
    import pyvista

    inside = np.array([[210.0, 130.0, 0.0], [700.0, 850.0, 0.0], [300.0, 640.0, 0.0]])
    found = pyvista.PolyData(inside).sample(frame)["f"]
    np.testing.assert_allclose(found, inside[:, 0] * inside[:, 1], rtol=1e-5)


def test_unchanged_mesh_is_stored_once(tmp_path):
    series = MeshSeries(tmp_path / "fields.xdmf")
    moving = SQUARE[:4].copy()
    for i in range(4):
        moving *= 1.0 if i < 2 else 1.5  # in place, as mesh motion does it
        series.write(i, moving, [[0, 1, 2], [1, 3, 2]], {"f": np.full(4, float(i))})
    with h5py.File(tmp_path / "fields.h5") as h5:
        frames = [sorted(h5["frames"][name]) for name in sorted(h5["frames"])]
    assert frames == [["point", "points", "topology"], ["point"]] + [["point", "points"]] * 2
    _, read = read_all(tmp_path / "fields.xdmf")
    assert [frame.bounds[1] for frame in read] == [1000, 1000, 1500, 2250]
    assert [frame.n_cells for frame in read] == [2] * 4
    assert [frame["f"][0] for frame in read] == [0, 1, 2, 3]


def test_particles_come_back_as_their_number_changes(tmp_path):
    rng = np.random.default_rng(2)
    folder = tmp_path / "Läufe & mehr"
    attributes = {"units": ["Salz", "Ton & <Sand>"], "outline": np.arange(20000.0).reshape(-1, 2)}
    series = ParticleSeries(folder / "particles.xdmf", attributes)
    sent = []
    for i, count in enumerate((50, 50, 61, 1)):
        x, start = rng.normal(size=(count, 2)), rng.normal(size=(count, 2))
        unit = rng.integers(0, 300, count).astype(np.int16)
        series.write(i * MYR, x, {"unit": unit, "start": start}, time=-i * MYR)
        sent.append((x, unit, start))
    times, frames = read_all(folder / "particles.xdmf")
    assert times == [i * MYR for i in range(4)]
    for i, (frame, (x, unit, start)) in enumerate(zip(frames, sent, strict=True)):
        assert (frame.n_points, frame.n_cells) == (len(x), len(x))
        np.testing.assert_allclose(frame.points[:, :2], x, rtol=1e-6)
        np.testing.assert_array_equal(frame["unit"], unit)
        saved = read_particles(folder / "particles.h5", frame=i)
        np.testing.assert_array_equal(saved.x, x)
        np.testing.assert_array_equal(saved.data["unit"], unit)
        np.testing.assert_array_equal(saved.data["start"], start)
        assert saved.elapsed == i * MYR
        assert saved.data["unit"].dtype == np.int16
    last = read_particles(folder / "particles.xdmf")
    assert len(last.x) == 1
    assert last.attributes["units"] == attributes["units"]
    np.testing.assert_array_equal(last.attributes["outline"], attributes["outline"])


def test_long_series_goes_on_in_further_files(tmp_path, monkeypatch):
    monkeypatch.setattr(xdmf, "PART_SIZE", 20_000)
    series = MeshSeries(tmp_path / "fields.xdmf")
    for i in range(30):
        series.write(i, SQUARE, QUADRATIC, {"f": np.full(9, float(i))})
    files = sorted(path.name for path in tmp_path.iterdir())
    assert "fields-2.h5" in files
    assert files.count("fields.h5") == 1
    times, frames = read_all(tmp_path / "fields.xdmf")
    assert times == list(range(30))
    assert [frame["f"][8] for frame in frames] == list(range(30))
    MeshSeries(tmp_path / "fields.xdmf")
    assert list(tmp_path.iterdir()) == []


def test_particles_of_further_files_are_found(tmp_path, monkeypatch):
    monkeypatch.setattr(xdmf, "PART_SIZE", 20_000)
    series = ParticleSeries(tmp_path / "particles", {"units": ["salt"]})
    for i in range(20):
        series.write(i, np.full((100, 2), float(i)))
    assert (tmp_path / "particles-2.h5").exists()
    for frame in (0, 13, -1):
        saved = read_particles(tmp_path / "particles.h5", frame)
        assert saved.x[0, 0] == saved.elapsed == range(20)[frame]
        assert saved.attributes == {"units": ["salt"]}


@pytest.mark.parametrize("size", [20_000, 10**9])
def test_interrupted_series_goes_on(tmp_path, monkeypatch, size):
    monkeypatch.setattr(xdmf, "PART_SIZE", size)
    first = ParticleSeries(tmp_path / "p")
    for i in range(20):
        first.write(i, np.full((100, 2), float(i)))
    second = ParticleSeries(tmp_path / "p", until=4.0)
    assert read_all(tmp_path / "p.xdmf")[0] == [0, 1, 2, 3, 4]
    for i in (5, 6):
        second.write(i, np.full((101, 2), 10.0 * i))
    times, frames = read_all(tmp_path / "p.xdmf")
    assert times == [0, 1, 2, 3, 4, 5, 6]
    assert [frame.points[0, 0] for frame in frames] == [0, 1, 2, 3, 4, 50, 60]
    assert [frame.n_points for frame in frames] == [100] * 5 + [101] * 2
    with pytest.raises(CaseError, match="no frame 7; the file has 7"):
        read_particles(tmp_path / "p.h5", 7)


def test_time_must_ascend(tmp_path):
    series = ParticleSeries(tmp_path / "p")
    series.write(1.0, np.zeros((3, 2)))
    for elapsed in (1.0, 0.5, np.nan):
        with pytest.raises(ValueError, match="ascend"):
            series.write(elapsed, np.zeros((3, 2)))


@pytest.mark.parametrize(
    "data", [{"f": np.zeros(8)}, {"f": np.zeros((9, 4))}, {"a/b": np.zeros(9)}, {"f": 1.0}]
)
def test_values_that_do_not_fit_are_refused(tmp_path, data):
    with pytest.raises(ValueError, match=r"shape|slash"):
        MeshSeries(tmp_path / "m").write(0, SQUARE, QUADRATIC, data)
    assert list(tmp_path.iterdir()) == []


WRITER = """
import sys, numpy as np
from restoration.xdmf import ParticleSeries
series = ParticleSeries(sys.argv[1], {"units": ["salt"]})
rng = np.random.default_rng(0)
for i in range(100000):
    series.write(float(i), np.full((3000, 2), float(i)), {"unit": np.full(3000, i, np.int64)})
    print(i, flush=True)
"""


def test_killed_run_leaves_a_readable_pair(tmp_path):
    rng = np.random.default_rng(3)
    for attempt in range(6):
        path = tmp_path / str(attempt) / "particles.xdmf"
        command = [sys.executable, "-c", WRITER, str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
            child.stdout.readline()
            time.sleep(rng.uniform(0, 0.3))
            child.send_signal(signal.SIGKILL)
            acknowledged = len(child.stdout.read().split())
        times, frames = read_all(path)
        assert len(times) >= acknowledged + 1
        assert times == list(range(len(times)))
        assert [frame["unit"][-1] for frame in frames] == times
        assert read_particles(path).elapsed >= acknowledged


FULL = """
import sys, resource, numpy as np
from restoration.errors import OutputError
from restoration.xdmf import ParticleSeries
series = ParticleSeries(sys.argv[1])
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]), resource.RLIM_INFINITY))
try:
    for i in range(100):
        series.write(float(i), np.full((3000, 2), float(i)))
except OutputError as error:
    print(i, error)
"""


@pytest.mark.parametrize("limit", [100, 1_000, 100_000, 250_000, 300_000, 500_000, 1_000_000])
def test_write_that_fails_is_reported_and_leaves_the_last_frame(tmp_path, limit):
    """The system refuses to let files grow: what HDF5 does itself then is to crash at exit."""
    path = tmp_path / "particles.xdmf"
    command = [sys.executable, "-c", FULL, str(path), str(limit)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    frames, message = done.stdout.split(" ", 1)
    assert "particles" in message
    assert "--out" in message
    assert message.count("\n") == 1
    assert not list(tmp_path.glob(".*"))
    if int(frames):
        assert read_all(path)[0] == list(range(int(frames)))


def test_full_disk_is_seen_before_anything_is_written(tmp_path, monkeypatch):
    series = ParticleSeries(tmp_path / "particles")
    series.write(0, np.zeros((1000, 2)))
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}
    usage = writing.shutil.disk_usage(tmp_path)._replace(free=10_000)
    monkeypatch.setattr(writing.shutil, "disk_usage", lambda path: usage)
    with pytest.raises(OutputError, match=r"particles.h5: .* MB .* 0.0 MB: free some space"):
        series.write(1, np.zeros((1000, 2)))
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before
    monkeypatch.undo()
    series.write(1, np.ones((1000, 2)))
    assert read_all(tmp_path / "particles.xdmf")[0] == [0, 1]


def test_folder_that_is_a_file(tmp_path):
    (tmp_path / "out").write_text("")
    with pytest.raises(OutputError, match="a file stands where a folder is needed"):
        ParticleSeries(tmp_path / "out" / "particles").write(0, np.zeros((3, 2)))


def test_broken_series_cannot_go_on(tmp_path):
    (tmp_path / "p.h5").write_bytes(b"not HDF5")
    with pytest.raises(OutputError, match=r"p.h5: not readable: .* begin anew with --fresh"):
        ParticleSeries(tmp_path / "p", until=1.0)
    ParticleSeries(tmp_path / "p").write(0, np.zeros((3, 2)))


@pytest.mark.parametrize("lost", ["p.h5", "p-2.h5", "p-3.h5"])
def test_a_series_that_has_lost_frames_cannot_go_on(tmp_path, monkeypatch, lost):
    monkeypatch.setattr(xdmf, "PART_SIZE", 20_000)
    first = ParticleSeries(tmp_path / "p")
    for i in range(20):
        first.write(i, np.full((100, 2), float(i)))
    (tmp_path / lost).unlink()
    with pytest.raises(OutputError, match=r"p.h5: frames are missing: .* begin anew with --fresh"):
        ParticleSeries(tmp_path / "p", until=19.0)


def external(h5):
    h5["frames/000000/point/unit"] = h5py.ExternalLink("/etc/hostname", "x")


def soft(h5):
    h5["frames/000000/point/unit"] = h5py.SoftLink("/frames/000000/points")


def filtered(h5):
    h5.create_dataset("frames/000000/point/unit", data=np.zeros(3), compression="gzip")


def huge(h5):
    h5.create_dataset("frames/000000/point/unit", shape=(10**12,), dtype="i2", chunks=(1000,))


def short(h5):
    h5["frames/000000/point/unit"] = np.zeros(2)


def text(h5):
    h5["frames/000000/point/unit"] = np.array([b"a", b"b", b"c"])


def elsewhere(h5):
    h5.create_dataset(
        "frames/000000/point/unit", (3,), "f8", external=[("/etc/hostname", 0, h5py.h5f.UNLIMITED)]
    )


def virtual(h5):
    layout = h5py.VirtualLayout((3,), "f8")
    layout[:] = h5py.VirtualSource("/etc/hostname", "x", shape=(3,))
    h5.create_virtual_dataset("frames/000000/point/unit", layout)


def nan(h5):
    h5["frames/000000/points"][0, 0] = np.nan


def no_json(h5):
    del h5["attributes"]
    h5["attributes"] = np.bytes_(b"{")


def no_frames(h5):
    del h5["frames"]


@pytest.mark.parametrize(
    "attack",
    [external, soft, filtered, huge, short, text, elsewhere, virtual, nan, no_json, no_frames],
    ids=lambda attack: attack.__name__,
)
def test_particles_of_foreign_files_are_refused(tmp_path, attack):
    ParticleSeries(tmp_path / "p").write(0, np.zeros((3, 2)))
    with h5py.File(tmp_path / "p.h5", "a") as h5:
        attack(h5)
    with pytest.raises(CaseError, match=r"^p.h5: not a particle series of this program: \w"):
        read_particles(tmp_path / "p.h5")


@pytest.mark.parametrize("content", [b"", b"\x89HDF\r\n\x1a\n", json.dumps({}).encode()])
def test_files_that_are_no_series_are_refused(tmp_path, content):
    (tmp_path / "p.h5").write_bytes(content)
    with pytest.raises(CaseError, match=r"^p.h5: not a particle series"):
        read_particles(tmp_path / "p.h5")


def test_missing_series(tmp_path):
    with pytest.raises(CaseError, match=r"^p.h5: no such file$"):
        read_particles(tmp_path / "p.h5")

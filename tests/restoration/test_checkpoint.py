"""Checkpoints alone: what they hold, which one is taken, what is refused and how it is told."""

import hashlib
import json
import os
from collections import namedtuple

import h5py
import numpy as np
import pytest

from restoration import checkpoint, writing
from restoration.checkpoint import FORMAT, HEAD, KEPT, Checkpoints, packed, unpacked
from restoration.errors import CheckpointError, OutputError

Usage = namedtuple("Usage", "total used free")


def memory(step=1, rock=("kept-0",)):
    rock = {name: {"x": np.arange(3.0) + len(name)} for name in rock}
    return {"time": 2.5 * step, "step": step, "rock": rock}


def headed(rest):
    """Return a file whose user block says that the rest of it is whole."""
    about = {"format": FORMAT, "bytes": len(rest), "sha256": hashlib.sha256(rest).hexdigest()}
    return json.dumps(about).encode().ljust(HEAD - 1) + b"\n" + rest


def test_a_memory_comes_back_as_it_was():
    arrays = [
        np.arange(6).reshape(2, 3),
        np.array([np.nan, -0.0, np.inf, 5e-324]),
        np.zeros((0, 2)),
        np.array(7, np.int16),
        np.array([True, False]),
        np.array([2**64 - 1], np.uint64),
    ]
    plain = {"text": "\u00e4\n", "none": None, "flag": True, "number": 0.1, "whole": 2**60}
    given = plain | {"arrays": arrays, "deep": {"er": [{"x": arrays[0]}, 1]}}
    found = unpacked(packed(given), "memory")
    assert {name: found[name] for name in plain} == plain
    for one, other in zip(found["arrays"], arrays, strict=True):
        assert (one.dtype, one.shape) == (other.dtype, other.shape)
        assert one.tobytes() == other.tobytes()
    assert found["deep"]["er"][1] == 1
    np.testing.assert_array_equal(found["deep"]["er"][0]["x"], arrays[0])


def test_numbers_of_numpy_and_tuples_become_plain():
    found = unpacked(packed({"a": np.float64(0.1), "b": np.int32(3), "c": (1, np.bool_(True))}), "")
    assert found == {"a": 0.1, "b": 3, "c": [1, True]}
    assert [type(found[name]) for name in "ab"] == [float, int]


@pytest.mark.parametrize("array", [np.array([object()]), np.array(["text"]), np.zeros(1, complex)])
def test_arrays_that_could_be_anything_are_no_part_of_it(array):
    with pytest.raises(TypeError, match=r"\('deep', 0\): arrays of .* are not for checkpoints"):
        packed({"deep": [array]})


def test_the_file_is_hdf5_for_others_too(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    packed({"x": np.arange(3.0)})
    assert list(tmp_path.iterdir()) == []  # it is made in memory
    path = tmp_path / "checkpoint.h5"
    path.write_bytes(packed({"x": np.arange(3.0)}))
    with h5py.File(path) as h5:
        assert h5.userblock_size == HEAD
        assert h5["arrays/0"][()].tolist() == [0, 1, 2]
        assert json.loads(h5["about"][()].tobytes())["arrays"] == [["x"]]
    head = json.loads(path.read_bytes()[:HEAD])
    assert head["bytes"] == path.stat().st_size - HEAD


@pytest.mark.parametrize("content", [b"", b"x" * (HEAD - 1), b"x" * HEAD, b"x" * 5000])
def test_what_is_no_checkpoint_is_told(content):
    with pytest.raises(CheckpointError, match="step: is damaged, or no checkpoint of this version"):
        unpacked(content, "step")


def test_a_longer_and_a_shorter_one_is_damaged():
    content = packed(memory())
    for wrong in (content + b"\0", content[:-1], content[:HEAD]):
        with pytest.raises(CheckpointError, match="is damaged"):
            unpacked(wrong, "step")


def test_one_of_another_format_is_refused(monkeypatch):
    content = packed(memory())
    monkeypatch.setattr(checkpoint, "FORMAT", "of another kind")
    with pytest.raises(CheckpointError, match="no checkpoint of this version"):
        unpacked(content, "step")


@pytest.mark.parametrize(
    "about",
    [
        None,
        b"no JSON",
        b"[]",
        b"{}",
        b'{"memory": {}, "arrays": [["x", "y"]]}',
        b'{"memory": [], "arrays": [[5]]}',
        b'{"memory": {"x": 1}, "arrays": [["x"], ["y"]]}',
        b'{"memory": {}, "arrays": [[]]}',
    ],
)
def test_one_that_is_whole_but_says_nonsense_is_told(tmp_path, about):
    path = tmp_path / "file"
    with h5py.File(path, "w") as h5:
        if about is not None:
            h5["about"] = np.frombuffer(about, np.uint8)
            h5["arrays/0"] = np.zeros(1)
    with pytest.raises(CheckpointError, match="step: is not readable: "):
        unpacked(headed(path.read_bytes()), "step")
    with pytest.raises(CheckpointError, match="step: is not readable: "):
        unpacked(headed(b"no HDF5"), "step")


def test_the_last_ones_are_kept_and_the_newest_is_taken(tmp_path):
    checkpoints = Checkpoints(tmp_path / "checkpoints")
    assert checkpoints.newest() == (None, [])
    for step in range(8, 14):  # over the place where a digit is added
        checkpoints.write(step, memory(step))
    names = sorted(path.name for path in checkpoints.folder.iterdir())
    assert KEPT == 3  # so does the page on reliability
    steps = [f"step-{step:07d}.h5" for step in range(14 - KEPT, 14)]
    assert names == sorted(["kept-0.h5", "latest.json", *steps])
    latest = json.loads((checkpoints.folder / "latest.json").read_text())
    assert latest == {"file": "step-0000013.h5", "step": 13, "time_s": 32.5}
    found, notes = Checkpoints(checkpoints.folder).newest()
    assert (found["step"], found["time"], notes) == (13, 32.5, [])
    np.testing.assert_array_equal(found["rock"]["kept-0"]["x"], memory()["rock"]["kept-0"]["x"])


def test_what_does_not_change_is_written_once(tmp_path):
    checkpoints = Checkpoints(tmp_path / "checkpoints")
    checkpoints.write(1, memory(1))
    kept = checkpoints.folder / "kept-0.h5"
    first = kept.stat().st_mtime_ns, kept.stat().st_ino
    checkpoints.write(2, memory(2, ("kept-0", "kept-10")))
    assert (kept.stat().st_mtime_ns, kept.stat().st_ino) == first
    assert (checkpoints.folder / "kept-10.h5").exists()
    again = Checkpoints(checkpoints.folder)
    found, _ = again.newest()
    assert sorted(found["rock"]) == ["kept-0", "kept-10"]
    again.write(3, found | {"rock": found["rock"] | memory(1, ("kept-20",))["rock"]})
    assert (kept.stat().st_mtime_ns, kept.stat().st_ino) == first
    assert sorted(Checkpoints(again.folder).newest()[0]["rock"]) == ["kept-0", "kept-10", "kept-20"]


def test_damaged_ones_are_told_and_an_earlier_one_is_taken(tmp_path):
    checkpoints = Checkpoints(tmp_path)
    for step in (1, 2, 3):
        checkpoints.write(step, memory(step))
    (tmp_path / "step-0000003.h5").write_bytes(b"")
    (tmp_path / "step-0000002.h5").unlink()
    (tmp_path / "step-0000002.h5").mkdir()
    found, notes = Checkpoints(tmp_path).newest()
    assert found["step"] == 1
    assert notes == [
        "checkpoint step-0000003.h5: is damaged, or no checkpoint of this version; an earlier one "
        "is taken",
        "checkpoint step-0000002.h5: Is a directory; an earlier one is taken",
    ]


def test_one_that_lacks_what_it_shares_is_not_taken(tmp_path):
    Checkpoints(tmp_path).write(1, memory())
    (tmp_path / "kept-0.h5").unlink()
    found, notes = Checkpoints(tmp_path).newest()
    assert found is None
    assert "kept-0.h5: No such file or directory" in notes[0]


def test_one_that_is_too_large_is_not_read(tmp_path, monkeypatch):
    Checkpoints(tmp_path).write(1, memory())
    largest = max(path.stat().st_size for path in tmp_path.iterdir())
    monkeypatch.setattr(checkpoint, "LARGEST", largest)
    assert Checkpoints(tmp_path).newest()[1] == []
    monkeypatch.setattr(checkpoint, "LARGEST", largest - 1)
    assert "is too large" in Checkpoints(tmp_path).newest()[1][0]


def test_all_goes_at_the_end_and_nothing_else(tmp_path):
    checkpoints = Checkpoints(tmp_path / "checkpoints")
    checkpoints.write(1, memory())
    checkpoints.clear()
    assert not checkpoints.folder.exists()
    checkpoints.clear()  # nothing is there
    checkpoints.write(1, memory())
    (checkpoints.folder / "mine.txt").touch()
    checkpoints.clear()
    assert [path.name for path in checkpoints.folder.iterdir()] == ["mine.txt"]


def test_the_disk_must_have_room_for_two(tmp_path, monkeypatch):
    size = len(packed(memory()["rock"]["kept-0"]))
    for free, fits in ((2 * size, True), (2 * size - 1, False)):
        monkeypatch.setattr(writing.shutil, "disk_usage", lambda _, free=free: Usage(0, 0, free))
        checkpoints = Checkpoints(tmp_path / str(fits))
        with pytest.raises(OutputError, match="MB of free disk") as caught:
            checkpoints.write(1, memory() | {"large": np.zeros(10 * size)})
        assert ("kept-0" in str(caught.value)) is not fits


def test_each_is_on_the_disk_before_the_next_is_begun(tmp_path, monkeypatch):
    """Shared rock first, then the checkpoint, then the note that acknowledges it."""
    synced, fsync = [], os.fsync

    def noted(descriptor):
        synced.append(os.path.basename(os.readlink(f"/proc/self/fd/{descriptor}")))
        fsync(descriptor)

    monkeypatch.setattr(os, "fsync", noted)
    Checkpoints(tmp_path / "folder").write(1, memory())
    files = [".kept-0.h5.tmp", ".step-0000001.h5.tmp", ".latest.json.tmp"]
    assert synced == [part for file in files for part in (file, "folder")]


def test_a_folder_that_cannot_be_is_told(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(OutputError, match="a file stands where a folder is needed"):
        Checkpoints(tmp_path / "file" / "checkpoints").write(1, memory())

"""Checkpoints: files from which a run goes on as if nothing had happened.

A checkpoint is one file, written once: beside its place, synced to the disk, then renamed. It is an
HDF5 file whose user block holds a checksum of the rest, so that a byte that has changed is found
before anything is read. It holds arrays, numbers and texts and nothing that could be executed.
"""

import hashlib
import io
import json
import os
import stat
from contextlib import suppress
from pathlib import Path

import h5py
import numpy as np

from restoration.errors import CheckpointError
from restoration.writing import check_room, disk_faults, replacing, write_text

KEPT = 3  # checkpoints of a run
HEAD = 512  # bytes of the user block of HDF5
FORMAT = "restoration checkpoint 2"
LARGEST = 200_000_000_000  # bytes of a file that is read
KINDS = "fiub"  # of the arrays
DAMAGED = "is damaged, or no checkpoint of this version"


def packed(memory):
    """Return a memory as the bytes of a checkpoint file.

    Args:
        memory: dicts, lists, numbers, texts, None and arrays, one within the other.
    """
    plain = _without_arrays(memory, (), found := [])
    about = {"memory": plain, "arrays": [path for path, _ in found]}
    text = json.dumps(about).encode()
    with h5py.File("memory", "w", driver="core", backing_store=False, userblock_size=HEAD) as h5:
        h5["about"] = np.frombuffer(text, np.uint8)
        for number, (_, array) in enumerate(found):
            h5[f"arrays/{number}"] = array
        h5.flush()
        image = h5.id.get_file_image()  # without the user block
    return _head(image) + image


def unpacked(content, name):
    """Return the memory in the bytes of a checkpoint file.

    Args:
        content: bytes of the file.
        name: of the file, for messages.

    Raises:
        CheckpointError: it is not what `packed` has returned.
    """
    if len(content) < HEAD or content[:HEAD] != _head(content[HEAD:]):
        raise CheckpointError(f"{name}: {DAMAGED}")
    try:
        with h5py.File(io.BytesIO(content), "r") as h5:
            about = json.loads(h5["about"][()].tobytes())
            memory = about["memory"]
            for number, path in enumerate(about["arrays"]):
                at = memory
                for key in path[:-1]:
                    at = at[key]
                at[path[-1]] = h5[f"arrays/{number}"][()]
    except (OSError, RuntimeError, LookupError, TypeError, ValueError) as error:
        raise CheckpointError(f"{name}: is not readable: {error}") from error
    return memory


def _head(rest):
    """Return the user block for the rest of a file."""
    checksum = hashlib.sha256(rest).hexdigest()
    head = json.dumps({"format": FORMAT, "bytes": len(rest), "sha256": checksum})
    return head.encode().ljust(HEAD - 1) + b"\n"


def _without_arrays(value, path, found):
    """Return a memory without its arrays, which are added with their places to a list."""
    if isinstance(value, dict):
        return {key: _without_arrays(v, (*path, key), found) for key, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_without_arrays(v, (*path, i), found) for i, v in enumerate(value)]
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        if value.dtype.kind not in KINDS:
            raise TypeError(f"{path}: arrays of {value.dtype} are not for checkpoints")
        found.append((path, value))
        return None
    return value


class Checkpoints:
    """The checkpoints of a run.

    Args:
        folder: where they are, made by `write`.
    """

    def __init__(self, folder):
        self.folder, self._written = Path(folder), set()

    def write(self, step, memory):
        """Write a checkpoint, durable when this returns, and remove all but the last ones.

        Args:
            step: number of the step that was made last; it is in the name.
            memory: see `packed`. Its entry ``rock`` holds what does not change any more, by names
                such as ``kept-0``: each is a file of its own, written once.

        Raises:
            OutputError: it could not be written.
        """
        rock = memory["rock"]
        for name in rock.keys() - self._written:
            self._put(self.folder / f"{name}.h5", packed(rock[name]))
            self._written.add(name)
        path = self.folder / f"step-{step:07d}.h5"
        self._put(path, packed(memory | {"rock": sorted(rock)}))
        latest = {"file": path.name, "step": step, "time_s": memory["time"]}
        write_text(self.folder / "latest.json", json.dumps(latest) + "\n", durable=True)
        for old in self._steps()[KEPT:]:
            with disk_faults(old):
                old.unlink(missing_ok=True)

    def newest(self):
        """Return the memory of the newest whole checkpoint, and notes on those that are not.

        Returns:
            The memory, or None where there is none, and a list of texts.
        """
        notes = []
        for path in self._steps():
            try:
                memory = _read(path)
                rock = {name: _read(self.folder / f"{name}.h5") for name in memory["rock"]}
                self._written = set(rock)
                return memory | {"rock": rock}, notes
            except CheckpointError as error:
                notes.append(f"checkpoint {error}; an earlier one is taken")
        return None, notes

    def clear(self):
        """Remove all of them, and the folder if nothing else is in it."""
        for path in (*self._steps(), *self.folder.glob("kept-*.h5"), self.folder / "latest.json"):
            with disk_faults(path):
                path.unlink(missing_ok=True)
        with suppress(OSError):
            self.folder.rmdir()

    def _put(self, path, content):
        with disk_faults(path):
            path.parent.mkdir(exist_ok=True)
        check_room(path, 2 * len(content))
        with replacing(path, durable=True) as temporary:
            temporary.write_bytes(content)

    def _steps(self):
        """Return the paths of the checkpoints, the newest first."""
        return sorted(self.folder.glob("step-[0-9]*.h5"), reverse=True)


def _read(path):
    """Return the memory in a checkpoint file, of which no more is read than it says it has."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # no wait for a pipe
        with open(descriptor, "rb") as file:
            size = os.fstat(descriptor).st_size
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise CheckpointError(f"{path.name}: is not a regular file")
            if size > LARGEST:
                raise CheckpointError(f"{path.name}: is too large")
            head = file.read(HEAD)
            if f'"bytes": {size - HEAD},'.encode() not in head:
                raise CheckpointError(f"{path.name}: {DAMAGED}")
            return unpacked(head + file.read(size - HEAD), path.name)
    except OSError as error:
        raise CheckpointError(f"{path.name}: {error.strerror}") from error

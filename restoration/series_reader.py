"""The reader of particle series (HDF5), run apart by `saved`: files may come from anywhere."""

import json
import math
import os
import sys
from pathlib import Path

import h5py
import numpy as np

from restoration.apart import answer
from restoration.errors import CaseError

MOST_DATA = 100  # values of a particle
MOST_SPACE = 2  # axes of an array


def read_frame(filled, frame, *files):
    """Write a frame of a particle series as .npz.

    Links, filters and data kept elsewhere are refused, and so is an array larger than the file.

    Args:
        filled: open file; gets ``x`` (n, 2), ``about`` (JSON of names, attributes and elapsed time)
            and ``data_0``, ``data_1``.. in the order of the names.
        frame: number of the frame, from 0, or from the end when negative.
        files: all .h5 of the series.

    Raises:
        CaseError: they cannot be read, or are no such series, or have no such frame.
    """
    try:
        frames = [(file, name) for file in files for name in _frame_names(file)]
        if not -len(frames) <= int(frame) < len(frames):
            raise CaseError(f"no frame {frame}; the file has {len(frames)}")
        file, name = frames[int(frame)]
        with h5py.File(file, "r") as h5:
            x, data, about = _read(
                _member(_member(h5, "frames"), name), _member(h5, "attributes", "S")
            )
    except FileNotFoundError:
        raise CaseError("no such file") from None
    except (OSError, RuntimeError, LookupError, TypeError, ValueError, OverflowError) as error:
        fault = str(error).strip("'\"")
        raise CaseError(f"not a particle series of this program: {fault}") from error
    about = np.frombuffer(json.dumps(about).encode(), np.uint8)
    np.savez(filled, x=x, about=about, **{f"data_{i}": v for i, v in enumerate(data)})


def _frame_names(file):
    with h5py.File(file, "r") as h5:
        return sorted(_member(h5, "frames"))


def _read(group, attributes):
    """Return positions, values and what is told about them, of the group of a frame."""
    x = _member(group, "points", "f")[()].astype(float)
    values = _member(group, "point") if "point" in group else {}
    if len(values) > MOST_DATA:
        raise ValueError(f"a particle has {len(values)} values; at most {MOST_DATA} are read")
    data = {name: _member(values, name, "fiu")[()] for name in values}
    if x.shape[1:] == (3,):
        raise ValueError("its particles have three coordinates, and a section has two")
    if x.ndim != 2 or x.shape[1] != 2 or any(v.shape[:1] != x.shape[:1] for v in data.values()):
        raise ValueError("the arrays do not fit each other")
    if not np.isfinite(x).all():
        raise ValueError("a position is not finite")
    elapsed = float(group.attrs["elapsed"])
    if not math.isfinite(elapsed):
        raise ValueError("its time is not finite")
    about = {"names": [*data], "attributes": json.loads(attributes[()]), "elapsed": elapsed}
    return x, [v[:, :2] if v.ndim == 2 else v for v in data.values()], about


def _member(group, name, kinds=None):
    """Return a member of an HDF5 group: a group, or a dataset whose dtype is one of ``kinds``."""
    link = group.get(name, getlink=True)
    if link is None:
        raise ValueError(f"there is no {name}")
    if not isinstance(link, h5py.HardLink):
        raise ValueError(f"{name} is a link")
    member = group[name]
    if not isinstance(member, h5py.Group if kinds is None else h5py.Dataset):
        raise ValueError(f"{name} is not what it should be")
    if kinds is None:
        return member
    settings = member.id.get_create_plist()
    if member.is_virtual or settings.get_external_count() or settings.get_nfilters():
        raise ValueError(f"{name} is filtered or stored elsewhere")
    shape = member.shape  # of an empty one None
    if shape is None or len(shape) > MOST_SPACE or member.dtype.kind not in kinds:
        raise ValueError(f"{name} is not what it should be")
    size = math.prod(map(int, shape)) * member.dtype.itemsize  # which overflows no int of Python
    if size > os.path.getsize(group.file.filename):
        raise ValueError(f"{name} is larger than the file")
    return member


def main():
    """Answer `apart.read_apart`; the arguments are the frame and the files."""
    return answer(lambda filled, frame, *files: read_frame(filled, frame, *map(Path, files)))


if __name__ == "__main__":
    sys.exit(main())

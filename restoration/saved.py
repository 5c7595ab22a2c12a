"""A particle cloud saved by an earlier run, for the start of another one."""

import json
import os
from dataclasses import dataclass
from itertools import count, takewhile
from pathlib import Path

import h5py
import numpy as np

from restoration.errors import CaseError


@dataclass(frozen=True, eq=False)
class SavedParticles:
    """A frame of a particle series.

    Attributes:
        x: positions, shape (n, 2), m.
        data: values by name, such as ``unit``, one row per particle.
        attributes: what the series tells about its run, such as the names of the units.
        elapsed: time the run had run, s.
    """

    x: np.ndarray
    data: dict[str, np.ndarray]
    attributes: dict
    elapsed: float


def read_particles(path, frame=-1):
    """Return a frame of a particle series as `SavedParticles`.

    The file may come from anywhere: links and filters are refused, and so is an array that is
    larger than the file.

    Args:
        path: path of the .h5, or of the .xdmf beside it.
        frame: number of the frame, from 0, or from the end when negative.

    Raises:
        CaseError: the file cannot be read, or is no such series, or has no such frame.
    """
    path = Path(path).with_suffix(".h5")
    try:
        frames = [(file, name) for file in parts(path) for name in _frame_names(file)]
        if not -len(frames) <= frame < len(frames):
            raise CaseError(f"{path.name}: no frame {frame}; the file has {len(frames)}")
        file, name = frames[frame]
        with h5py.File(file, "r") as h5:
            return _read(_member(_member(h5, "frames"), name), _member(h5, "attributes", "S"))
    except FileNotFoundError:
        raise CaseError(f"{path.name}: no such file") from None
    except (OSError, RuntimeError, KeyError, TypeError, ValueError) as error:
        fault = str(error).strip("'\"")
        raise CaseError(f"{path.name}: not a particle series of this program: {fault}") from error


def part(path, number):
    """Return the path of an .h5 of a series; ``number`` counts from 1."""
    return path.with_name(f"{path.stem}{'' if number == 1 else f'-{number}'}.h5")


def parts(path):
    """Return the paths of all .h5 of a series; of the first one even if it is missing."""
    more = takewhile(lambda number: part(path, number).exists(), count(2))
    return [part(path, number) for number in (1, *more)]


def _frame_names(file):
    with h5py.File(file, "r") as h5:
        return sorted(_member(h5, "frames"))


def _read(group, attributes):
    """Return the particles of the group of a frame."""
    x = _member(group, "points", "f")[()]
    values = _member(group, "point") if "point" in group else {}
    data = {name: _member(values, name, "fi")[()] for name in values}
    if x.shape[1:] == (3,):
        raise ValueError("its particles have three coordinates, and a section has two")
    if x.ndim != 2 or x.shape[1] != 2 or any(v.shape[:1] != x.shape[:1] for v in data.values()):
        raise ValueError("the arrays do not fit each other")
    if not np.isfinite(x).all():
        raise ValueError("a position is not finite")
    return SavedParticles(
        x=x,
        data={name: v[:, :2] if v.ndim == 2 else v for name, v in data.items()},
        attributes=json.loads(attributes[()]),
        elapsed=float(group.attrs["elapsed"]),
    )


def _member(group, name, kinds=None):
    """Return a member of an HDF5 group: a group, or a dataset whose dtype is one of ``kinds``."""
    if not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise ValueError(f"{name} is a link")
    member = group[name]
    if isinstance(member, h5py.Group) != (kinds is None):
        raise ValueError(f"{name} is not what it should be")
    if kinds is None:
        return member
    settings = member.id.get_create_plist()
    if member.is_virtual or settings.get_external_count() or settings.get_nfilters():
        raise ValueError(f"{name} is filtered or stored elsewhere")
    if member.dtype.kind not in kinds or member.nbytes > os.path.getsize(group.file.filename):
        raise ValueError(f"{name} is not what it should be, or larger than the file")
    return member

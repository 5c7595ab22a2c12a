"""A particle cloud saved by an earlier run, for the start of another one."""

import json
from dataclasses import dataclass
from itertools import count, takewhile
from pathlib import Path

import numpy as np

from restoration.apart import GB, read_apart
from restoration.errors import CaseError
from restoration.files import MB

LARGEST = 500 * MB  # of an .h5
SECONDS = 5  # of computing, and one more for each
SPEED = 10 * MB


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

    The file may come from anywhere: it is read by another process (`series_reader`), since HDF5
    may crash or go round for ever in one that is damaged.

    Args:
        path: path of the .h5, or of the .xdmf beside it.
        frame: number of the frame, from 0, or from the end when negative.

    Raises:
        CaseError: the file cannot be read, or is no such series, or has no such frame.
    """
    path = Path(path).with_suffix(".h5")
    files = parts(path)
    sizes = [file.stat().st_size for file in files if file.is_file()]
    if max(sizes, default=0) > LARGEST:
        largest = f"{max(sizes) / MB:.1f} MB large; at most {LARGEST / MB:g} MB are read"
        raise CaseError(f"{path.name}: is {largest}")
    arguments = [str(frame), *(str(file.absolute()) for file in files)]
    limits = SECONDS + sum(sizes) // SPEED, 2 * GB + 4 * sum(sizes)
    with read_apart("restoration.series_reader", arguments, path.name, *limits) as answer:
        read = np.load(answer, allow_pickle=False)
        about = json.loads(read["about"].tobytes())
        return SavedParticles(
            x=read["x"],
            data={name: read[f"data_{i}"] for i, name in enumerate(about["names"])},
            attributes=about["attributes"],
            elapsed=about["elapsed"],
        )


def part(path, number):
    """Return the path of an .h5 of a series; ``number`` counts from 1."""
    return path.with_name(f"{path.stem}{'' if number == 1 else f'-{number}'}.h5")


def parts(path):
    """Return the paths of all .h5 of a series; of the first one even if it is missing."""
    more = takewhile(lambda number: part(path, number).exists(), count(2))
    return [part(path, number) for number in (1, *more)]

"""Particles that a case brings along: a CSV table, or the particles of an earlier run."""

import csv

import numpy as np

from restoration.errors import CaseError, Fault
from restoration.files import MB, read_text
from restoration.words import hint, listed, quoted

LARGEST = 500 * MB
MOST_FAULTS = 20


def read_cloud(path, shown, scale, sign):
    """Return a cloud of particles.

    Args:
        path: a ``.csv`` with the columns x, z and unit (or rock), or the ``particles.h5`` of a run.
        shown: its name in messages.
        scale: m in a unit of the coordinates (of a table; a run's are in m).
        sign: -1 where the second coordinate is depth.

    Returns:
        Positions (n, 2), m; row of the unit names (n,), int16; the names.

    Raises:
        CaseError: it cannot be read, with the lines of a table.
    """
    if path.suffix.lower() == ".h5":
        return _from_run(path, shown)
    rows = list(csv.reader(read_text(path, shown, LARGEST).splitlines()))
    header = [name.strip().casefold() for name in rows[0]]
    kind = "unit" if "unit" in header else "rock"
    lost = [name for name in ("x", "z", kind) if name not in header]
    if lost:
        found = f"the first line names {listed(header, last='and')}"
        message = f"{found}; columns x, z and unit are needed{hint(lost[0], header)}"
        raise CaseError([Fault(shown, 1, None, "", message)])
    columns = [header.index(name) for name in ("x", "z", kind)]
    x, names, faults = [], [], []
    for number, row in enumerate(rows[1:], start=2):
        if not any(field.strip() for field in row):
            continue
        try:
            values = [row[column].strip() for column in columns]
            point = float(values[0]), float(values[1])
            if not np.isfinite(point).all() or not values[2]:
                raise ValueError
        except (ValueError, IndexError):
            message = f"{quoted(','.join(row))} is not a finite x, a finite z and a unit"
            faults.append(Fault(shown, number, None, "", message))
            if len(faults) == MOST_FAULTS:
                break
            continue
        x.append(point)
        names.append(values[2])
    if not x and not faults:
        faults.append(Fault(shown, None, None, "", "holds no particle"))
    if faults:
        raise CaseError(faults)
    known, unit = np.unique(names, return_inverse=True)
    return np.array(x) * (scale, scale * sign), unit.astype(np.int16), tuple(map(str, known))


def _from_run(path, shown):
    """Return the last frame of the particles of a run."""
    from restoration.saved import read_particles

    saved = read_particles(path)
    names = saved.attributes.get("unit_names")
    if names is None or "unit" not in saved.data:
        raise CaseError([Fault(shown, None, None, "", "holds no particles of a run")])
    return saved.x[:, :2], saved.data["unit"].astype(np.int16), tuple(map(str, names))

"""Particles that a case brings along: a CSV table, or the particles of an earlier run."""

import csv
import re

import numpy as np

from restoration.errors import CaseError, Fault
from restoration.files import MB, read_text
from restoration.saved import read_particles
from restoration.words import hint, listed, quoted, wrong_name

LARGEST = 500 * MB
MOST_FAULTS = 20
MOST_UNITS = 1000
LONGEST_LINE = 1000  # characters
LINE_END = re.compile("\r\n|\n|\r")  # no other sign ends a line: it may stand in a name
DIGITS = np.array([0, *map(ord, "0123456789.eE+- ")], np.uint32)  # 0 fills up


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
    text = LINE_END.split(read_text(path, shown, LARGEST))
    for number, line in enumerate(text, 1):
        if len(line) > LONGEST_LINE:  # a table of text is as wide as its widest entry everywhere
            message = f"is a line of {len(line)} characters; at most {LONGEST_LINE} are read"
            raise _refused(shown, message, number)
    header = [name.strip().strip('"').casefold() for name in text[0].split(",")]
    kind = "unit" if "unit" in header else "rock"
    lost = [name for name in ("x", "z", kind) if name not in header]
    if lost:
        found = f"the first line names {listed(header, last='and')}"
        near = "; separate them by commas" if ";" in text[0] else hint(lost[0], header)
        message = f"{found}; columns x, z and unit are needed{near}"
        raise _refused(shown, message, 1)
    if double := [name for name in ("x", "z", kind) if header.count(name) > 1]:
        message = f"the first line names {double[0]} twice; keep one"
        raise _refused(shown, message, 1)
    columns = [header.index(name) for name in ("x", "z", kind)]
    if not any(line.strip() for line in text[1:]):
        raise _refused(shown, "holds no particle")
    try:
        form = {"dtype": str, "delimiter": ",", "quotechar": '"', "comments": None, "ndmin": 2}
        table = np.loadtxt(text[1:], usecols=columns, **form)
        numbers = np.ascontiguousarray(table[:, :2])
        x = numbers.astype(float)
        names = np.char.strip(table[:, 2])
        if not np.isin(numbers.view(np.uint32), DIGITS).all():  # 1_000 is a float of Python
            raise ValueError
        if not np.isfinite(x).all() or (names == "").any():
            raise ValueError
    except ValueError:
        raise CaseError(_row_faults(text, columns, shown)) from None
    known, unit = np.unique(names, return_inverse=True)
    if len(known) > MOST_UNITS:
        message = f"names {len(known)} units, at most {MOST_UNITS} are possible"
        raise _refused(shown, message)
    if wrong := _wrong_names(known):
        raise _refused(shown, wrong)
    return x * (scale, scale * sign), unit.astype(np.int16), tuple(map(str, known))


def _wrong_names(names):
    """Return why one of the names of units cannot be, or None."""
    found = ((name, wrong_name(str(name))) for name in names)
    return next((f"the unit {quoted(name)} {wrong}" for name, wrong in found if wrong), None)


def _row_faults(text, columns, shown):
    """Return the faults of the rows of a table that could not be read."""
    faults = []
    for number, line in enumerate(text[1:], start=2):
        if not line.strip():
            continue
        fields = [field.strip() for field in next(csv.reader([line]))]
        try:
            values = [fields[column] for column in columns]
            odd = {*values[0], *values[1]} - {*map(chr, DIGITS)}
            if odd or not np.isfinite([*map(float, values[:2])]).all() or not values[2]:
                raise ValueError
        except (ValueError, IndexError):
            message = f"{quoted(line)} is not a finite x, a finite z and a unit"
            faults.append(Fault(shown, number, None, "", message))
            if len(faults) == MOST_FAULTS:
                break
    return faults or [Fault(shown, None, None, "", "is not a table of x, z and unit")]


def _from_run(path, shown):
    """Return the last frame of the particles of a run."""
    saved = read_particles(path)
    attributes = saved.attributes if isinstance(saved.attributes, dict) else {}
    names, unit = attributes.get("unit_names"), saved.data.get("unit")
    if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
        raise _refused(shown, "does not name its units")
    if unit is None or unit.ndim != 1 or not np.issubdtype(unit.dtype, np.integer):
        raise _refused(shown, "has no unit for its particles")
    if not len(unit) or unit.min() < 0 or unit.max() >= len(names):
        message = f"its particles are not all of its {len(names)} units"
        raise _refused(shown, message)
    if not np.isfinite(saved.x).all():
        raise _refused(shown, "has particles that are nowhere")
    if len(names) > MOST_UNITS:
        message = f"names {len(names)} units, at most {MOST_UNITS} are possible"
        raise _refused(shown, message)
    if len({*names}) < len(names):
        raise _refused(shown, "gives two units one name")
    if wrong := _wrong_names(names):
        raise _refused(shown, wrong)
    present, unit = np.unique(unit, return_inverse=True)
    return saved.x[:, :2], unit.astype(np.int16), tuple(names[row] for row in present)


def _refused(shown, message, line=None):
    return CaseError([Fault(shown, line, None, "", message)])

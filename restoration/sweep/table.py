"""The table of a sweep: a row for every run, from what lies in the run folders."""

import csv
import io
import json
from dataclasses import asdict, dataclass
from pathlib import Path

from restoration.errors import CaseError, StoppedError
from restoration.sweep.runs import written
from restoration.units import number
from restoration.words import counted, listed
from restoration.writing import write_text

CSV, JSON = "sweep.csv", "sweep.json"
STATES = ("done", "stopped", "failed", "refused", "waiting")
# The entries of run.json that a row has, by the name of the column.
NUMBERS = {
    "steps": ("steps",),
    "stokes_solves": ("stokes_solves",),
    "run_wall_s": ("wall_s",),
    "peak_rss_mb": ("peak_rss_mb",),
    "time_reached_s": ("time_reached_s",),
    "area_change": ("area_change",),
    "worst_residual": ("worst_residual",),
    "back_mean_m": ("there_and_back", "mean_m"),
    "back_p99_m": ("there_and_back", "p99_m"),
    "back_max_m": ("there_and_back", "max_m"),
    "surface_relief_m": ("surface_relief_m",),
    "surface_rms_slope": ("surface_rms_slope",),
    "stopped_m": ("stopped", "value_m"),
    "stopped_s": ("stopped", "time_s"),
    "viscosity_factor": ("viscosity_factor",),
    "certificate": ("certificate", "verdict"),
}
# Of all horizons the greatest: column, table of the record, entry of its rows.
GREATEST = {
    "horizons_mean_m": (("horizons",), "mean_m"),
    "horizons_max_m": (("horizons",), "max_m"),
    "predicted_m": (("certificate", "horizons"), "predicted_m"),
}
FLATNESS = "flatness_m"  # of the last row of diagnostics.csv
# Columns of the short table: of the row, their heads, and digits.
SHORT = {
    "steps": "steps",
    "wall_s": "s",
    "flatness_m": "flatness/m",
    "back_mean_m": "back/m",
    "back_max_m": "at most/m",
    "horizons_max_m": "horizons/m",
    "predicted_m": "predicted/m",
    "stopped_s": "stop/s",
}
WIDEST = 100  # characters of a note in the short table


@dataclass(frozen=True)
class Row:
    """What became of a run.

    Attributes:
        number: of the run, from 1.
        folder: name of its run folder, or None.
        entries: values by entry of the case.
        state: one of `STATES`.
        exit_code: of its last try; None where it was not tried.
        error: one line, or empty.
        wall_s: seconds of its last try, all of it; None where it was not tried.
        numbers: by column, see `NUMBERS`; empty where there are none.
    """

    number: int
    folder: str | None
    entries: dict
    state: str
    exit_code: int | None = None
    error: str = ""
    wall_s: float | None = None
    numbers: dict | None = None

    def plain(self):
        """Return the row as plain values, columns that are absent as None."""
        row = asdict(self)
        found = row.pop("numbers") or {}
        return row | dict.fromkeys((*NUMBERS, *GREATEST, FLATNESS)) | found


def row_of(run, out, ended=None, before=None):
    """Return the row of a run.

    Args:
        run: `runs.Run`.
        out: folder of the sweep.
        ended: `children.Ended` of the try just made, or None.
        before: row of this folder in the table that was there, plain values, or None.
    """
    make = (run.number, run.folder, run.variation.entries)
    if run.faults:
        more = len(run.faults) - 1
        text = str(run.faults[0]) + (f" (and {counted(more, 'more fault')})" if more else "")
        return Row(*make, "refused", CaseError.exit_code, text)
    folder = Path(out) / run.folder
    record = read_record(folder / "run.json")
    numbers = numbers_of(record, folder)
    wall = round(ended.wall_s, 3) if ended else (before or {}).get("wall_s")
    if record.get("case_sha256") == run.sha256 and record.get("ended_well") is True:
        if ended is None or ended.code == 0:
            return Row(*make, "done", 0, "", wall, numbers)
    if ended is not None:
        return Row(*make, *_state(ended, folder), wall, numbers)
    if before and before.get("state") in ("failed", "stopped"):
        code, error = before.get("exit_code"), str(before.get("error") or "")
        return Row(*make, before["state"], code, error, wall, numbers)
    if record:
        code = record.get("exit_code")
        state = "stopped" if code == StoppedError.exit_code else "failed"
        return Row(*make, state, code, f"see {folder / 'log.txt'}", wall, numbers)
    return Row(*make, "waiting")


def _state(ended, folder):
    """Return state, exit code and error of a try that did not end well."""
    if ended.code == StoppedError.exit_code:
        return "stopped", ended.code, ended.error
    if ended.code == 0:  # yet its record is not that of this run
        return "failed", 1, f"{folder} holds another run: the case file has changed meanwhile"
    return "failed", ended.code, ended.error


def read_record(path):
    """Return the record of a run, or the table of a sweep; empty where it cannot be read."""
    try:
        found = json.loads(Path(path).read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def numbers_of(record, folder):
    """Return the main numbers of a record by column; absent ones are None."""
    found = {name: _at(record, path) for name, path in NUMBERS.items()}
    for name, (path, entry) in GREATEST.items():
        rows = _at(record, path)
        values = [row.get(entry) for row in rows if isinstance(row, dict)] if rows else []
        # one horizon that is not known to any bound leaves the greatest unknown
        found[name] = max(values) if values and None not in values else None
    found[FLATNESS] = _last_flatness(Path(folder) / "diagnostics.csv")
    return found


def _at(record, path):
    """Return what a record holds at a path, or None."""
    for part in path:
        record = record.get(part) if isinstance(record, dict) else None
    return record


def _last_flatness(path):
    """Return the flatness in the last row of a table of steps, or None."""
    try:
        with open(path, newline="", encoding="utf-8") as stream:
            rows = list(csv.DictReader(stream))
        return float(rows[-1][FLATNESS])
    except (OSError, ValueError, KeyError, IndexError, TypeError):
        return None


def plain(sweep, rows):
    """Return the table as plain values for JSON."""
    return {
        "title": sweep.title,
        "sweep": str(sweep.path),
        "case": str(sweep.case),
        "set": sweep.shared,
        "counts": counts(rows),
        "runs": [row.plain() for row in rows],
    }


def counts(rows):
    """Return how many rows there are by state, all of `STATES`."""
    return {state: sum(row.state == state for row in rows) for state in STATES}


def counts_text(rows):
    """Return how many rows there are by state, in words."""
    found = [f"{count} {state}" for state, count in counts(rows).items() if count]
    return f"{counted(len(rows), 'run')}: {listed(found, last='and')}"


def write_table(out, sweep, rows):
    """Write the table as CSV and JSON into the folder of a sweep.

    Raises:
        OutputError: a file could not be written.
    """
    stream, table = io.StringIO(newline=""), plain(sweep, rows)
    writer = csv.writer(stream, lineterminator="\n")
    first = table["runs"][0]
    columns = [name for name in first if name != "entries"]
    at = columns.index("state")
    writer.writerow([*columns[:at], *sweep.entries, *columns[at:]])
    for row in table["runs"]:
        own = [written(row["entries"][n]) if n in row["entries"] else "" for n in sweep.entries]
        values = ["" if row[name] is None else row[name] for name in columns]
        writer.writerow([*values[:at], *own, *values[at:]])
    write_text(Path(out) / CSV, stream.getvalue())
    write_text(Path(out) / JSON, json.dumps(table, indent=1, allow_nan=False) + "\n")


def table_text(sweep, rows):
    """Return the short table: what was varied, what became of it, the main numbers."""
    heads, plains = shortened(sweep.entries), [row.plain() for row in rows]
    shown = [name for name in SHORT if any(row[name] is not None for row in plains)]
    lines = [["", *heads, "state", *(SHORT[name] for name in shown), ""]]
    for row in plains:
        own = [written(row["entries"][n]) if n in row["entries"] else "" for n in sweep.entries]
        values = ["" if row[name] is None else number(row[name]) for name in shown]
        note = row["error"] if len(row["error"]) <= WIDEST else row["error"][: WIDEST - 3] + "..."
        lines.append([str(row["number"]), *own, row["state"], *values, note])
    widths = [max(len(line[i]) for line in lines) for i in range(len(lines[0]))]
    left = {*range(1, 2 + len(heads)), len(widths) - 1}
    return "\n".join(
        "  ".join(
            text.ljust(width) if i in left else text.rjust(width)
            for i, (text, width) in enumerate(zip(line, widths, strict=True))
        ).rstrip()
        for line in lines
    )


def shortened(names):
    """Return entries by as many of their last parts as tell them apart."""
    found = []
    for name in names:
        parts = name.split(".")
        for length in range(1, len(parts) + 1):
            text = ".".join(parts[-length:])
            if not any(other != name and f".{other}".endswith(f".{text}") for other in names):
                break
        found.append(text)
    return found

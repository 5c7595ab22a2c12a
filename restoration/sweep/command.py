"""The command `restore sweep`: reads the file, runs what is missing, tells and keeps."""

import json
import os
import sys
from contextlib import closing
from pathlib import Path

from restoration.errors import CaseError, StoppedError
from restoration.launch import cores
from restoration.run_folder import locked
from restoration.stop_request import StopRequest
from restoration.sweep.children import run_children
from restoration.sweep.file import read_sweep
from restoration.sweep.runs import folders_of_others, planned
from restoration.sweep.table import (
    JSON,
    counts,
    counts_text,
    plain,
    read_record,
    row_of,
    table_text,
    write_table,
)
from restoration.words import counted, listed
from restoration.writing import disk_faults, write_text

INCOMPLETE = 1  # exit code of a sweep some of whose runs are not done
MOST_WORKERS = 1000
# Seconds that what MPI has started beside a run may still hold the folder after the last run.
PATIENCE = 3.0
GIVEN = "sweep.yaml"  # in the folder of a sweep: the file as given


def sweep(
    path,
    sets=(),
    outside=False,
    out=None,
    workers=None,
    list_only=False,
    as_json=False,
    quiet=False,
):
    """Run what is missing of a sweep, and return the exit code.

    Args:
        path: the sweep file.
        sets: overrides of all runs, texts ``a.b=value``.
        outside: whether the sweep and its case may name files outside their folders.
        out: folder of the sweep; None for ``runs/<sweep>``.
        workers: runs at a time; None for one on each core.
        list_only: tell what would be run, and run nothing.
        as_json: print JSON and nothing else.
        quiet: no word of single runs.

    Raises:
        CaseError: the sweep is refused, all of its runs are, or the folder holds something else.
        OutputError: the table could not be written; all runs have been stopped.
    """
    if workers is not None and not 1 <= workers <= MOST_WORKERS:
        raise CaseError(f"--workers: {workers} is not possible; 1 to {MOST_WORKERS} are")
    found = read_sweep(path, outside)
    runs, notes = planned(found, sets, outside)
    out = Path(out) if out is not None else Path("runs") / found.name
    _only_a_sweep(out)

    def tell(text):
        if not quiet:
            print(text, file=sys.stderr, flush=True)

    def answer(rows):
        if as_json:
            print(json.dumps(plain(found, rows), indent=1, allow_nan=False))
        else:
            print(table_text(found, rows))
            print(f"{counts_text(rows)}; {out}")
        return 0 if all(row.state == "done" for row in rows) else INCOMPLETE

    for note in notes:
        print(f"note: {note}", file=sys.stderr)
    for run in runs:
        for fault in run.faults:
            print(f"refused: run {run.number}: {fault}", file=sys.stderr)
    if list_only:
        answer(_rows(runs, out).values())
        return INCOMPLETE if any(run.faults for run in runs) else 0
    with StopRequest() as stop, locked(out, "sweep", PATIENCE) as lock:
        rows = _swept(found, runs, out, workers, outside, stop, lock, tell)
        code = answer(rows.values())
    if stop.wanted:
        raise StoppedError(
            f"stopped on request with {counts(rows.values())['done']} of {len(rows)} runs done; "
            "the same command goes on"
        )
    return code


def _swept(found, runs, out, workers, outside, stop, lock, tell):
    """Run what is missing, keep the table, and return the rows by number of the run.

    Args:
        found: the sweep, as `file.read_sweep` gives it.
        runs: all of its runs.
        out: folder of the sweep.
        workers: runs at a time; None for one on each core.
        outside: whether runs may name files outside their folders.
        stop: `stop_request.StopRequest`.
        lock: open file that keeps the folder; children inherit it.
        tell: function that tells the user a line.
    """
    rows = _rows(runs, out)
    with disk_faults(out):
        out.mkdir(parents=True, exist_ok=True)
    write_text(out / GIVEN, found.text)
    write_table(out, found, rows.values())
    if others := folders_of_others(out, runs):
        tell(f"note: of no run of this sweep any more: {listed(others, last='and')}")
    todo = [run for run in runs if rows[run.number].state not in ("done", "refused")]
    workers = min(workers or cores(), max(len(todo), 1))
    tell(f"{counts_text(rows.values())}; {len(todo)} to run, {workers} at a time")
    warned = _warn_of_memory(workers, [run.memory_mb for run in todo])

    def command(run):
        flags = [part for text in run.sets for part in ("--set", text)]
        flags += ["--allow-outside"] if outside else []
        start = [sys.executable, "-P", "-m", "restoration.cli", "run", str(found.case)]
        return [*start, "--quiet", "--out", str(out / run.folder), *flags]

    # closed at once where the table cannot be written, so that no child is left behind
    with closing(run_children(todo, command, workers, stop, (lock.fileno(),))) as children:
        for number, (run, ended) in enumerate(children, start=1):
            row = rows[run.number] = row_of(run, out, ended)
            write_table(out, found, rows.values())
            tell(f"[{number}/{len(todo)}] {run.folder}: {_said(row)}")
            if not warned and row.numbers:
                warned = _warn_of_memory(workers, [row.numbers["peak_rss_mb"] or 0])
    return rows


def _only_a_sweep(out):
    """Refuse a folder that holds something else than a sweep.

    Raises:
        CaseError: it does.
    """
    if out.exists() and (not out.is_dir() or (any(out.iterdir()) and not (out / GIVEN).is_file())):
        raise CaseError(f"{out}: is not a sweep folder and not empty; give another --out")


def _rows(runs, out):
    """Return the rows of runs by number, as what lies in the folder of the sweep has it."""
    table = read_record(out / JSON).get("runs")
    before = {
        row.get("folder"): row for row in table or () if isinstance(row, dict) and row.get("folder")
    }
    return {run.number: row_of(run, out, before=before.get(run.folder)) for run in runs}


def _said(row):
    """Return in words what became of a run."""
    if row.state == "done":
        return f"done, {counted(row.numbers['steps'], 'step')} in {row.wall_s:.0f} s"
    return f"{row.state} ({row.exit_code}): {row.error}"


def _warn_of_memory(workers, each_mb):
    """Warn where so many runs at a time take more than the machine has; return whether it does.

    Args:
        workers: runs at a time.
        each_mb: what runs take, MB.
    """
    has = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e6
    most = sum(sorted(each_mb)[-workers:]) if len(each_mb) > 1 else workers * sum(each_mb)
    if most <= has:
        return False
    fewer = max(1, int(workers * has / most))
    print(
        f"warning: {workers} runs at a time take about {most / 1e3:.1f} GB of memory and the "
        f"machine has {has / 1e3:.1f} GB; --workers {fewer} fits better",
        file=sys.stderr,
    )
    return True

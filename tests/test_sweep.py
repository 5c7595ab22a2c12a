"""Sweeps: what a file means, what is wrong with one, and runs that are killed, bad, or done."""

import csv
import json
import math
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from restoration.cli import main
from restoration.errors import CaseError, OutputError
from restoration.run_folder import locked
from restoration.sweep.children import Ended, error_line, run_children
from restoration.sweep.command import PATIENCE, sweep
from restoration.sweep.file import read_sweep
from restoration.sweep.ranges import read_range
from restoration.sweep.runs import memory_mb, planned
from restoration.sweep.table import row_of, shortened
from restoration.units import NUMBER, to_si
from tests.torture import tries

ROOT = Path(__file__).parents[1]
SHIPPED = sorted(ROOT.glob("cases/*/*.sweep.yaml"))
CASE = """\
title: Flat layers
section:
  box: {width: 40 km, height: 1 km} # flat, so that pictures are small
  layers:
    - rock: salt
      top: {depth: 0.8 km, cosine: {amplitude: 50 m, wavelength: 80 km}}
    - rock: sediment
rocks:
  salt: {density: 2150 kg/m^3, viscosity: 1e19 Pa s}
  sediment: {density: 2600 kg/m^3, viscosity: 1e19 Pa s}
mesh: {cells: [8, 2]}
particles: {per_cell: 2, densify: 1}
time: {marks: [0 Ma, 0.2 Ma], min_steps: 3}
certificate: off
"""
SALT = "rocks.salt.viscosity"


@pytest.fixture
def write(tmp_path):
    """A function that writes a sweep file beside a tiny case, and returns its path."""
    (tmp_path / "case.yaml").write_text(CASE)

    def written(text, name="salt.sweep.yaml"):
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return written


def varied(path):
    return [one.entries for one in read_sweep(path).variations]


# what a file means


def test_a_list_is_taken_as_it_stands(write):
    path = write(
        f"case: case.yaml\nset: {{mesh.cells: 6}}\nlist:\n"
        f"  - {{name: weak, {SALT}: 1e17 Pa s}}\n  - {{{SALT}: 1e18 Pa s, time.scheme: euler}}\n"
    )
    found = read_sweep(path)
    assert [one.entries for one in found.variations] == [
        {SALT: "1e17 Pa s"},
        {SALT: "1e18 Pa s", "time.scheme": "euler"},
    ]
    assert found.entries == [SALT, "time.scheme"]
    assert found.shared == {"mesh.cells": 6}
    assert found.name == "salt"
    runs, _ = planned(found)
    assert runs[0].folder == f"weak-{runs[0].sha256[:8]}"
    assert runs[1].folder.startswith("1e18-Pa-s_euler-")


def test_a_grid_is_the_product(write):
    path = write(
        f"case: case.yaml\ngrid:\n  {SALT}: [1e17 Pa s, 1e18 Pa s]\n  mesh.cells: [4, 6, 8]\n"
    )
    assert varied(path) == [
        {SALT: salt, "mesh.cells": cells}
        for salt in ("1e17 Pa s", "1e18 Pa s")
        for cells in (4, 6, 8)
    ]


@pytest.mark.parametrize("seed", range(tries(5, 100)))
def test_a_latin_hypercube_hits_every_stratum_once(write, seed):
    n = 7 + 13 * seed
    path = write(
        f"case: case.yaml\nlatin:\n  samples: {n}\n  seed: {seed}\n  ranges:\n"
        f"    {SALT}: log 1e17 .. 1e19 Pa s\n"
        "    rocks.salt.density: 2100 .. 2200 kg/m^3\n"
        "    time.courant: 0.5 .. 1.5\n"
    )
    rows = varied(path)
    viscosity = np.array([to_si(row[SALT], "viscosity") for row in rows])
    density = np.array([to_si(row["rocks.salt.density"], "density") for row in rows])
    courant = np.array([row["time.courant"] for row in rows])
    for share in (np.log10(viscosity / 1e17) / 2, (density - 2100) / 100, courant - 0.5):
        assert sorted(np.floor(share * n)) == list(range(n))
    assert varied(path) == rows  # the same file, the same runs


def test_another_seed_is_another_hypercube(write):
    text = "case: case.yaml\nlatin: {samples: 9, seed: SEED, ranges: {time.courant: 0.5 .. 1.5}}\n"
    one, other = (varied(write(text.replace("SEED", seed))) for seed in "12")
    assert one != other


@pytest.mark.parametrize(
    ("text", "ends"),
    [
        ("1e17 .. 1e19 Pa s", ("1e17 Pa s", "1e19 Pa s")),
        ("log 1e17 Pa s .. 1e19 Pa s", ("1e17 Pa s", "1e19 Pa s")),
        ("-2..2 km", ("-2 km", "2 km")),
        ("0.5 .. 1.5", (0.5, 1.5)),
        ("1000 .. 1000.001 m", ("1000 m", "1000.001 m")),
    ],
)
def test_a_range_goes_from_end_to_end(text, ends):
    found = read_range(text)
    assert found.value(0.0) == ends[0]
    assert found.value(1.0) == ends[1]
    middle = str(found.value(0.5)).partition(" ")[0]
    value = float(NUMBER.match(middle).group())
    mean = math.sqrt(found.low * found.high) if found.log else (found.low + found.high) / 2
    assert value == pytest.approx(mean, abs=1e-6 * (found.high - found.low))


def test_whole_ends_make_whole_numbers_all_as_often():
    for text in ("3 .. 7", "log 3 .. 7"):
        found = read_range(text)
        values = [found.value(share) for share in np.linspace(0, 1, 5000, endpoint=False)]
        assert set(values) == {3, 4, 5, 6, 7}
        assert all(type(value) is int for value in values)
    even = [read_range("3 .. 7").value(s) for s in np.linspace(0, 1, 5000, endpoint=False)]
    assert {even.count(k) for k in range(3, 8)} == {1000}


def test_values_of_every_kind_reach_the_case(write):
    path = write(
        "case: case.yaml\nset: {certificate: off}\nlist:\n"
        "  - time.marks: [0 Ma, 0.1 Ma]\n    mesh: {cells: [40, 3], element: MINI}\n"
        "    output.arrows: true\n    time.courant: 1.0e-1\n    title: 'yes'\n"
    )
    ((run,), _) = planned(read_sweep(path))
    assert not run.faults
    assert "output.arrows=true" in run.sets
    assert 'title="yes"' in run.sets


@pytest.mark.parametrize("path", SHIPPED, ids=lambda path: path.stem)
def test_shipped_sweeps_are_sound(path):
    runs, notes = planned(read_sweep(path))
    assert len(runs) > 1
    assert not notes
    assert not any(run.faults for run in runs)
    assert path.name in (path.parent / "README.md").read_text(encoding="utf-8")


def test_the_sweeps_of_the_page_are_sound(write):
    blocks = re.findall(r"```yaml\n(.*?)```", (ROOT / "docs/sweep.md").read_text(), re.S)
    assert len(blocks) == 3
    for block in blocks:
        runs, _ = planned(read_sweep(write(block)))
        assert not any(run.faults for run in runs)


# what is wrong with a file


GRID = f"grid: {{{SALT}: [1e17 Pa s, 1e18 Pa s]}}\n"
BROKEN = {
    "empty": ("", "is empty"),
    "text": ("just text", ":1:1: holds 'just text'"),
    "no case": (GRID, "case: is missing; name the case file"),
    "no way": ("case: case.yaml\n", ":1:1: varies nothing; give one of list, grid or latin"),
    "misspelt": (
        f"case: case.yaml\ngird: {{{SALT}: [1 Pa s]}}\n",
        ":2:1: gird: no such entry; did",
    ),
    "two ways": (
        f"case: case.yaml\n{GRID}list: [{{{SALT}: 1e17 Pa s}}]\n",
        ":3:1: list: stands be",
    ),
    "grid of text": (f"case: case.yaml\ngrid: {{{SALT}: 1e17 Pa s}}\n", ":2:30: grid.rocks.salt"),
    "grid of nothing": (f"case: case.yaml\ngrid: {{{SALT}: []}}\n", ":2:30: grid.rocks.salt.visc"),
    "empty grid": ("case: case.yaml\ngrid: {}\n", ":2:7: grid: is empty"),
    "empty list": ("case: case.yaml\nlist: []\n", ":2:7: list: is empty"),
    "list of text": ("case: case.yaml\nlist: [weak]\n", ":2:8: list.0: 'weak' is not a group"),
    "only a name": ("case: case.yaml\nlist: [{name: weak}]\n", ":2:8: list.0: has a name and"),
    "name a list": (
        f"case: case.yaml\nlist: [{{name: [a], {SALT}: 1 Pa s}}]\n",
        ":2:15: list.0.nam",
    ),
    "grid too large": (
        f"case: case.yaml\ngrid: {{a.b: {[*range(200)]}, a.c: {[*range(60)]}}}\n",
        ":2:1: grid: makes 12000 runs; at most 10000",
    ),
    "dots": ("case: case.yaml\ngrid: {a..b: [1]}\n", ":2:7: grid: 'a..b' is no entry"),
    "equals sign": ("case: case.yaml\ngrid: {a.b=1: [1]}\n", ":2:7: grid: 'a.b=1' is no entry"),
    "undone": (
        "case: case.yaml\nlist: [{a.b: 1, a: {b: 2}}]\n",
        ":2:8: list.0: 'a' would undo 'a.b'; give it first",
    ),
    "far apart": (
        "case: case.yaml\nlatin: {samples: 1, ranges: {a.b: -1e308 .. 1e308 m}}\n",
        ":2:35: latin.ranges.a.b: '-1e308 .. 1e308 m': the ends are too far apart",
    ),
    "orders apart": (
        "case: case.yaml\nlatin: {samples: 1, ranges: {a.b: log 1e-300 .. 1e300}}\n",
        ":2:35: latin.ranges.a.b: 'log 1e-300 .. 1e300': the ends are too far apart",
    ),
    "samples": (
        "case: case.yaml\nlatin: {ranges: {a.b: 1 .. 2}}\n",
        "latin.samples: is missing; giv",
    ),
    "no samples": (
        "case: case.yaml\nlatin: {samples: 0, ranges: {a.b: 1 .. 2}}\n",
        ":2:18: latin.s",
    ),
    "half a sample": (
        "case: case.yaml\nlatin: {samples: 2.5, ranges: {a.b: 1 .. 2}}\n",
        ":2:18: lat",
    ),
    "seed": (
        "case: case.yaml\nlatin: {samples: 2, seed: -1, ranges: {a: 1 .. 2}}\n",
        ":2:27: latin",
    ),
    "a value": (
        "case: case.yaml\nlatin: {samples: 2, ranges: {a.b: 1 Pa s}}\n",
        ":2:35: latin.rang",
    ),
    "reversed": (
        "case: case.yaml\nlatin: {samples: 2, ranges: {a.b: 2 .. 1 m}}\n",
        "2 is not below 1",
    ),
    "log of 0": (
        "case: case.yaml\nlatin: {samples: 2, ranges: {a.b: log 0 .. 1 m}}\n",
        "above 0, not",
    ),
    "two units": (
        "case: case.yaml\nlatin: {samples: 2, ranges: {a: 1 m .. 2 km}}\n",
        "take one unit",
    ),
    "outside": (
        "case: ../case.yaml\n" + GRID,
        ":1:7: case: '../case.yaml' leaves the folder of the sw",
    ),
    "missing case": ("case: cas.yaml\n" + GRID, "cas.yaml: no such file; did you mean 'case.yaml'"),
    "tag": ("case: !!str case.yaml\n" + GRID, ":1:7: a case has no use for the tag"),
    "alias": ("case: &a case.yaml\ntitle: *a\n" + GRID, ":2:8: a case has no use for the alias"),
    "not yaml": ("case: case.yaml\ngrid: {a: [1}\n", ":2:13: not YAML"),
    "no such entry": (
        "case: case.yaml\ngrid:\n  rocks.salt.viscosty: [1e17 Pa s, 1e18 Pa s]\n",
        ":3:25: rocks.salt.viscosty: no such entry; did you mean 'viscosity'",
    ),
    "no such value": (
        f"case: case.yaml\ngrid: {{{SALT}: [1e17 m]}}\n",
        f":2:31: {SALT}: '1e17 m' is a",
    ),
    "no such unit": (
        f"case: case.yaml\nlatin:\n  samples: 3\n  ranges:\n    {SALT}: 1 .. 2 kg\n",
        f":5:27: {SALT}: '",
    ),
    "shared": (f"case: case.yaml\nset: {{mesh.cells: x}}\n{GRID}", ":2:19: mesh.cells: 'x'"),
}


@pytest.mark.parametrize("name", BROKEN)
def test_broken_files_are_refused_with_their_place(name, write, tmp_path, monkeypatch, capsys):
    text, said = BROKEN[name]
    path = write(text)
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", path.name]) == 2
    told = capsys.readouterr().err
    assert said in told
    assert "Traceback" not in told
    assert len(told.strip().splitlines()) <= 4
    assert sorted(p.name for p in tmp_path.iterdir()) == ["case.yaml", "salt.sweep.yaml"]


@pytest.mark.parametrize("number", [0, -1, 100_000])
def test_impossible_numbers_of_workers(write, number, capsys):
    path = write(f"case: case.yaml\n{GRID}")
    assert main(["sweep", str(path), "--workers", str(number)]) == 2
    assert "--workers" in capsys.readouterr().err


def test_what_is_varied_cannot_be_set_too(write, capsys):
    path = write(f"case: case.yaml\n{GRID}")
    assert main(["sweep", str(path), "--set", f"{SALT}=1e20 Pa s"]) == 2
    assert "is varied by" in capsys.readouterr().err


def test_the_same_run_twice_is_made_once(write):
    path = write(f"case: case.yaml\ngrid: {{{SALT}: [1e17 Pa s, 2e17 Pa s, 1e17 Pa s]}}\n")
    runs, notes = planned(read_sweep(path))
    assert [run.number for run in runs] == [1, 2]
    assert notes == ["run 3 is run 1 again and left out"]


def test_a_list_of_what_would_run_runs_nothing(write, tmp_path, monkeypatch, capsys):
    path = write(f"case: case.yaml\ngrid: {{{SALT}: [1e17 Pa s, 12 m, 1e19 Pa s]}}\n")
    monkeypatch.chdir(tmp_path)
    assert main(["sweep", str(path), "--list", "--json"]) == 1
    said = capsys.readouterr()
    rows = json.loads(said.out)["runs"]
    assert [row["state"] for row in rows] == ["waiting", "refused", "waiting"]
    assert rows[1]["exit_code"] == 2
    assert re.search(r"refused: run 2: .*:2:42: rocks.salt.viscosity: '12 m' is a", said.err)
    assert not (tmp_path / "runs").exists()


# folders


@pytest.mark.parametrize("kind", ["file", "folder", "run"])
def test_a_folder_of_something_else_is_not_touched(write, tmp_path, kind, capsys):
    path, out = write(f"case: case.yaml\n{GRID}"), tmp_path / "out"
    if kind == "file":
        out.write_text("mine")
    else:
        out.mkdir()
        (out / ("notes.txt" if kind == "folder" else "run.json")).write_text("mine")
    before = sorted(tmp_path.rglob("*"))
    assert main(["sweep", str(path), "--out", str(out)]) == 2
    assert "is not a sweep folder and not empty" in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before


def test_a_folder_that_cannot_be_made_is_told(write, tmp_path, capsys):
    path = write(f"case: case.yaml\n{GRID}")
    (tmp_path / "file").write_text("")
    assert main(["sweep", str(path), "--out", str(tmp_path / "file" / "out")]) == 5
    assert "a file stands where a folder is needed" in capsys.readouterr().err


def test_a_folder_at_work_is_refused(write, tmp_path):
    path, out = write(f"case: case.yaml\n{GRID}"), tmp_path / "out"
    with locked(out, "sweep"), pytest.raises(CaseError, match="another sweep is at work in it"):
        sweep(path, out=out)
    assert not out.exists()


def test_a_changed_file_keeps_what_is_still_of_it(write, tmp_path):
    """The folder of a run goes by its case, not by its place in the file."""
    first, _ = planned(read_sweep(write(f"case: case.yaml\n{GRID}")))
    text = f"case: case.yaml\ngrid: {{{SALT}: [5e17 Pa s, 1e18 Pa s, 1e17 Pa s]}}\n"
    changed, _ = planned(read_sweep(write(text)))
    assert [run.folder for run in changed][1:] == [run.folder for run in reversed(first)]
    done = tmp_path / "out" / first[0].folder
    done.mkdir(parents=True)
    record = {"ended_well": True, "exit_code": 0, "case_sha256": first[0].sha256, "steps": 7}
    (done / "run.json").write_text(json.dumps(record))
    states = [row_of(run, tmp_path / "out").state for run in changed]
    assert states == ["waiting", "waiting", "done"]
    (tmp_path / "case.yaml").write_text(CASE.replace("2600", "2700"))  # another case: all anew
    anew, _ = planned(read_sweep(write(text)))
    assert {row_of(run, tmp_path / "out").state for run in anew} == {"waiting"}


def test_a_folder_of_another_case_is_not_done(write, tmp_path):
    """Eight signs of a hash may agree by chance; all of it decides."""
    (run, _), _ = planned(read_sweep(write(f"case: case.yaml\n{GRID}")))
    folder = tmp_path / run.folder
    folder.mkdir()
    record = {"ended_well": True, "exit_code": 0, "case_sha256": run.sha256[:8] + 56 * "0"}
    (folder / "run.json").write_text(json.dumps(record))
    assert row_of(run, tmp_path).state == "failed"
    row = row_of(run, tmp_path, Ended(0, "", 1.0))
    assert (row.state, row.exit_code) == ("failed", 1)
    assert "the case file has changed meanwhile" in row.error


@pytest.mark.parametrize("content", ["", "[]", "{", '{"ended_well": 1}', "[" * 100_000, "\0"])
def test_a_record_that_cannot_be_read_is_no_run(write, tmp_path, content):
    (run, _), _ = planned(read_sweep(write(f"case: case.yaml\n{GRID}")))
    folder = tmp_path / "out" / run.folder
    folder.mkdir(parents=True)
    (folder / "run.json").write_text(content)
    assert row_of(run, tmp_path / "out").state in ("waiting", "failed")


def test_numbers_of_a_row(write, tmp_path):
    (run, _), _ = planned(read_sweep(write(f"case: case.yaml\n{GRID}")))
    folder = tmp_path / run.folder
    folder.mkdir()
    record = {
        "ended_well": True,
        "case_sha256": run.sha256,
        "there_and_back": {"mean_m": 1.0, "p99_m": 2.0, "max_m": 3.0},
        "horizons": [{"mean_m": 0.1, "max_m": 4.0}, {"mean_m": 0.2, "max_m": 1.0}],
        "certificate": {
            "verdict": "trusted",
            "horizons": [{"predicted_m": 5.0}, {"predicted_m": None}],
        },
    }
    (folder / "run.json").write_text(json.dumps(record))
    (folder / "diagnostics.csv").write_text("step,flatness_m\n1,9.5\n2,8.5\n")
    row = row_of(run, tmp_path).plain()
    assert (row["back_mean_m"], row["back_p99_m"], row["back_max_m"]) == (1.0, 2.0, 3.0)
    assert (row["horizons_mean_m"], row["horizons_max_m"]) == (0.2, 4.0)
    assert row["predicted_m"] is None  # one of them is not known to any bound
    assert row["certificate"] == "trusted"
    assert row["flatness_m"] == 8.5
    assert row["surface_relief_m"] is None


def test_entries_are_told_apart_by_their_last_parts():
    names = ["rocks.salt.viscosity", "rocks.sediment.viscosity", "mesh.cells"]
    assert shortened(names) == ["salt.viscosity", "sediment.viscosity", "cells"]


# children


def ended(commands, workers=2, stop=None, **more):
    stop = stop or SimpleNamespace(wanted=False)
    return run_children(commands, lambda command: command, workers, stop, **more)


def test_a_child_that_fails_touches_no_other():
    kill = [sys.executable, "-c", "import os; os.kill(os.getpid(), 9)"]
    fail = [sys.executable, "-c", "import sys; sys.stderr.write('note: a\\nb\\n'); sys.exit(4)"]
    commands = [kill, ["true"], fail, ["true", "again"]]
    found = {commands.index(job): end for job, end in ended(commands)}
    assert [found[i].code for i in range(4)] == [137, 0, 4, 0]
    assert "SIGKILL" in found[0].error
    assert found[2].error == "b"


def test_errors_of_children_are_one_line():
    traced = "Traceback (most recent call last):\n  File x\nValueError: no\n"
    assert error_line("warning: w\nnote: n\nfault one\nfault two\n") == "fault one"
    assert error_line(traced) == "ValueError: no"
    assert error_line("") == "ended without a word"


def test_no_more_at_a_time_than_workers(tmp_path):
    script = "echo x >> {0}; ls | wc -l > /dev/null; grep -c x {0} >> {1}; sleep 0.3; sed -i 1d {0}"
    alive, counts = tmp_path / "alive", tmp_path / "counts"
    commands = [["sh", "-c", script.format(alive, counts)]] * 6
    begin = time.monotonic()
    assert [end.code for _, end in ended(commands, workers=2)] == [0] * 6
    assert time.monotonic() - begin > 3 * 0.3
    assert max(map(int, counts.read_text().split())) <= 2


def test_a_wish_to_stop_ends_children_and_begins_none():
    stop = SimpleNamespace(wanted=False)
    children = ended([["true"], ["sleep", "60"], ["sleep", "61"]], workers=2, stop=stop)
    begin = time.monotonic()
    assert next(children)[1].code == 0
    stop.wanted = True
    rest = list(children)
    assert time.monotonic() - begin < 10
    assert {end.code for _, end in rest} == {128 + signal.SIGTERM}
    assert len(rest) <= 2


@pytest.mark.parametrize("error", [OutputError, KeyboardInterrupt])
def test_children_end_where_the_caller_does(error):
    begin = time.monotonic()
    commands = [["true"], ["sleep", "60"], ["sleep", "61"]]
    with closing(ended(commands, workers=3)) as children:
        assert next(children)[0] == ["true"]
        with pytest.raises(error):
            children.throw(error("the table could not be written"))
    assert time.monotonic() - begin < 10
    assert not children_of(os.getpid(), "sleep")


def test_memory_is_warned_of(write, monkeypatch, tmp_path, capsys):
    from restoration.resolve import load
    from restoration.sweep import command

    coarse, fine = (
        memory_mb(load(tmp_path / "case.yaml", [f"mesh.cells={n}"]).scene)
        for n in (write("") and 8, 64)
    )
    assert 300 < coarse < fine
    assert not command._warn_of_memory(2, [300, 300])
    assert command._warn_of_memory(2, [1e9, 300, 1e9])
    assert "--workers 1" in capsys.readouterr().err


# real runs


def restore(*arguments, cwd):
    return subprocess.Popen(
        [sys.executable, "-m", "restoration.cli", *map(str, arguments)],
        cwd=cwd,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        # the tests themselves may have been started under nohup
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),
    )


def children_of(parent, text):
    """Return the ids of the children of a process with a text in their command line."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            above = int((folder / "stat").read_text().rpartition(")")[2].split()[1])
            line = (folder / "cmdline").read_bytes().decode(errors="replace")
        except OSError:  # it has ended meanwhile
            continue
        if above == parent and text in line:
            found.append(int(folder.name))
    return found


def rows_of(out):
    with open(out / "sweep.csv", newline="") as stream:
        rows = list(csv.DictReader(stream))
    table = json.loads((out / "sweep.json").read_text())
    assert [row["state"] for row in rows] == [row["state"] for row in table["runs"]]
    return table["runs"]


@pytest.mark.slow
@pytest.mark.torture
def test_some_are_killed_some_are_bad_and_the_rest_finish(write, tmp_path):
    """R23: 20 runs, 3 killed, 2 bad: 15 are done, and a second call runs the 5 only."""
    n = tries(20, 200)
    bad, out = {n // 4, 3 * n // 4}, tmp_path / "out"
    bad |= set(range(1, n, 10)) if n > 20 else set()
    values = [f"{1 + 0.01 * i:.2f}e19 Pa s" for i in range(n)]
    text = "case: case.yaml\nlist:\n"
    given = ["-1e19 Pa s" if i in bad else value for i, value in enumerate(values)]
    path = write(text + "".join(f"  - {{{SALT}: {value}}}\n" for value in given))
    runs, _ = planned(read_sweep(path))
    good = [run for run in runs if not run.faults]
    victims = {run.folder for run in good[2 :: len(good) // (3 * n // 20)][: 3 * n // 20]}
    assert len(victims) == 3 * n // 20
    process = restore("sweep", path, "--out", out, "--workers", 2, cwd=tmp_path)
    try:
        left = set(victims)
        while left:
            assert process.poll() is None, process.communicate()
            for folder in [f for f in left if (out / f / "diagnostics.csv").exists()]:
                (child,) = children_of(process.pid, f"{out / folder}")
                os.kill(child, signal.SIGKILL)
                left.remove(folder)
            time.sleep(0.02)
        _, said = process.communicate(timeout=60 * n)
    finally:
        process.kill()
    assert process.returncode == 1
    assert said.count("refused: run") == len(bad)
    rows = rows_of(out)
    assert len(rows) == n
    assert sum(row["state"] == "done" for row in rows) == n - len(bad) - len(victims)
    for i, row in enumerate(rows):
        if i in bad:
            assert (row["state"], row["exit_code"], row["folder"]) == ("refused", 2, None)
            assert f":{3 + i}:28: {SALT}: '-1e19 Pa s' must not be below" in row["error"]
        elif row["folder"] in victims:
            assert (row["state"], row["exit_code"]) == ("failed", 137)
            assert "SIGKILL" in row["error"]
        else:
            assert (row["state"], row["exit_code"], row["error"]) == ("done", 0, "")
            assert row["steps"] >= 3
            assert row["flatness_m"] > 0
    done = {row["folder"]: (out / row["folder"] / "run.json").stat().st_mtime_ns
            for row in rows if row["state"] == "done"}  # fmt: skip
    path.write_text(text + "".join(f"  - {{{SALT}: {value}}}\n" for value in values))
    process = restore("sweep", path, "--out", out, "--json", cwd=tmp_path)
    table, said = process.communicate(timeout=60 * n)
    assert process.returncode == 0, said
    again = len(bad) + len(victims)
    assert f"{n - again} done" in said
    assert f"{again} to run" in said
    assert said.count(": done, ") == again
    assert json.loads(table)["counts"]["done"] == n
    for folder, moment in done.items():
        assert (out / folder / "run.json").stat().st_mtime_ns == moment


def begun(write, tmp_path, values=3):
    """Start a sweep of long runs, and return it with its folder once two are at work."""
    grid = ", ".join(f"{k + 1}e19 Pa s" for k in range(values))
    path = write(f"case: case.yaml\nset: {{time.min_steps: 5000}}\ngrid: {{{SALT}: [{grid}]}}\n")
    out = tmp_path / "out"
    process = restore("sweep", path, "--out", out, "--workers", 2, cwd=tmp_path)
    limit = time.monotonic() + 60
    while sum(len(p.read_text().splitlines()) > 3 for p in out.glob("*/diagnostics.csv")) < 2:
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < limit
        time.sleep(0.05)
    return process, path, out


def wait_until_gone(pids, seconds=30):
    limit = time.monotonic() + seconds
    while alive := [pid for pid in pids if running(pid)]:
        assert time.monotonic() < limit, alive
        time.sleep(0.05)


def running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_stop_is_polite(write, tmp_path, number):
    """To all of its group, as Ctrl-C and the end of a terminal come, it reaches no child twice."""
    process, path, out = begun(write, tmp_path)
    children = children_of(process.pid, str(out))
    try:
        os.killpg(process.pid, number)
        printed, said = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 75
    assert "stopped on request with 0 of 3 runs done; the same command goes on" in said
    assert "Traceback" not in said
    assert not any(map(running, children))
    assert [row["state"] for row in rows_of(out)] == ["stopped", "stopped", "waiting"]
    assert "2 stopped and 1 waiting" in printed
    for row in rows_of(out)[:2]:
        assert row["exit_code"] == 75
        assert json.loads((out / row["folder"] / "run.json").read_text())["exit_code"] == 75
    assert main(["sweep", str(path), "--out", str(out), "--list"]) == 0


@pytest.mark.slow
def test_children_end_with_the_sweep_and_keep_its_folder_until_then(write, tmp_path):
    process, path, out = begun(write, tmp_path)
    children = children_of(process.pid, str(out))
    assert len(children) == 2
    try:
        second = restore("sweep", path, "--out", out, cwd=tmp_path)
        assert "another sweep is at work in it" in second.communicate(timeout=60)[1]
        assert second.returncode == 2
        for child in children:
            os.kill(child, signal.SIGSTOP)  # busy, and not listening
        process.kill()
        process.communicate(timeout=60)
        with pytest.raises(CaseError, match="another sweep is at work"), locked(out, "sweep"):
            pass
        for child in children:
            os.kill(child, signal.SIGCONT)
        wait_until_gone(children)
    finally:
        for child in filter(running, children):
            os.kill(child, signal.SIGKILL)
    with locked(out, "sweep", PATIENCE):
        pass
    codes = [json.loads(path.read_text())["exit_code"] for path in out.glob("*/run.json")]
    assert codes == [75, 75]

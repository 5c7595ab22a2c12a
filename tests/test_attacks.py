"""What a case file from a stranger may try: each is refused in a line, and nothing else happens."""

import json
import os
import re
import subprocess
import sys
import tempfile
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import h5py
import numpy as np
import pytest

from restoration import cli, files, resolve, shapes, words
from restoration.environment import SETTINGS
from restoration.errors import CaseError
from restoration.resolve import load
from restoration.starter import survey_text
from restoration.words import UNWRITABLE
from restoration.xdmf import ParticleSeries

ROOT = Path(__file__).parents[1]
ROCKS = """
rocks:
  salt: {density: 2160 kg/m^3, viscosity: 1e17 Pa s}
  shale: {density: 2600 kg/m^3, viscosity: 1e19 Pa s}
time: {marks: [0 Ma, 1 kyr]}
""".replace("1 kyr", "1 ka")
LAYERS = """
section:
  box: {width: 2 km, height: 1 km}
  layers: [{rock: salt, top: {depth: 0.5 km}}, {rock: shale}]
"""
PARTICLES = "section: {particles: p.h5, box: {width: 2 km, height: 1 km}}\n"
TB = 10**12
MARK = "this must not be read"


def square(unit, low, high):
    ring = [[0, low], [2000, low], [2000, high], [0, high], [0, low]]
    geometry = {"type": "Polygon", "coordinates": [ring]}
    return {"type": "Feature", "properties": {"unit": unit}, "geometry": geometry}


def collection(*features):
    return json.dumps({"type": "FeatureCollection", "features": features})


SECTION = collection(square("salt", -1000, -500), square("shale", -500, 0))


def computed():
    """Return the seconds of computing of this process and of those it has started."""
    return sum(os.times()[:4])


def refused(path, overrides=(), allow_outside=False):
    """Return what is said of a case, which takes 2 s at most and names nothing of other files."""
    begin = computed()
    with pytest.raises(CaseError) as caught:
        load(path, overrides, allow_outside)
    assert computed() - begin < 2
    told = str(caught.value)
    assert len(told.splitlines()) == len(caught.value.faults)
    assert not any(UNWRITABLE.search(line) for line in told.splitlines())
    assert MARK not in told
    return told


@pytest.fixture
def case(tmp_path):
    """Return a function that writes a case beside files of a stranger."""
    folder = tmp_path / "case"
    folder.mkdir()
    (tmp_path / "secret.geojson").write_text(SECTION.replace("salt", MARK))
    (tmp_path / "outer").mkdir()
    (tmp_path / "outer/secret.geojson").write_text(SECTION.replace("salt", MARK))

    def write(text):
        (folder / "case.yaml").write_text(text, encoding="utf-8", errors="surrogatepass")
        return folder / "case.yaml"

    return write


def named(name):
    return f"section: {{file: {name}}}\n{ROCKS}"


# --- the names of files ---------------------------------------------------------------------------

OUT = "leaves the folder of the case"
NO_NAME = "is not a file name"
NO_KIND = "is of no kind that is read here"


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("../secret.geojson", OUT),
        ("a/../../secret.geojson", OUT),
        ("/etc/passwd", "is an absolute path"),
        ("'..\\..\\secret.geojson'", "has backslashes"),
        ("C:/secret.geojson", NO_NAME),
        ("https://example.org/a.geojson", NO_NAME),
        ("file:///etc/passwd", NO_NAME),
        ("/vsicurl/https://example.org/a.geojson", NO_NAME),
        ("/vsizip/a.zip/a.geojson", NO_NAME),
        ('"a.geojson\\0.txt"', "holds the character U+0000"),
        ('"a\\e[2J.geojson"', "holds the character U+001B"),
        ("x.vrt", NO_KIND),
        ("x.dxf", NO_KIND),
        ("x.svg", NO_KIND),
        ("x.gpkg", NO_KIND),
        ("case.yaml", NO_KIND),
        ("\N{LATIN SMALL LETTER E WITH ACUTE}" * 199 + ".geojson", "cannot be read: File name"),
        (".", NO_KIND),
        ("folder.geojson", "there is no file"),
        ("pipe.geojson", "there is no file"),
        ("link.geojson", "is a link out of the folder"),
        ("chain.geojson", "is a link out of the folder"),
        ("inner/secret.geojson", "is a link out of the folder"),
        ("loop.geojson", "is a link that leads nowhere"),
        ("zero.geojson", "is a link out of the folder"),
        ("huge.geojson", "is 1000000.0 MB large; at most 50 MB are read"),
    ],
)
def test_no_name_leads_anywhere_but_to_a_file_in_the_folder(case, name, message):
    path = case(named(name))
    folder = path.parent
    (folder / "folder.geojson").mkdir()
    os.mkfifo(folder / "pipe.geojson")
    (folder / "link.geojson").symlink_to("../secret.geojson")
    (folder / "chain.geojson").symlink_to("link.geojson")
    (folder / "inner").symlink_to("../outer")
    (folder / "loop.geojson").symlink_to("loop.geojson")
    (folder / "zero.geojson").symlink_to("/dev/zero")
    with open(folder / "huge.geojson", "wb") as file:
        file.truncate(TB)
    for kind in ("vrt", "dxf", "svg", "gpkg"):
        (folder / f"x.{kind}").write_text(MARK)
    assert message in refused(path)
    # the same by --set
    assert message in refused(case(named("section.geojson")), [f"section.file={name}"])


@pytest.mark.parametrize("name", ["zero.geojson", "/dev/zero.geojson", "pipe.geojson"])
def test_what_is_allowed_outside_must_still_be_a_file(case, name):
    path = case(named(name))
    os.mkfifo(path.parent / "pipe.geojson")
    (path.parent / "zero.geojson").symlink_to("/dev/zero")
    assert "there is no file" in refused(path, allow_outside=True)


@pytest.mark.parametrize("name", ["https://example.org/a.geojson", "/vsicurl/x.geojson"])
def test_no_address_is_allowed_at_all(case, name):
    assert NO_NAME in refused(case(named(name)), allow_outside=True)


def test_a_case_that_is_no_file(tmp_path):
    os.mkfifo(tmp_path / "case.yaml")
    assert "is not a regular file" in refused(tmp_path / "case.yaml")
    assert "is not a regular file" in refused(Path("/dev/zero"))
    (tmp_path / "link.yaml").symlink_to("/dev/stdin")
    assert "is not a regular file" in refused(tmp_path / "link.yaml")


def test_a_file_swapped_for_a_pipe_does_not_hang(case, monkeypatch):
    """Between the look at a file and its opening lies time enough for another file."""
    path = case(named("section.geojson"))
    os.mkfifo(path.parent / "section.geojson")
    status = os.stat(path)
    monkeypatch.setattr(files.os, "stat", lambda *_, **__: status)
    assert "section.geojson: is not a regular file" in refused(path)


def test_a_file_swapped_while_it_is_read_is_refused(case, monkeypatch):
    """The record of a run names the file by its sha256."""
    path = case(named("section.geojson"))
    section = path.parent / "section.geojson"
    section.write_text(SECTION)

    def read_and_swap(*arguments):
        shape = shapes.from_file(*arguments)
        section.write_text(SECTION + " ")
        return shape

    load(path)
    monkeypatch.setattr(resolve, "from_file", read_and_swap)
    assert "section.geojson was changed while it was read" in refused(path)


# --- YAML -----------------------------------------------------------------------------------------

LAUGHS = "a: &a [x, x]\n" + "".join(
    f"{b}: &{b} [*{a}, *{a}, *{a}]\n" for a, b in zip("abcdefghijkl", "bcdefghijklm", strict=True)
)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (f"title: !!python/object/apply:os.system ['echo {MARK} > x']\n", "no use for the tag"),
        ("title: !!python/name:os.system\n", "no use for the tag"),
        ("title: !include /etc/passwd\n", "no use for the tag !include"),
        ("title: !!binary aGFsbG8=\n", "no use for the tag"),
        ("%TAG ! tag:yaml.org,2002:python/\n---\n", "no use for a directive"),
        (LAUGHS, "no use for the anchor &a"),
        ("surface: &a\n  air: *a\n", "no use for the alias *a"),
        ("surface:\n  <<: {theta: 1}\n", "surface.<<: no such entry"),
        ("title: " + "[" * 50_000, "is nested more than 32 levels deep"),
        ("title: " + "{a: " * 20_000, "is nested more than 32 levels deep"),
        ("".join(" " * i + "a:\n" for i in range(400)), "is nested more than 32 levels deep"),
        ("particles: {seed: 1" + "0" * 5000 + "}\n", "is not a whole number"),
        ("mesh: {cells: 0x7fffffff}\n", "'0x7fffffff'"),
        ("time: {courant: 1e999}\n", "'1e999' is not a number"),
        ("gravity: 9**9**9 m/s^2\n", "is not a plain number with a unit"),
        ("gravity: __import__('os').getpid() m/s^2\n", "is not an acceleration"),
        ("gravity: " + "9" * 50_000 + " m/s^2\n", "is too long"),
        ("---\n---\n", "a second document begins"),
        ("".join(f"k{i}: 1\n" for i in range(4_000)), "more faults"),
        ("title: " + "x" * 90_000 + "\n", "is a name of 90000 characters"),
        ("x" * 999_000 + "\n", "is a line of 999000 characters"),
        ("\n" * 999_000, "has 999009 lines"),
        ("#" * 1_100_000, "at most 1 MB are read"),
        ('title: "\\e]0;owned\\a"\n', "holds the character U+001B"),
        ('title: "one\\nrow,of,a,table"\n', "holds the character U+000A"),
        ('title: "\\u202Etext turned round"\n', "holds the character U+202E"),
        ('title: "\\ud800"\n', "holds the character U+D800"),
        ('"rocks\\e[2J": 1\n', "no such entry; did you mean 'rocks'"),
        ("solver: {options: {ksp_view: 'ascii:/tmp/x'}}\n", "is no option of the solver"),
        ("solver: {options: {options_file: /tmp/x}}\n", "is no option of the solver"),
    ],
)
def test_no_text_does_anything(case, tmp_path, text, message):
    before = sorted(tmp_path.rglob("*"))
    path = case(text + LAYERS + ROCKS)
    assert message in refused(path)
    assert sorted(tmp_path.rglob("*")) == sorted([*before, path])


def test_names_are_compared_for_the_first_faults_only(case, monkeypatch):
    """Each comparison takes a millisecond, and more than forty are not told."""
    asked, compare = [], words.get_close_matches
    monkeypatch.setattr(
        words, "get_close_matches", lambda *a, **k: asked.append(a) or compare(*a, **k)
    )
    text = "".join(f"k{i}: 1\n" for i in range(1000))
    assert refused(case(text + LAYERS + ROCKS)).endswith("and 960 more faults")
    assert 40 <= len(asked) < 500


# --- GeoJSON and tables ---------------------------------------------------------------------------

ENTITIES = '<?xml version="1.0"?><!DOCTYPE a [<!ENTITY b SYSTEM "file:///etc/passwd">]><a>&b;</a>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[" * 100_000, "is nested too deeply for GeoJSON"),
        ('{"a":' * 100_000, "is nested too deeply for GeoJSON"),
        ("[" + "[]," * 3_000_000, "has more than 1,000,000 vertices"),
        ("[" + "0," * 6_000_000, "has more than 1,000,000 vertices"),
        (SECTION.replace('"salt"', '"salt", "unit": "shale"'), "gives 'unit' twice"),
        (SECTION.replace("2000", "1e999"), "holds a coordinate beyond 1e9 m"),
        (SECTION.replace("2000", "NaN"), "holds NaN, which is no coordinate"),
        (SECTION.replace("2000", "-Infinity"), "holds -Infinity, which is no coordinate"),
        (SECTION.replace("2000", "9" * 5000), "holds a number of thousands of digits"),
        (SECTION.replace("2000", "9" * 4000), "holds a coordinate beyond 1e9 m"),
        (SECTION.replace("salt", "\\u001b[2J"), "holds the character U+001B"),
        (SECTION.replace("salt", "\\ud800"), "holds the character U+D800"),
        (SECTION.replace("salt", "x" * 1000), "is a name of 1000 characters"),
        (ENTITIES, "is XML (KML, SVG, GML?), not GeoJSON"),
        ("PK\x03\x04 bomb", "is a zip archive"),
        ("\0" * 1000, "is a binary file"),
    ],
)
def test_no_section_does_anything(case, text, message):
    path = case(named("section.geojson"))
    (path.parent / "section.geojson").write_text(text)
    assert message in refused(path)


def test_a_section_adds_no_lines_to_the_case_printed_for_it(tmp_path):
    feature = json.dumps(square("sa\x1b[2Jlt\u2028time: {}", -1000, 0))
    text = collection(json.loads(feature.replace('"unit"', '"unit\\nrocks: {}"')))
    (tmp_path / "section.geojson").write_text(text)
    told = survey_text(tmp_path / "section.geojson").split("\n")
    assert not any(UNWRITABLE.search(line) for line in told)
    assert [line for line in told if line.startswith(("rocks:", "time:"))] == [
        "rocks:",
        "time: {marks: [0 Ma, 1 Ma]} # from today back to 1 Ma",
    ]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x,z,unit\n" + "1,-1,salt\n" * 100 + "1,-1," + "x" * 10**6, "p.csv:102: is a line of"),
        ("x,z,unit\n1_0,-1,salt\n", "p.csv:2: '1_0,-1,salt' is not a finite x"),
        ("x,z,unit\n1e999,-1,salt\n", "p.csv:2: '1e999,-1,salt' is not a finite x"),
        ("x,z,unit\n\N{FULLWIDTH DIGIT ONE},-1,salt\n", "p.csv:2: "),
        ("x,z,unit\n1,-1,sa\x1b[2Jlt\n", "p.csv: the unit 'sa?[2Jlt' holds the character U+001B"),
        ("x,x,z,unit\n1,2,-1,salt\n", "p.csv:1: the first line names x twice"),
        ("x,z,unit\n" + "".join(f"1,-1,u{i}\n" for i in range(1001)), "names 1001 units"),
    ],
)
def test_no_table_does_anything(case, text, message):
    path = case(PARTICLES.replace("p.h5", "p.csv") + ROCKS)
    (path.parent / "p.csv").write_text(text, encoding="utf-8")
    assert message in refused(path)


# --- HDF5 -----------------------------------------------------------------------------------------


def series(folder, names=("salt", "shale")):
    """Write the particles of a run, and return the path of the .h5."""
    rng = np.random.default_rng(1)
    x = np.column_stack([rng.uniform(0, 2000, 50), rng.uniform(-1000, 0, 50)])
    writer = ParticleSeries(folder / "p.xdmf", {"unit_names": list(names)})
    writer.write(0.0, x, {"unit": np.arange(50, dtype=np.int16) % 2})
    return folder / "p.h5"


FRAME = "frames/000000"


def external_link(h5):
    del h5[FRAME]
    h5[FRAME] = h5py.ExternalLink("../secret.h5", "/")


def soft_link(h5):
    h5["other"] = h5[f"{FRAME}/points"]
    del h5[f"{FRAME}/points"]
    h5[f"{FRAME}/points"] = h5py.SoftLink("/other")


def loop(h5):
    del h5[FRAME]
    h5[FRAME] = h5["frames"]


def virtual(h5):
    del h5[f"{FRAME}/points"]
    layout = h5py.VirtualLayout((50, 2), float)
    layout[:] = h5py.VirtualSource("../secret.h5", "points", (50, 2))
    h5.create_virtual_dataset(f"{FRAME}/points", layout)


def stored_elsewhere(h5):
    del h5[f"{FRAME}/points"]
    h5[FRAME].create_dataset("points", (50, 2), float, external=[("/etc/passwd", 0, 800)])


def compressed(h5):
    del h5[f"{FRAME}/points"]
    h5[FRAME].create_dataset("points", data=np.zeros((10**6, 2)), compression="gzip")


def without_end(h5):
    del h5[f"{FRAME}/points"]
    h5[FRAME].create_dataset("points", (2**40, 2), float, chunks=(1024, 2))


def overflowing(h5):
    """2^60 rows of two numbers of 8 bytes are 0 bytes, counted in 64 bits."""
    del h5[f"{FRAME}/points"]
    space = h5py.h5s.create_simple((2**60, 2), (h5py.h5s.UNLIMITED, 2))
    settings = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    settings.set_chunk((1024, 2))
    h5py.h5d.create(h5[FRAME].id, b"points", h5py.h5t.NATIVE_DOUBLE, space, settings)


def of_many_axes(h5):
    del h5[f"{FRAME}/points"]
    h5[f"{FRAME}/points"] = np.zeros((1,) * 32)


def a_type(h5):
    del h5[f"{FRAME}/points"]
    h5[f"{FRAME}/points"] = np.dtype(float)


def of_objects(h5):
    del h5[f"{FRAME}/point/unit"]
    kind = h5py.special_dtype(vlen=str)
    h5[FRAME]["point"].create_dataset("unit", (50,), kind)[:] = "x"


def not_finite(h5):
    h5[f"{FRAME}/points"][0, 0] = np.nan


def deep_attributes(h5):
    del h5["attributes"]
    h5["attributes"] = np.bytes_(b"[" * 100_000)


def name_of_escapes(h5):
    del h5["attributes"]
    h5["attributes"] = np.bytes_(json.dumps({"unit_names": ["salt", "\x1b[2J"]}).encode())


def unit_of_none(h5):
    h5[f"{FRAME}/point/unit"][:] = 30_000


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (external_link, "000000 is a link"),
        (soft_link, "points is a link"),
        (loop, "there is no points"),
        (virtual, "points is filtered or stored elsewhere"),
        (stored_elsewhere, "points is filtered or stored elsewhere"),
        (compressed, "points is filtered or stored elsewhere"),
        (without_end, "points is larger than the file"),
        (overflowing, "points is larger than the file"),
        (of_many_axes, "points is not what it should be"),
        (a_type, "points is not what it should be"),
        (of_objects, "unit is not what it should be"),
        (not_finite, "a position is not finite"),
        (deep_attributes, "maximum recursion depth"),
        (name_of_escapes, "the unit '?[2J' holds the character U+001B"),
        (unit_of_none, "its particles are not all of its 2 units"),
    ],
)
def test_no_series_does_anything(case, change, message):
    path = case(PARTICLES + ROCKS)
    file = series(path.parent)
    load(path)
    with h5py.File(file, "a") as h5:
        change(h5)
    assert message in refused(path)


def test_a_series_that_is_none(case):
    path = case(PARTICLES + ROCKS)
    file = series(path.parent)
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    assert "p.h5: not a particle series of this program" in refused(path)
    file.write_bytes(b"\x89HDF\r\n\x1a\n" + os.urandom(1000))
    assert "p.h5: not a particle series of this program" in refused(path)
    with open(file, "r+b") as stream:
        stream.truncate(TB)
    assert "is 1000000.0 MB large; at most 500 MB are read" in refused(path)


def test_a_series_goes_on_in_the_folder_only(case):
    path = case(PARTICLES + ROCKS)
    series(path.parent)
    os.rename(series(path.parent.parent), path.parent.parent / "q.h5")
    (path.parent / "p-2.h5").symlink_to("../q.h5")
    assert "'p-2.h5' is a link out of the folder" in refused(path)
    os.remove(path.parent / "p-2.h5")
    os.mkfifo(path.parent / "p-2.h5")
    assert "is not a regular file" in refused(path)


# --- what names do in what is written -------------------------------------------------------------

NAMES = (
    "../../out",
    '<a href="x">&amp;',
    "=cmd|' /C calc'!A0",
    "a,b\";'c",
    "$\\frac{1",
    "%s{0}",
    "-rf",
)


@pytest.fixture(scope="module")
def watched(tmp_path_factory):
    """Check and run a small case with the names of a stranger in a process that is watched."""
    folder = tmp_path_factory.mktemp("watched")
    layers = [
        {"rock": name, "top": {"depth": f"{700 - 100 * i} m"}} for i, name in enumerate(NAMES)
    ]
    case = {
        "title": '</Xdmf> "; $(touch owned) `touch owned`',
        "section": {
            "box": {"width": "2 km", "height": "1 km"},
            "layers": [*layers, {"rock": "sediment"}],
        },
        "rocks": {
            name: {"density": "2160 kg/m^3", "viscosity": "1e17 Pa s"}
            for name in [*NAMES, "sediment"]
        },
        "certificate": "off",
        "mesh": {"cells": 4},
        "particles": {"per_cell": 4},
        "time": {"marks": ["0 ka", "1 ka"], "min_steps": 1},
    }
    (folder / "case.yaml").write_text(json.dumps(case))
    code = WATCH.format(runs=[["check", "case.yaml"], ["run", "case.yaml", "--out", "run"]])
    done = subprocess.run(
        [sys.executable, "-P", "-c", code],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return folder, json.loads((folder / "seen.json").read_text())


JIT_SETTINGS = ("dolfinx/dolfinx_jit_parameters.json", "ffcx/ffcx_parameters.json")  # the user's
WATCH = """
import json, os, sys

import tempfile

tempfile.gettempdir()  # which tries the folder by a file of its own
seen = []
WRITES = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND
CHANGES = ("os.remove", "os.rename", "os.mkdir", "os.rmdir", "os.link", "os.symlink", "os.truncate",
           "os.chmod", "os.chown", "shutil.rmtree", "shutil.move", "tempfile.mkstemp")
STARTS = ("subprocess.Popen", "os.system", "os.exec", "os.posix_spawn", "os.spawn", "pty.spawn")


def watch(event, arguments):
    if event == "open" and isinstance(arguments[0], (str, bytes)):
        kind = "write" if arguments[2] & WRITES else "read"
        seen.append((kind, os.path.realpath(os.fsdecode(arguments[0]))))
    elif event in CHANGES and not isinstance(arguments[0], int):
        seen.append(("write", os.path.abspath(os.fsdecode(arguments[0]))))
    elif event in STARTS:
        seen.append(("start", os.path.basename(str(arguments[0]))))
    elif event.startswith(("socket.", "urllib.", "http.", "ftplib.", "webbrowser.")):
        seen.append(("net", event))


sys.addaudithook(watch)
from restoration.cli import main
from restoration.environment import jit_cache

codes = [main(arguments) for arguments in {runs}]
import matplotlib
for cache in (jit_cache().parent, matplotlib.get_cachedir(), matplotlib.get_configdir()):
    seen += [("cache", os.path.realpath(cache)), ("cache", str(cache))]
caught, seen = seen, []
with open("seen.json", "w") as file:
    json.dump(caught, file)
sys.exit(max(codes))
"""


def test_a_run_opens_what_it_must_and_speaks_to_nobody(watched):
    folder, seen = watched
    by_kind = {kind: {name for row, name in seen if row == kind} for kind, _ in seen}
    run, caches = str(folder / "run"), (*by_kind["cache"], "/dev/null")
    lock = re.compile(r"/tmp/restore-\d+-[0-9a-f]{16}\.lock")
    stray = [
        name
        for name in by_kind["write"]
        if not (f"{name}/".startswith(f"{run}/") or name.startswith(caches))
        and "__pycache__" not in name
        and not lock.fullmatch(name)
    ]
    assert len(by_kind["write"]) > 20
    assert stray == []
    system = ("/usr/", "/etc/", "/proc/", "/sys/", "/lib/", f"{ROOT}/", f"{run}/")
    ours = (*system, *caches, os.path.realpath(sys.prefix), tempfile.gettempdir() + "/restore-")
    asked = {f"{folder}/{name}" for name in ("case.yaml", "run", *SETTINGS)}
    asked |= {f"{Path.home()}/.config/{name}" for name in JIT_SETTINGS}
    assert [n for n in by_kind["read"] if not (n.startswith(ours) or n in asked)] == []
    assert "net" not in by_kind
    known = re.compile(r"git|ldconfig|.*gcc(-\d+)?|cc|python3(\.\d+)?")
    assert [name for name in by_kind["start"] if not known.fullmatch(name)] == []
    assert sorted(path.name for path in folder.iterdir()) == ["case.yaml", "run", "seen.json"]


def test_names_break_none_of_the_files_written(watched):
    folder, _ = watched
    run = folder / "run"
    for xdmf in run.glob("*.xdmf"):
        assert ElementTree.parse(xdmf).getroot().tag == "Xdmf"
    rows = (run / "diagnostics.csv").read_text().splitlines()
    assert {row.count(",") for row in rows} == {rows[0].count(",")}
    assert json.loads((run / "run.json").read_text())["ended_well"]
    found = json.loads(next((run / "horizons").iterdir()).read_text())["features"]
    names = {feature["properties"]["name"] for feature in found}
    assert f"{NAMES[0]} / {NAMES[1]}" in names
    assert len((run / "log.txt").read_text().splitlines()[0].split("Xdmf>")) == 2
    # what was resolved is the same case again
    assert load(run / "resolved.yaml").resolved == (run / "resolved.yaml").read_text()


@pytest.mark.parametrize("name", SETTINGS)
def test_no_library_takes_settings_from_the_folder(tmp_path, monkeypatch, capsys, name):
    """PETSc starts a program of our choice as debugger where a .petscrc says so."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).symlink_to("nowhere")
    (tmp_path / "case.yaml").write_text(LAYERS + ROCKS)
    assert cli.main(["check", "case.yaml"]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"the working folder holds {name}, and {SETTINGS[name]} would")
    assert told.count("\n") == 1


def test_a_file_name_of_escapes_is_told_without(tmp_path, capsys):
    name = tmp_path / "a\x1b[2J\nb\udcff.yaml"
    assert cli.main(["check", str(name)]) == 2
    told = capsys.readouterr().err.splitlines()
    assert len([line for line in told if not line.startswith("warning")]) == 1
    assert not any(UNWRITABLE.search(line) for line in told)

"""Every parser under fire: whatever it is given, it reads it or refuses it in lines; no third way.

Inputs are good ones with a few changes, since what is random throughout is refused at its first
sign. The same every time; ``make torture`` tries many more.
"""

import copy
import json
import subprocess
import sys
import time
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from restoration.check import describe, describe_text
from restoration.cloud import read_cloud
from restoration.errors import CaseError
from restoration.resolve import load
from restoration.section import read_section
from restoration.starter import survey_text
from restoration.tree import override, read_tree
from restoration.units import UNITS, to_si
from restoration.words import UNWRITABLE
from tests.test_attacks import LAYERS, PARTICLES, ROCKS, SECTION, series
from tests.torture import tries

ROOT = Path(__file__).parents[1]
SECONDS = 2  # of computing, at most, of one input
CASES = [
    path.read_text(encoding="utf-8")
    for path in sorted(ROOT.glob("cases/*/case.yaml"))
    if "file:" not in path.read_text(encoding="utf-8")
]
CASES.append(
    """
title: Everything a case can say
section:
  box: {width: 6 km, height: 2 km}
  layers:
    - {rock: salt, top: {depth: 1.6 km, cosine: {amplitude: 50 m, wavelength: 3 km, phase: 1 km}}}
    - {rock: shale, name: roof}
rocks:
  salt: {density: 2160 kg/m^3, viscosity: 1e17 Pa s, color: "#d8a0c0"}
  shale: {density: 2.6 g/cm^3, viscosity: 1e19 Pa s}
  fault: {density: 2200 kg/m^3, viscosity: 1e16 Pa s}
faults:
  - {name: west, rock: fault, width: 50 m, at: 1 km, dip: 60 deg, from: 0.2 km, to: 1.6 km}
  - {name: east, rock: fault, width: 50 m, points: [[4 km, 0.1 km], [4.5 km, 1 km]]}
boundary:
  left: {velocity: [{at: [-2 km, 0 km], value: [0 mm/yr, 1 mm/yr]}, free]}
  right: {velocity: [{time: [0 Ma, 1 Ma], value: [1 mm/yr, 0 mm/yr]}, free]}
  surface: free
surface: {theta: 0.5, reverse: slave, noise: 0.5 m, air: {thickness: 1 km, viscosity: 1e16 Pa s}}
gravity: 9.8 m/s^2
mesh: {cells: [30, 10], element: P2-P1, refine: {levels: 1, where: [interfaces], every: 2}}
particles: {per_cell: 6, densify: 2, jitter: 0.3, seed: 5, velocity: plain}
transfer: {density: hat, viscosity: linear, mean: geometric}
solver: {name: fieldsplit, options: {ksp_rtol: 1e-9}}
time:
  marks: [0 Ma, 2 Ma]
  scheme: rk3
  tolerance: 1 m
  stop: {horizon: salt, flat: 50 m}
accuracy: draft
output: {at: 5, fields: [velocity], particles: false, exaggeration: 2}
certificate: {noise: 2 m, tolerance: 50 m}
"""
)
TOKENS = [
    *"{}[]:,-#'\"!&*|>%@` \t\n\r0e.+~?",
    *("nan", "null", "true", "1e999", "-1", "0", ": ", "- ", "\n  ", "\0", "\x1b[2J", "\ud800"),
    *("9" * 30, "<<: ", "!!python/name:os.system ", "&a ", "*a", "\N{NO-BREAK SPACE}", "\ufeff"),
    *(" km", " Ma", " Pa s", "free", "no-slip", "..", "/", "\\", "__class__", "\N{MINUS SIGN}5 km"),
]
VALUES = [
    *(None, True, False, 0, -1, 1, 2**31, 10**30, 0.5, 1e308, -1e-320, float("nan"), float("inf")),
    *("", " ", "0", "x", "free", "5 km", "-5 km", "0 km", "1e-9 m", "2 Ma", "1 Pa s", "all", "off"),
    *("\x00", "\n", "\x1b[2J", "\ud800", "x" * 300, "../x", "salt", "salt / roof", "surface"),
    *([], {}, [[]], [None], {"a": 1}, ["5 km", "1 km"], [0, 0], {"velocity": ["1 mm/yr", "free"]}),
]


def fuzz(usual, torture):
    """Return the settings of a test: as many inputs, the same in every run."""
    return settings(
        derandomize=True,
        max_examples=tries(usual, torture),
        deadline=None,
        database=None,
        suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
    )


def answered(read):
    """Return what is read, or None where it is refused as it should be: in lines, soon."""
    begin, result, fault = time.process_time(), None, None
    try:
        result = read()
    except CaseError as error:
        fault = error
    assert time.process_time() - begin < SECONDS
    if fault is not None:
        told = str(fault).splitlines()
        assert len(told) == len(fault.faults)
        assert all(line.strip() and not UNWRITABLE.search(line) for line in told), told
    return result


# One seed is drawn for all changes of an input: a draw for each takes longer than most parsers do.
SEEDED = st.randoms(use_true_random=True)


def some_text(rng):
    """Return a few signs of any kind, of which UTF-8 can write most."""
    return "".join(chr(rng.choice([rng.randrange(128), rng.randrange(0x11000)])) for _ in range(3))


@st.composite
def changed_text(draw, texts):
    """Draw a text with pieces of it replaced by signs, or by other pieces."""
    rng = draw(SEEDED)
    text = rng.choice(texts)
    for _ in range(rng.randint(1, 5)):
        at, other = rng.randint(0, len(text)), rng.randint(0, len(text))
        piece = rng.choice(
            [rng.choice(TOKENS), rng.choice(TOKENS), some_text(rng), text[other:][:25]]
        )
        text = text[:at] + piece + text[at + rng.choice([0, 0, 1, 4, 30]) :]
    return text


def places(value, path=()):
    """Return the paths of all values within one."""
    inner = ()
    if isinstance(value, (dict, list)):
        inner = value.items() if isinstance(value, dict) else enumerate(value)
    return [path, *(place for key, v in inner for place in places(v, (*path, key)))]


@st.composite
def changed_value(draw, values):
    """Draw a value with parts of it replaced, removed, renamed or put in other places."""
    rng = draw(SEEDED)
    value = copy.deepcopy(rng.choice(values))
    for _ in range(rng.randint(1, 3)):
        *path, key = rng.choice([place for place in places(value) if place] or [(None,)])
        if key is None:
            break
        parent = at(value, path)
        match rng.choice(("replace", "remove", "rename", "move")):
            case "replace":
                parent[key] = copy.deepcopy(rng.choice(VALUES))
            case "remove":
                del parent[key]
            case "rename" if isinstance(parent, dict):
                parent[f"{key}{rng.choice(['s', ' ', '_', '1'])}"] = parent.pop(key)
            case "move":
                parent[key] = copy.deepcopy(at(value, rng.choice(places(value))))
    return value


def at(value, path):
    """Return the value at a path."""
    for part in path:
        value = value[part]
    return value


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("fuzz")


def write(path, text):
    path.write_text(text, encoding="utf-8", errors="surrogatepass")
    return path


@pytest.mark.torture
@fuzz(2000, 100_000)
@given(changed_text(CASES) | st.text(max_size=60))
def test_yaml(text):
    answered(lambda: read_tree(text, "case.yaml"))


@pytest.mark.torture
@fuzz(400, 50_000)
@given(value=changed_value([read_tree(text, "").data for text in CASES]))
def test_cases_by_their_values(folder, value):
    """What is accepted can be told, and resolves to a case that says the same."""
    path = write(folder / "case.yaml", json.dumps(value, indent=1))
    loaded = answered(lambda: load(path))
    if loaded is not None:
        json.dumps(describe(loaded), allow_nan=False)
        assert describe_text(loaded).isprintable() is False  # lines
        again = write(folder / "again.yaml", loaded.resolved)
        assert load(again).resolved == loaded.resolved


@pytest.mark.torture
@fuzz(600, 50_000)
@given(text=changed_text(CASES))
def test_cases_by_their_text(folder, text):
    path = write(folder / "case.yaml", text)
    answered(lambda: load(path))


@pytest.mark.torture
@fuzz(500, 50_000)
@given(
    changed_text(["rocks.salt.density=1 km", "section.layers.0.top={depth: 1 km}", "mesh.cells=9"])
)
def test_overrides(text):
    def read():
        tree = read_tree(CASES[0], "case.yaml")
        override(tree, text)
        return tree

    answered(read)


@pytest.mark.torture
@fuzz(2000, 100_000)
@given(
    changed_text([f"2.5 {unit}" for units in UNITS.values() for unit in units])
    | st.text(max_size=20)
    | st.sampled_from(VALUES),
    st.sampled_from([*UNITS]),
)
def test_units(text, kind):
    begin, told = time.process_time(), "read"
    try:
        to_si(text, kind)
    except ValueError as error:
        told = str(error)
    assert told
    assert not UNWRITABLE.search(told)
    assert time.process_time() - begin < 0.05


@pytest.mark.torture
@fuzz(600, 50_000)
@given(value=changed_value([json.loads(SECTION)]))
def test_sections_by_their_values(folder, value):
    path = write(folder / "s.geojson", json.dumps(value))
    answered(lambda: read_section(path, "s.geojson"))
    told = answered(lambda: survey_text(path))
    assert told is None or told.encode()


@pytest.mark.torture
@fuzz(1000, 50_000)
@given(text=changed_text([SECTION]))
def test_sections_by_their_text(folder, text):
    path = write(folder / "s.geojson", text)
    answered(lambda: read_section(path, "s.geojson"))


TABLES = ["x,z,unit\n1,-1,salt\n2.5e3,-2,shale\n", 'z,"unit",x,w\r\n-1,"a, b",3,4\r\n']


@pytest.mark.torture
@fuzz(2000, 100_000)
@given(text=changed_text(TABLES))
def test_tables(folder, text):
    path = write(folder / "p.csv", text)
    answered(lambda: read_cloud(path, "p.csv", 1.0, 1.0))


CHILD = """
import random, signal, sys
from pathlib import Path
import numpy as np
from restoration.errors import CaseError
from restoration.series_reader import read_frame

good, folder = Path(sys.argv[1]).read_bytes(), Path(sys.argv[2])
answers = {"read": 0, "refused": 0}
with open(folder / "filled", "w+b") as filled:
    for seed in range(int(sys.argv[3]), int(sys.argv[4])):
        (folder / "seed").write_text(str(seed))
        rng, raw = random.Random(seed), bytearray(good)
        for _ in range(rng.randint(1, 8)):
            at = rng.randrange(len(raw))
            other = raw[rng.randrange(len(raw))]
            odd = rng.choice([0, 1, 127, 128, 255, rng.randrange(256), other])
            raw[at : at + rng.choice([0, 1, 1, 1, 4])] = bytes([odd]) * rng.choice([1, 1, 1, 4])
        if rng.random() < 0.05:
            raw = raw[: rng.randrange(len(raw))]
        (folder / "f.h5").write_bytes(raw)
        signal.alarm(10)
        filled.seek(0)
        try:
            read_frame(filled, -1, folder / "f.h5")
            answers["read"] += 1
        except CaseError as error:
            answers["refused" if str(error).strip() else "without a word"] += 1
print(answers["read"], answers["refused"])
"""


@pytest.mark.torture
def test_bytes_of_a_series(tmp_path):
    """HDF5 is used in a process of its own, which neither crashes nor takes 10 s here."""
    file = series(tmp_path)
    number = tries(2000, 100_000)
    done = subprocess.run(
        [sys.executable, "-c", CHILD, file, tmp_path, "0", str(number)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, (done.stderr[-2000:], (tmp_path / "seed").read_text())
    read, refused = map(int, done.stdout.split())
    assert read + refused == number
    assert min(read, refused) > number / 20


@pytest.mark.torture
@fuzz(10, 200)
@given(data=st.data())
def test_bytes_of_a_series_by_the_whole_way(folder, data):
    """The process, the file in memory and the case around it."""
    raw = bytearray(series(folder).read_bytes())
    for at in data.draw(st.lists(st.integers(0, 3000), min_size=1, max_size=5)):
        raw[at] = data.draw(st.integers(0, 255))
    (folder / "p.h5").write_bytes(raw)
    path = write(folder / "case.yaml", PARTICLES + ROCKS)
    answered(lambda: load(path))


def test_what_is_fuzzed_is_read_as_it_is(folder):
    """Else all would be refused, and nothing tried."""
    for text in [*CASES, LAYERS + ROCKS]:
        load(write(folder / "case.yaml", text))
    read_section(write(folder / "s.geojson", SECTION), "s.geojson")
    for text in TABLES:
        read_cloud(write(folder / "p.csv", text), "p.csv", 1.0, 1.0)

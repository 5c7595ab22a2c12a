"""The entries of a case file: their kinds, bounds and defaults.

Quantities keep the text the user wrote beside their SI value. All values are frozen.
"""

import re
from itertools import pairwise
from typing import Annotated

from pydantic import (
    AfterValidator,
    Field,
    PlainValidator,
    WrapValidator,
    field_validator,
    model_validator,
)

from restoration.fault_entries import FaultEntry
from restoration.kinds import Entry, FilePath, Length, Name, Size, quantity, read_names, words
from restoration.units import UNITS, Quantity, parse, show
from restoration.words import hint, listed, quoted, wrong_name

# Defaults by accuracy; the measurements behind them are in docs/trade.md.
PRESETS = {
    "draft": {"cells": 20, "per_cell": 4, "courant": 2.0, "min_steps": 5},
    "balanced": {"cells": 45, "per_cell": 4, "courant": 1.0, "min_steps": 10},
    "fine": {"cells": 90, "per_cell": 12, "courant": 1.0, "min_steps": 20},
}
BOX_CELLS = {"draft": 5, "balanced": 8, "fine": 12}  # of the shortest side of a box with a length
LONGEST = 1e4 * UNITS["time"]["Myr"]  # s, of a march
HIGHEST = {"velocity": 1.0, "pressure": 1e12, "length": 1e8}  # of walls, SI
SCHEMES = ("rk4", "rk3", "midpoint", "implicit-midpoint", "paper", "euler")
TOLERANT = ("rk3", "implicit-midpoint")  # which take a tolerance of the error of a step
COLOR = re.compile(r"#[0-9a-fA-F]{6}")
ELEMENTS = ("P2-P1", "P2b-P1dg", "P2-P1dg", "MINI", "Q2-Q1", "Q2-P1dg")
QUADRATIC = ("P2-P1", "P2b-P1dg", "P2-P1dg")  # velocities that can be made free of divergence
REFINED_AT = ("interfaces", "faults", "velocity-gradient")
# Options of PETSc that a case may give: those that the solvers heed. Viewers and monitors are not
# among them: they can write files, and a case file must not.
OPTIONS = (
    "ksp_type",
    "ksp_rtol",
    "ksp_max_it",
    "ksp_gmres_restart",
    "pc_type",
    "pc_factor_mat_solver_type",
    "pressure_ksp_type",
    "pressure_ksp_max_it",
    "pressure_ksp_chebyshev_esteig",
    "pressure_pc_type",
    "velocity_ksp_type",
    "velocity_ksp_max_it",
    "velocity_ksp_rtol",
    "velocity_pc_type",
    "velocity_mg_levels_ksp_type",
    "velocity_mg_levels_ksp_max_it",
    "velocity_mg_levels_pc_type",
    "velocity_mg_coarse_pc_type",
    "velocity_mg_coarse_pc_factor_mat_solver_type",
    "velocity_mg_coarse_pc_gamg_threshold",
    "velocity_mg_coarse_pc_gamg_square_graph",
    "velocity_mg_coarse_mg_levels_ksp_type",
    "velocity_mg_coarse_mg_levels_ksp_max_it",
    "velocity_mg_coarse_mg_levels_pc_type",
    "mat_mumps_icntl_7",
    "mat_mumps_icntl_14",
    "mat_mumps_icntl_23",
    "mat_mumps_icntl_24",
    "mat_mumps_cntl_1",
)
OPTION_VALUE = re.compile(r"(?!(?i:[+-]?[.]?(nan|inf)))[A-Za-z0-9_.,+-]{1,40}")


def read_cells(value):
    """Return the number of squares along the shortest side, or (across, up), or (x, y, up)."""
    ask = "write the number of squares along the shorter side, or [across, up]"
    numbers = value if isinstance(value, list) else [value]
    if len(numbers) not in (1, 2, 3) or any(type(n) is not int for n in numbers):
        raise ValueError(f"{quoted(value)}: {ask}")
    for n in numbers:
        if not 1 <= n <= 5000:
            raise ValueError(f"{n} squares are not possible; between 1 and 5000 are")
    return numbers[0] if len(numbers) == 1 else tuple(numbers)


def read_mark(value):
    """Return a model time as a time or, after today, an age."""
    text = value.strip() if isinstance(value, str) else value
    kind = "age" if isinstance(text, str) and re.search(r"\d\s*[Mk]a$", text) else "time"
    mark = parse(text, kind)
    if abs(mark.si) > LONGEST:
        raise ValueError(f"{quoted(mark.text)} is beyond {show(LONGEST, 'time')}")
    return mark


def is_age(mark):
    """Return whether a mark counts back from today."""
    return mark.text.endswith("a")


def read_marks(value):
    """Return the marks; each fault names its number in the list."""
    if not isinstance(value, list):
        raise ValueError(f"{quoted(value)} is not a list; write marks: [0 Myr, 6 Myr, 0 Myr]")
    marks = tuple(read_mark(entry) for entry in value)
    if len(marks) < 2:
        raise ValueError("a run needs two marks at least, such as [0 Myr, 6 Myr, 0 Myr]")
    if len({is_age(mark) for mark in marks}) == 2:
        raise ValueError("ages (Ma) and times (Myr) do not mix; write all marks in one")
    for before, after in pairwise(marks):
        if before.si == after.si:
            raise ValueError(
                f"the march from {before.text} to {after.text} goes nowhere; give another mark"
            )
    return marks


class TableEntry(Entry):
    """Values along a wall, in model time, or both: then a row of values for each time."""

    at: tuple[Quantity, ...] | None = None
    time: tuple[Quantity, ...] | None = None
    value: tuple[Quantity | tuple[Quantity, ...], ...]


TABLE_EXAMPLES = {
    "velocity": "{at: [-2 km, 0 km], value: [0 mm/yr, 10 mm/yr]}",
    "pressure": "{time: [0 kyr, 20 kyr], value: [0 MPa, -5 MPa]}",
}


def read_table(value, unit):
    """Return a table of values of a wall."""
    such = f"a table is such as {TABLE_EXAMPLES[unit]}"
    known = tuple(TableEntry.model_fields)
    for name in value:
        if name not in known:
            raise ValueError(f"{quoted(name)} is no entry of a table{hint(name, known)}")
    if "value" not in value or len(value) < 2:
        missing = "value" if "value" not in value else "'at' (along the wall) or 'time'"
        raise ValueError(f"{missing} is missing; {such}")
    axes = {"at": lambda entry: _bounded(parse(entry, "length"), "length"), "time": read_mark}
    found = {name: read_axis(name, value[name], axes[name]) for name in axes if name in value}
    *outer, inner = reversed([*found])  # a row for each time, in it a value for each place
    rows = value["value"]
    if outer:
        _counted(rows, "time", found)
        rows = [read_row(row, inner, found, unit) for row in rows]
        return TableEntry(**found, value=tuple(rows))
    return TableEntry(**found, value=read_row(rows, inner, found, unit))


def read_axis(name, entries, read):
    """Return the places or the times of a table: two at least, all rising or all falling."""
    if not isinstance(entries, list) or len(entries) < 2:
        raise ValueError(f"{name}: {quoted(entries)} is no list of two or more")
    found = tuple(read(entry) for entry in entries)
    if len({is_age(entry) for entry in found}) == 2:
        raise ValueError(f"{name}: ages (Ma) and times (Myr) do not mix; write all in one")
    way = found[1].si - found[0].si
    for before, after in pairwise(found):
        if (after.si - before.si) * way <= 0:
            raise ValueError(f"{name}: {after.text} after {before.text}: let all rise, or all fall")
    return found


def read_row(row, name, found, unit):
    """Return a value for each place or time of a table."""
    _counted(row, name, found)
    return tuple(_bounded(parse(entry, unit), unit) for entry in row)


def _counted(row, name, found):
    """Refuse anything but a list as long as the places or times are."""
    number = len(found[name])
    if not isinstance(row, list) or len(row) != number:
        each = "a row" if name == "time" and "at" in found else "a value"
        ask = f"{each} for each of the {number} of '{name}'"
        raise ValueError(f"value: {quoted(row)} where {ask} is needed")


def _bounded(found, unit):
    """Return a quantity of a wall, or refuse it beyond what is possible."""
    if abs(found.si) > HIGHEST[unit]:
        raise ValueError(f"{quoted(found.text)} is beyond {show(HIGHEST[unit], unit)}")
    return found


class WallEntry(Entry):
    """One wall: its kind and, for velocity and traction, a value along x and z."""

    kind: str
    values: tuple[Quantity | TableEntry | None, Quantity | TableEntry | None] | None = None


WALL_EXAMPLES = {
    "velocity": "{velocity: [10 mm/yr, free]}",
    "traction": "{traction: [0 MPa, -5 MPa]}",
}


def read_wall_value(value, unit):
    """Return one value of a wall: a quantity, a table, or None where the component is free."""
    if isinstance(value, dict):
        return read_table(value, unit)
    return None if value == "free" else _bounded(parse(value, unit), unit)


def read_wall(value):
    """Return a wall from a word, or from {velocity: [..]} or {traction: [..]}."""
    kinds = ("no-slip", "free-slip", "free")
    groups = listed(WALL_EXAMPLES.values(), last="and")
    if isinstance(value, str):
        if value not in kinds:
            near = hint(value, kinds)
            raise ValueError(f"{quoted(value)} is no kind of wall{near}, and {groups}")
        return WallEntry(kind=value)
    if not isinstance(value, dict) or len(value) != 1:
        raise ValueError(f"{quoted(value)} is no kind of wall; possible: {listed(kinds)}; {groups}")
    ((kind, pair),) = value.items()
    if kind not in ("velocity", "traction"):
        raise ValueError(f"'{kind}' is no kind of wall{hint(kind, ('velocity', 'traction'))}")
    if not isinstance(pair, list) or len(pair) != 2:
        such = WALL_EXAMPLES[kind]
        raise ValueError(f"{kind} takes a value along x and one along z, such as {such}")
    unit = "velocity" if kind == "velocity" else "pressure"
    values = tuple(read_wall_value(entry, unit) for entry in pair)
    if kind == "traction" and None in values:
        raise ValueError("a traction has a value along x and along z; 0 MPa is none")
    if kind == "velocity" and values == (None, None):
        raise ValueError(
            "holds nothing; write {traction: [0 MPa, 0 MPa]} for a wall left to itself"
        )
    return WallEntry(kind=kind, values=values)


class Cosine(Entry):
    """A wave on a horizon: amplitude * cos(2 pi (x - phase) / wavelength), upwards.

    In a box with a length times cos(2 pi (y - phase_y) / wavelength_y) where that is given.
    """

    amplitude: Length
    wavelength: Size
    phase: Length = Quantity("0 km", 0.0)
    wavelength_y: Size | None = None
    phase_y: Length | None = None


class Top(Entry):
    """The top of a layer."""

    depth: quantity("length", low=0.0)
    cosine: Cosine | None = None


class Layer(Entry):
    """A layer of a box."""

    rock: Name
    name: Name | None = None
    top: Top | None = None


class Box(Entry):
    """A box: x from 0 to width, z from -height to 0; with a length y from 0 to that."""

    width: Size
    length: Size | None = None
    height: Size


class Section(Entry):
    """Where the section comes from: box and layers, a file of polygons, or particles."""

    box: Box | None = None
    layers: list[Layer] | None = None
    file: FilePath | None = None
    particles: FilePath | None = None
    property: Name = "unit"
    rock_property: Name | None = None
    coordinates: words("m", "km") = "m"
    vertical: words("up", "down") = "up"
    tolerance: quantity("length", above=0.0) | None = None


def read_color(value):
    """Return a colour ``#rrggbb``."""
    if not isinstance(value, str) or not COLOR.fullmatch(value):
        raise ValueError(f'{quoted(value)} is not a colour; write it in quotes, such as "#d8a0c0"')
    return value.lower()


class RockEntry(Entry):
    """A material, and the units of a section file that are of it."""

    density: quantity("density", low=0.0, high=3e4)
    viscosity: quantity("viscosity", low=1.0, high=1e30)
    unit: Annotated[tuple[str, ...], PlainValidator(read_names)] | None = None
    color: Annotated[str, PlainValidator(read_color)] | None = None


Wall = Annotated[WallEntry, PlainValidator(read_wall)]


class Boundary(Entry):
    """The four walls, and the two more of a box with a length."""

    left: Wall = WallEntry(kind="free-slip")
    right: Wall = WallEntry(kind="free-slip")
    base: Wall = WallEntry(kind="no-slip")
    surface: Wall = WallEntry(kind="free-slip")
    front: Wall | None = None
    back: Wall | None = None


class AirEntry(Entry):
    """Air that is solved for above a free surface."""

    thickness: Size
    viscosity: quantity("viscosity", low=1.0, high=1e30)
    density: quantity("density", low=0.0, high=3e4) = Quantity("1 kg/m^3", 1.0)


class Surface(Entry):
    """How a free surface moves."""

    theta: Annotated[float, Field(ge=0, le=1)] = 0.0
    reverse: words("auto", "integrate", "slave", "stabilise") = "auto"
    motion: words("vertical", "normal") = "vertical"
    limit: Annotated[float, Field(gt=0, le=1)] = 0.5  # above 1 a surface grows
    air: AirEntry | None = None
    noise: quantity("length", above=0.0) = Quantity("1 m", 1.0)
    tolerance: quantity("length", above=0.0) = Quantity("100 m", 100.0)


def read_where(value):
    """Return where a mesh is refined, from one word or a list without repeats."""
    words_given = value if isinstance(value, list) else [value]
    for word in words_given:
        if word not in REFINED_AT:
            near = hint(word, REFINED_AT) if isinstance(word, str) else ""
            raise ValueError(f"{quoted(word)} is not possible{near or possible(REFINED_AT)}")
    if not words_given:
        raise ValueError(f"names no place{possible(REFINED_AT)}")
    return tuple(dict.fromkeys(words_given))


def possible(known):
    """Return the end of a message that lists what is possible."""
    return f"; possible: {listed(known)}"


class Refine(Entry):
    """Where the mesh is finer, and how often it is adapted."""

    levels: Annotated[int, Field(ge=1, le=8)] = 2
    where: Annotated[tuple[str, ...], PlainValidator(read_where)] = ("interfaces", "faults")
    every: Annotated[int, Field(ge=1, le=10**6)] = 1


class Mesh(Entry):
    """The mesh."""

    cells: Annotated[int | tuple[int, ...], PlainValidator(read_cells)] | None = None
    element: words(*ELEMENTS) = "P2-P1"
    interfaces: words("particles", "fitted", "auto") = "particles"
    refine: Refine | None = None


def read_options(value):
    """Return options of the linear solver, (name, value) pairs of texts."""
    if not isinstance(value, dict):
        raise ValueError(f"{quoted(value)} is not a group of entries such as ksp_rtol: 1e-9")
    pairs = []
    for name, given in value.items():
        if name not in OPTIONS:
            raise ValueError(f"{quoted(name)} is no option of the solver{hint(str(name), OPTIONS)}")
        if isinstance(given, bool) or not isinstance(given, (int, float, str)):
            raise ValueError(f"{name}: {quoted(given)} is not a number or a word")
        if not OPTION_VALUE.fullmatch(str(given)):
            raise ValueError(f"{name}: {quoted(given)} is not a number or a word")
        pairs.append((name, str(given)))
    return tuple(pairs)


class Solver(Entry):
    """How the Stokes matrix is solved."""

    name: words("auto", "direct", "fieldsplit") = "auto"
    options: Annotated[tuple[tuple[str, str], ...], PlainValidator(read_options)] = ()
    reproducible: bool = True


class Particles(Entry):
    """The particles."""

    per_cell: Annotated[int, Field(ge=1, le=1000)] | None = None
    densify: Annotated[int, Field(ge=1, le=1000)] = 5
    jitter: Annotated[float, Field(ge=0, le=1)] = 0.5
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = 1
    velocity: words("conservative", "plain") | None = None


class Transfer(Entry):
    """How rock goes from particles to fields."""

    density: words("projection", "hat", "linear", "quadrature", "cell", "lines") = "projection"
    viscosity: words("hat", "linear", "quadrature", "cell", "lines") = "hat"
    mean: words("harmonic", "geometric", "arithmetic") = "harmonic"

    @field_validator("viscosity", mode="before")
    @classmethod
    def _stays_positive(cls, value):
        """Refuse what overshoots."""
        if value == "projection":
            raise ValueError(
                "'projection' overshoots beside jumps, which a viscosity does not bear: it must "
                "stay positive; take 'hat' or 'linear'"
            )
        return value


class Stop(Entry):
    """Where a march ends before its last mark."""

    horizon: Annotated[tuple[str, ...], PlainValidator(read_names)]
    flat: Size | None = None
    relief: Size | None = None
    depth: Length | None = None
    flattest: bool | None = None

    @model_validator(mode="after")
    def _one(self):
        """Refuse more than one criterion, or none."""
        criteria = ("flat", "relief", "depth", "flattest")
        given = [name for name in criteria if getattr(self, name) is not None]
        such = "one of flat: 50 m, relief: 100 m, depth: 3 km, flattest: true"
        if self.flattest is False:
            raise ValueError(f"flattest is true or not given; write {such}")
        if len(given) != 1:
            what = f"{listed(given, last='and')} together" if given else "no criterion"
            raise ValueError(f"{what}; write {such}")
        return self


def read_known_age(value):
    """Return an age or a duration above 0."""
    known = read_mark(value)
    if not known.si > 0:
        raise ValueError(f"{quoted(known.text)} must be above 0")
    return known


class Time(Entry):
    """The march."""

    marks: Annotated[tuple[Quantity, ...], PlainValidator(read_marks)]
    scheme: words(*SCHEMES) = "rk4"
    courant: Annotated[float, Field(gt=0, le=1e3)] | None = None
    min_steps: Annotated[int, Field(ge=1, le=10**6)] | None = None
    tolerance: quantity("length", low=1e-6, high=1e6) | None = None
    stop: Stop | None = None
    known_age: Annotated[Quantity, PlainValidator(read_known_age)] | None = None

    @field_validator("stop")
    @classmethod
    def _one_way(cls, value, found):
        """Refuse to stop between marks that turn back."""
        marks = found.data.get("marks", ())
        for a, b, c in zip(marks, marks[1:], marks[2:], strict=False):
            if value is not None and (b.si - a.si) * (c.si - b.si) < 0:
                raise ValueError(f"is for marks that go one way, and these turn at {b.text}")
        return value

    @field_validator("known_age")
    @classmethod
    def _stops(cls, value, found):
        """Refuse a known age of nothing."""
        if value is not None and "stop" in found.data and found.data["stop"] is None:
            raise ValueError("is the age of where the run stops; give time.stop too")
        return value

    @field_validator("tolerance")
    @classmethod
    def _told(cls, value, found):
        """Refuse a tolerance where the scheme has no use for it."""
        scheme = found.data.get("scheme")
        if value is not None and scheme is not None and scheme not in TOLERANT:
            raise ValueError(f"has no use with {scheme}; possible with {' and '.join(TOLERANT)}")
        return value


FIELDS = ("velocity", "pressure", "density", "viscosity", "strain_rate")


def read_at(value):
    """Return ``marks`` or a number of steps."""
    if value == "marks" or (type(value) is int and value >= 1):
        return value
    raise ValueError(f"{quoted(value)} is not possible; write marks, or a number of steps")


class Output(Entry):
    """What is written, and when."""

    at: Annotated[str | int, PlainValidator(read_at)] = "marks"
    fields: list[words(*FIELDS)] = Field(default_factory=lambda: [*FIELDS])
    particles: bool = True
    arrows: bool = False
    exaggeration: Annotated[float, Field(gt=0, le=100)] = 1.0


class Certificate(Entry):
    """What the certificate of a restoration is about."""

    noise: quantity("length", above=0.0, high=1e5) = Quantity("1 m", 1.0)
    tolerance: quantity("length", above=0.0, high=1e8) = Quantity("100 m", 100.0)


def read_certificate(value, read):
    """Return the entries of a certificate, or ``off``."""
    return "off" if value == "off" or value is False else read(value)


def rock_name(name):
    """Return the name of a rock as it stands."""
    if wrong := wrong_name(name):
        raise ValueError(f"{quoted(name)} {wrong}")
    return name


def not_empty(rocks):
    """Refuse an empty rock table."""
    if not rocks:
        raise ValueError("holds no rock; give each a density and a viscosity")
    return rocks


class Case(Entry):
    """A case, as written and with its defaults."""

    title: Name | None = None
    section: Section
    rocks: Annotated[
        dict[Annotated[str, AfterValidator(rock_name)], RockEntry], AfterValidator(not_empty)
    ]
    faults: list[FaultEntry] | None = None
    boundary: Boundary = Boundary()
    surface: Surface | None = None
    gravity: quantity("acceleration", low=0.0, high=1e3) = Quantity("9.81 m/s^2", 9.81)
    mesh: Mesh = Mesh()
    particles: Particles = Particles()
    transfer: Transfer = Transfer()
    solver: Solver = Solver()
    time: Time
    accuracy: words(*PRESETS) = "balanced"
    output: Output = Output()
    certificate: Annotated[Certificate, WrapValidator(read_certificate)] = Certificate()

    def preset(self, group, name):
        """Return an entry, or what ``accuracy`` makes it."""
        given = getattr(getattr(self, group), name)
        return PRESETS[self.accuracy][name] if given is None else given

"""The case file: every entry with its default, and all faults of a file at once.

Quantities keep the text the user wrote beside their SI value. The `Case` is frozen and knows
nothing of meshes and solvers.
"""

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    PlainValidator,
    ValidationError,
)

from restoration.errors import CaseError
from restoration.files import read_text
from restoration.tree import override, read_tree, shortened
from restoration.units import UNITS, Quantity, advice, parse, show
from restoration.words import hint, listed, nearest, quoted

# Defaults by accuracy; the measurements behind them are in docs/accuracy.md.
PRESETS = {
    "draft": {"cells": 20, "per_cell": 4, "courant": 1.0, "min_steps": 10},
    "balanced": {"cells": 45, "per_cell": 4, "courant": 0.5, "min_steps": 20},
    "fine": {"cells": 90, "per_cell": 4, "courant": 0.5, "min_steps": 40},
}
# Entries of docs/design.md that are promised and not built: refused by name.
LATER = {
    ("mesh", "refine"): "mesh refinement is not built yet; raise mesh.cells instead",
    ("faults",): "faults with a strength of their own are not built yet; lines of a section file "
    "are followed and drawn",
    ("boundary", "front"): "sections are two-dimensional so far; remove this wall",
    ("boundary", "back"): "sections are two-dimensional so far; remove this wall",
}
SYNONYMS = {"top": "surface", "bottom": "base", "walls": "boundary", "colour": "color"}
FREE_SURFACE = (
    "a free surface is not built yet; use free-slip for a surface that stays flat, or "
    "{traction: [0 MPa, 0 MPa]} for one that rock may cross"
)
# Entries of a section that only a file has a use for.
FILE_ENTRIES = ("property", "rock_property", "coordinates", "vertical", "tolerance")
WALLS = ("left", "right", "base", "surface")
LONGEST = 1e4 * UNITS["time"]["Myr"]  # s, of a march
HIGHEST = {"velocity": 1.0, "pressure": 1e12}  # of walls, SI
COLOR = re.compile(r"#[0-9a-fA-F]{6}")


class Entry(BaseModel):
    """A group of entries: no others, no conversions, no infinities, no changes."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def quantity(kind, low=None, high=None, above=None):
    """Return the type of a quantity within bounds, SI."""

    def read(value):
        found = value if isinstance(value, Quantity) else parse(value, kind)
        if above is not None and not found.si > above:
            raise ValueError(f"{quoted(found.text)} must be above {show(above, kind)}")
        if low is not None and found.si < low:
            raise ValueError(f"{quoted(found.text)} must not be below {show(low, kind)}")
        if high is not None and found.si > high:
            raise ValueError(f"{quoted(found.text)} is above {show(high, kind)}, the most possible")
        return found

    return Annotated[Quantity, PlainValidator(read)]


def words(*known):
    """Return the type of a word out of a few."""

    def read(value):
        if not isinstance(value, str) or value not in known:
            near = hint(value, known) if isinstance(value, str) else f"; possible: {listed(known)}"
            raise ValueError(f"{quoted(value)} is not possible{near}")
        return value

    return Annotated[str, PlainValidator(read)]


def read_name(value):
    """Return a name; numbers become text."""
    if isinstance(value, bool) or not isinstance(value, (str, int)) or not str(value).strip():
        raise ValueError(f"{quoted(value)} is not a name")
    return str(value).strip()


def read_names(value):
    """Return a tuple of names from one or a list."""
    return tuple(read_name(entry) for entry in (value if isinstance(value, list) else [value]))


def read_cells(value):
    """Return the number of squares along the shorter side, or (across, up)."""
    ask = "write the number of squares along the shorter side, or [across, up]"
    numbers = value if isinstance(value, list) else [value]
    if len(numbers) not in (1, 2) or any(type(n) is not int for n in numbers):
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


class WallEntry(Entry):
    """One wall: its kind and, for velocity and traction, a value along x and z."""

    kind: str
    values: tuple[Quantity | None, Quantity | None] | None = None


def read_wall(value):
    """Return a wall from a word, or from {velocity: [..]} or {traction: [..]}."""
    kinds = ("no-slip", "free-slip")
    groups = "{velocity: [10 mm/yr, free]} and {traction: [0 MPa, -5 MPa]}"
    if isinstance(value, str):
        if value not in (*kinds, "free"):  # which _cross_faults refuses with more to say
            near = hint(value, kinds)
            raise ValueError(f"{quoted(value)} is no kind of wall{near}, and {groups}")
        return WallEntry(kind=value)
    if not isinstance(value, dict) or len(value) != 1:
        raise ValueError(f"{quoted(value)} is no kind of wall; possible: {listed(kinds)}; {groups}")
    ((kind, pair),) = value.items()
    if kind not in ("velocity", "traction"):
        raise ValueError(f"'{kind}' is no kind of wall{hint(kind, ('velocity', 'traction'))}")
    if not isinstance(pair, list) or len(pair) != 2:
        raise ValueError(f"{kind} takes a value along x and one along z, such as {groups}")
    unit = "velocity" if kind == "velocity" else "pressure"
    values = tuple(None if entry == "free" else parse(entry, unit) for entry in pair)
    for found in values:
        if found and abs(found.si) > HIGHEST[unit]:
            raise ValueError(f"{quoted(found.text)} is beyond {show(HIGHEST[unit], unit)}")
    if kind == "velocity" and values == (None, None):
        raise ValueError(
            "holds nothing; write {traction: [0 MPa, 0 MPa]} for a wall left to itself"
        )
    return WallEntry(kind=kind, values=values)


Name = Annotated[str, PlainValidator(read_name)]
Length = quantity("length")
Size = quantity("length", above=0.0, low=1e-3, high=1e8)


class Cosine(Entry):
    """A wave on a horizon: amplitude * cos(2 pi (x - phase) / wavelength), upwards."""

    amplitude: Length
    wavelength: Size
    phase: Length = Quantity("0 km", 0.0)


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
    """A box: x from 0 to width, z from -height to 0."""

    width: Size
    height: Size


class Section(Entry):
    """Where the section comes from: box and layers, a file of polygons, or particles."""

    box: Box | None = None
    layers: list[Layer] | None = None
    file: Name | None = None
    particles: Name | None = None
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
    """The four walls."""

    left: Wall = WallEntry(kind="free-slip")
    right: Wall = WallEntry(kind="free-slip")
    base: Wall = WallEntry(kind="no-slip")
    surface: Wall = WallEntry(kind="free-slip")


class Mesh(Entry):
    """The mesh."""

    cells: Annotated[int | tuple[int, int], PlainValidator(read_cells)] | None = None


class Particles(Entry):
    """The particles."""

    per_cell: Annotated[int, Field(ge=1, le=1000)] | None = None
    densify: Annotated[int, Field(ge=1, le=1000)] = 5
    jitter: Annotated[float, Field(ge=0, le=1)] = 0.5
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = 1


class Transfer(Entry):
    """How rock goes from particles to fields."""

    density: words("hat", "quadrature", "cell") = "hat"
    viscosity: words("hat", "cell") = "hat"
    mean: words("harmonic", "geometric", "arithmetic") = "harmonic"


class Time(Entry):
    """The march."""

    marks: Annotated[tuple[Quantity, ...], PlainValidator(read_marks)]
    scheme: words("rk4", "midpoint", "paper", "euler") = "rk4"
    courant: Annotated[float, Field(gt=0, le=1e3)] | None = None
    min_steps: Annotated[int, Field(ge=1, le=10**6)] | None = None


FIELDS = ("velocity", "pressure", "density", "viscosity", "strain_rate")


def read_at(value):
    """Return ``marks`` or a number of steps."""
    if value == "marks" or (type(value) is int and value >= 1):
        return value
    raise ValueError(f"{quoted(value)} is not possible; write marks, or a number of steps")


class Output(Entry):
    """What is written, and when."""

    at: Annotated[str | int, PlainValidator(read_at)] = "marks"
    fields: list[words(*FIELDS)] = list(FIELDS)
    particles: bool = True
    arrows: bool = False
    exaggeration: Annotated[float, Field(gt=0, le=100)] = 1.0


def not_empty(rocks):
    """Refuse an empty rock table."""
    if not rocks:
        raise ValueError("holds no rock; give each a density and a viscosity")
    return rocks


class Case(Entry):
    """A case, as written and with its defaults."""

    title: Name | None = None
    section: Section
    rocks: Annotated[dict[str, RockEntry], AfterValidator(not_empty)]
    boundary: Boundary = Boundary()
    gravity: quantity("acceleration", low=0.0, high=1e3) = Quantity("9.81 m/s^2", 9.81)
    mesh: Mesh = Mesh()
    particles: Particles = Particles()
    transfer: Transfer = Transfer()
    time: Time
    accuracy: words(*PRESETS) = "balanced"
    output: Output = Output()

    def preset(self, group, name):
        """Return an entry, or what ``accuracy`` makes it."""
        given = getattr(getattr(self, group), name)
        return PRESETS[self.accuracy][name] if given is None else given


def read_case(path, overrides=()):
    """Return the `Case` of a file, its text and the `Tree` that knows the place of every entry.

    Args:
        path: the case file.
        overrides: ``a.b=value`` texts.

    Raises:
        CaseError: with all faults of the file.
    """
    shown = str(path)
    text = read_text(Path(path), shown)
    tree = read_tree(text, shown)
    for assignment in overrides:
        override(tree, assignment)
    if not isinstance(tree.data, dict):
        message = f"holds {quoted(tree.data)} and not entries such as 'section:' and 'rocks:'"
        raise CaseError([*tree.faults, tree.fault((), message)])
    faults, case = list(tree.faults), None
    try:
        case = Case.model_validate(tree.data)
    except ValidationError as error:
        faults += _told(tree, error.errors())
    faults += _cross_faults(tree)
    if faults:
        placed = sorted(faults, key=lambda f: (f.line is None, f.line or 0, f.column or 0))
        placed = [_without_echo(fault) for fault in dict.fromkeys(placed)]
        raise CaseError(shortened(placed))
    return case, text, tree


def _without_echo(fault):
    """Return a fault of ``--set a.b`` without the entry a.b once more."""
    return replace(fault, entry="") if fault.file == f"--set {fault.entry}" else fault


def _told(tree, errors):
    """Return a fault for every error; a misspelt name is not told as missing too."""
    meant = {
        (*error["loc"][:-1], _meant(error["loc"][-1], _names_at(error["loc"][:-1])))
        for error in errors
        if error["type"] == "extra_forbidden"
    }
    return [
        _fault(tree, error)
        for error in errors
        if error["type"] != "missing" or error["loc"] not in meant
    ]


def _meant(name, known):
    """Return the entry that a name stands for, or None."""
    synonym = SYNONYMS.get(nearest(name, SYNONYMS))
    return nearest(name, known) or (synonym if synonym in known else None)


def _fault(tree, found):
    """Return the fault behind one error of pydantic."""
    path = tuple(part for part in found["loc"] if part != "[key]")
    kind, context = found["type"], found.get("ctx", {})
    if kind == "extra_forbidden":
        if message := LATER.get(path):
            return tree.fault(path, message, at="key")
        known = _names_at(path[:-1])
        meant = _meant(path[-1], known)
        near = f"; did you mean '{meant}'? (possible: {listed(known)})" if meant else ""
        near = near or hint(path[-1], known)
        return tree.fault(path, f"no such entry{near}", at="key")
    if kind == "missing":
        return tree.fault(path, f"is missing{_missing(path)}", at="key")
    if kind == "value_error":
        return tree.fault(path, str(context["error"]))
    value = quoted(found["input"])
    bounds = {
        "greater_than": "must be above {gt:g}",
        "greater_than_equal": "must not be below {ge:g}",
        "less_than_equal": "must not be above {le:g}",
    }
    if kind in bounds:
        return tree.fault(path, f"{value} {bounds[kind].format(**context)}")
    expected = {
        "int_type": "is not a whole number",
        "float_type": "is not a number",
        "bool_type": "is not true or false",
        "list_type": "is not a list",
        "dict_type": "is not a group of entries",
        "model_type": "is not a group of entries",
        "string_type": "is not text",
    }
    told = f"{value} {expected.get(kind, found['msg'])}"
    if found["input"] is None:
        told = "is empty; fill it in or remove it"
    return tree.fault(path, f"{told}{_group_hint(path, kind)}")


def _model_at(path):
    """Return the model of the group at a path."""
    model = Case
    for part in path:
        if isinstance(part, int) or model is None:
            continue
        if model is Case and part == "rocks":
            model = {"rocks": RockEntry}
            continue
        if isinstance(model, dict):
            model = model["rocks"]
            continue
        field = model.model_fields.get(part)
        model = _inner_model(field.annotation) if field else None
    return model


def _inner_model(annotation):
    """Return the model inside an annotation such as ``list[Layer] | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for inner in getattr(annotation, "__args__", ()):
        if (model := _inner_model(inner)) is not None:
            return model
    return None


def _names_at(path):
    """Return the names of the entries a group may have."""
    model = _model_at(path)
    return list(model.model_fields) if isinstance(model, type) else []


def _group_hint(path, kind):
    names = _names_at(path) if kind in ("model_type", "dict_type") else []
    return f"; its entries are {listed(names, last='and')}" if names else ""


def _missing(path):
    asks = {
        ("section",): "; give a box and layers, a file of polygons, or particles",
        ("rocks",): "; give every rock a density and a viscosity",
        ("time",): "; give marks, such as time: {marks: [0 Myr, 6 Myr, 0 Myr]}",
        ("time", "marks"): "; such as [0 Myr, 6 Myr, 0 Myr], or ages [0 Ma, 2 Ma] to restore",
    }
    kind = dict.fromkeys(("width", "height", "depth", "amplitude", "wavelength"), "length")
    kind |= {"density": "density", "viscosity": "viscosity"}
    if path in asks:
        return asks[path]
    return f"; {advice(kind[path[-1]])}" if path[-1] in kind else ""


def _cross_faults(tree):
    """Return the faults between entries; reads the raw values, so that others do not hide them."""
    faults = []
    section, rocks = tree.raw(("section",)), tree.raw(("rocks",))
    if isinstance(section, dict):
        faults += _section_faults(tree, section)
    layers = tree.raw(("section", "layers"))
    if isinstance(layers, list) and isinstance(rocks, dict) and rocks:
        for i, layer in enumerate(layers):
            rock = layer.get("rock") if isinstance(layer, dict) else None
            if (
                isinstance(rock, (str, int))
                and not isinstance(rock, bool)
                and str(rock) not in rocks
            ):
                path = ("section", "layers", i, "rock")
                faults.append(tree.fault(path, f"there is no rock '{rock}'{hint(rock, rocks)}"))
    for name in WALLS:
        if tree.raw(("boundary", name)) == "free":
            message = FREE_SURFACE if name == "surface" else "only the surface can be free"
            faults.append(tree.fault(("boundary", name), message))
    return faults


def _section_faults(tree, section):
    """Return the faults of the ways to give a section."""
    at = ("section",)
    ways = [way for way in ("layers", "file", "particles") if section.get(way) is not None]
    if len(ways) > 1:
        return [tree.fault(at, f"{listed(ways, last='and')} are given; a section comes from one")]
    if not ways:
        ask = "give box and layers, or file, or particles"
        return [tree.fault(at, f"nothing says where the rock is; {ask}")]
    (way,) = ways
    faults = []
    if way != "file" and section.get("box") is None:
        faults.append(tree.fault(at, f"{way} need a box: {{width: .., height: ..}}"))
    if way == "file" and section.get("box") is not None:
        faults.append(tree.fault((*at, "box"), "the outline comes from the file; remove the box"))
    if way == "layers":
        for name in FILE_ENTRIES:
            if name in section:
                message = "says nothing about layers; remove it"
                faults.append(tree.fault((*at, name), message, at="key"))
        layers = section["layers"]
        for i, layer in enumerate(layers if isinstance(layers, list) else []):
            has_top = isinstance(layer, dict) and layer.get("top") is not None
            if i + 1 < len(layers) and not has_top:
                faults.append(
                    tree.fault((*at, "layers", i), "has no top; only the last layer fills the rest")
                )
            elif i + 1 == len(layers) and has_top:
                faults.append(
                    tree.fault(
                        (*at, "layers", i, "top"),
                        "the last layer fills up to the surface; "
                        "remove its top, or add a layer above",
                    )
                )
        if layers == []:
            faults.append(tree.fault((*at, "layers"), "holds no layer"))
    return faults


__all__ = ["PRESETS", "Case", "is_age", "read_case"]

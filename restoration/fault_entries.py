"""The entries of faults with a width and a rock, and what they may say together."""

from typing import Annotated

import numpy as np
from pydantic import PlainValidator, create_model

from restoration.kinds import Entry, Length, Name, Size
from restoration.units import Quantity, parse
from restoration.words import hint, listed, quoted

WAYS = ("dip", "points", "line")  # to say where a fault is
OF_DIP = ("at", "depth", "from", "to", "detachment")  # entries that only a dip has a use for
DIPS = "60 deg dips to the right, -60 deg to the left, 90 deg is vertical"


def read_dip(value):
    """Return a dip from -90 to 90 deg, not 0."""
    dip = value if isinstance(value, Quantity) else parse(value, "angle")
    if dip.si == 0 or abs(dip.si) > np.pi / 2 + 1e-12:
        found = f"{quoted(dip.text)} is no dip between -90 deg and 90 deg"
        raise ValueError(f"{'a fault cannot be level' if dip.si == 0 else found}; {DIPS}")
    return dip


def read_points(value):
    """Return pairs of x and depth, two at least."""
    such = "[[3 km, 0 km], [2.2 km, 1.2 km]], pairs of x and depth"
    if not isinstance(value, list) or any(not isinstance(p, list) or len(p) != 2 for p in value):
        raise ValueError(f"{quoted(value)} is no row of points such as {such}")
    if len(value) < 2:
        raise ValueError(f"a fault needs two points at least, such as {such}")
    return tuple(tuple(parse(entry, "length") for entry in point) for point in value)


class _Fault(Entry):
    name: Name | None = None
    rock: Name
    width: Size
    line: Name | None = None
    points: Annotated[tuple[tuple[Quantity, ...], ...], PlainValidator(read_points)] | None = None
    dip: Annotated[Quantity, PlainValidator(read_dip)] | None = None
    at: Length | None = None
    depth: Length | None = None
    detachment: Length | None = None


# `from` is no name that Python would take in a class.
FaultEntry = create_model(
    "FaultEntry",
    __base__=_Fault,
    __doc__="A fault: a band of rock along a line that dips, a row of points or a drawn line.",
    **{"from": (Length | None, None), "to": (Length | None, None)},
)


def wrong_faults(tree):
    """Return the faults between the entries of the geological ones; reads the raw values."""
    at, given, rocks = ("faults",), tree.raw(("faults",)), tree.raw(("rocks",))
    found, names = [], {}
    if not isinstance(given, list):
        return []
    if given and tree.raw(("section", "particles")) is not None:
        message = "a cloud of particles brings the rock of its faults; remove them"
        found.append(tree.fault(at, message, at="key"))
    for i, fault in enumerate(given):
        if not isinstance(fault, dict):
            continue
        found += _wrong_rock(tree, i, fault, rocks) + _wrong_ways(tree, i, fault)
        name = fault.get("name", fault.get("line"))
        if isinstance(name, (str, int)) and names.setdefault(str(name).strip(), i) != i:
            message = f"{quoted(name)} is the name of another fault; give each its own"
            found.append(tree.fault((*at, i, "name" if "name" in fault else "line"), message))
    return found


def _wrong_rock(tree, i, fault, rocks):
    """Return the fault of a rock that is not there."""
    rock = fault.get("rock")
    if not isinstance(rocks, dict) or not isinstance(rock, (str, int)) or isinstance(rock, bool):
        return []
    if str(rock).strip() in rocks:
        return []
    return [tree.fault(("faults", i, "rock"), f"there is no rock '{rock}'{hint(rock, rocks)}")]


def _wrong_ways(tree, i, fault):
    """Return what is wrong with how a fault is said to lie."""
    at, ways = ("faults", i), [way for way in WAYS if fault.get(way) is not None]
    if len(ways) > 1:
        return [tree.fault(at, f"{listed(ways, last='and')} are given; a fault lies in one way")]
    if not ways and set(fault) - set(FaultEntry.model_fields):
        return []  # misspelt, which is told already
    if not ways:
        ask = "give dip and at, or points, or the name of a line of the section file"
        return [tree.fault(at, f"nothing says where the fault is; {ask}")]
    found = []
    if ways == ["dip"] and fault.get("at") is None:
        found.append(tree.fault(at, "at is missing: the x that the fault passes; such as 2 km"))
    if ways != ["dip"]:
        found += [
            tree.fault((*at, name), "goes with a dip only; remove it", at="key")
            for name in OF_DIP
            if name in fault
        ]
    if ways == ["line"] and tree.raw(("section", "file")) is None:
        message = "the lines of faults come from a section file, and there is none; give points"
        found.append(tree.fault((*at, "line"), message))
    return found

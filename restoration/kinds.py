"""Kinds of entries of a case file: groups, quantities within bounds, words and names."""

from typing import Annotated

from pydantic import BaseModel, ConfigDict, PlainValidator

from restoration.units import Quantity, parse, show
from restoration.words import LONGEST_NAME, hint, listed, quoted, wrong_name

LONGEST_PATH = 1000  # characters


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


def read_name(value, longest=LONGEST_NAME):
    """Return a name; numbers become text."""
    if isinstance(value, bool) or not isinstance(value, (str, int)):
        raise ValueError(f"{quoted(value)} is not a name")
    if wrong := wrong_name(name := str(value).strip(), longest):
        raise ValueError(f"{quoted(value)} {wrong}")
    return name


def read_names(value):
    """Return a tuple of names from one or a list."""
    if value == []:
        raise ValueError("names nothing; write a name, or a list of names")
    return tuple(read_name(entry) for entry in (value if isinstance(value, list) else [value]))


def read_path(value):
    """Return the path of a file, which may be longer than a name."""
    return read_name(value, LONGEST_PATH)


Name = Annotated[str, PlainValidator(lambda value: read_name(value))]
FilePath = Annotated[str, PlainValidator(read_path)]
Length = quantity("length")
Size = quantity("length", above=0.0, low=1e-3, high=1e8)

"""The sweep file: a case, and what of it is varied and how."""

import json
from dataclasses import dataclass, field
from itertools import product
from math import prod
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field, PlainValidator, ValidationError

from restoration.case import in_order, told
from restoration.errors import CaseError
from restoration.files import inside, read_text
from restoration.kinds import Entry, Name, read_name
from restoration.sweep.ranges import read_range
from restoration.tree import read_tree
from restoration.words import listed, quoted

MOST_RUNS = 10_000
WAYS = ("list", "grid", "latin")
NAME = "name"  # of a combination of a list; no entry of a case


def not_empty(found):
    """Refuse an empty list or group."""
    if not found:
        raise ValueError("is empty; fill it in or remove it")
    return found


def entry_names(entries):
    """Refuse what cannot be the name of an entry of a case, or would undo one before it."""
    groups = {}
    for name in entries:
        parts = name.split(".")
        if "=" in name or not all(part.strip() for part in parts):
            raise ValueError(f"{quoted(name)} is no entry; write such as rocks.salt.viscosity")
        if name in groups:
            raise ValueError(f"{quoted(name)} would undo {quoted(groups[name])}; give it first")
        groups |= {".".join(parts[:count]): name for count in range(1, len(parts))}
    return entries


Entries = Annotated[dict[str, Any], AfterValidator(entry_names)]
Varied = Annotated[Entries, AfterValidator(not_empty)]
Combinations = Annotated[list[Varied], AfterValidator(not_empty)]
Values = Annotated[list[Any], AfterValidator(not_empty)]
Grid = Annotated[dict[str, Values], AfterValidator(entry_names), AfterValidator(not_empty)]
RangeEntry = Annotated[Any, PlainValidator(read_range)]
Ranges = Annotated[dict[str, RangeEntry], AfterValidator(entry_names), AfterValidator(not_empty)]


class Latin(Entry):
    """A Latin hypercube: each range cut into as many parts as there are samples, one in each."""

    samples: Annotated[int, Field(ge=1, le=MOST_RUNS)]
    ranges: Ranges
    seed: Annotated[int, Field(ge=0, le=2**32 - 1)] = 1


class SweepEntries(Entry):
    """The entries of a sweep file."""

    title: Name | None = None
    case: Name
    set: Entries = Field(default_factory=dict)
    list: Combinations | None = None
    grid: Grid | None = None
    latin: Latin | None = None


@dataclass(frozen=True)
class Variation:
    """What one run has of its own.

    Attributes:
        entries: values by entry of the case.
        places: path in the sweep file of each of them.
        name: given name, or None.
    """

    entries: dict
    places: dict
    name: str | None = None


@dataclass(frozen=True, eq=False)
class Sweep:
    """A sweep file, read.

    Attributes:
        path: of the sweep file.
        text: the file as given.
        title: of the sweep.
        case: path of the case file.
        shared: values by entry that all runs have.
        variations: tuple of `Variation`, in the order of the file.
        tree: `tree.Tree` that knows the place of every value.
    """

    path: Path
    text: str
    title: str
    case: Path
    shared: dict
    variations: tuple
    tree: object = field(repr=False)

    @property
    def entries(self):
        """Names of what is varied, in the order of the file."""
        return list(dict.fromkeys(name for one in self.variations for name in one.entries))

    @property
    def name(self):
        """Name of the sweep: that of its file, or of the folder where it is ``sweep.yaml``."""
        stem = self.path.stem.removesuffix(".sweep")
        return (self.path.absolute().parent.name if stem == "sweep" else stem) or "sweep"


def read_sweep(path, allow_outside=False):
    """Return the `Sweep` of a file.

    Args:
        path: the sweep file.
        allow_outside: whether its case may lie outside its folder.

    Raises:
        CaseError: with all faults of the file.
    """
    path, shown = Path(path), str(path)
    text = read_text(path, shown)
    tree = read_tree(text, shown)
    if not isinstance(tree.data, dict):
        message = f"holds {quoted(tree.data)} and not entries such as 'case:' and 'grid:'"
        raise CaseError([*tree.faults, tree.fault((), message)])
    faults, found = list(tree.faults), None
    try:
        found = SweepEntries.model_validate(tree.data)
    except ValidationError as error:
        faults += told(tree, error.errors(), SweepEntries)
    faults += _cross_faults(tree)
    case = None
    try:
        case = inside(path.parent, read_name(tree.data.get("case", "-")), allow_outside, "sweep")
    except ValueError as error:
        if found is not None:  # else told already
            faults.append(tree.fault(("case",), str(error)))
    if faults:
        raise CaseError(in_order(faults))
    return Sweep(
        path, text, found.title or path.stem, case, found.set, tuple(_variations(found)), tree
    )


def _cross_faults(tree):
    """Return the faults of a sweep that varies nothing, in two ways, or too much."""
    given = [name for name in tree.data if name in WAYS]
    faults = []
    if not given:
        faults.append(tree.fault((), f"varies nothing; give one of {listed(WAYS)}"))
    for name in given[1:]:
        message = f"stands beside '{given[0]}'; a sweep has one of {listed(WAYS)}"
        faults.append(tree.fault((name,), message, at="key"))
    lists = tree.data.get("grid")
    if isinstance(lists, dict) and all(isinstance(values, list) for values in lists.values()):
        count = prod(map(len, lists.values()))
        if count > MOST_RUNS:
            message = f"makes {count} runs; at most {MOST_RUNS} are possible"
            faults.append(tree.fault(("grid",), message, at="key"))
    rows = tree.data.get("list")
    for i, row in enumerate(rows if isinstance(rows, list) else ()):
        if isinstance(row, dict) and NAME in row:
            try:
                read_name(row[NAME])
            except ValueError as error:
                faults.append(tree.fault(("list", i, NAME), str(error)))
            if len(row) == 1:
                faults.append(tree.fault(("list", i), "has a name and varies nothing"))
    return faults


def _variations(found):
    """Yield the variations of a sweep whose entries are sound."""
    if found.list is not None:
        for i, row in enumerate(found.list):
            entries = {name: value for name, value in row.items() if name != NAME}
            places = {name: ("list", i, name) for name in entries}
            yield Variation(entries, places, read_name(row[NAME]) if NAME in row else None)
    elif found.grid is not None:
        names = list(found.grid)
        for values in product(*(enumerate(found.grid[name]) for name in names)):
            entries = {name: value for name, (_, value) in zip(names, values, strict=True)}
            places = {name: ("grid", name, i) for name, (i, _) in zip(names, values, strict=True)}
            yield Variation(entries, places)
    else:
        yield from _sampled(found.latin)


def _sampled(latin):
    """Yield the variations of a Latin hypercube."""
    from scipy.stats import qmc  # loads much

    names = list(latin.ranges)
    shares = qmc.LatinHypercube(len(names), seed=latin.seed).random(latin.samples)
    places = {name: ("latin", "ranges", name) for name in names}
    for row in shares:
        values = zip(names, row, strict=True)
        yield Variation({name: latin.ranges[name].value(float(u)) for name, u in values}, places)


def assignment(name, value):
    """Return ``a.b=value`` as the command line takes it; the value is JSON, which is YAML too."""
    return f"{name}={json.dumps(value, ensure_ascii=False)}"

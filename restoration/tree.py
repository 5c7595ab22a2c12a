"""A YAML text as plain values, with the line and column of every entry.

The events of the parser are read directly: nothing is constructed, so tags, anchors and aliases
have no effect before they are refused. Lines are bounded before reading, entries and depth while
reading. Numbers are decimal and finite; whatever else looks like one stays text.
"""

import math
import re
from dataclasses import dataclass, field

from ruamel.yaml import YAML
from ruamel.yaml import events as ev
from ruamel.yaml.error import YAMLError

from restoration.errors import CaseError, Fault
from restoration.words import listed, quoted

DEEPEST = 32
MOST_NODES = 10_000  # which take a second
MOST_LINES = 10_000
LONGEST_LINE = 100_000  # characters
MOST_FAULTS = 40
INTEGER = re.compile(r"[-+]?(0|[1-9][0-9]{0,17})", re.ASCII)
DECIMAL = re.compile(
    r"[-+]?((0|[1-9][0-9]{0,39})(\.[0-9]{0,40})?|\.[0-9]{1,40})([eE][-+]?[0-9]{1,3})?", re.ASCII
)
DIRECTIVE = re.compile("^%", re.MULTILINE)
CONSTANTS = {"": None, "~": None, "null": None, "true": True, "false": False}


@dataclass(frozen=True)
class Place:
    """Where an entry is: file as the user named it, line and column from 1 or None."""

    file: str
    line: int | None = None
    column: int | None = None


@dataclass
class Tree:
    """The values of a YAML text.

    Attributes:
        file: its name in messages.
        data: mappings, lists and scalars.
        values: place of every value by path, a tuple of names and indices.
        keys: place of every name by path.
        faults: what was refused while reading.
    """

    file: str
    data: object = None
    values: dict = field(default_factory=dict)
    keys: dict = field(default_factory=dict)
    faults: list = field(default_factory=list)

    def fault(self, path, message, at="value"):
        """Return a `Fault` at the value or the key of a path, or at the nearest entry above."""
        path = tuple(path)
        places = [self.keys, self.values] if at == "key" else [self.values, self.keys]
        for length in range(len(path), -1, -1):
            for table in places:
                if path[:length] in table:
                    place, entry = table[path[:length]], dotted(path)
                    entry = "" if place.file == f"--set {entry}" else entry  # told already
                    return Fault(place.file, place.line, place.column, entry, message)
        return Fault(self.file, None, None, dotted(path), message)

    def raw(self, path):
        """Return the value at a path; None where there is none."""
        value = self.data
        for part in path:
            try:
                value = value[part]
            except (KeyError, IndexError, TypeError):
                return None
        return value


def dotted(path):
    """Return a path as ``section.layers.0.rock``."""
    return ".".join(str(part)[:80] for part in path)


def read_tree(text, file):
    """Return the `Tree` of a YAML text; faults it can go on after are kept in it.

    Raises:
        CaseError: it is not YAML, or too deep or too large.
    """
    tree = Tree(file)
    builder = _Builder(tree)
    _check_lines(text, file)
    try:
        for event in YAML(typ="safe", pure=True).parse(text):
            builder.take(event)
    except YAMLError as error:
        raise CaseError([*tree.faults, _syntax_fault(error, file, text)]) from None
    except (ValueError, RecursionError, AttributeError, IndexError, OverflowError) as error:
        reason = str(error)
        if isinstance(error, OverflowError) or "chr()" in reason:
            reason = "an escape such as \\U00110000 stands for no character"
        raise CaseError(
            [Fault(file, None, None, "", f"cannot be read as YAML: {reason}")]
        ) from None
    return tree


def _check_lines(text, file):
    """Refuse what the parser would take long for: more or longer lines than a case has."""
    if found := DIRECTIVE.search(text):
        line = text.count("\n", 0, found.start()) + 1
        message = "a case has no use for a directive, a line that begins with %: remove it"
        raise CaseError([Fault(file, line, 1, "", message)])
    lines = text.splitlines()
    if len(lines) > MOST_LINES:
        message = f"has {len(lines)} lines; at most {MOST_LINES} are read"
        raise CaseError([Fault(file, MOST_LINES + 1, None, "", message)])
    for number, line in enumerate(lines, 1):
        if len(line) > LONGEST_LINE:
            message = f"is a line of {len(line)} characters; at most {LONGEST_LINE} are read"
            raise CaseError([Fault(file, number, None, "", message)])


def override(tree, assignment):
    """Set one entry, as ``--set section.layers.0.rock=salt`` asks.

    Args:
        tree: changed in place.
        assignment: ``a.b=value``; the value is YAML.

    Raises:
        CaseError: there is no such place, or the value is not YAML.
    """
    name, equals, text = assignment.partition("=")
    path = tuple(_index(part) for part in name.strip().split("."))
    file = f"--set {quoted(name.strip())[1:-1]}"
    if not equals or not all(part != "" for part in path):
        raise _refused(file, "write --set entry=value, such as mesh.cells=32")
    if len(path) > DEEPEST:
        raise _refused(file, "is nested too deeply")
    try:
        value = read_tree(text, file)
    except CaseError as error:
        message = error.faults[0].message
        raise _refused(file, f"{quoted(text)} cannot be read as YAML: {message}") from None
    tree.faults.extend(value.faults)
    parent = _parent(tree, path, file)
    key = path[-1]
    if isinstance(parent, list) and key == len(parent):
        parent.append(None)
    parent[key] = value.data
    for table in (tree.values, tree.keys):
        for known in [known for known in table if known[: len(path)] == path]:
            del table[known]
    tree.keys[path] = tree.values[path] = Place(file)
    for inner in value.values:
        tree.values[path + inner] = Place(file)


def _parent(tree, path, file):
    """Return the group or list that holds a path, making missing groups on the way."""
    if tree.data is None:
        tree.data = {}
    here = tree.data
    for depth, part in enumerate(path):
        last = depth == len(path) - 1
        entry = dotted(path[:depth])
        if isinstance(here, list):
            if not isinstance(part, int) or not 0 <= part < len(here) + last:
                found = f"{entry} is a list of {len(here)}"
                raise _refused(file, f"{found}; its entries are numbered from 0 to {len(here) - 1}")
        elif not isinstance(here, dict):
            raise _refused(file, f"{entry} is {quoted(here)} and has no entries")
        else:
            part = str(part)
        if last:
            break
        if isinstance(here, dict) and here.get(part) is None:
            here[part] = {}
        here = here[part]
    return here if isinstance(here, list) else _Named(here)


class _Named:
    """A mapping whose names are text, also where they look like numbers."""

    def __init__(self, entries):
        self.entries = entries

    def __setitem__(self, key, value):
        self.entries[str(key)] = value


def _index(part):
    return int(part) if part.isascii() and part.isdigit() and len(part) < 6 else part


def _refused(file, message):
    return CaseError([Fault(file, None, None, "", message)])


class _Builder:
    """Builds the values of a tree from parser events."""

    def __init__(self, tree):
        self.tree = tree
        self.stack = []  # of [values, path, pending key or None]
        self.nodes = self.documents = 0
        self.doubles = []  # paths given twice; their inner entries are not told again

    def take(self, event):
        """Take the next event."""
        if isinstance(event, ev.DocumentStartEvent):
            self.documents += 1
            if self.documents > 1:
                self.stop(event, "a second document begins; keep one case in a file")
        elif isinstance(event, ev.NodeEvent):
            self.node(event)
        elif isinstance(event, (ev.MappingEndEvent, ev.SequenceEndEvent)):
            self.stack.pop()

    def node(self, event):
        """Take a scalar, the start of a mapping or list, or an alias."""
        self.nodes += 1
        if self.nodes > MOST_NODES:
            self.stop(event, f"holds more than {MOST_NODES} entries")
        if isinstance(event, ev.AliasEvent):
            self.refuse(event, f"the alias *{str(event.anchor)[:40]}: repeat the value instead")
            return self.put(event, None)
        if event.anchor:
            self.refuse(event, f"the anchor &{str(event.anchor)[:40]}: write the value without it")
        tag = getattr(event, "ctag", None) or getattr(event, "tag", None)
        if tag:
            self.refuse(event, f"the tag {str(tag)[:40]}: write the value without it")
        if isinstance(event, ev.ScalarEvent):
            return self.put(event, scalar(event))
        if len(self.stack) >= DEEPEST:
            self.stop(event, f"is nested more than {DEEPEST} levels deep")
        values = {} if isinstance(event, ev.MappingStartEvent) else []
        path = self.put(event, values)
        self.stack.append([values, path, None])

    def put(self, event, value):
        """Store a value, or take it as the name of the next one; return its path."""
        place = self.place(event)
        if value is None and self.stack and self.stack[-1][2] is not None:
            # nothing has no place of its own; the parser gives that of what comes next
            place = self.tree.keys.get((*self.stack[-1][1], self.stack[-1][2]), place)
        if not self.stack:
            self.tree.data = value
            self.tree.values[()] = place
            return ()
        values, path, key = self.stack[-1]
        if isinstance(values, list):
            path = (*path, len(values))
            values.append(value)
        elif key is None:
            self.stack[-1][2] = self.name(event, value)
            return (*path, self.stack[-1][2])
        else:
            path = (*path, key)
            self.stack[-1][2] = None
            if path not in self.tree.values:
                values[key] = value
        self.tree.values.setdefault(path, place)
        return path

    def name(self, event, value):
        """Return the name of an entry, and refuse what cannot be one."""
        _, path, _ = self.stack[-1]
        if not isinstance(event, ev.ScalarEvent):
            self.refuse(event, "a list or group as the name of an entry: write plain text")
            return f"({self.nodes})"
        key = event.value
        place = self.tree.keys.get((*path, key))
        if place:
            message = f"is given twice, first in line {place.line}; keep one"
            self.tree.keys[(*path, key)] = self.place(event)
            self.doubles.append((*path, key))
            if not any((*path, key)[: len(double)] == double for double in self.doubles[:-1]):
                self.tree.faults.append(self.tree.fault((*path, key), message, at="key"))
        self.tree.keys[(*path, key)] = self.place(event)
        return key

    def place(self, event):
        mark = event.start_mark
        return Place(self.tree.file, mark.line + 1, mark.column + 1)

    def refuse(self, event, message):
        place = self.place(event)
        fault = Fault(place.file, place.line, place.column, "", f"a case has no use for {message}")
        self.tree.faults.append(fault)

    def stop(self, event, message):
        place = self.place(event)
        raise CaseError([Fault(place.file, place.line, place.column, "", message)])


def scalar(event):
    """Return the value of a scalar: quoted text, a number, a truth, nothing, or plain text."""
    text = event.value
    if event.style is not None:
        return text
    if text in CONSTANTS:
        return CONSTANTS[text]
    if INTEGER.fullmatch(text):
        return int(text)
    if DECIMAL.fullmatch(text) and math.isfinite(value := float(text)):
        return value
    return text


# What the parser says, and what the user can do.
SYNTAX = {
    "cannot start any token": "a tab or a reserved sign stands where an entry begins; indent with "
    "spaces and put text that begins with @ ` % in quotes",
    "mapping values are not allowed": "a second ': ' in a line, or a wrong indentation; put text "
    "that holds ': ' in quotes",
    "could not find expected ':'": "an entry without ': '; write name: value, with a space after "
    "the colon",
    "expected <block end>": "the indentation does not match the lines above",
    "expected ',' or '}'": "the bracket { is not closed, or a comma is missing",
    "expected ',' or ']'": "the bracket [ is not closed, or a comma is missing",
    "expected the node content": "nothing where a value is needed, as between two commas",
    "expected '<document start>'": "something goes on after the end; see the indentation, and the "
    "brackets and quotes above",
    "unexpected end of stream": "a quote is not closed",
    "undefined alias": "an alias (*) of nothing; put text that begins with * in quotes",
    "special characters are not allowed": "a control character",
}


def _syntax_fault(error, file, text):
    """Return what a parser error means, at its place."""
    mark = getattr(error, "problem_mark", None) or getattr(error, "context_mark", None)
    problem = str(getattr(error, "problem", None) or getattr(error, "reason", None) or error)
    problem = " ".join(problem.split())
    meaning = next((meaning for sign, meaning in SYNTAX.items() if sign in problem), problem[:120])
    line, column = (mark.line + 1, mark.column + 1) if mark else _found_at(error, text)
    start = getattr(error, "context_mark", None)
    since = f" (begun in line {start.line + 1})" if start and start.line + 1 != line else ""
    begun = "" if start is None else text.splitlines()[start.line : start.line + 1]
    if "bracket" in meaning and " #" in "".join(begun):
        since += "; # begins a comment, so a colour needs quotes"
    return Fault(file, line, column, "", f"not YAML: {meaning}{since}")


def _found_at(error, text):
    """Return line and column of an error that knows a position only; two Nones without one."""
    position = getattr(error, "position", None)
    if not isinstance(position, int):
        return None, None
    before = text[:position]
    return before.count("\n") + 1, position - before.rfind("\n")


def shortened(faults, more=0):
    """Return the first faults, and how many more there are, ``more`` of them not given."""
    if len(faults) + more <= MOST_FAULTS:
        return faults
    more += len(faults) - MOST_FAULTS
    return [*faults[:MOST_FAULTS], Fault(faults[0].file, None, None, "", f"and {more} more faults")]


__all__ = ["Place", "Tree", "dotted", "listed", "override", "read_tree", "shortened"]

"""YAML as a tree: every value has its place, nothing is executed, nothing takes long."""

import time

import pytest

from restoration.errors import CaseError
from restoration.tree import DEEPEST, MOST_FAULTS, Fault, override, read_tree, shortened

TEXT = """\
section:
  layers:
    - {rock: salt, depth: 8 km}
    - rock: sediment
marks: [0 Myr,
  6 Myr]
"""


def refused(text):
    with pytest.raises(CaseError) as caught:
        read_tree(text, "case.yaml")
    return str(caught.value)


@pytest.mark.parametrize(
    ("path", "line", "column"),
    [
        (("section",), 2, 3),
        (("section", "layers", 0, "depth"), 3, 27),
        (("section", "layers", 1, "rock"), 4, 13),
        (("marks", 1), 6, 3),
        (("marks", 1, "beyond"), 6, 3),
        (("section", "missing"), 2, 3),
    ],
)
def test_places(path, line, column):
    fault = read_tree(TEXT, "case.yaml").fault(path, "is wrong")
    assert (fault.line, fault.column) == (line, column)
    assert str(fault) == f"case.yaml:{line}:{column}: {'.'.join(map(str, path))}: is wrong"


def test_place_of_a_name():
    fault = read_tree(TEXT, "case.yaml").fault(("section", "layers", 0, "depth"), "", at="key")
    assert (fault.line, fault.column) == (3, 20)


def test_plain_values():
    text = "[1, -2, 1e21, .5, true, null, ~, no, yes, 1_000, 0x1F, .nan, 2020-01-01, '1', 5 km]"
    assert read_tree(text, "t").data == [
        1, -2, 1e21, 0.5, True, None, None, "no", "yes", "1_000", "0x1F", ".nan", "2020-01-01",
        "1", "5 km",
    ]  # fmt: skip


def test_what_only_looks_like_a_number_stays_text():
    """So that no entry takes it for one: octal, sexagesimal, infinite or of more digits."""
    odd = [
        "010",
        "0o10",
        "1:30",
        "1e999",
        "-1e999",
        ".inf",
        "1e",
        "0x1p3",
        "9" * 41,
        "1.0.0",
        "\N{ARABIC-INDIC DIGIT ONE}",
    ]
    assert read_tree(f"[{', '.join(odd)}]", "t").data == odd
    assert read_tree("[1" + "0" * 17 + ", 1" + "0" * 18 + "]", "t").data == [10**17, 1e18]


def test_a_folded_text_is_one_line():
    assert read_tree("a: >\n  two\n  lines\n", "t").data == {"a": "two lines\n"}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("a:\n\tb: 1", "case.yaml:2:1: not YAML: a tab or a reserved sign"),
        ("title: a: b", "case.yaml:1:9: not YAML: a second ': ' in a line"),
        ("a: [1, 2\nb: 3", r"the bracket [ is not closed, or a comma is missing (begun in line 1)"),
        ("a: {c: #ff0000}\nb: 1", "so a colour needs quotes"),
        ('a: "x', "a quote is not closed"),
        ("a: 1\n---\nb: 2", "case.yaml:2:1: a second document begins"),
        ("[" * 100_000, f"is nested more than {DEEPEST} levels deep"),
        ("a: " + "{a: " * 20_000, f"is nested more than {DEEPEST} levels deep"),
        ("- " * 50_000, f"is nested more than {DEEPEST} levels deep"),
        ("[" + f"{'1,' * 100}\n" * 5000, "holds more than 10000 entries"),
        ("- 1\n" * 250_000, "case.yaml:10001: has 250000 lines; at most 10000 are read"),
        ("#\n" * 500_000, "case.yaml:10001: has 500000 lines; at most 10000 are read"),
        ("a" * 1_000_000 + ": 1", "case.yaml:1: is a line of 1000003 characters; at most 100000"),
        ("a: 1\n%A\n", "case.yaml:2:1: a case has no use for a directive"),
        ('a: "\\UFFFFFFFF"', "an escape such as \\U00110000 stands for no character"),
        ("a" * 90_000 + ": 1", "not YAML"),
        ("a: \x07", "a control character"),
    ],
)
def test_what_is_no_tree(text, message):
    begin = time.process_time()
    assert message in refused(text)
    assert time.process_time() - begin < 2


@pytest.mark.parametrize(
    ("text", "messages"),
    [
        ("a: &x 1\nb: *x", ["1:4: a case has no use for the anchor &x", "2:4: a case has no use"]),
        ("a: !!python/object/apply:os.system [ls]", ["1:4: a case has no use for the tag"]),
        ("a: !include x", ["1:4: a case has no use for the tag !include"]),
        ("? [a]\n: 1", ["1:3: a case has no use for a list or group as the name"]),
        ("a: 1\nb: 2\na: 3", ["3:1: a: is given twice, first in line 1; keep one"]),
        ("a: {b: 1, c: 2}\na: {b: 1, c: 2}", ["2:1: a: is given twice, first in line 1; keep one"]),
    ],
)
def test_what_a_tree_refuses_and_goes_on(text, messages):
    faults = [str(fault) for fault in read_tree(text, "case.yaml").faults]
    assert len(faults) == len(messages)
    assert all(f"case.yaml:{part}" in row for part, row in zip(messages, faults, strict=True))


def test_overrides():
    tree = read_tree(TEXT, "case.yaml")
    override(tree, "section.layers.0.rock=shale")
    override(tree, "marks=[1 Myr, 2 Myr]")
    override(tree, "section.layers.2={rock: sand}")
    override(tree, "mesh.cells=32")
    assert tree.data["section"]["layers"] == [
        {"rock": "shale", "depth": "8 km"}, {"rock": "sediment"}, {"rock": "sand"},
    ]  # fmt: skip
    assert tree.data["marks"] == ["1 Myr", "2 Myr"]
    assert tree.data["mesh"] == {"cells": 32}
    assert str(tree.fault(("marks", 1), "odd")) == "--set marks: marks.1: odd"
    assert tree.fault(("section", "layers", 0, "depth"), "").line == 3


@pytest.mark.parametrize(
    ("assignment", "message"),
    [
        ("mesh.cells", "--set mesh.cells: write --set entry=value"),
        ("=1", "write --set entry=value"),
        ("a..b=1", "write --set entry=value"),
        ("section.layers.5.rock=a", "section.layers is a list of 2"),
        ("section.layers.x=a", "section.layers is a list of 2"),
        ("section.layers.0.rock.deep=a", "section.layers.0.rock is 'salt' and has no entries"),
        ("marks=[1", "'[1' cannot be read as YAML"),
        (".".join("a" * 40) + "=1", "is nested too deeply"),
        ("a\nb\x00c", "--set a?b?c: write"),
    ],
)
def test_overrides_that_are_refused(assignment, message):
    with pytest.raises(CaseError) as caught:
        override(read_tree(TEXT, "case.yaml"), assignment)
    assert message in str(caught.value)


def test_faults_beyond_a_screen_are_counted():
    faults = [Fault("f", i, 1, "", "bad") for i in range(MOST_FAULTS + 5)]
    assert len(shortened(faults)) == MOST_FAULTS + 1
    assert "5 more faults" in str(shortened(faults)[-1])

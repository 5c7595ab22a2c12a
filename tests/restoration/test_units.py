"""Quantities: every usual spelling is read, everything else is refused quickly and says why."""

import math
import random
import re
import time

import pytest

from restoration.units import EXAMPLES, LONGEST, SPELLINGS, UNITS, YEAR, number, parse, show, to_si
from restoration.words import UNWRITABLE
from tests.torture import tries


@pytest.mark.parametrize("kind", UNITS)
def test_every_kind_reads_its_own_units_and_example(kind):
    for unit, factor in UNITS[kind].items():
        assert to_si(f"3 {unit}", kind) == pytest.approx(3 * factor, rel=1e-15)
    assert to_si(EXAMPLES[kind], kind) > 0


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("9.142 km", "length", 9142.0),
        ("0.3 km", "length", 300.0),
        ("25km", "length", 25e3),
        ("  25   km ", "length", 25e3),
        ("5 cm", "length", 0.05),
        (".5 m", "length", 0.5),
        ("5. m", "length", 5.0),
        ("-5 m", "length", -5.0),
        ("+1E3 m", "length", 1e3),
        ("5\N{NO-BREAK SPACE}m", "length", 5.0),
        ("1 yr", "time", 31_557_600.0),
        ("1 year", "time", YEAR),
        ("2.5 kyr", "time", 2500 * YEAR),
        ("2 Ma", "age", 2e6 * YEAR),
        ("2600 kg/m3", "density", 2600.0),
        ("2600 kg/m**3", "density", 2600.0),
        ("2600 kg m^-3", "density", 2600.0),
        ("2600 kg*m^-3", "density", 2600.0),
        ("2600 kg/m\N{SUPERSCRIPT THREE}", "density", 2600.0),
        ("2600 kg / m^3", "density", 2600.0),
        ("2.6 g/cc", "density", 2600.0),
        ("1e19 Pa.s", "viscosity", 1e19),
        ("1e19 Pa*s", "viscosity", 1e19),
        ("1e19 Pa\N{MIDDLE DOT}s", "viscosity", 1e19),
        ("10 mm/a", "velocity", 1e-2 / YEAR),
        ("10 mm yr^-1", "velocity", 1e-2 / YEAR),
        ("1 cm/year", "velocity", 1e-2 / YEAR),
        ("1 km/Myr", "velocity", 1e-3 / YEAR),
        ("9.81 m s^-2", "acceleration", 9.81),
        ("\N{MINUS SIGN}5 km", "length", -5e3),
        ("1e\N{MINUS SIGN}3 km", "length", 1.0),
        ("5\N{NARROW NO-BREAK SPACE}km", "length", 5e3),
        ("180\N{DEGREE SIGN}", "angle", math.pi),
        ("180 \N{MASCULINE ORDINAL INDICATOR}", "angle", math.pi),
        ("9.81 m s\N{SUPERSCRIPT MINUS}\N{SUPERSCRIPT TWO}", "acceleration", 9.81),
    ],
)
def test_usual_spellings(text, kind, value):
    assert to_si(text, kind) == pytest.approx(value, rel=1e-15)


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("1 Myr", "time", 31557600e6),
        ("1 kyr", "time", 31557600e3),
        ("1 yr", "time", 31557600.0),
        ("1 s", "time", 1.0),
        ("1 Ma", "age", 31557600e6),
        ("1 ka", "age", 31557600e3),
        ("1 m/yr", "velocity", 1 / 31557600.0),
        ("1 mm/yr", "velocity", 1e-3 / 31557600.0),
        ("1 km/Myr", "velocity", 1e-3 / 31557600.0),
        ("1 m/s", "velocity", 1.0),
        ("1 Pa", "pressure", 1.0),
        ("1 MPa", "pressure", 1e6),
        ("1 m/s^2", "acceleration", 1.0),
        ("180 deg", "angle", 3.141592653589793),
        ("1 rad", "angle", 1.0),
        ("1 g/cm^3", "density", 1000.0),
        ("1 cm", "length", 0.01),
        ("1 mm", "length", 0.001),
    ],
)
def test_units_are_what_they_are(text, kind, value):
    """By numbers written here: what is read and shown by one table agrees whatever is in it."""
    assert to_si(text, kind) == pytest.approx(value, rel=1e-15)


def test_decimals_arrive_unchanged():
    """0.1 km is 100 m and not 100.00000000000001 m."""
    assert all(to_si(f"{i / 10} km", "length") == 100.0 * i for i in range(1, 1000))


@pytest.mark.parametrize(
    ("text", "kind", "message"),
    [
        ("1e21", "viscosity", "has no unit; write a number and Pa s, such as 1e19 Pa s"),
        (2600, "density", "'2600' has no unit"),
        ("1e18 Pas", "viscosity", "'Pas' is no unit of viscosity; did you mean 'Pa s'"),
        ("5 km", "time", "is a length, not a time; write a number and one of Myr, kyr, yr or s"),
        ("5 Ma", "time", "is an age; a time is written Myr, kyr, yr or s"),
        ("5 Myr", "age", "is a time; an age is written Ma or ka"),
        ("5 myr", "time", "did you mean 'Myr'"),
        ("9,142 km", "length", "the decimal sign is a point"),
        ("1 000 km", "length", "not a plain number with a unit"),
        ("9**9**9 km", "length", "not a plain number with a unit"),
        ("5 miles", "length", "'miles' is no unit of length"),
        ("nan km", "length", "is not finite"),
        ("-inf km", "length", "is not finite"),
        ("1e999 km", "length", "is too large a number"),
        ("1e308 km", "length", "is too large a number"),
        ("1e-999 km", "length", "is too small a number"),
        ("\N{EN DASH}5 km", "length", "holds the character U+2013"),
        ("5 \N{MICRO SIGN}m", "length", "'\N{MICRO SIGN}m' is no unit of length"),
        ("5 \N{GREEK SMALL LETTER MU}m", "length", "'\N{GREEK SMALL LETTER MU}m' is no unit"),
        ("5 \N{SQUARE KM}", "length", "'\N{SQUARE KM}' is no unit of length"),
        ("2\N{SUPERSCRIPT TWO} km", "length", "is not a plain number"),
        ("5 k\u200bm", "length", "is no unit of length"),
        ("\N{ARABIC-INDIC DIGIT FIVE} km", "length", "holds the character U+0665"),
        ("1/0 km", "length", "is no unit of length"),
        ("(1) km", "length", "is not a length"),
        ("1e99999 km", "length", "is not a plain number"),
        ("\N{FULLWIDTH DIGIT ONE} km", "length", "holds the character U+FF11"),
        ("km", "length", "is not a length"),
        ("", "length", "is not a length"),
        (True, "length", "true is not a length"),
        (None, "length", "nothing is not a length"),
        ([1, "km"], "length", "a list of 2 is not a length"),
        ({"a": 1}, "length", "a group of entries (a) is not a length"),
        ("5 km" + " " * LONGEST, "length", "is too long"),
        ("0x10 m", "length", "is no unit of length"),
        ("1_000 m", "length", "is no unit of length"),
    ],
)
def test_what_is_refused(text, kind, message):
    with pytest.raises(ValueError, match=re.escape(message)):
        parse(text, kind)


def spellings():
    """Return (kind, SI value, text) of one of every unit in all its spellings."""
    found = []
    for kind, units in UNITS.items():
        names = [(name, factor) for name, factor in units.items()]
        names += [
            (spelling, factor)
            for spelling, plain in SPELLINGS.items()
            for name, factor in units.items()
            if plain == name.replace("^", "")
        ]
        for name, factor in names:
            powers = name.replace("^2", "\N{SUPERSCRIPT TWO}").replace(
                "^3", "\N{SUPERSCRIPT THREE}"
            )
            for text in {
                name,
                powers,
                name.replace("^", "**"),
                name.replace("^", ""),
                name.replace("/", " / "),
                name.replace(" ", "\N{MIDDLE DOT}"),
                name.replace(" ", "*"),
                name.replace(" ", "."),
                name.replace(" ", "  "),
                name.replace(" ", "\N{NO-BREAK SPACE}"),
            }:
                found.append((kind, factor, text))
    return found


def quick(text, kind):
    """Return the SI value of a text, or None where it is refused; neither may take 50 ms."""
    begin = time.process_time()
    value, told = None, "read"
    try:
        value = to_si(text, kind)
    except ValueError as error:
        told = str(error)
    assert told
    assert not UNWRITABLE.search(told)
    assert time.process_time() - begin < 0.05
    return value


def test_all_spellings_of_all_units_in_all_kinds():
    """A unit is read where its kind is asked for, and named as what it is everywhere else."""
    tried, alike = spellings(), 0
    assert len(tried) > 100
    for kind, factor, text in tried:
        for asked in UNITS:
            if asked == kind:
                assert quick(f"2.5 {text}", asked) == pytest.approx(2.5 * factor, rel=1e-15)
                alike += 1
            else:
                assert quick(f"2.5 {text}", asked) is None, (text, asked)
    assert alike == len(tried)


@pytest.mark.torture
def test_whatever_is_written_is_read_or_refused_quickly():
    rng = random.Random(16)
    parts = [*"0123456789.eE+-*/^ ()_,\t", "nan", "inf", "\N{MICRO SIGN}", "9" * 30, "e999"]
    parts += [unit for units in UNITS.values() for unit in units] + ["\N{SUPERSCRIPT TWO}", "\0"]
    parts += [
        "\N{MIDDLE DOT}",
        "\N{MINUS SIGN}",
        "\N{FULLWIDTH DIGIT ONE}",
        "**9**9",
        "\x1b[2J",
        "\ud800",
    ]
    read = []
    for _ in range(tries(5_000, 100_000)):
        text = "".join(rng.choice(parts) for _ in range(rng.randint(0, 9)))
        value = quick(text, rng.choice(list(UNITS)))
        read += [value] if value is not None else []
    assert len(read) > 5
    assert all(math.isfinite(value) for value in read)


@pytest.mark.parametrize(
    ("value", "kind", "text"),
    [
        (2.65e14, "time", "8.4 Myr"),
        (-6e6 * YEAR, "time", "-6 Myr"),
        (0.0, "time", "0 Myr"),
        (2.5e3 * YEAR, "time", "2.5 kyr"),
        (9142.0, "length", "9.14 km"),
        (999.9, "length", "1 km"),
        (12.5, "length", "12.5 m"),
        (0.3, "length", "30 cm"),
        (2150.0, "density", "2150 kg/m^3"),
        (1e19, "viscosity", "1e19 Pa s"),
        (1e-2 / YEAR, "velocity", "10 mm/yr"),
        (5e6, "pressure", "5 MPa"),
    ],
)
def test_quantities_read_well(value, kind, text):
    assert show(value, kind) == text


def test_what_is_shown_can_be_read_again():
    rng = random.Random(1)
    for kind in UNITS:
        for _ in range(200):
            value = rng.choice([-1, 1]) * 10 ** rng.uniform(-6, 25)
            assert to_si(show(value, kind, 12), kind) == pytest.approx(value, rel=1e-11)


def test_numbers_read_well():
    assert [number(x) for x in (123456.7, 0.5, 1e19, -6e-9, 0)] == [
        "123457", "0.5", "1e19", "-6e-9", "0",
    ]  # fmt: skip

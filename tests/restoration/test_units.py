"""Quantities: every usual spelling is read, everything else is refused quickly and says why."""

import math
import random
import re
import time

import pytest

from restoration.units import EXAMPLES, LONGEST, UNITS, YEAR, number, parse, show, to_si


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
    ],
)
def test_usual_spellings(text, kind, value):
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
        ("\N{MINUS SIGN}5 km", "length", "holds the character U+2212"),
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


def test_whatever_is_written_is_read_or_refused_quickly():
    rng = random.Random(16)
    parts = [*"0123456789.eE+-*/^ ()_,\t", "nan", "inf", "\N{MICRO SIGN}", "9" * 30, "e999"]
    parts += [unit for units in UNITS.values() for unit in units] + ["\N{SUPERSCRIPT TWO}", "\0"]
    read, messages = 0, []
    for _ in range(5000):
        text = "".join(rng.choice(parts) for _ in range(rng.randint(0, 9)))
        begin = time.process_time()
        try:
            read += math.isfinite(to_si(text, rng.choice(list(UNITS)))) or 1 / 0
        except ValueError as error:
            messages.append(str(error))
        assert time.process_time() - begin < 0.05
    assert read > 5
    assert all(message.isprintable() for message in messages)


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

"""Units: a quantity is text such as ``8.4 Myr`` in a case file and an SI number inside.

A number by one pattern and a unit of one table: nothing is evaluated, so nothing takes long.
"""

import math
import re
from dataclasses import dataclass
from decimal import Decimal

from restoration.words import hint, listed, quoted

YEAR = 365.25 * 86400.0  # s
MYR = 1e6 * YEAR

# The SI value of every unit; the everyday one comes first.
UNITS = {
    "length": {"km": 1e3, "m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "time": {"Myr": 1e6 * YEAR, "kyr": 1e3 * YEAR, "yr": YEAR, "s": 1.0},
    "age": {"Ma": 1e6 * YEAR, "ka": 1e3 * YEAR},
    "density": {"kg/m^3": 1.0, "g/cm^3": 1e3},
    "viscosity": {"Pa s": 1.0},
    "velocity": {
        "mm/yr": 1e-3 / YEAR,
        "cm/yr": 1e-2 / YEAR,
        "m/yr": 1.0 / YEAR,
        "km/Myr": 1e-3 / YEAR,
        "m/s": 1.0,
    },
    "pressure": {"MPa": 1e6, "kPa": 1e3, "Pa": 1.0},
    "acceleration": {"m/s^2": 1.0},
    "angle": {"deg": math.pi / 180, "rad": 1.0},
}
EXAMPLES = {
    "length": "25 km",
    "time": "6 Myr",
    "age": "2 Ma",
    "density": "2600 kg/m^3",
    "viscosity": "1e19 Pa s",
    "velocity": "10 mm/yr",
    "pressure": "5 MPa",
    "acceleration": "9.81 m/s^2",
    "angle": "60 deg",
}
# Other spellings in use, after `_plain`; Ma is an age and never a duration.
SPELLINGS = {
    "metre": "m", "metres": "m", "meter": "m", "meters": "m",
    "y": "yr", "year": "yr", "years": "yr", "sec": "s", "ky": "kyr", "My": "Myr",
    "g/cc": "g/cm3", "kg m-3": "kg/m3", "g cm-3": "g/cm3",
    "degree": "deg", "degrees": "deg", "radian": "rad", "radians": "rad",
    "m s-1": "m/s", "m s-2": "m/s2", "m/s/s": "m/s2",
}  # fmt: skip
SPELLINGS |= {
    f"{length}{year}": f"{length}/yr"
    for length in ("mm", "cm", "m")
    for year in ("/a", "/y", "/year", " yr-1", " a-1", " y-1")
}
SPELLINGS |= {"km/My": "km/Myr", "km Myr-1": "km/Myr"}
# Signs that texts are pasted with, and what they stand for; exponents in a unit alone: 2² is no 22.
SIGNS = {"\N{MINUS SIGN}": "-"} | dict.fromkeys(
    ("\N{NO-BREAK SPACE}", "\N{NARROW NO-BREAK SPACE}", "\N{THIN SPACE}", "\N{FIGURE SPACE}"), " "
)
SIGNS = str.maketrans(SIGNS)
UNIT_SIGNS = {"·": "*", "⋅": "*", "²": "2", "³": "3", "⁻": "-", "¹": "1", "°": "deg"}
UNIT_SIGNS |= {"\N{MASCULINE ORDINAL INDICATOR}": "deg", "\N{RING ABOVE}": "deg"}
UNIT_SIGNS = str.maketrans(UNIT_SIGNS)
NUMBER = re.compile(r"[+-]?(\d{1,40}\.?\d{0,40}|\.\d{1,40})([eE][+-]?\d{1,4})?", re.ASCII)
LONGEST = 64  # characters of a quantity


@dataclass(frozen=True)
class Quantity:
    """A number with a unit.

    Attributes:
        text: as the user wrote it, such as ``25 km``.
        si: its value in SI units.
    """

    text: str
    si: float


def parse(text, kind):
    """Return the `Quantity` written in ``text``.

    Args:
        text: what the case file holds; anything but text is refused.
        kind: a key of `UNITS`.

    Raises:
        ValueError: it is not a finite number with a unit of this kind; the message says why.
    """
    if isinstance(text, bool) or not isinstance(text, (str, int, float)):
        raise ValueError(f"{quoted(text)} is not {article(kind)}; {advice(kind)}")
    if len(str(text)) > LONGEST:
        raise ValueError(f"{quoted(text)} is too long for {article(kind)}; {advice(kind)}")
    plain = str(text).translate(SIGNS).strip()
    match = NUMBER.match(plain)
    if not match:
        raise ValueError(_no_number(text, plain, kind))
    unit = plain[match.end() :].strip().translate(UNIT_SIGNS)
    if not unit:
        raise ValueError(f"{quoted(text)} has no unit; {advice(kind)}")
    value = float(Decimal(match.group()) * Decimal(_factor(text, unit, kind)))
    if not math.isfinite(value):
        raise ValueError(f"{quoted(text)} is too large a number")
    if value == 0 and re.search("[1-9]", match.group().lower().split("e")[0]):
        raise ValueError(f"{quoted(text)} is too small a number")
    return Quantity(str(text).strip(), value)


def to_si(text, kind):
    """Return the SI value of a quantity such as ``25 km``; arguments and errors as `parse`."""
    return parse(text, kind).si


def show(value, kind, digits=3):
    """Return an SI value in the unit that reads best, such as ``8.4 Myr`` for 2.65e14 s.

    Args:
        value: SI value.
        kind: a key of `UNITS`.
        digits: significant digits.
    """
    units = UNITS[kind]
    best = next(iter(units))
    if kind not in ("velocity", "angle") and value and math.isfinite(value):
        by_size = sorted(units, key=units.get, reverse=True)
        fits = [unit for unit in by_size if abs(value) >= 0.9995 * units[unit]]
        best = fits[0] if fits else by_size[-1]
    if kind == "density":
        best = "kg/m^3"
    return f"{number(value / units[best], digits)} {best}"


def number(value, digits=3):
    """Return a number as people write it: ``8.4``, ``1e19``, ``12300``."""
    if value and not 1e-4 <= abs(value) < 1e7:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        if "." in mantissa:
            mantissa = mantissa.rstrip("0").rstrip(".")
        return f"{mantissa}e{int(exponent)}"
    whole = len(str(int(abs(value))))
    text = f"{value:.{max(digits, whole)}g}"
    return text if "e" not in text else str(round(value))


def article(kind):
    """Return the kind with its article: ``a length``, ``an age``."""
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind}"


def advice(kind):
    """Return what to write for a quantity of this kind."""
    units = listed(UNITS[kind])
    units = f"one of {units}" if len(UNITS[kind]) > 1 else units
    return f"write a number and {units}, such as {EXAMPLES[kind]}"


def _plain(unit):
    """Return a unit without the freedoms of its spelling."""
    unit = re.sub(r"\s*/\s*", "/", unit.replace("**", "^").replace("^", ""))
    return " ".join(re.sub(r"[*.]", " ", unit).split())


def _factor(text, unit, kind):
    """Return the SI value of one unit, or raise ValueError naming the possible ones."""
    if unit[0] in ",*^0123456789.":
        raise ValueError(
            f"{quoted(text)} is not a plain number with a unit (the decimal sign is a point); "
            + advice(kind)
        )
    plain = _plain(unit)
    plain = SPELLINGS.get(plain, plain)
    for name, factor in UNITS[kind].items():
        if _plain(name) == plain:
            return factor
    if kind == "time" and unit in UNITS["age"]:
        raise ValueError(f"{quoted(text)} is an age; a time is written {listed(UNITS['time'])}")
    if kind == "age" and unit in UNITS["time"]:
        raise ValueError(f"{quoted(text)} is a time; an age is written {listed(UNITS['age'])}")
    for other, units in UNITS.items():
        if plain in [_plain(name) for name in units]:
            what = f"{quoted(text)} is {article(other)}, not {article(kind)}"
            raise ValueError(f"{what}; {advice(kind)}")
    names = list(UNITS[kind])
    raise ValueError(f"{quoted(text)}: {quoted(unit)} is no unit of {kind}{hint(unit, names)}")


def _no_number(text, plain, kind):
    """Return the message for text that does not begin with a number."""
    odd = next((sign for sign in plain if ord(sign) > 127), None)
    if plain.lower().lstrip("+-.").startswith(("nan", "inf")):
        return f"{quoted(text)} is not finite; {advice(kind)}"
    if odd:
        return f"{quoted(text)} holds the character U+{ord(odd):04X}; {advice(kind)}"
    return f"{quoted(text)} is not {article(kind)}; {advice(kind)}"

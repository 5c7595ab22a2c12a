"""A range of a sweep file, such as ``log 1e17 .. 1e19 Pa s``, and the values in it."""

import math
import re
from dataclasses import dataclass

from restoration.tree import INTEGER
from restoration.units import LONGEST, NUMBER, number
from restoration.words import quoted

SUCH = "write low .. high with a unit, such as 1e17 .. 1e19 Pa s, or log 1e17 .. 1e19 Pa s"
DIGITS = 7  # of a value, counted from the first that differs between the ends
MOST_DIGITS = 15


@dataclass(frozen=True)
class Range:
    """Values between two ends.

    Attributes:
        low, high: the ends, in the unit.
        unit: as written, or empty.
        log: whether the logarithm of values is spread evenly, rather than the values.
        whole: whether values are whole numbers, both ends among them.
    """

    low: float
    high: float
    unit: str
    log: bool
    whole: bool

    def value(self, share):
        """Return the value below which a share of the range lies, as a case takes it.

        Args:
            share: from 0 to below 1.

        Returns:
            An integer, a float, or text with a unit.
        """
        high = self.high + self.whole
        if self.log:
            at = self.low * (high / self.low) ** share
        else:
            at = self.low + share * (high - self.low)
        if self.whole:
            return min(math.floor(at), int(self.high))
        most = max(abs(self.low), abs(self.high))
        digits = DIGITS + math.ceil(math.log10(most / (self.high - self.low)))
        text = number(at, min(max(digits, DIGITS), MOST_DIGITS))
        return f"{text} {self.unit}" if self.unit else float(text)


def read_range(value):
    """Return the `Range` that a sweep file holds.

    Raises:
        ValueError: it is none, or an empty one; the message says why.
    """
    if not isinstance(value, str) or len(value) > 2 * LONGEST or ".." not in value:
        raise ValueError(f"{quoted(value)} is not a range; {SUCH}")
    log = re.match(r"\s*log\s+", value)
    first, _, last = value[log.end() if log else 0 :].partition("..")
    ends = [
        (first.strip(), NUMBER.match(first.strip())),
        (last.strip(), NUMBER.match(last.strip())),
    ]
    if not all(match for _, match in ends):
        raise ValueError(f"{quoted(value)} is not a range; {SUCH}")
    (low, first_unit), (high, unit) = (
        (match.group(), text[match.end() :].strip()) for text, match in ends
    )
    if first_unit not in ("", unit):
        raise ValueError(f"{quoted(value)}: '{first_unit}' is not '{unit}'; take one unit for both")
    whole = not unit and bool(INTEGER.fullmatch(low) and INTEGER.fullmatch(high))
    found = Range(float(low), float(high), unit, bool(log), whole)
    if not (math.isfinite(found.low) and math.isfinite(found.high)):
        raise ValueError(f"{quoted(value)}: the numbers are too large")
    if not found.low < found.high:
        raise ValueError(f"{quoted(value)}: {low} is not below {high}")
    if log and not found.low > 0:
        raise ValueError(f"{quoted(value)}: a log range begins above 0, not at {low}")
    if not math.isfinite(found.high / found.low if log else found.high - found.low):
        raise ValueError(f"{quoted(value)}: the ends are too far apart")
    return found

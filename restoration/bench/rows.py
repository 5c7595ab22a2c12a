"""What a benchmark says: one row for every number, with its reference."""

import math
import time
from dataclasses import asdict, dataclass, field

import numpy as np


@dataclass(frozen=True)
class Row:
    """One number of a benchmark.

    Attributes:
        name: of the benchmark.
        case: which variant, in words.
        metric: what was measured, with its unit.
        value: the number.
        reference: what it should be; None where nothing is known.
        relative_error: of the value against the reference; None likewise.
        bound: greatest relative error that is accepted (of the value itself where it is an error
            already); None where the row only informs.
        unknowns, cells, steps, stokes_solves: size and work; None where there is none.
        wall_s: seconds.
        source: of the reference.
        parameters: of the variant, by name, for figures and tables.
    """

    name: str
    case: str
    metric: str
    value: float
    reference: float | None = None
    relative_error: float | None = None
    bound: float | None = None
    unknowns: int | None = None
    cells: int | None = None
    steps: int | None = None
    stokes_solves: int | None = None
    wall_s: float | None = None
    source: str = ""
    parameters: dict = field(default_factory=dict)

    @property
    def held(self):
        """Whether the number is within its bound; None where it has none."""
        if self.bound is None:
            return None
        error = self.value if self.relative_error is None else self.relative_error
        return bool(math.isfinite(error) and abs(error) <= self.bound)

    def plain(self):
        """Return the row as plain values for JSON; what is not finite is None."""
        entries = asdict(self) | {"held": self.held}
        return {name: _finite(value) for name, value in entries.items()}


def compared(name, case, metric, value, reference, **more):
    """Return the row of a number with a reference."""
    error = value / reference - 1 if reference else None
    return Row(name, case, metric, float(value), float(reference), error, **more)


def at_least(name, case, metric, order, expected, **more):
    """Return the row of an order; one above what theory promises is no fault."""
    short = min(0.0, order / expected - 1)
    return Row(name, case, metric, order, expected, short, 0.1, **more)


def _finite(value):
    if isinstance(value, dict):
        return {name: _finite(entry) for name, entry in value.items()}
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def observed_order(sizes, errors):
    """Return the order between the last two of a series: d log(error) / d log(size)."""
    return float(np.log(errors[-1] / errors[-2]) / np.log(sizes[-1] / sizes[-2]))


class Clock:
    """Seconds since it was made."""

    def __init__(self):
        self._began = time.perf_counter()

    @property
    def seconds(self):
        """Wall seconds, rounded."""
        return round(time.perf_counter() - self._began, 3)

"""The state of a run at one time."""

from dataclasses import dataclass

from restoration.lines import MovingLine
from restoration.particles import Particles
from restoration.stokes import Flow


@dataclass(frozen=True, eq=False)
class State:
    """Where the rock is.

    Attributes:
        time: model time, s.
        particles: located `Particles`.
        lines: horizons and faults.
        flow: the flow at this time; None until it is solved for.
        grid: the `Grid` of that flow.
    """

    time: float
    particles: Particles
    lines: tuple[MovingLine, ...]
    flow: Flow | None = None
    grid: object | None = None

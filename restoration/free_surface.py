"""How a free surface is carried through time: which steps it bears, and what backward."""

from dataclasses import replace

import numpy as np

from restoration.advection import SCHEMES
from restoration.errors import MeshError
from restoration.layered import longest_way_back
from restoration.lines import surface_of, with_rows
from restoration.surface import line_area, standing
from restoration.surface_modes import INTEGRABLE, Slaving, SurfaceResponse
from restoration.units import show

CLOSEST_PER_CELL = 64  # vertices that a cliff has pressed together nearer than this go


class FreeSurface:
    """Decides for every leg of a march how the surface is carried.

    Args:
        scene: `scene.Scene` with a free surface.

    Attributes:
        gamma: fastest rate of the surface seen so far, 1/s; None before it was looked at.
        slaving: `Slaving` of the leg, or None where the surface is integrated.
        growth: gamma T of the way back, T the longest between the marks; None forward.
    """

    def __init__(self, scene):
        self.plan, self.scheme = scene.surface, scene.time.scheme
        self.marks = scene.time.marks
        self.gamma, self.slaving, self.growth = None, None, None
        self._leg = self._response = self._mode = None

    def stable_step(self, grid, time, mark):
        """Return the longest step that the surface bears on the way to a mark, s.

        The flow at ``time`` was the last one solved for. Begins the leg where it is new.
        """
        theta, most, backward = self.plan.theta, SCHEMES[self.scheme].stable, mark < time
        if not backward and theta >= 0.5:
            self._begin(time, mark, 0.0)
            return np.inf
        if self._response is None or not self._response.of(grid):
            self._response = SurfaceResponse(grid)
        rate, self._mode = self._response.fastest(self._mode)
        self.gamma = max(self.gamma or 0.0, rate)
        self._begin(time, mark, rate)
        if rate == 0:
            return np.inf
        if not backward:
            longest = most / max(1 - theta * most, 1e-9)
        elif self.plan.reverse == "stabilise":
            return np.inf
        else:
            longest = min(most, 1 / theta) if theta and not self.slaving else most
            rate = min(rate, self.slaving.cut) if self.slaving else rate
        return self.plan.limit * longest / rate

    def memory(self):
        """Return what is known of the surface, for a checkpoint; see `recall`."""
        return {
            "gamma": self.gamma,
            "growth": self.growth,
            "leg": self._leg,
            "mode": self._mode,
            "slaving": self.slaving and self.slaving.memory(),
        }

    def recall(self, memory, grid):
        """Go on from what `memory` returned, with the `Grid` of that moment."""
        self.gamma, self.growth = memory["gamma"], memory["growth"]
        self._leg, self._mode = memory["leg"], memory["mode"]
        self.slaving, self._response = None, None
        if memory["slaving"]:
            self.slaving = self._new_slaving()
            self.slaving.recall(memory["slaving"], grid)

    def _new_slaving(self):
        return Slaving(longest_way_back(self.marks), self.plan.tolerance)

    @property
    def slaved(self):
        """Number of modes that are slaved now."""
        found = self.slaving is not None and self.slaving.modes is not None
        return len(self.slaving.modes.slaved) if found else 0

    def lead(self, dt):
        """Return how far ahead the weight of the moved surface is to count, s; see `stabilise`.

        Not at all backward where modes are slaved: steps are longer there than the fast ones bear,
        whose flow has a pole where theta dt gamma is 1.
        """
        if dt < 0 and self.plan.reverse == "stabilise":
            return (self.plan.theta or 1.0) * -dt
        return 0.0 if dt < 0 and self.slaving else self.plan.theta * dt

    def _begin(self, time, mark, rate):
        if self._leg == mark:
            return
        self._leg = mark
        if mark < time and self.growth is not None:
            return  # goes on backward as in the leg before
        self.slaving, self.growth = None, None
        if mark > time:
            return
        span = longest_way_back(self.marks)
        self.growth = rate * span
        wanted = self.plan.reverse
        if rate and (wanted == "slave" or (wanted == "auto" and self.growth > INTEGRABLE)):
            self.slaving = self._new_slaving()


def without_cliffs(lines, most, cell_size):
    """Return the lines with what is too steep of the surface fallen down, and its area, m^2.

    Args:
        lines: `lines.MovingLine`s with a surface.
        most: area that may fall at once, m^2.
        cell_size: m.

    Raises:
        MeshError: so much falls at once that it is no surface any more.
    """
    surface = surface_of(lines)
    points, area = standing(surface.points)
    if not area:
        return lines, 0.0
    if area > most:
        where = surface.points[np.abs(points - surface.points).max(axis=1).argmax()]
        at = " and ".join(
            f"{n} = {show(float(v), 'length')}" for n, v in zip("xz", where, strict=True)
        )
        raise MeshError(f"the surface overturns near {at}; nothing restores what lies below")
    kept = np.r_[True, np.diff(points[:, 0]) > cell_size / CLOSEST_PER_CELL]
    kept[[0, -1]] = True
    upright = with_rows(replace(surface, points=points), kept)
    return tuple(upright if x is surface else x for x in lines), area


def with_area(lines, area):
    """Return the lines with the surface at an area below it, m^2, and how far it went, m.

    It moves up or down as a whole.
    """
    surface = surface_of(lines)
    shift = (area - line_area(surface.points)) / np.ptp(surface.points[:, 0])
    moved = replace(surface, points=surface.points + [0.0, shift])
    return tuple(moved if x is surface else x for x in lines), abs(shift)

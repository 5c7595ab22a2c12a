"""Scenes small enough for unit tests."""

import numpy as np
import pytest

from restoration.scene import (
    Line,
    Outline,
    OutputPlan,
    ParticlePlan,
    Rock,
    Scene,
    TimePlan,
    Transfer,
    Unit,
    Wall,
)

MYR = 31557600e6
WIDTH, HEIGHT = 9142.0, 10000.0


def diapir_top(x):
    """Height of the salt of the paper's sect. 4.1, m."""
    return -8000 + 200 * np.cos(np.pi * x / WIDTH)


def diapir_scene(cells=(12, 13), viscosity=(1e19, 1e19), marks=(0, 1, 0), **plans):
    """The diapir of sect. 4.1 on a coarse mesh; ``plans`` replaces whole plans."""
    slip, fast = Wall("free-slip", (0.0, None), (0.0, 0.0)), Wall("no-slip", (0.0, 0.0), (0.0, 0.0))
    x = np.linspace(0, WIDTH, 201)
    defaults = {
        "particles": ParticlePlan(6, 4, 0.3, 1),
        "transfer": Transfer("hat", "hat", "harmonic"),
        "time": TimePlan(tuple(mark * MYR for mark in marks), "rk4", 1.0, 5),
        "output": OutputPlan("marks", ("velocity", "pressure", "density"), True, False, 1.0),
        "walls": {"left": slip, "right": slip, "base": fast, "surface": fast},
        "outline": Outline(
            np.array([[0, 0], [WIDTH, 0.0]]), np.array([[0, -HEIGHT], [WIDTH, -HEIGHT]])
        ),
    }
    entries = {
        "title": "diapir",
        "rocks": (
            Rock("salt", 2150.0, viscosity[0], "#d8a0c0"),
            Rock("sediment", 2600.0, viscosity[1], "#c0a060"),
        ),
        "units": (Unit("salt", 0, "#d8a0c0"), Unit("sediment", 1, "#c0a060")),
        "unit_at": lambda p: (p[:, 1] > diapir_top(p[:, 0])).astype(np.int16),
        "lines": (Line("salt / sediment", "horizon", np.column_stack([x, diapir_top(x)])),),
        "gravity": 9.81,
        "cells": cells,
        "cloud": None,
        "notes": (),
    }
    return Scene(**entries | defaults | plans)


class PlainEngine:
    """What the march asks of an engine that cannot fail; a state is all there is."""

    retried, longest, notes = 0, np.inf, ()

    def with_flow(self, state):
        return state

    def taken_over(self, state):
        return state

    def memory(self, state, gather=True):
        return state

    def recalled(self, memory):
        return memory

    def gathered(self, memory):
        return memory

    def watch(self, state):
        pass

    def guard(self, state):
        pass

    def facts(self):
        return {}


@pytest.fixture(scope="session")
def make_scene():
    return diapir_scene

"""Scenes of the benchmarks: boxes of two rocks, built without a case file."""

import numpy as np

from restoration.bench.boxes import ZERO
from restoration.scene import (
    Line,
    MeshPlan,
    Outline,
    OutputPlan,
    ParticlePlan,
    Rock,
    Scene,
    SolverPlan,
    TimePlan,
    Transfer,
    Unit,
    Wall,
)

LOWER, UPPER = 0, 1  # rocks of `two_rocks`


def two_rocks(
    width,
    height,
    unit_at,
    line,
    density,
    viscosity,
    cells,
    walls,
    gravity=9.81,
    mesh=None,
    particles=None,
    transfer=None,
    marks=(0.0, 1.0),
    courant=0.5,
    min_steps=1,
    scheme="rk4",
):
    """Return the scene of a box with z from 0 at the base to ``height``, and two rocks in it.

    Args:
        width, height: m.
        unit_at: maps points (n, 2) to rows of rocks, (n,).
        line: the contact between the rocks, shape (n, 2), m.
        density, viscosity: of the two rocks, kg/m^3 and Pa s.
        cells: columns and rows of squares.
        walls: ``free-slip`` or ``no-slip`` by name.
        gravity: m/s^2.
        mesh, particles, transfer: plans; defaults as of a case.
        marks, courant, min_steps, scheme: of the time.
    """
    across = {"left": 0, "right": 0, "base": 1, "surface": 1}
    slip = {
        name: Wall("free-slip", tuple(0.0 if i == axis else None for i in (0, 1)), ZERO)
        for name, axis in across.items()
    }
    fast = Wall("no-slip", ZERO, ZERO)
    colors = ("#d8a0c0", "#c0a060")
    return Scene(
        title="benchmark",
        outline=Outline(
            np.array([[0.0, height], [width, height]]), np.array([[0.0, 0.0], [width, 0.0]])
        ),
        rocks=tuple(
            Rock(name, rho, eta, color)
            for name, rho, eta, color in zip(
                ("lower", "upper"), density, viscosity, colors, strict=True
            )
        ),
        units=tuple(Unit(name, i, colors[i]) for i, name in enumerate(("lower", "upper"))),
        unit_at=unit_at,
        lines=(Line("lower / upper", "horizon", line),),
        walls={name: slip[name] if kind == "free-slip" else fast for name, kind in walls.items()},
        gravity=gravity,
        cells=cells,
        particles=particles or ParticlePlan(4, 5, 0.5, 1),
        transfer=transfer or Transfer("hat", "hat", "harmonic"),
        time=TimePlan(tuple(marks), scheme, courant, min_steps),
        output=OutputPlan("marks", (), False, False, 1.0),
        cloud=None,
        notes=(),
        mesh=mesh or MeshPlan(),
        solver=SolverPlan(),
    )


def under_a_wave(mean, amplitude, wavelength):
    """Return height and units of an interface ``mean + amplitude cos(2 pi x / wavelength)``."""
    k = 2 * np.pi / wavelength

    def height(x):
        return mean + amplitude * np.cos(k * x)

    def unit_at(points):
        return (points[:, 1] > height(points[:, 0])).astype(np.int16)

    return height, unit_at


def velocity_at(state, points):
    """Return the velocity of a state with a flow at points (n, 2), m/s."""
    grid = state.grid
    cell, hats = grid.index.locate(points, grid.index.guess(points))
    return grid.sampler(grid.sampler.coefficients(state.flow.u), cell, hats)

"""Rayleigh-Taylor instability and falling block: the paper's appendices A and B."""

from itertools import product

import numpy as np
from dolfinx import fem

from meshes.section import fitted_mesh
from restoration.bench.boxes import Solved
from restoration.bench.exact import two_layer_growth_rate
from restoration.bench.reference import (
    RAMBERG,
    RAMBERG_VELOCITY,
    sinking_block_velocity,
)
from restoration.bench.rows import Clock, Row, compared
from restoration.bench.scenes import two_rocks, under_a_wave, velocity_at
from restoration.engine import StokesEngine
from restoration.particles import CellIndex
from restoration.sampling import VelocitySampler
from restoration.scene import MeshPlan, RefinePlan, Transfer

GRAVITY = 9.81
SLIP_ON_PLATES = {
    "left": "free-slip",
    "right": "free-slip",
    "base": "no-slip",
    "surface": "no-slip",
}
EXACT = "exact flow at finite amplitude, computed for these pages; Ramberg (1968) is its limit"
LINEAR = "linear theory, Ramberg (1968); paper, eqs. A1 to A3 with the sign of A1 corrected"
# Points of a quick run.
QUICK_POINTS = [(256000.0, 1.25e20), (128000.0, 2.5e23)]


def ramberg_scene(wavelength, eta2, amplitude, fitted, squares=40):
    """Return the scene of the paper's appendix A.

    Args:
        wavelength, eta2: m and Pa s, of the lower layer.
        amplitude: of the interface, m.
        fitted: whether mesh lines follow the interface; else particles in cells halved as often.
        squares: along a side.
    """
    height, unit_at = under_a_wave(RAMBERG["h2"], amplitude, wavelength)
    x = np.linspace(0, RAMBERG["width"], 4001)
    # cells of 1/160 of a wave at the interface: a polygon through points of a wave cuts its crests
    levels = int(np.ceil(np.log2(160 * RAMBERG["width"] / squares / wavelength)))
    refine = RefinePlan(levels, ("interfaces",), 1)
    if fitted:
        mesh = MeshPlan("P2b-P1dg", "fitted", refine)
    else:
        mesh = MeshPlan(refine=refine)
    return two_rocks(
        RAMBERG["width"],
        RAMBERG["h1"] + RAMBERG["h2"],
        unit_at,
        np.column_stack([x, height(x)]),
        (RAMBERG["rho2"], RAMBERG["rho1"]),
        (eta2, RAMBERG["eta1"]),
        (squares, squares),
        SLIP_ON_PLATES,
        mesh=mesh,
        transfer=Transfer("linear", "linear", "geometric"),
    )


def run_rayleigh_taylor(quick):
    """Rayleigh-Taylor instability of two layers (paper, appendix A)."""
    points = QUICK_POINTS if quick else [key for key in RAMBERG_VELOCITY if key[1] >= 1.25e20]
    for wavelength, eta2 in points:
        for fitted, bound in ((False, 5e-3), (True, 1e-3)):
            clock = Clock()
            amplitude = RAMBERG["amplitude"]
            scene = ramberg_scene(wavelength, eta2, amplitude, fitted)
            state = _first(scene)
            crest = np.array([0.0, RAMBERG["h2"] + amplitude])
            trough = np.array([wavelength / 2, RAMBERG["h2"] - amplitude])
            found = velocity_at(state, np.array([crest, trough]))[:, 1]
            state.grid.stokes.release()
            for where, value, reference in zip(
                ("crest", "trough"), found, RAMBERG_VELOCITY[wavelength, eta2], strict=True
            ):
                yield compared(
                    "rayleigh-taylor",
                    f"wavelength {wavelength / 1e3:g} km, eta2 {eta2:g}, "
                    + ("fitted" if fitted else "particles"),
                    f"velocity of the {where}, m/s",
                    value,
                    reference,
                    bound=bound,
                    source=EXACT,
                    parameters={"wavelength": wavelength, "eta2": eta2, "fitted": fitted}
                    | {"where": where},
                    **_size(state, clock),
                )
    for wavelength, eta2 in points[:1] if quick else points[::3]:
        clock = Clock()
        amplitude = 2e-4 * wavelength
        state = _first(ramberg_scene(wavelength, eta2, amplitude, True))
        value = velocity_at(state, np.array([[0.0, RAMBERG["h2"] + amplitude]]))[0, 1]
        state.grid.stokes.release()
        rate = two_layer_growth_rate(
            2 * np.pi / wavelength,
            RAMBERG["h1"],
            RAMBERG["h2"],
            RAMBERG["eta1"],
            eta2,
            RAMBERG["rho1"] - RAMBERG["rho2"],
            GRAVITY,
        )
        yield compared(
            "rayleigh-taylor",
            f"wavelength {wavelength / 1e3:g} km, eta2 {eta2:g}, small amplitude, fitted",
            "growth rate, 1/s",
            value / amplitude,
            rate,
            bound=1e-3,
            source=LINEAR,
            parameters={"wavelength": wavelength, "eta2": eta2, "small": True},
            **_size(state, clock),
        )


def _first(scene):
    engine = StokesEngine(scene)
    return engine.with_flow(engine.start())


def _size(state, clock):
    return {
        "unknowns": state.grid.spaces.unknowns,
        "cells": state.grid.section.cell_count,
        "stokes_solves": 1,
        "wall_s": clock.seconds,
    }


# The falling block: side of the box, m; the experiments (eta2, rho1) of the paper's appendix B.
SIDE, RHO2 = 500e3, 3200.0
EXPERIMENTS = ((1e20, 3220.0), (1e21, 3300.0), (1e22, 6600.0), (1e23, 3300.0), (1e24, 9900.0))
BLOCK_VISCOSITIES = (1e19, 1e20, 1e21, 1e22, 1e23, 1e24, 1e25, 1e26, 1e27, 5e27)
BLOCK = np.array([[0.4, 0.7], [0.6, 0.7], [0.6, 0.9], [0.4, 0.9], [0.4, 0.7]])
CENTRE = np.array([[0.5, 0.8]])


def block_section(squares):
    """Return the unit square with mesh lines around the block, finer there, and who is inside."""
    flat = [np.array([[0.0, z], [1.0, z]]) for z in (1.0, 0.0)]
    section, points = fitted_mesh(*flat, [BLOCK], 1 / squares, 0.125 / squares)
    inside = (np.abs(points - CENTRE) < 0.1).all(axis=1)
    return section, inside[section.regions]


def fall(section, block, contrast, element="P2b-P1dg"):
    """Return the `Solved` fall of a block of unit weight, and ``|v| eta2`` at its centre.

    Args:
        section, block: of `block_section`.
        contrast: log10(eta2 / eta1), medium over block.
        element: pair of elements; pressure jumps at the block, and a continuous one is slow there.
    """
    weakest = min(1.0, 10.0**-contrast)

    def viscosity(spaces):
        eta = fem.Function(spaces.D)
        eta.x.array[:] = np.where(block, 10.0**-contrast, 1.0) / weakest
        return eta

    def density(spaces):
        rho = fem.Function(spaces.D)
        rho.x.array[:] = block
        return rho

    solved = Solved(section, element, viscosity, density, eta0=weakest)
    index, sampler = CellIndex(section), VelocitySampler(solved.spaces)
    cell, hats = index.locate(CENTRE, index.guess(CENTRE))
    u = sampler(sampler.coefficients(solved.flow.u), cell, hats)
    solved.problem.release()
    return solved, float(-u[0, 1])


def run_falling_block(quick):
    """Falling block: velocity against viscosity contrast (paper, appendix B)."""
    source = "converged solution computed for these pages, good to 1e-4"
    section, block = block_section(10 if quick else 25)
    contrasts = (-8, -4, 0, 4) if quick else range(-8, 9)
    for contrast in contrasts:
        solved, value = fall(section, block, contrast)
        yield compared(
            "falling-block",
            f"contrast 1e{contrast:+d}",
            "v eta2 / ((rho1 - rho2) g L^2)",
            value,
            float(sinking_block_velocity(contrast)),
            bound=1e-2,
            source=source,
            parameters={"contrast": contrast},
            **solved.size,
        )
    experiments = EXPERIMENTS[::2] if quick else EXPERIMENTS
    off = []
    for (eta2, rho1), eta1 in product(experiments, (1e19, 5e27) if quick else BLOCK_VISCOSITIES):
        clock = Clock()
        scene = block_scene(eta1, eta2, rho1, 16 if quick else 25)
        state = _first(scene)
        velocity = -velocity_at(state, CENTRE * SIDE)[0, 1]
        state.grid.stokes.release()
        value = velocity * eta2 / (rho1 - RHO2)
        contrast = float(np.log10(eta2 / eta1))
        reference = float(sinking_block_velocity(contrast)) * GRAVITY * SIDE**2
        off.append(value / reference)
        yield compared(
            "falling-block",
            f"eta2 {eta2:g}, rho1 {rho1:g}, eta1 {eta1:g}",
            "v eta2 / (rho1 - rho2), m^3/s^2",
            value,
            reference,
            bound=1e-2,
            source=source,
            parameters={"contrast": contrast, "eta2": eta2, "rho1": rho1, "eta1": eta1},
            **_size(state, clock),
        )
    yield Row(
        "falling-block",
        "all experiments",
        "spread around the curve",
        max(off) / min(off) - 1,
        0.0,
        None,
        1e-2,
        source="Gerya (2019); the points of all experiments lie on one curve",
    )


def block_scene(eta1, eta2, rho1, squares):
    """Return the scene of the paper's appendix B; mesh lines follow the block."""

    def unit_at(points):
        return (np.abs(points / SIDE - CENTRE) < 0.1).all(axis=1).astype(np.int16)

    slip = dict.fromkeys(SLIP_ON_PLATES, "free-slip")
    return two_rocks(
        SIDE,
        SIDE,
        unit_at,
        BLOCK * SIDE,
        (RHO2, rho1),
        (eta2, eta1),
        (squares, squares),
        slip,
        mesh=MeshPlan("P2b-P1dg", "fitted", RefinePlan(3, ("interfaces",), 1)),
    )

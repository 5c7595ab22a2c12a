"""The Rayleigh-Taylor benchmark of van Keken et al. (1997): growth, and the greatest velocity."""

import numpy as np
from scipy.interpolate import CubicSpline

from restoration.bench.reference import (
    VAN_KEKEN_EARLY,
    VAN_KEKEN_GROWTH,
    VAN_KEKEN_PEAK,
)
from restoration.bench.rows import Clock, compared
from restoration.bench.scenes import two_rocks, under_a_wave, velocity_at
from restoration.engine import StokesEngine
from restoration.run import march
from restoration.scene import MeshPlan, ParticlePlan, RefinePlan

NAME = "van-keken"
WIDTH, DEPTH, AMPLITUDE = 0.9142, 0.2, 0.02
WALLS = {"left": "free-slip", "right": "free-slip", "base": "no-slip", "surface": "no-slip"}
SOURCE = "van Keken et al. (1997), J. Geophys. Res. 102, 22477-22495"
PUBLISHED = 0.00309  # greatest v_rms of one viscosity, at t = 208.5 to 209
END = {1: 230.0, 10: 85.0, 100: 60.0}


def scene(ratio, amplitude=AMPLITUDE, cells=48, **plans):
    """Return the scene, without units: height, top viscosity and weight difference are one.

    Args:
        ratio: viscosity of the upper layer over that of the lower.
        amplitude: of the interface.
        cells: squares across.
        plans: other arguments of `scenes.two_rocks`.
    """
    height, unit_at = under_a_wave(DEPTH, amplitude, 2 * WIDTH)
    x = np.linspace(0, WIDTH, 801)
    return two_rocks(
        WIDTH,
        1.0,
        unit_at,
        np.column_stack([x, height(x)]),
        (0.0, 1.0),
        (1 / ratio, 1.0),
        (cells, round(cells / WIDTH)),
        WALLS,
        gravity=1.0,
        **plans,
    )


def run_van_keken(quick):
    """Rayleigh-Taylor instability of van Keken et al. (1997)."""
    for ratio in VAN_KEKEN_GROWTH:
        clock, amplitude = Clock(), 1e-4
        mesh = MeshPlan("P2-P1", "fitted", RefinePlan(2, ("interfaces",), 1))
        engine = StokesEngine(scene(ratio, amplitude, 20, mesh=mesh))
        state = engine.with_flow(engine.start())
        rate = velocity_at(state, np.array([[0.0, DEPTH + amplitude]]))[0, 1] / amplitude
        engine.grid.stokes.release()
        yield compared(
            NAME,
            f"ratio {ratio}, small amplitude, fitted",
            "growth rate",
            rate,
            VAN_KEKEN_GROWTH[ratio],
            bound=5e-3,
            source="linear theory, Ramberg (1968)",
            parameters={"ratio": ratio},
            unknowns=state.grid.spaces.unknowns,
            cells=state.grid.section.cell_count,
            stokes_solves=1,
            wall_s=clock.seconds,
        )
    runs = (
        [(1, "particles", 32)]
        if quick
        else [
            (1, "particles", 32),
            (1, "particles", 64),
            (1, "fitted", 40),
            (10, "particles", 48),
            (10, "fitted", 24),
            (100, "particles", 48),
            (100, "fitted", 24),
        ]
    )
    for ratio, interfaces, cells in runs:
        yield from _march(ratio, interfaces, cells, quick)


def _march(ratio, interfaces, cells, quick):
    clock = Clock()
    fitted = interfaces == "fitted"
    mesh = MeshPlan("P2-P1", interfaces, RefinePlan(1, ("interfaces",), 1) if fitted else None)
    engine = StokesEngine(
        scene(
            ratio,
            cells=cells,
            mesh=mesh,
            particles=ParticlePlan(2 if fitted else 6, 5, 0.5, 1),
            marks=(0.0, END[ratio]),
            courant=1.0,
            min_steps=40,
            scheme="midpoint" if fitted else "rk4",
        )
    )
    times, speeds = [], []

    def note(_, state):
        times.append(state.time)
        speeds.append(state.grid.speeds(state.flow)[0])

    start = engine.with_flow(engine.start())
    note(None, start)
    march(start, engine, engine.scene.time, every_step=(note,))
    engine.grid.stokes.release()
    times, speeds = np.array(times), np.array(speeds)
    case = f"ratio {ratio}, {interfaces}, {cells} squares across"
    more = {
        "source": SOURCE,
        "unknowns": engine.grid.spaces.unknowns,
        "cells": engine.grid.section.cell_count,
        "steps": len(times) - 1,
        "stokes_solves": engine.counts.solves,
        "wall_s": clock.seconds,
    }
    at = {"ratio": ratio, "interfaces": interfaces, "squares": cells}
    for t, v in VAN_KEKEN_EARLY[ratio][1:]:
        yield compared(
            NAME,
            case,
            f"v_rms at t = {t:g}",
            float(np.exp(CubicSpline(times, np.log(speeds))(t))),
            v,
            bound=2e-2 if quick else None,
            parameters=at,
            **more | {"source": "exact flow by Fourier series, residual below 1e-5"},
        )
    peak, when = peak_of(times, speeds)
    published = VAN_KEKEN_PEAK[ratio]
    value = PUBLISHED if ratio == 1 else published[0][1]
    best = ratio == 1 and (interfaces, cells) in (("particles", 64), ("fitted", 40))
    yield compared(
        NAME,
        case,
        "greatest v_rms",
        peak,
        value,
        bound=5e-3 if best else 2e-2 if ratio == 1 else None,
        parameters=at | {"times": times.tolist(), "speeds": speeds.tolist()},
        **more,
    )
    yield compared(
        NAME,
        case,
        "time of the greatest v_rms",
        when,
        208.75 if ratio == 1 else published[0][0],
        bound=2e-2 if ratio == 1 else None,
        parameters=at,
        **more,
    )


def peak_of(times, speeds):
    """Return the greatest speed and its time, by the parabola through the three highest."""
    i = int(np.clip(speeds.argmax(), 1, len(speeds) - 2))
    a, b, c = np.polyfit(times[i - 1 : i + 2] - times[i], speeds[i - 1 : i + 2], 2)
    if a >= 0:
        return float(speeds[i]), float(times[i])
    shift = -b / (2 * a)
    return float(c - b**2 / (4 * a)), float(times[i] + shift)

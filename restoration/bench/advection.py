"""Particles in a given velocity: rotation (the paper's appendix C) and the time-reversed vortex."""

import numpy as np

from meshes.box import section_mesh
from restoration.advection import SCHEMES
from restoration.bench.exact import constant_speed_rotation, single_vortex
from restoration.bench.reference import ROTATION, ROTATION_GAIN, VORTEX_HALF, VORTEX_RIM
from restoration.bench.rows import Clock, Row, compared, observed_order
from restoration.particles import OUTSIDE, CellIndex
from restoration.sampling import VelocitySampler
from restoration.spaces import Spaces
from restoration.units import YEAR

RADIUS = 3e3  # m, of the particle of the paper
SMALL_GAIN = 1e-6  # m, below which a difference of radii is rounding


def run_rotation(quick):
    """Rotation of a particle at constant speed (paper, appendix C, with its field corrected)."""
    speed = ROTATION["speed_m_per_yr"] / YEAR
    centre = 1e3 * np.array(ROTATION["centre_km"], float)
    velocity, _ = constant_speed_rotation(speed, centre)
    start = 1e3 * np.array([ROTATION["start_km"]], float)
    period = 2 * np.pi * RADIUS / speed
    fields = {"exact velocity": velocity}
    for element in ("P2-P1", "Q2-Q1"):
        fields[f"velocity on 16 x 16 squares of {element}"] = _on_mesh(element, velocity)
    for field, flow in fields.items():
        exact = field.startswith("exact")
        for name, gains in ROTATION_GAIN.items():
            found = {}
            for years, gain in sorted(gains.items()):
                clock, dt = Clock(), years * YEAR
                steps, x = int(period // dt), start
                for _ in range(steps):
                    x = SCHEMES[name].step(x, flow, dt)
                x = SCHEMES[name].step(x, flow, period - steps * dt)
                found[years] = float(np.hypot(*(x - centre)[0]) - RADIUS)
                # The field on a mesh is not the exact one: its own error stays as dt vanishes.
                yield compared(
                    "rotation",
                    f"{name}, {field}",
                    f"radius gained at {years:g} years, m",
                    found[years],
                    gain,
                    bound=1e-3 if exact and abs(gain) > SMALL_GAIN else None,
                    steps=steps + 1,
                    wall_s=clock.seconds,
                    source="the same scheme in exact arithmetic; paper, fig. C2, is linear in dt",
                    parameters={"stepper": name, "years": years, "field": field},
                )
            if exact:
                years = [1000.0, 2000.0]
                order = observed_order(years, [abs(found[y]) for y in years])
                # the radius of even orders gains one more order
                expected = SCHEMES[name].order + (SCHEMES[name].order % 2 == 0)
                yield compared(
                    "rotation",
                    f"{name}, {field}",
                    "order of the radius",
                    order,
                    expected,
                    bound=0.05,
                    source="theory of Runge-Kutta methods",
                    parameters={"stepper": name},
                )
    del quick


def _on_mesh(element, velocity):
    """Return a velocity as the elements of the paper's mesh hold it."""
    cell = "quadrilateral" if element.startswith("Q") else "triangle"
    flat = [np.array([[0.0, z], [1e4, z]]) for z in (1e4, 0.0)]
    section = section_mesh(*flat, (16, 16), cell)
    spaces, index = Spaces(section, element), CellIndex(section)
    sampler = VelocitySampler(spaces)
    with np.errstate(invalid="ignore"):
        nodal = velocity(spaces.V.tabulate_dof_coordinates()[:, :2])
    nodal = np.where(np.isfinite(nodal), nodal, 0.0)  # the centre has no direction
    coefficients = sampler.coefficients(nodal)

    def flow(x):
        return sampler(coefficients, *index.locate(x, np.full(len(x), OUTSIDE, np.int32)))

    return flow


def run_single_vortex(quick):
    """Points carried around by a vortex that turns back (LeVeque 1996)."""
    source = "LeVeque (1996), SIAM J. Numer. Anal. 33, 627-665; places by tight integration"
    counts = (100, 200) if quick else (100, 200, 400)
    for period, (_, places) in VORTEX_HALF.items():
        field = single_vortex(period)

        def flow(xt, field=field):
            """The time travels along as a third coordinate, so that stages see their own."""
            return np.column_stack([field(xt[:, :2], xt[0, 2]), np.ones(len(xt))])

        for name, scheme in SCHEMES.items():
            order = scheme.order
            halves, back = [], []
            for steps in counts:
                clock, dt = Clock(), period / steps
                xt = np.column_stack([VORTEX_RIM, np.zeros(len(VORTEX_RIM))])
                for step in range(steps):
                    if step == steps // 2:
                        halves.append(np.abs(xt[:, :2] - places).max())
                    xt = SCHEMES[name].step(xt, flow, dt)
                back.append(np.abs(xt[:, :2] - VORTEX_RIM).max())
                more = {
                    "source": source,
                    "steps": steps,
                    "wall_s": clock.seconds,
                    "parameters": {"stepper": name, "period": period, "steps": steps}
                    | {"velocities": steps * SCHEMES[name].solves},
                }
                case = f"{name}, period {period:g}"
                metric = f"farthest from its place, {steps} steps"
                yield Row("single-vortex", case, f"{metric}, half way", halves[-1], 0.0, **more)
                yield Row("single-vortex", case, f"{metric}, at the end", back[-1], 0.0, **more)
            if period == 2.0:
                found = observed_order(1 / np.array(counts), halves)
                short = min(0.0, found / order - 1)
                yield Row(
                    "single-vortex",
                    f"{name}, period {period:g}",
                    "order half way",
                    found,
                    order,
                    short,
                    0.1,
                    source="theory of Runge-Kutta methods",
                    parameters={"stepper": name},
                )

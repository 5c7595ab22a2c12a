"""What a surface must keep: its area, rest where nothing drives it, the load of what is below."""

from dataclasses import replace

import numpy as np
import ufl
from dolfinx import fem

from restoration.bench.boxes import Solved, unit_square
from restoration.bench.rows import Clock, Row, at_least, compared, observed_order
from restoration.bench.scenes import two_rocks, velocity_at
from restoration.bench.surfaces import (
    FITTED,
    HILL,
    KYR,
    LID,
    LINEAR,
    MANTLE,
    WALLS,
    below_air,
    course,
    hill,
    sloshing,
)
from restoration.diagnostics import relative_change, volume_by_rock
from restoration.engine import StokesEngine
from restoration.layered import Layer, growth_matrix
from restoration.scene import Air, MeshPlan, RefinePlan, Transfer, Wall
from restoration.surface import line_area
from restoration.topography import SurfaceStress, dynamic_topography

ROUNDING = 1e-10
GRAVITY = 10.0


def run_advective_volume(quick):
    """Area of the section and of its rocks below a surface that moves."""
    name = "advective-volume"
    marks = np.arange(0, 16, 5) * KYR
    particles = hill(GRAVITY, HILL, 14, marks, MeshPlan())
    runs = {
        "relaxation of 7 km, fitted, rk4": hill(GRAVITY, HILL, 8, marks),
        "relaxation of 7 km, particles, rk4": particles,
        "relaxation of 7 km, particles, euler": hill(
            GRAVITY, HILL, 14, marks, MeshPlan(), scheme="euler", steps=4
        ),
    }
    if not quick:
        runs["sloshing, fitted, euler, 2500 yr"] = sloshing(2500, 40)
        runs["sloshing, fitted, euler, 25000 yr, theta = 0.5"] = sloshing(25000, 8, 0.5)
    for case, scene in runs.items():
        engine = StokesEngine(scene)
        first = engine.with_flow(engine.start())
        before = engine.section.area, volume_by_rock(scene, engine.grid, first.particles)
        engine.grid.stokes.release()
        ran = course(scene)
        section, state = ran.engine.section, ran.state
        after = volume_by_rock(scene, ran.engine.grid, state.particles)
        rocks = relative_change(before[1], after)
        shift = ran.engine.surface_shift * scene.outline.width / before[0]
        lines = [line_area(points) for points in ran.surfaces]
        euler = "euler" in case
        found = {
            "change of the area of the mesh, relative": (section.area / before[0] - 1, 1e-12),
            "change of the area below the surface line": (lines[-1] / lines[0] - 1, 1e-12),
            "area that the shifts of the surface made up for": (shift, None if euler else 1e-7),
            "change of the area of a rock, largest": (max(rocks.values(), key=abs), 2e-4),
        }
        for metric, (value, bound) in found.items():
            yield Row(
                name,
                case,
                metric,
                abs(value),
                0.0,
                None,
                bound,
                source="no rock crosses any wall",
                parameters={"case": case},
                **ran.size,
            )


def layers_under(
    surface, mesh, heights=(MANTLE, MANTLE + LID), transfer="cell", squares=14, **plan
):
    """Return the scene of a light layer on a heavy one under a free surface.

    Args:
        surface: shape (n, 2), m.
        mesh: `scene.MeshPlan`.
        heights: of the contact, and of the flat surface, m.
        transfer: of density and viscosity.
        squares: rows; 14 have a mesh line at the contact.
        plan: entries of `scene.SurfacePlan`.
    """
    width = float(surface[-1, 0])
    box = two_rocks(
        width,
        heights[1],
        lambda points: (points[:, 1] > heights[0]).astype(np.int16),
        np.array([[0.0, heights[0]], [width, heights[0]]]),
        (3300.0, 2800.0),
        (1e21, 1e22),
        (2 * squares, squares),
        WALLS,
        gravity=GRAVITY,
        mesh=mesh,
        transfer=Transfer(transfer, transfer, "harmonic"),
        marks=(0.0, 5 * KYR),
        courant=np.inf,
        min_steps=2,
    )
    return below_air(box, surface, **plan)


def run_topography_rest(quick):
    """What rests under a surface, and what moves below a relief that nothing holds."""
    name = "topography-rest"
    top, width = MANTLE + LID, 2 * (MANTLE + LID)
    flat = np.array([[0.0, top], [width, top]])
    speed = 3300.0 * GRAVITY * top**2 / 1e21  # at which such a weight would fall
    rest = {
        "flat layers on a mesh line, P2-P1": (layers_under(flat, MeshPlan()), ROUNDING),
        "flat layers, fitted, P2b-P1dg": (layers_under(flat, FITTED), ROUNDING),
        "flat layers on a mesh line, under air": (
            layers_under(flat, MeshPlan(), air=Air(100e3, 0.0, 1e18)),
            ROUNDING,
        ),
        "flat layers inside squares, P2-P1": (
            layers_under(flat, MeshPlan(), transfer="hat", squares=13),
            None,
        ),
    }
    for case, (scene, bound) in rest.items():
        ran = course(scene)
        state = ran.engine.with_flow(ran.state)
        moved = float(np.abs(ran.surfaces[-1][:, 1] - top).max())
        for metric, value in {
            "speed over rho g H^2 / eta": np.abs(state.flow.u).max() / speed,
            "motion of the surface in 5 kyr over H": moved / top,
        }.items():
            more = {"parameters": {"case": case}, **ran.size}
            yield Row(name, case, metric, float(value), 0.0, None, bound, **more)
    yield from _held_relief(name, quick)
    yield from _loose_relief(name, quick)


def _held_relief(name, quick):
    """A relief whose weight is held: by a fluid as heavy as the rock, or by a load like it."""
    top, width = MANTLE + LID, 2 * (MANTLE + LID)
    k, speed = np.pi / width, 3300.0 * GRAVITY * top**2 / 1e21
    x = np.linspace(0, width, 801)
    surface = np.column_stack([x, top + HILL * np.cos(k * x)])
    one = {"unit_at": lambda points: np.zeros(len(points), np.int16)}
    held = layers_under(surface, MeshPlan(), air=Air(100e3, 3300.0, 1e19))
    clock, engine = Clock(), StokesEngine(replace(held, **one))
    state = engine.with_flow(engine.start())
    yield Row(
        name,
        "relief of 7 km under a fluid as heavy",
        "speed over rho g H^2 / eta",
        float(np.abs(state.flow.u).max()) / speed,
        0.0,
        None,
        ROUNDING,
        parameters={"case": "relief under a fluid as heavy"},
        unknowns=engine.grid.spaces.unknowns,
        wall_s=clock.seconds,
    )
    errors, counts = [], (7, 14) if quick else (7, 14, 28)
    for squares in counts:
        scene = layers_under(surface, MeshPlan(), squares=squares)

        def load(points, axis):
            slope = -HILL * k * np.sin(k * points[:, 0])
            normal = np.array([-slope, np.ones(len(slope))]) / np.hypot(1, slope)
            return -3300.0 * GRAVITY * (top + 2 * HILL - points[:, 1]) * normal[axis]

        traction = tuple(lambda points, axis=axis: load(points, axis) for axis in (0, 1))
        walls = scene.walls | {"surface": Wall("traction", (None, None), traction)}
        clock, engine = Clock(), StokesEngine(replace(scene, walls=walls, **one))
        state = engine.with_flow(engine.start())
        errors.append(float(np.abs(state.flow.u).max()) / speed)
        yield Row(
            name,
            "relief of 7 km under a load that holds it",
            f"speed over rho g H^2 / eta, {squares} rows",
            errors[-1],
            0.0,
            None,
            1e-5,
            parameters={"squares": squares, "case": "relief under a load"},
            unknowns=engine.grid.spaces.unknowns,
            wall_s=clock.seconds,
        )
    yield Row(
        name,
        "relief of 7 km under a load that holds it",
        f"order from {counts[-2]} to {counts[-1]} rows",
        observed_order(1 / np.array(counts), errors),
        source="normals of a polygon against those of the wave: 2",
    )


def _loose_relief(name, quick):
    """A small relief on flat layers of two densities: both surfaces move as linear theory says."""
    top, width, amplitude = MANTLE + LID, 2 * (MANTLE + LID), 70.0
    layers, k = (Layer(MANTLE, 3300.0, 1e21), Layer(LID, 2800.0, 1e22)), np.pi / width
    x = np.linspace(0, width, 801)
    clock, wave = Clock(), amplitude * np.cos(k * x)
    scene = layers_under(np.column_stack([x, top + wave]), FITTED, squares=8 if quick else 16)
    engine = StokesEngine(scene)
    state = engine.with_flow(engine.start())
    a = growth_matrix(layers, k, GRAVITY)
    points = {"contact": np.array([[0.0, MANTLE], [width, MANTLE]])}
    points["surface"] = engine.grid.top.line[[0, -1]]
    for i, (where, ends) in enumerate(points.items()):
        left, right = velocity_at(state, ends)[:, 1]
        yield compared(
            name,
            "relief of 70 m that nothing holds, fitted",
            f"velocity of the {where} over the relief, 1/s",
            (left - right) / (2 * amplitude),
            a[i, 1],
            bound=2e-3,
            source=LINEAR,
            unknowns=engine.grid.spaces.unknowns,
            wall_s=clock.seconds,
        )


# Dynamic topography. A load cos(k x) sin(n z) between plates of free slip, viscosity and g of 1.
LOAD, ALONG, UP = 0.1, 2 * np.pi, np.pi


def load_stress():
    """Return the amplitude of the normal stress on top of the square, for the load `LOAD`.

    The vertical velocity is ``W cos(k x) sin(n z)`` with ``W = -LOAD k^2 / (k^2 + n^2)^2`` and the
    pressure ``-W n (k^2 + n^2) / k^2 cos(k x) cos(n z)``: put into the equations.
    """
    square = ALONG**2 + UP**2
    w = -LOAD * ALONG**2 / square**2
    return -UP * w * (square / ALONG**2 + 2)


def _density(spaces):
    x = ufl.SpatialCoordinate(spaces.section.mesh)
    return 1 + LOAD * ufl.cos(ALONG * x[0]) * ufl.sin(UP * x[1])


def _one(spaces):
    return fem.Constant(spaces.section.mesh, 1.0)


def plain_stress(solved, stress):
    """Return the normal stress from the velocity gradient and pressure at the surface, projected.

    Args:
        solved: `boxes.Solved`.
        stress: `SurfaceStress` of the same spaces.
    """
    spaces = solved.spaces
    u, p = fem.Function(spaces.V), fem.Function(spaces.Q)
    u.x.array[:], p.x.array[:] = solved.flow.u.ravel(), solved.flow.p
    ds = spaces.ds(spaces.section.wall_tags["surface"])
    return stress.projected(lambda test: (2 * u[1].dx(1) - p) * test * ds)


def run_dynamic_topography(quick):
    """Stress on a surface of free slip, and the topography it stands for."""
    name = "dynamic-topography"
    counts = (8, 16) if quick else (8, 16, 32)
    for element in ("P2-P1", "P2b-P1dg", "P2-P1dg", "Q2-Q1", "Q2-P1dg", "MINI"):
        errors = {"consistent": [], "projected": []}
        for n in counts:
            solved = Solved(unit_square(element, n), element, _one, _density, degree=8)
            spaces = solved.spaces
            stress = SurfaceStress(spaces.section, spaces, _density(spaces), _one(spaces), 1.0, 1.0)
            wave = np.cos(ALONG * stress.x)
            ways = {"consistent": stress.normal(solved.flow)}
            ways["projected"] = plain_stress(solved, stress)
            for how, found in ways.items():
                error = stress.amplitude(found, wave) / load_stress() - 1
                errors[how].append(abs(error))
                yield Row(
                    name,
                    f"{element}, {n} squares, {how}",
                    "error of the wave of the normal stress",
                    float(error),
                    0.0,
                    None,
                    2e-3 if how == "consistent" and element != "MINI" else None,
                    source="exact solution, see restoration.bench.reliefs.load_stress",
                    parameters={"element": element, "squares": n, "how": how},
                    **solved.size,
                )
            normal = ways["consistent"]
            normal = normal - stress.amplitude(normal, np.ones(len(normal)))
            off = np.abs(normal - load_stress() * wave).max() / load_stress()
            yield Row(
                name,
                f"{element}, {n} squares, consistent",
                "greatest error of the normal stress at a node",
                float(off),
                0.0,
                parameters={"element": element, "squares": n},
                **solved.size,
            )
            solved.problem.release()
        for how, found in errors.items():
            value = observed_order(1 / np.array(counts), found)
            sharp = how == "consistent" and element != "MINI"
            case, metric = f"{element}, {how}", f"order from {counts[-2]} to {counts[-1]} squares"
            if sharp:
                yield at_least(
                    name, case, metric, value, 4, source="twice that of strain rate and pressure"
                )
            else:
                yield Row(name, case, metric, value)
    yield from _over_a_contact(name, quick)


def _over_a_contact(name, quick):
    """The topography over a bent contact: where a free surface would stand still."""
    top, width = MANTLE + LID, 2 * (MANTLE + LID)
    k, amplitude = np.pi / width, 7e3
    x = np.linspace(0, width, 801)
    for ratio in (1.0, 100.0):
        for interfaces in ("fitted", "particles"):
            layers = Layer(400e3, 3250.0, 1e21), Layer(top - 400e3, 3300.0, ratio * 1e21)
            a = growth_matrix(layers, k, GRAVITY)
            clock, line = Clock(), 400e3 + amplitude * np.cos(k * x)
            scene = two_rocks(
                width,
                top,
                lambda points, line=line: (points[:, 1] > np.interp(points[:, 0], x, line)).astype(
                    np.int16
                ),
                np.column_stack([x, line]),
                tuple(layer.density for layer in layers),
                tuple(layer.viscosity for layer in layers),
                (28, 14) if quick else (56, 28),
                WALLS,
                gravity=GRAVITY,
                mesh=replace(
                    FITTED if interfaces == "fitted" else MeshPlan(),
                    refine=RefinePlan(1, ("interfaces",), 1),
                ),
                transfer=Transfer("linear", "linear", "geometric"),
            )
            engine = StokesEngine(scene)
            state = engine.with_flow(engine.start())
            _, found = dynamic_topography(scene, engine.grid, state.flow)
            yield compared(
                name,
                f"contact of 7 km, viscosities 1 : {ratio:g}, {interfaces}",
                "topography over the contact",
                (found[0] - found[-1]) / (2 * amplitude),
                -a[1, 0] / a[1, 1],
                bound=2e-3 if interfaces == "fitted" else None,
                source=f"where the surface stands still, {LINEAR}",
                parameters={"ratio": ratio, "interfaces": interfaces},
                unknowns=engine.grid.spaces.unknowns,
                cells=engine.section.cell_count,
                stokes_solves=1,
                wall_s=clock.seconds,
            )
            engine.grid.stokes.release()

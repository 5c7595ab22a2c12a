"""Benchmarks with a known answer, asked with settings that can be chosen."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from restoration.bench import gravity, peers, surfaces, van_keken
from restoration.bench.boxes import Solved, cell_viscosity, unit_square
from restoration.bench.exact import solcx
from restoration.bench.reference import (
    RAMBERG,
    RAMBERG_VELOCITY,
    sinking_block_velocity,
)
from restoration.bench.scenes import velocity_at
from restoration.bench.solutions import solcx_by_particles, solcx_density
from restoration.engine import StokesEngine
from restoration.run import march
from restoration.scene import MeshPlan, RefinePlan, SolverPlan, Transfer
from restoration.trade.choices import Choice
from restoration.words import counted

PLANE = ("P2-P1", "P2b-P1dg", "P2-P1dg", "MINI", "Q2-Q1", "Q2-P1dg")


@dataclass(frozen=True)
class Question:
    """A benchmark as a question.

    Attributes:
        title: what is asked.
        unit: of the errors, ``m``, or empty for relative ones.
        truth: what they are errors against.
        base: settings by entry, those of the benchmark.
        small: settings that make it cheap, for what is done once beforehand.
        choices: tuple of `Choice` that depart from them.
        answer: function of settings that gives the entries of a `trials.Trial` that do not cost,
            the errors as ``error`` and ``most``.
        columns: what these are.
    """

    title: str
    unit: str
    truth: str
    base: dict
    small: dict
    choices: tuple
    answer: Callable
    columns: tuple[str, str] = ("mean", "greatest")


def adjusted(scene, settings):
    """Return a scene with other settings; those that it has no part for are left alone.

    Args:
        scene: `scene.Scene`.
        settings: values by entry; ``mesh.refine`` is a number of levels, 0 for none.
    """
    get = settings.get
    levels = int(get("mesh.refine", 0))
    per_cell = get("particles.per_cell", scene.particles.per_cell)
    tolerance = get("solver.rtol")
    fitted = get("mesh.interfaces", scene.mesh.interfaces) != "particles"
    quadratic = not get("mesh.element", scene.mesh.element).startswith(("Q", "MINI"))
    return replace(
        scene,
        mesh=MeshPlan(
            get("mesh.element", scene.mesh.element),
            "fitted" if fitted else "particles",
            RefinePlan(levels, ("interfaces",), 1) if levels else None,
        ),
        particles=replace(
            scene.particles,
            per_cell=int(per_cell),
            velocity="conservative" if quadratic else "plain",
        ),
        transfer=Transfer(
            get("transfer.density", scene.transfer.density),
            get("transfer.viscosity", scene.transfer.viscosity),
            get("transfer.mean", scene.transfer.mean),
        ),
        solver=SolverPlan("fieldsplit", (("ksp_rtol", str(tolerance)),))
        if tolerance
        else scene.solver,
        time=replace(
            scene.time,
            scheme=get("time.scheme", scene.time.scheme),
            courant=float(get("time.courant", scene.time.courant)),
            min_steps=int(get("time.min_steps", scene.time.min_steps)),
        ),
    )


def errors(values, **size):
    """Return the mean and the greatest of errors, with size and work, as of a `trials.Trial`."""
    values = np.abs(values)
    return {"error": float(values.mean()), "most": float(values.max())} | size


def first_velocities(scenes, points):
    """Return velocities of the first instant of scenes, at points of each, and their size and work.

    Args:
        scenes: list of `scene.Scene`.
        points: for each of them shape (n, 2), m.
    """
    found, unknowns = [], 0
    for scene, at in zip(scenes, points, strict=True):
        engine = StokesEngine(scene)
        state = engine.with_flow(engine.start())
        found.append(velocity_at(state, at))
        unknowns = max(unknowns, state.grid.spaces.unknowns)
        state.grid.stokes.release()
    return found, {"unknowns": unknowns, "solves": len(scenes)}


def axis(kind, entry, values, text="{}"):
    """Return choices of one axis that set one entry."""
    return [Choice(kind, text.format(value), {entry: value}) for value in values]


def elements(names):
    """Return choices of other elements."""
    return axis("element", "mesh.element", names)


# The first is what benchmarks have as they are, the falling block by particles.
AVERAGES = [
    Choice("rock", name, {"transfer.density": density, "transfer.viscosity": viscosity})
    for name, density, viscosity in (
        ("transfer hat", "hat", "hat"),
        ("transfer linear", "linear", "linear"),
        ("transfer cell", "cell", "cell"),
        ("transfer lines", "lines", "lines"),
    )
]
PER_CELL = [
    Choice("particles", f"{counted(count, 'particle')} a cell", {"particles.per_cell": count})
    for count in (1, 16)
]
FITTED = Choice("rock", "fitted", {"mesh.interfaces": "fitted"})
PARTICLES = Choice("rock", "particles", {"mesh.interfaces": "particles"})
DISCONTINUOUS = Choice("element", "P2b-P1dg", {"mesh.element": "P2b-P1dg"})


def rayleigh_taylor(settings):
    """Return errors of the velocities of crests and troughs of two waves."""
    waves = gravity.QUICK_POINTS
    amplitude, middle = RAMBERG["amplitude"], RAMBERG["h2"]
    scenes = [
        adjusted(
            gravity.ramberg_scene(length, eta2, amplitude, False, int(settings["mesh.cells"])),
            settings,
        )
        for length, eta2 in waves
    ]
    points = [
        np.array([[0.0, middle + amplitude], [length / 2, middle - amplitude]])
        for length, _ in waves
    ]
    found, size = first_velocities(scenes, points)
    exact = [RAMBERG_VELOCITY[wave] for wave in waves]
    return errors([u[:, 1] / v - 1 for u, v in zip(found, exact, strict=True)], **size)


BLOCKS = (1e19, 1e21, 1e23)  # Pa s, in a medium of 1e21


def falling_block(settings):
    """Return errors of the velocities of a weak, an equal and a stiff block."""
    medium, heavier = 1e21, 100.0
    scenes = [
        adjusted(
            gravity.block_scene(eta, medium, gravity.RHO2 + heavier, int(settings["mesh.cells"])),
            settings,
        )
        for eta in BLOCKS
    ]
    found, size = first_velocities(scenes, [gravity.CENTRE * gravity.SIDE] * len(BLOCKS))
    scale = heavier * gravity.GRAVITY * gravity.SIDE**2 / medium
    exact = [float(sinking_block_velocity(np.log10(medium / eta))) * scale for eta in BLOCKS]
    return errors([-u[0, 1] / v - 1 for u, v in zip(found, exact, strict=True)], **size)


STEP = 1e6  # of the viscosity of SolCx


def solcx_step(settings):
    """Return relative errors of velocity and pressure of SolCx."""
    element, squares = settings["mesh.element"], int(settings["mesh.cells"])
    if settings["mesh.interfaces"] == "fitted":
        section = unit_square(element, squares)
        step = cell_viscosity(lambda x: np.where(x[:, 0] < 0.5, 1.0, STEP))
        solved = Solved(section, element, step, solcx_density)
    else:  # the step in the middle of a square
        transfer = Transfer("cell", settings["transfer.viscosity"], settings["transfer.mean"])
        solved = solcx_by_particles(element, squares + 1, STEP, transfer)
    velocity, pressure = solved.errors(solcx(STEP))
    solved.problem.release()
    size = {"unknowns": solved.spaces.unknowns, "solves": 1}
    return {"error": float(velocity), "most": float(pressure)} | size


def relaxation(settings):
    """Return errors of crest and trough of a hill of 7 km after 5 and 15 kyr."""
    marks = np.array([0, 5, 15]) * surfaces.KYR
    scene = surfaces.hill(
        10.0, surfaces.HILL, int(settings["mesh.cells"]), marks, theta=settings["surface.theta"]
    )
    ran = surfaces.course(adjusted(scene, settings))
    kyr, off = np.round(ran.times / surfaces.KYR, 6), []
    for when in (5, 15):
        heights = ran.ends[kyr == when][-1] - surfaces.MANTLE - surfaces.LID
        off.append(heights - 1e3 * np.array(surfaces.HILLS[10.0][when]))
    size = {name: ran.size[name] for name in ("unknowns", "steps")}
    return errors(off, solves=ran.size["stokes_solves"], **size)


def overturn(settings):
    """Return errors of the greatest velocity of van Keken's overturn, and of its time."""
    cells = int(settings["mesh.cells"])
    scene = van_keken.scene(1, cells=cells, marks=(0.0, settings["time.end"]))
    engine, passed = StokesEngine(adjusted(scene, settings)), []

    def note(_, state):
        passed.append((state.time, state.grid.speeds(state.flow)[0]))

    march(engine.start(), engine, engine.scene.time, every_step=(note,))
    size = {"unknowns": engine.grid.spaces.unknowns, "solves": engine.counts.solves}
    engine.grid.stokes.release()
    peak, when = van_keken.peak_of(*np.array(passed).T)
    return errors([peak / peers.PEAK - 1, when / peers.PEAK_AT - 1], steps=len(passed), **size)


QUESTIONS = {
    "rayleigh-taylor": Question(
        "Rayleigh-Taylor instability of two layers: first velocity of crests and troughs",
        "",
        "exact flow at finite amplitude",
        {
            "mesh.cells": 40,
            "mesh.element": "P2-P1",
            "mesh.interfaces": "particles",
            "mesh.refine": 3,
            "transfer.density": "linear",
            "transfer.viscosity": "linear",
            "transfer.mean": "geometric",
        },
        {"mesh.cells": 8, "mesh.refine": 1},
        (
            *axis("mesh", "mesh.cells", (10, 20, 28, 56), "{} cells"),
            *axis("refine", "mesh.refine", (0, 1, 2, 4), "halved {} times"),
            *elements(("P2b-P1dg", "P2-P1dg", "MINI")),
            FITTED,
            *(way for way in AVERAGES if way.name != "transfer linear"),
            *axis("mean", "transfer.mean", ("harmonic", "arithmetic"), "{} mean"),
            *PER_CELL,
        ),
        rayleigh_taylor,
    ),
    "falling-block": Question(
        "Falling block, weaker, as stiff and stiffer than the medium by 100: first velocity",
        "",
        "converged solution, good to 1e-4",
        {
            "mesh.cells": 24,  # the block's sides lie on lines of 10, 20 or 30 by chance
            "mesh.element": "P2b-P1dg",
            "mesh.interfaces": "fitted",
            "mesh.refine": 3,
            "transfer.density": "hat",
            "transfer.viscosity": "hat",
            "transfer.mean": "harmonic",
        },
        {"mesh.cells": 8, "mesh.refine": 1},
        (
            *axis("mesh", "mesh.cells", (6, 9, 14, 38), "{} cells"),
            *axis("refine", "mesh.refine", (0, 1, 2, 4, 5), "halved {} times"),
            *elements(("P2-P1", "P2-P1dg", "MINI")),
            PARTICLES,
            *(
                Choice("rock", f"particles, {way.name}", PARTICLES.entries | way.entries)
                for way in AVERAGES[1:]
            ),
        ),
        falling_block,
    ),
    "solcx": Question(
        "SolCx: a step of the viscosity of 1e6, on a mesh line or within squares",
        "",
        "exact solution",
        {
            "mesh.cells": 32,
            "mesh.element": "P2-P1",
            "mesh.interfaces": "particles",
            "transfer.viscosity": "hat",
            "transfer.mean": "harmonic",
        },
        {"mesh.cells": 4},
        (
            *axis("mesh", "mesh.cells", (8, 16, 64), "{} cells"),
            *elements(PLANE[1:]),
            FITTED,
            *axis("rock", "transfer.viscosity", ("linear", "quadrature", "cell"), "{} averages"),
            *axis("mean", "transfer.mean", ("geometric", "arithmetic"), "{} mean"),
        ),
        solcx_step,
        columns=("velocity", "pressure"),
    ),
    "surface-relaxation": Question(
        "Relaxation of a hill of 7 km under a free surface, crest and trough after 5 and 15 kyr",
        "m",
        "fully non-linear relaxation, computed independently",
        {
            "mesh.cells": 8,
            "mesh.element": "P2b-P1dg",
            "mesh.interfaces": "fitted",
            "time.scheme": "rk4",
            "time.min_steps": 2,
            "surface.theta": 0.0,
        },
        {"mesh.cells": 4, "time.min_steps": 1},
        (
            *axis("mesh", "mesh.cells", (4, 6, 12, 16), "{} rows"),
            *elements(("P2-P1", "P2-P1dg", "MINI")),
            PARTICLES,
            Choice(
                "refine",
                "particles, halved 3 times",
                PARTICLES.entries | {"mesh.refine": 3},
            ),
            *axis("stepper", "time.scheme", ("euler", "midpoint", "rk3")),
            Choice("stepper", "euler, theta 0.5", {"time.scheme": "euler", "surface.theta": 0.5}),
            *axis("step", "time.min_steps", (1, 4, 8), "{} steps between times"),
        ),
        relaxation,
    ),
    "van-keken": Question(
        "Overturn of van Keken et al. (1997), one viscosity: the greatest velocity and its time",
        "",
        "published solutions, see docs/benchmarks.md",
        {
            "mesh.cells": 24,
            "mesh.element": "P2-P1",
            "mesh.interfaces": "particles",
            "transfer.density": "projection",
            "time.scheme": "rk4",
            "time.courant": 1.0,
            "time.min_steps": 20,
            "time.end": 230.0,
        },
        {"mesh.cells": 6, "time.end": 5.0, "time.min_steps": 2},
        (
            *axis("mesh", "mesh.cells", (12, 17, 34), "{} cells"),
            *elements(("P2b-P1dg", "P2-P1dg", "MINI", "Q2-Q1")),
            FITTED,
            *AVERAGES,
            *PER_CELL,
            *axis("stepper", "time.scheme", ("euler", "midpoint", "rk3")),
            *axis("step", "time.courant", (0.5, 2.0, 4.0), "courant {}"),
        ),
        overturn,
    ),
}

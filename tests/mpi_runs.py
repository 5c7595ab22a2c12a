"""Prints where the rock of small runs has come to, as JSON; run it on any number of ranks."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from restoration.box_engine import BoxEngine
from restoration.engine import StokesEngine
from restoration.environment import use_jit_cache
from restoration.resolve import load
from restoration.run import march
from restoration.scene import (
    MeshPlan,
    Outline,
    ParticlePlan,
    RefinePlan,
    SolverPlan,
    SurfacePlan,
    TimePlan,
    Transfer,
    Wall,
)
from tests.restoration.conftest import HEIGHT, MYR, WIDTH, diapir_scene

AWAY = 3e4  # m, keeps every number far from zero
LOAD = 1.2  # of the mean, that no rank has more particles than
OPEN = {"right": Wall("velocity", (6e-11, None), (0.0, 0.0))}


def walls(**others):
    """Return the walls of the diapir, some of them others."""
    return diapir_scene().walls | others


def free_surface():
    """Return a scene whose surface is free, and whose right wall lets rock out."""
    x = np.linspace(0, WIDTH, 41)
    top = np.column_stack([x, 50 * np.cos(np.pi * x / WIDTH)])
    return diapir_scene(
        cells=(10, 11),
        viscosity=(1e19, 1e20),
        marks=(0, 0.1, 0.05),
        walls=walls(surface=Wall("free", (None, None), (0.0, 0.0)), **OPEN),
        outline=Outline(top, np.array([[0, -HEIGHT], [WIDTH, -HEIGHT]])),
        surface=SurfacePlan(),
        time=TimePlan((0.0, 0.1 * MYR, 0.05 * MYR), "midpoint", 1.0, 3),
    )


def graben():
    """Return the shipped graben on few cells, whose mesh is made anew several times."""
    case = Path(__file__).parents[1] / "cases" / "graben" / "case.yaml"
    sets = "mesh.cells=[18, 6]", "time.marks=[0 kyr, 5 kyr]", "time.min_steps=3"
    return load(case, sets).scene


def box(name):
    """Return the shipped case of three dimensions on few cells, by a solver."""
    case = Path(__file__).parents[1] / "cases" / "diapir-3d" / "case.yaml"
    options = "{ksp_rtol: 1e-12}" if name == "fieldsplit" else "{}"
    sets = (
        "mesh.cells=[3, 3, 2]",
        "time={marks: [0 Myr, 0.5 Myr], min_steps: 2}",
        f"solver={{name: {name}, options: {options}}}",
        "rocks.salt.viscosity=1e18 Pa s",
    )
    return load(case, sets).scene


def run(scene):
    """Return particles and lines at the end of a run, and whether all ranks had their share."""
    engine, loads = (BoxEngine if scene.dim == 3 else StokesEngine)(scene), []
    end = march(
        engine.start(),
        engine,
        scene.time,
        every_step=(lambda *_: loads.append(engine.sharing.load),),
    )
    end = engine.whole(end)
    return {
        "x": (end.particles.x + AWAY).ravel().tolist(),
        "unit": (end.particles.unit + 1).tolist(),
        "lines": (np.concatenate([line.points for line in end.lines]) + AWAY).ravel().tolist(),
        "balanced": float(max(loads) <= LOAD),
        "counts": [
            1.0 + count
            for count in (
                engine.born,
                *(
                    crossed[name]
                    for crossed in (engine.left, engine.entered)
                    for name in sorted(crossed)
                ),
            )
        ],
    }, engine.ranks.first


SCENES = {
    "fifty steps": lambda: diapir_scene(
        viscosity=(1e19, 1e20), marks=(0, 1), time=TimePlan((0.0, MYR), "rk4", 1.0, 50)
    ),
    "fitted": lambda: diapir_scene(
        viscosity=(1e18, 1e20),
        mesh=MeshPlan(interfaces="fitted"),
        time=TimePlan((0.0, 0.3 * MYR), "midpoint", 1.0, 8),
    ),
    "free surface": free_surface,
    "free surface, solved by all ranks": lambda: replace(
        free_surface(), solver=SolverPlan("direct", (), reproducible=False)
    ),
    "few particles": lambda: diapir_scene(
        particles=ParticlePlan(1, 1, 1.0, 1),
        transfer=Transfer("linear", "cell", "harmonic"),
        walls=walls(left=Wall("velocity", (6e-11, None), (0.0, 0.0)), **OPEN),
        time=TimePlan((0.0, 0.5 * MYR), "paper", 1.0, 12),
    ),
    "implicit": lambda: diapir_scene(
        time=TimePlan((0.0, 0.5 * MYR), "implicit-midpoint", 1.0, 4),
    ),
    "refined": lambda: diapir_scene(
        viscosity=(1e19, 1e20),
        mesh=MeshPlan(refine=RefinePlan(1, ("interfaces", "velocity-gradient"), 1)),
        transfer=Transfer("hat", "quadrature", "arithmetic"),
        time=TimePlan((0.0, 0.5 * MYR), "rk3", 1.0, 4, tolerance=5.0),
    ),
    "graben, meshes made anew": graben,
    "box": lambda: box("direct"),
    "box by the field split": lambda: box("fieldsplit"),
}


if __name__ == "__main__":
    use_jit_cache()
    found = {}
    for name, scene in SCENES.items():
        numbers, first = run(scene())
        found |= {f"{name}: {key}": value for key, value in numbers.items()}
    if first:
        print(json.dumps(found))

"""The linear solvers and the adaption of meshes: iterations, and seconds against a direct solve."""

import numpy as np
from dolfinx import fem

from meshes.refine import adapted_mesh
from restoration.bench.boxes import Solved, free_slip_walls, unit_cube, unit_square
from restoration.bench.rows import Clock, Row
from restoration.scene import SolverPlan
from restoration.spaces import Spaces
from restoration.stokes import StokesProblem

MOST_ITERATIONS, MOST_CYCLES, GROWTH = 60, 300, 1.3
SIZES = {2: (70, 140, 210), 3: (10, 20)}
QUICK = {2: (40, 70), 3: (10,)}
LARGE = {2: 330, 3: 20}  # squares of a million unknowns, cubes of 200 thousand
ROUGH = 20  # discs of the section with many inclusions


def sinking_block(dim, n, contrast, solver, element="P2-P1", rough=False):
    """Return the `Solved` fall of a block of side 0.2 in a box of side 1.

    Args:
        dim: dimensions.
        n: squares or cubes along a side; a multiple of ten puts the block on mesh lines.
        contrast: viscosity of the block over that around it.
        solver: name of the solver.
        element: pair of elements.
        rough: many overlapping discs of stiff rock with stepped outlines instead of the block.
    """
    section = unit_square(element, n) if dim == 2 else unit_cube(n)
    centre = np.full(dim, 0.5)
    centre[-1] = 0.8
    rng = np.random.default_rng(3)
    discs = [(rng.random(dim), 0.04 + 0.08 * rng.random()) for _ in range(ROUGH)]

    def inside(x):
        if rough:
            return np.any([np.linalg.norm(x - c, axis=1) < r for c, r in discs], axis=0)
        return (np.abs(x - centre) < 0.1).all(axis=1)

    weakest = min(1.0, contrast)

    def cells(values):
        def field(spaces):
            function = fem.Function(spaces.D)
            x = spaces.section.corners.mean(axis=1)
            function.x.array[:] = np.where(inside(x), *values)
            return function

        return field

    viscosity, density = cells((contrast / weakest, 1 / weakest)), cells((31.0, 30.0))
    plan = SolverPlan(solver)
    return Solved(section, element, viscosity, density, solver=plan, eta0=weakest)


def run_solvers(quick):
    """Direct and iterative solvers on the sinking block, in two and three dimensions."""
    sizes = QUICK if quick else SIZES
    contrasts = (1e6,) if quick else (1.0, 1e-6, 1e6)
    for dim in (2, 3):
        for contrast in contrasts:
            before = None
            counts = sizes[dim]
            if not quick and contrast == 1e6 and dim == 2:
                counts = (*counts, LARGE[2])
            for n in counts:
                for solver in ("direct", "fieldsplit"):
                    if solver == "direct" and contrast != 1e6:
                        continue
                    solved = sinking_block(dim, n, contrast, solver)
                    its = solved.problem.counts.krylov_iterations
                    yield from _told(dim, n, contrast, solver, solved, before)
                    before = its if solver == "fieldsplit" else before
    for dim, n in () if quick else ((2, 100), (3, 13)):
        for contrast in (1e2, 1e4):
            solved = sinking_block(dim, n, contrast, "auto", rough=True)
            yield from _told(
                dim, n, contrast, "auto", solved, None, f"{ROUGH} stepped inclusions, "
            )


def _told(dim, n, contrast, solver, solved, before, what=""):
    problem = solved.problem
    clock = Clock()  # once more with the structure known, as a run does it
    problem.assemble()
    its, cycles = problem.counts.krylov_iterations, problem.solver.vcycles
    problem.solve()
    again = clock.seconds
    problem.release()
    parameters = {"dim": dim, "squares": n, "contrast": contrast, "solver": solver, "what": what}
    more = {"parameters": parameters, **solved.size}
    case = f"{what}{dim}-D, contrast {contrast:g}, {solved.spaces.unknowns} unknowns, {solver}"
    yield Row("solvers", case, "seconds of another solve", again, **more)
    residual = problem.counts.worst_residual
    held = 1e-8 if contrast <= 1e4 or (dim == 3 and contrast <= 1e6) else None
    yield Row("solvers", case, "true relative residual", residual, 0.0, None, held, **more)
    if solver != "fieldsplit":
        return
    goal = contrast == 1e6
    ratio = its / MOST_ITERATIONS - 1
    yield Row(
        "solvers",
        case,
        "iterations of FGMRES",
        its,
        MOST_ITERATIONS,
        max(0.0, ratio),
        0.0 if goal else None,
        source="goal: at most as many",
        **more,
    )
    yield Row(
        "solvers",
        case,
        "multigrid cycles of the velocity",
        cycles,
        MOST_CYCLES,
        max(0.0, cycles / MOST_CYCLES - 1),
        0.0 if goal else None,
        source="goal: at most as many",
        **more,
    )
    if before:
        growth = its / before
        yield Row(
            "solvers",
            case,
            "growth of the iterations since the mesh before",
            growth,
            GROWTH,
            max(0.0, growth / GROWTH - 1),
            0.0 if goal else None,
            source="goal: at most as much",
            **more,
        )


def run_adaption(quick):
    """Adaption of a mesh: seconds of a new mesh and all on it, over those of a Stokes solve."""
    base = unit_square("P2-P1", 20 if quick else 40)
    finest = 0.05 / (2 if quick else 4) / 4

    def wanted(x):
        distance = np.abs(x[:, 1] - 0.5 - 0.1 * np.cos(6 * x[:, 0]))
        return np.maximum(finest, distance / 2) / np.sqrt(2)

    ratios, unknowns = [], 0
    for _ in range(2 if quick else 5):
        clock = Clock()
        section = adapted_mesh(base, wanted, 3)
        meshed = clock.seconds
        spaces = Spaces(section)
        eta, rho = fem.Function(spaces.D), fem.Function(spaces.D)
        z = section.corners.mean(axis=1)[:, 1]
        eta.x.array[:], rho.x.array[:] = np.where(z > 0.5, 1e3, 1.0), np.where(z > 0.5, 2.0, 1.0)
        problem = StokesProblem(section, spaces, rho, eta, 1.0, free_slip_walls(), 1.0, True, False)
        ready = clock.seconds
        problem.assemble()
        problem.solve()
        first = clock.seconds - ready
        begin = clock.seconds
        problem.assemble()
        problem.solve()
        ratios.append((meshed, ready, first, clock.seconds - begin))
        problem.release()
        unknowns = spaces.unknowns
    meshed, ready, first, again = np.median(ratios, axis=0)
    more = {
        "unknowns": unknowns,
        "cells": section.cell_count,
        "source": "goal: half a Stokes solve",
    }
    for metric, value, bound in (
        ("mesh, over the first solve on it", meshed / first, 0.5),
        ("mesh, spaces and matrix, over the first solve on it", ready / first, 0.5),
        ("mesh, over a solve with known structure", meshed / again, None),
        ("mesh, spaces and matrix, over a solve with known structure", ready / again, None),
    ):
        yield Row(
            "adaption",
            f"{unknowns} unknowns",
            metric,
            value,
            0.0,
            None,
            None if quick else bound,
            **more,
        )
    yield Row("adaption", f"{unknowns} unknowns", "mesh, s", meshed, **more)
    yield Row("adaption", f"{unknowns} unknowns", "first solve, s", first, **more)

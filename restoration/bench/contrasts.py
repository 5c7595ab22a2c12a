"""Viscosity contrasts of 1 to 1e12 and density ratios of 1e-3 to 1e4: errors and residuals.

Where there is no exact solution, the work of gravity is to be the heat of the flow, and the
solution by one solver that by the other.
"""

from functools import partial

import numpy as np
import ufl
from dolfinx import fem

from restoration.bench.boxes import Solved, cell_viscosity, unit_square
from restoration.bench.exact import solcx
from restoration.bench.gravity import block_section, fall
from restoration.bench.reference import sinking_block_velocity
from restoration.bench.rows import Clock, Row, at_least, compared, observed_order
from restoration.bench.scenes import two_rocks, velocity_at
from restoration.bench.solutions import solcx_by_particles, solcx_density
from restoration.bench.solving import sinking_block
from restoration.engine import StokesEngine
from restoration.errors import RestorationError
from restoration.scene import MeshPlan, RefinePlan, SolverPlan, Transfer, Wall

CONTRASTS = (1.0, 1e3, 1e6, 1e9, 1e12)
RATIOS = (1e-3, 0.1, 0.9, 1.1, 10.0, 1e4)
SQUARES = 16
ZERO = (0.0, 0.0)
# What the errors must be below: about twice what 16 squares give.
STEP_ON, STEP_OFF, LAYER, BLOCK, ENERGY, RATIO = 2e-3, 0.15, 1e-8, 2e-2, 1e-3, 1e-8
ITERATED = 1e-4  # what a velocity by the field split may be off
RESIDUAL = 1e-8
BODIES = ("falling block", "random blobs")
# Contrasts of stiff bodies that move, and of weak ones, from which rounding alone makes more.
MOVING_BODY, WEAK_BODY = 1e4, 1e-10


def run_contrasts(quick):
    """Viscosity contrasts in four geometries, and density ratios."""
    n = SQUARES
    for contrast in CONTRASTS[:-1] if quick else CONTRASTS:
        yield from _step(n, contrast)
        yield from _layer(n, contrast)
        yield from _block(n // 2, contrast)
        yield from _blobs(n, contrast)
    yield from _ratios(n // 2)


def attempted(geometry, contrast, how, make, bound, source):
    """Yield the rows of one solve: its error and its residual, or why it was refused.

    Args:
        geometry, how: in words.
        contrast: of the viscosity; below 1 where what is inside is the weak part.
        make: function that returns (`Solved`, error).
        bound: of the error.
        source: of what the error is taken against.
    """
    case = f"{geometry}, contrast {contrast:g}, {how}"
    parameters = {"geometry": geometry, "contrast": contrast, "how": how}
    try:
        solved, error = make()
    except RestorationError as refused:
        yield refusal("contrasts", case, refused, parameters)
        return
    more = {"source": source, "parameters": parameters, **solved.size}
    yield Row("contrasts", case, "error", error, 0.0, None, bound, **more)
    residual = solved.problem.counts.worst_residual
    rounded = geometry in BODIES and not WEAK_BODY < contrast <= MOVING_BODY
    held = None if rounded else RESIDUAL
    yield Row("contrasts", case, "true relative residual", residual, 0.0, None, held, **more)
    solved.problem.release()


def refusal(name, case, refused, parameters):
    """Return the row of what was refused: it is held where there is a reason and its exit code."""
    told = {"refused": " ".join(str(refused).split())}
    good = refused.exit_code in (2, 3, 4) and told["refused"]
    return Row(
        name,
        case,
        "exit code",
        refused.exit_code,
        bound=None if good else 0.0,
        parameters=parameters | told,
    )


def _step(n, contrast):
    """Yield SolCx with its step on a mesh line and inside the cells of an odd mesh."""
    source = "Zhong (1996), exact"
    exact = solcx(contrast)

    def on(element, solver, squares):
        step = cell_viscosity(lambda x: np.where(x[:, 0] < 0.5, 1.0, contrast))
        mesh = unit_square(element, squares)
        solved = Solved(mesh, element, step, solcx_density, solver=SolverPlan(solver))
        return solved, solved.errors(exact)[0]

    def off(transfer):
        solved = solcx_by_particles("P2-P1", n + 1, contrast, transfer)
        return solved, solved.errors(exact)[0]

    for element, solver in (("P2b-P1dg", "direct"), ("P2-P1", "direct"), ("P2-P1", "fieldsplit")):
        rows = [
            row
            for squares in (n // 2, n)
            for row in attempted(
                "step on a mesh line",
                contrast,
                f"{element}, {solver}, {squares} squares",
                partial(on, element, solver, squares),
                STEP_ON * (SQUARES / squares) ** 3,
                source,
            )
        ]
        yield from rows
        errors = [row.value for row in rows if row.metric == "error"]
        # a continuous pressure that jumps spoils the order where neither side stands still
        if len(errors) == 2 and (element == "P2b-P1dg" or contrast != 1e3):
            order = observed_order([2, 1], errors)
            case = f"step on a mesh line, contrast {contrast:g}, {element}, {solver}"
            yield at_least("contrasts", case, "velocity order", order, 3, source=source)
    for kind in ("hat", "linear"):
        yield from attempted(
            "step inside cells",
            contrast,
            f"particles, {kind}",
            partial(off, Transfer("cell", kind, "harmonic")),
            STEP_OFF,
            source,
        )


def channel(n, contrast, row):
    """Return the exact flow of a channel with one layer of another viscosity, a cell thick.

    Unit square, base held, lid moved by 1, and a pressure that falls by 1: u'' = -1 / eta.

    Args:
        n: cells up.
        contrast: of the layer over the rest.
        row: of cells that is the layer, from 0 at the base.

    Returns:
        A function of points (n, 2) giving velocity (n, 2) and pressure (n,).
    """
    levels = np.array([0.0, row / n, (row + 1) / n, 1.0])
    eta = np.array([1.0, contrast, 1.0])
    # shear = s - z; u rises by (s dz - (z2^2 - z1^2) / 2) / eta in a layer
    rise, half = np.diff(levels) / eta, np.diff(levels**2) / (2 * eta)
    s = (1.0 + half.sum()) / rise.sum()
    at = np.concatenate([[0.0], np.cumsum(s * rise - half)])

    def exact(x):
        layer = np.clip(np.searchsorted(levels, x[:, 1], side="right") - 1, 0, 2)
        low = levels[layer]
        u = at[layer] + (s * (x[:, 1] - low) - (x[:, 1] ** 2 - low**2) / 2) / eta[layer]
        return np.column_stack([u, np.zeros(len(x))]), 1.0 - x[:, 0]

    return exact


def _layer(n, contrast):
    """Yield a layer one cell thick in a channel, weak and stiff; the elements hold its flow."""
    for value in sorted({contrast, 1 / contrast}):
        exact = channel(n, value, n // 3)

        def make(value, exact, solver):
            inside = (n // 3 / n, (n // 3 + 1) / n)
            viscosity = cell_viscosity(
                lambda x: (
                    np.where((x[:, 1] > inside[0]) & (x[:, 1] < inside[1]), value, 1.0)
                    / min(1.0, value)
                )
            )
            along = (lambda x: exact(x)[0][:, 0], 0.0)
            walls = {name: Wall("velocity", along, ZERO) for name in ("left", "right")}
            walls |= {name: Wall("velocity", along, ZERO) for name in ("base", "surface")}
            solved = Solved(
                unit_square("P2-P1", n),
                "P2-P1",
                viscosity,
                lambda spaces: fem.Constant(spaces.section.mesh, 0.0),
                walls,
                SolverPlan(solver),
                min(1.0, value),
            )
            return solved, solved.errors(exact)[0]

        for solver in ("direct", "fieldsplit"):
            yield from attempted(
                "layer one cell thick",
                value,
                f"P2-P1, {solver}",
                partial(make, value, exact, solver),
                LAYER if solver == "direct" else ITERATED,
                "channel flow, exact and in the space of the elements",
            )


def _block(squares, contrast):
    """Yield the falling block, stiff and weak, with mesh lines around it."""
    section, block = block_section(squares)
    for value in sorted({contrast, 1 / contrast}):

        def make(value, element):
            solved, found = fall(section, block, -np.log10(value), element)
            return solved, abs(found / float(sinking_block_velocity(-np.log10(value))) - 1)

        for element in ("P2b-P1dg", "P2-P1"):
            yield from attempted(
                "falling block",
                value,
                f"{element}, direct",
                partial(make, value, element),
                BLOCK if element == "P2b-P1dg" else 5 * BLOCK,
                "converged solution computed for these pages, good to 1e-4",
            )


def power(solved):
    """Return the work of the weight and the heat of the flow, both per time.

    Args:
        solved: `Solved`, without moving walls.
    """
    spaces, problem = solved.spaces, solved.problem
    u = fem.Function(spaces.V)
    u.x.array[:] = solved.flow.u.ravel()
    strain = ufl.sym(ufl.grad(u))
    heat = 2 * solved.eta * solved.problem.eta0 * ufl.inner(strain, strain) * spaces.dx
    work = -solved.rho * u[1] * spaces.dx
    total = problem.section.mesh.comm.allreduce
    return tuple(total(fem.assemble_scalar(fem.form(form))) for form in (work, heat))


def _blobs(n, contrast):
    """Yield many overlapping discs, stiff and weak: energy, and the field split beside the rest."""
    for value in sorted({contrast, 1 / contrast}):
        found = {}

        def direct(value, found):
            solved = sinking_block(2, n, value, "direct", rough=True)
            work, heat = power(solved)
            found["u"] = solved.flow.u
            return solved, abs(heat / work - 1)

        def iterated(value, found, solver):
            solved = sinking_block(2, n, value, solver, rough=True)
            off = np.linalg.norm(solved.flow.u - found["u"]) / np.linalg.norm(found["u"])
            return solved, float(off)

        yield from attempted(
            "random blobs",
            value,
            "P2-P1, direct",
            partial(direct, value, found),
            ENERGY,
            "work of the weight against heat of the flow",
        )
        if "u" in found:
            yield from attempted(
                "random blobs",
                value,
                "P2-P1, fieldsplit",
                partial(iterated, value, found, "fieldsplit"),
                ITERATED,
                "velocity against that of the direct solver",
            )


def _ratios(squares):
    """Yield the fall or rise of a block by its density ratio: the buoyancy alone must count."""
    clock = Clock()
    side, medium, eta = 1e4, 2500.0, 1e19
    block = np.array([[0.4, 0.7], [0.6, 0.7], [0.6, 0.9], [0.4, 0.9], [0.4, 0.7]]) * side

    def unit_at(points):
        return (np.abs(points / side - [0.5, 0.8]) < 0.1).all(axis=1).astype(np.int16)

    fitted = MeshPlan("P2b-P1dg", "fitted", RefinePlan(2, ("interfaces",), 1))
    for how, mesh in (("fitted", fitted), ("particles", MeshPlan())):
        first = None
        for ratio in RATIOS:
            rho = medium * ratio
            case = f"density ratio {ratio:g}, {how}"
            parameters = {"geometry": "density ratio", "contrast": ratio, "how": how}
            scene = two_rocks(
                side,
                side,
                unit_at,
                block,
                (medium, rho),
                (eta, 10 * eta),
                (squares, squares),
                dict.fromkeys(("left", "right", "base", "surface"), "free-slip"),
                mesh=mesh,
                transfer=Transfer("projection", "hat", "harmonic"),
            )
            try:
                engine = StokesEngine(scene)
                state = engine.with_flow(engine.start())
                fallen = -velocity_at(state, np.array([[0.5, 0.8]]) * side)[0, 1]
                state.grid.stokes.release()
            except RestorationError as refused:
                yield refusal("contrasts", case, refused, parameters)
                continue
            found = fallen * eta / ((rho - medium) * 9.81 * side**2)
            first = first or found
            yield compared(
                "contrasts",
                case,
                "v eta / (drho g L^2)",
                found,
                first,
                bound=RATIO,
                source="the same with the first ratio",
                parameters=parameters,
                unknowns=state.grid.spaces.unknowns,
                wall_s=clock.seconds,
            )


def panels(rows):
    """Return the panels of the figure, see `pictures.draw`: errors and residuals by contrast."""
    found = []
    for metric, label in (("error", "error"), ("true relative residual", "true relative residual")):
        series = {}
        for row in rows:
            p = row.parameters
            if row.metric == metric and p.get("geometry") != "density ratio":
                name = f"{p['geometry']}, {p['how']}"
                x, y, _ = series.setdefault(name, ([], [], "-"))
                x.append(p["contrast"])
                y.append(max(row.value, 1e-17))
        order = {name: np.argsort(x) for name, (x, _, _) in series.items()}
        series = {
            name: (np.array(x)[order[name]], np.array(y)[order[name]], how)
            for name, (x, y, how) in series.items()
        }
        scales = ("log", "log")
        found.append(
            (f"{label} by contrast", "viscosity inside over outside", label, scales, series)
        )
    return found

"""SolCx, SolKz and SolVi: orders of all elements, and the price of a jump inside cells."""

from itertools import product

import numpy as np
import ufl
from dolfinx import fem

from forms.elements import ELEMENTS
from meshes.section import fitted_mesh
from meshes.split import barycentric_mesh
from restoration.bench.boxes import (
    Solved,
    cell_viscosity,
    prescribed_walls,
    unit_square,
)
from restoration.bench.exact import solcx, solkz, solvi
from restoration.bench.rows import Row, observed_order
from restoration.particles import OUTSIDE, CellIndex
from restoration.scene import Transfer
from restoration.transfer import RockFields

PLANE = [name for name, pair in ELEMENTS.items() if {"triangle", "quadrilateral"} & {*pair.cells}]
TRANSFERS = ("cell", "hat", "linear", "quadrature")
MEANS = ("harmonic", "geometric", "arithmetic")
PER_SQUARE = 8  # particles along the side of a square, in the averages
HALF_OF_FACTS = 6e-3  # half the error of harmonic cell means with the jump inside cells, 65 squares
ORDER = {"MINI": 2}  # of the velocity; 3 otherwise
CONTRASTS = (1.0, 1e3, 1e6)
SPARED = (None, 1.0, 1e6)  # jumps at which a continuous pressure leaves the velocity its order


def solcx_density(spaces):
    """Return the density of SolCx under a gravity of one."""
    x, z = ufl.SpatialCoordinate(spaces.section.mesh)
    return -ufl.sin(ufl.pi * z) * ufl.cos(ufl.pi * x)


def run_solcx(quick):
    """SolCx: a viscosity step on and off a mesh line."""
    source = "Zhong (1996); exact solution, derived anew"
    squares = (16, 32) if quick else (16, 32, 64)
    for name, contrast in product(PLANE, (1e6,) if quick else CONTRASTS):
        step = cell_viscosity(lambda x, c=contrast: np.where(x[:, 0] < 0.5, 1.0, c))
        yield from _orders(
            "solcx",
            f"step {contrast:g} on a mesh line, {name}",
            [(n, Solved(unit_square(name, n), name, step, solcx_density)) for n in squares],
            solcx(contrast),
            ELEMENTS[name],
            source,
            {"place": "on", "element": name, "contrast": contrast},
            smooth=contrast == 1,
            jump=contrast,
        )
    chosen = [("P2-P1", "cell"), ("P2-P1", "linear"), ("P2-P1", "hat"), ("Q2-Q1", "linear")]
    pairs = chosen if quick else list(product(PLANE, TRANSFERS))
    for (name, kind), mean in product(pairs, ("harmonic",) if quick else MEANS):
        for contrast in (1e6,) if quick or name not in ("P2-P1", "Q2-Q1") else (1e3, 1e6):
            solved = [
                (n, solcx_by_particles(name, n, contrast, Transfer("cell", kind, mean)))
                for n in (33, 65)
            ]
            best = (name, kind, mean, contrast) == ("Q2-Q1", "linear", "harmonic", 1e6)
            yield from _orders(
                "solcx",
                f"step {contrast:g} inside squares, {name}, {kind} {mean}",
                solved,
                solcx(contrast),
                None,
                source,
                {"place": "off", "element": name, "contrast": contrast, "transfer": kind}
                | {"mean": mean},
                bound=HALF_OF_FACTS if best else None,
            )


def solcx_by_particles(name, n, contrast, transfer):
    """Return SolCx `Solved` with its step as particles carry it.

    Args:
        name: of the pair of elements.
        n: squares along a side; an odd number has the step in the middle of squares.
        contrast: of the step.
        transfer: `scene.Transfer`.
    """

    def unit(x):
        return (x[:, 0] > 0.5).astype(np.int64)

    viscosity = _averaged(transfer, [1.0, contrast], unit, n)
    return Solved(unit_square(name, n), name, viscosity, solcx_density)


def _averaged(transfer, table, unit, n):
    """Return what gives `Solved` the viscosity that particles carry, averaged by a transfer."""

    def viscosity(spaces):
        index = CellIndex(spaces.section)
        side = n * PER_SQUARE
        at = (np.arange(side) + 0.5) / side
        x = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
        x += (np.random.default_rng(1).random(x.shape) - 0.5) / (2 * side)
        fields = RockFields(spaces, index, np.ones(len(table)), table, transfer)
        cell, hats = index.locate(x, np.full(len(x), OUTSIDE, np.int32))
        fields.fill(x, cell, hats, unit(x), np.full(len(x), 1 / len(x)))
        return fields.eta

    return viscosity


def run_solkz(quick):
    """SolKz: a viscosity that grows exponentially upwards, given and carried by particles."""
    source = "Revenaugh & Parsons (1987); exact solution, derived anew"

    def density(spaces):
        x, z = ufl.SpatialCoordinate(spaces.section.mesh)
        return -ufl.sin(2 * z) * ufl.cos(3 * ufl.pi * x)

    squares = (16, 32) if quick else (16, 32, 64)
    # at 1e6 thirty-two squares are not yet fine enough to show the orders
    for name, contrast in product(PLANE, (1e3,) if quick else CONTRASTS):

        def viscosity(spaces, contrast=contrast):
            return contrast ** ufl.SpatialCoordinate(spaces.section.mesh)[1]

        yield from _orders(
            "solkz",
            f"contrast {contrast:g}, {name}",
            [(n, Solved(unit_square(name, n), name, viscosity, density)) for n in squares],
            solkz(contrast),
            ELEMENTS[name],
            source,
            {"place": "given", "element": name, "contrast": contrast},
            smooth=True,
        )
    layers = 2000  # of the table: far finer than a particle's distance to the next
    table = 1e6 ** ((np.arange(layers) + 0.5) / layers)
    for kind, mean in [("hat", "geometric")] if quick else product(TRANSFERS, MEANS):
        transfer = Transfer("cell", kind, mean)

        def unit(x):
            return np.clip((x[:, 1] * layers).astype(int), 0, layers - 1)

        solved = [
            (
                n,
                Solved(
                    unit_square("P2-P1", n), "P2-P1", _averaged(transfer, table, unit, n), density
                ),
            )
            for n in (32, 64)
        ]
        yield from _orders(
            "solkz",
            f"contrast 1e6 by particles, P2-P1, {kind} {mean}",
            solved,
            solkz(1e6),
            None,
            source,
            {"place": "particles", "element": "P2-P1", "contrast": 1e6, "transfer": kind}
            | {"mean": mean},
        )


def run_solvi(quick):
    """SolVi: a round inclusion in pure shear, on and off mesh lines."""
    source = "Schmid & Podladchikov (2003), Geophys. J. Int. 155, 269-288"
    triangles = [name for name in PLANE if "triangle" in ELEMENTS[name].cells]
    squares = (16, 32) if quick else (16, 32, 64)
    for name, contrast in product(triangles, (1e3,) if quick else (1.0, 1e3, 1e6)):
        solved = [(n, _solvi(name, n, contrast, fitted=True)) for n in squares]
        yield from _orders(
            "solvi",
            f"contrast {contrast:g}, fitted, {name}",
            solved,
            solvi(contrast),
            None,
            source,
            {"place": "fitted", "element": name, "contrast": contrast},
            least_order=None if contrast == 1 else 1.9,
        )
    choices = [("cell", "harmonic")] if quick else list(product(TRANSFERS, MEANS))
    for (kind, mean), contrast in product(choices, (1e3,) if quick else (1e3, 1e6)):
        for name in ("P2-P1",) if quick else ("P2-P1", "Q2-P1dg"):
            transfer = Transfer("cell", kind, mean)
            solved = [(n, _solvi(name, n, contrast, transfer=transfer)) for n in squares[-2:]]
            yield from _orders(
                "solvi",
                f"contrast {contrast:g}, through squares, {name}, {kind} {mean}",
                solved,
                solvi(contrast),
                None,
                source,
                {"place": "off", "element": name, "contrast": contrast, "transfer": kind}
                | {"mean": mean},
            )


def _solvi(name, n, contrast, fitted=False, transfer=None):
    exact, radius = solvi(contrast), 0.2

    def inside(x):
        return (np.hypot(*x.T) < radius).astype(np.int64)

    if fitted:
        angle = np.linspace(0, np.pi / 2, 2001)
        arc = radius * np.column_stack([np.cos(angle), np.sin(angle)])
        arc[0], arc[-1] = (radius, 0.0), (0.0, radius)
        flat = [np.array([[0.0, z], [1.0, z]]) for z in (1.0, 0.0)]
        section, points = fitted_mesh(*flat, [arc], 0.85 / n)
        rock = inside(points)[section.regions]
        if ELEMENTS[name].split:
            section = barycentric_mesh(section)
            rock = inside(points)[section.regions]

        def viscosity(spaces):
            eta = fem.Function(spaces.D)
            eta.x.array[:] = np.array([1.0, contrast])[rock]
            return eta

    else:
        section, viscosity = unit_square(name, n), _averaged(transfer, [1.0, contrast], inside, n)

    def weightless(spaces):
        return fem.Constant(spaces.section.mesh, 0.0)

    walls = prescribed_walls(lambda x: exact(x)[0])
    return Solved(section, name, viscosity, weightless, walls)


def _orders(
    name,
    case,
    solved,
    exact,
    pair,
    source,
    parameters,
    smooth=False,
    bound=None,
    least_order=None,
    jump=None,
):
    """Yield the errors on every mesh, and the observed orders.

    Orders are held where theory gives them: in velocity and pressure for a discontinuous pressure,
    and for a continuous one where the true one is continuous. Where it jumps by a ``jump`` that is
    not so high that the stiff side stands still, a continuous one spoils the velocity too.
    """
    sizes = [1 / n for n, _ in solved]
    errors = np.array([solution.errors(exact) for _, solution in solved])
    for _, solution in solved:
        solution.problem.release()
    for (n, solution), (u, p) in zip(solved, errors, strict=True):
        last = n == solved[-1][0]
        more = {"source": source, "parameters": parameters | {"squares": n}, **solution.size}
        held = bound if last else None
        yield Row(name, case, f"velocity error, {n} squares", u, 0.0, None, held, **more)
        yield Row(name, case, f"pressure error, {n} squares", p, 0.0, **more)
    for column, metric in enumerate(("velocity order", "pressure order")):
        order = observed_order(sizes, errors[:, column])
        expected = None
        if pair is not None and column == 0 and (not pair.continuous or jump in SPARED):
            expected = ORDER.get(pair.name, 3)
        elif pair is not None and (smooth or not pair.continuous):
            expected = 1.5 if pair.name == "MINI" else 2
        if column == 0 and least_order:
            expected = least_order
        if expected is None:
            yield Row(name, case, metric, order, source=source, parameters=parameters)
        else:  # an order above what theory promises is no fault
            short = min(0.0, order / expected - 1)
            yield Row(
                name,
                case,
                metric,
                order,
                expected,
                short,
                0.1,
                source=source,
                parameters=parameters,
            )

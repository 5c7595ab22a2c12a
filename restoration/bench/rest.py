"""Rest: what lies in layers under its own weight must not move.

The weight of a density that varies with depth alone is the gradient of a pressure. A pair of
elements moves nothing there if its velocities are divergence-free, whatever its pressures can hold;
other pairs turn the part of the weight that their pressure misses into flow (John et al. 2017,
SIAM Review 59, 492-544). The spurious speed is told over ``rho g L^2 / eta``, the speed at which
such a weight would fall.
"""

import numpy as np
import ufl
from dolfinx import fem

from forms.elements import ELEMENTS
from meshes.box import section_mesh
from meshes.split import barycentric_mesh
from restoration.bench.boxes import Solved, free_slip_walls, quadrature_points
from restoration.bench.rows import Row
from restoration.bench.solutions import PLANE
from restoration.scene import Wall

SOURCE = "at rest, exactly"
ROBUST = ("P2-P1dg",)  # divergence-free: held to rounding
ROUNDING = 1e-10


def _smooth(z):
    return 1 + np.exp(2 * z)


def _smooth_pressure(z, top):
    """Weight above z, up to the height ``top``, of `_smooth`."""
    return (top - z) + (np.exp(2 * top) - np.exp(2 * z)) / 2


def run_hydrostatic(quick):
    """Stratified rest: spurious flow in a box and under an inclined top that is free to move."""
    squares = (8, 16) if quick else (8, 16, 32)
    for name in PLANE:
        for case, make in SCENES.items():
            for n in squares:
                solved = make(name, n)
                spurious = float(np.abs(solved.flow.u).max())
                solved.problem.release()
                held = ROUNDING if name in ROBUST and case != "layers inside squares" else None
                if case == "layers on a mesh line":
                    held = ROUNDING  # every pressure holds it
                yield Row(
                    "hydrostatic",
                    f"{case}, {name}",
                    f"spurious speed, {n} squares",
                    spurious,
                    0.0,
                    None,
                    held,
                    source=SOURCE,
                    parameters={"element": name, "squares": n, "case": case},
                    **solved.size,
                )


def _square(name, n, top=None):
    top = np.array([[0.0, 1.0], [1.0, 1.0]]) if top is None else top
    cell = ELEMENTS[name].cells[0]
    section = section_mesh(top, np.array([[0.0, 0.0], [1.0, 0.0]]), (n, n), cell)
    return barycentric_mesh(section) if ELEMENTS[name].split else section


def _one(spaces):
    return fem.Constant(spaces.section.mesh, 1.0)


def _smooth_density(spaces):
    """Values at points, of a degree of quadrature at which its integrals are exact to rounding."""
    z = ufl.SpatialCoordinate(spaces.section.mesh)[1]
    return 1 + ufl.exp(2 * z)


def _layers(height):
    """Return a density that halves above a height, by the means of the quadrature points."""

    def density(spaces):
        rho = fem.Function(spaces.P)
        z = quadrature_points(spaces.section, spaces.degree)[:, 1]
        rho.x.array[:] = np.where(z > height, 0.5, 1.0)
        return rho

    return density


INCLINED = np.array([[0.0, 1.0], [1.0, 1.25]])


def _free_top(name, n):
    """A smooth density under an inclined top that only the weight of what lies above it loads."""
    run, rise = INCLINED[1] - INCLINED[0]
    normal = np.array([-rise, run]) / np.hypot(run, rise)
    load = tuple(
        lambda x, axis=axis: -_smooth_pressure(x[:, 1], 1.5) * normal[axis] for axis in range(2)
    )
    walls = free_slip_walls() | {"surface": Wall("traction", (None, None), load)}
    section = _square(name, n, INCLINED)
    return Solved(section, name, _one, _smooth_density, walls, degree=10)


SCENES = {
    "smooth density in a box": lambda name, n: Solved(
        _square(name, n), name, _one, _smooth_density, degree=10
    ),
    "smooth density under a free inclined top": _free_top,
    "layers on a mesh line": lambda name, n: Solved(_square(name, n), name, _one, _layers(0.5)),
    "layers inside squares": lambda name, n: Solved(
        _square(name, n), name, _one, _layers(0.5 + 0.3 / n)
    ),
}

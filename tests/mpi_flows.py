"""Solves Stokes problems on however many ranks there are, and prints what must not depend on them.

Run by `tests/test_mpi.py` on one, two and three ranks.
"""

import json
import sys

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from forms.elements import ELEMENTS
from restoration.bench.boxes import Solved, cell_viscosity, unit_cube, unit_square
from restoration.bench.exact import solcx
from restoration.bench.gravity import block_section
from restoration.bench.solutions import solcx_density
from restoration.environment import use_jit_cache
from restoration.scene import SolverPlan


def norms(solved):
    """Return numbers of a flow that are sums over the whole section."""
    spaces, comm = solved.spaces, solved.spaces.section.mesh.comm
    u, p = fem.Function(spaces.V), fem.Function(spaces.Q)
    u.x.array[:], p.x.array[:] = solved.flow.u.ravel(), solved.flow.p
    x = ufl.SpatialCoordinate(spaces.section.mesh)
    up = u[spaces.section.dim - 1]
    integrands = (
        ufl.inner(u, u),
        ufl.inner(ufl.grad(u), ufl.grad(u)),
        p**2,
        up * x[0] ** 2,
        p * x[0] ** 2,
    )
    totals = [
        comm.allreduce(fem.assemble_scalar(fem.form(f * spaces.dx)), op=MPI.SUM) for f in integrands
    ]
    largest = comm.allreduce(float(np.abs(solved.flow.u).max()), op=MPI.MAX)
    return [*totals, largest]


def stepped(element, solver, dim=2):
    """SolCx and its like in a cube: a step of 1e3 on a mesh line, and a weight that varies."""
    if dim == 2:
        section = unit_square(element, 12)
        density = solcx_density
    else:
        cell = "hexahedron" if element.startswith("Q") else "tetrahedron"
        section = unit_cube(4, cell)

        def density(spaces):
            x = ufl.SpatialCoordinate(spaces.section.mesh)
            return -ufl.sin(ufl.pi * x[2]) * ufl.cos(ufl.pi * x[0])

    step = cell_viscosity(lambda x: np.where(x[:, 0] < 0.5, 1.0, 1e3))
    return Solved(section, element, step, density, solver=SolverPlan(*solver))


def block(solver):
    """A falling block on a fitted mesh."""
    section, inside = block_section(8)

    def viscosity(spaces):
        eta = fem.Function(spaces.D)
        eta.x.array[:] = np.where(inside, 1e4, 1.0)
        return eta

    def density(spaces):
        rho = fem.Function(spaces.D)
        rho.x.array[:] = 30.0 + inside
        return rho

    return Solved(section, "P2-P1", viscosity, density, solver=SolverPlan(*solver))


TIGHT = ("fieldsplit", (("ksp_rtol", "1e-12"),))


def main():
    """Print the numbers of every problem by name, as JSON, on the first rank."""
    use_jit_cache()
    found = {}
    for element in ELEMENTS:
        if {"triangle", "quadrilateral"} & {*ELEMENTS[element].cells}:
            solved = stepped(element, ("direct",))
            found[f"{element}, direct"] = norms(solved)
            if element == "P2-P1":
                found["errors against SolCx"] = list(solved.errors(solcx(1e3)))
    for element in ("P2-P1", "P2b-P1dg", "Q2-P1dg"):
        found[f"{element}, fieldsplit"] = norms(stepped(element, TIGHT))
    for element in ("P2-P1", "P2b-P1dg", "MINI", "Q2-P1dg"):
        found[f"{element}, 3-D"] = norms(stepped(element, ("direct",), 3))
    found["P2-P1, 3-D, fieldsplit"] = norms(stepped("P2-P1", TIGHT, 3))
    found["block, fitted, direct"] = norms(block(("direct",)))
    found["block, fitted, fieldsplit"] = norms(block(TIGHT))
    if MPI.COMM_WORLD.rank == 0:
        json.dump(found, sys.stdout)


if __name__ == "__main__":
    main()

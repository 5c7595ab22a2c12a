"""Stokes problems in boxes whose answer is known, and how far a flow is from it."""

import basix
import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI

from forms.elements import ELEMENTS
from meshes.box import box_mesh, section_mesh
from meshes.split import barycentric_mesh
from restoration.bench.rows import Clock
from restoration.scene import Wall
from restoration.spaces import Spaces
from restoration.stokes import StokesProblem

ZERO = (0.0, 0.0)


def free_slip_walls(dim=2):
    """Return free-slip walls all around a box, by name."""
    axes = {"left": 0, "right": 0, "base": dim - 1, "surface": dim - 1}
    if dim == 3:
        axes |= {"front": 1, "back": 1}
    return {
        name: Wall("free-slip", tuple(0.0 if i == axis else None for i in range(dim)), ZERO)
        for name, axis in axes.items()
    }


def prescribed_walls(u, names=("left", "right", "base", "surface")):
    """Return walls with the velocity of a function of points (n, 2) that gives (n, 2)."""
    values = tuple(lambda x, axis=axis: u(x)[:, axis] for axis in range(2))
    return {name: Wall("velocity", values, ZERO) for name in names}


def unit_square(element, n):
    """Return the mesh of a unit square with ``n`` squares along a side, split if need be."""
    pair = ELEMENTS[element]
    flat = [np.array([[0.0, z], [1.0, z]]) for z in (1.0, 0.0)]
    section = section_mesh(*flat, (n, n), pair.cells[0])
    return barycentric_mesh(section) if pair.split else section


def unit_cube(n, cell="tetrahedron"):
    """Return the mesh of a unit cube with ``n`` cubes along an edge."""
    return box_mesh((0, 0, 0), (1, 1, 1), (n, n, n), cell)


class Solved:
    """A Stokes problem of a box, solved; closed unless a wall bears a traction.

    Args:
        section: `meshes.data.SectionMesh`.
        element: name of the pair of elements.
        viscosity: a function of `Spaces` that gives a UFL expression, over ``eta0``.
        density: a function of `Spaces` that gives a UFL expression; gravity is 1 downwards.
        walls: by name; None for free slip.
        solver: `scene.SolverPlan`, or None.
        eta0: least viscosity.
        degree: of the quadrature; None for that of the elements.

    Attributes:
        spaces, rho, eta, problem, flow, seconds: what was made, and the wall seconds of all of it.
    """

    def __init__(
        self,
        section,
        element,
        viscosity,
        density,
        walls=None,
        solver=None,
        eta0=1.0,
        degree=None,
    ):
        clock = Clock()
        self.spaces = Spaces(section, element, degree)
        self.rho, self.eta = density(self.spaces), viscosity(self.spaces)
        walls = walls or free_slip_walls(section.dim)
        self.problem = StokesProblem(
            section,
            self.spaces,
            self.rho,
            self.eta,
            eta0,
            walls,
            1.0,
            all(wall.kind != "traction" for wall in walls.values()),
            False,
            solver,
        )
        self.problem.assemble()
        self.flow = self.problem.solve()
        self.seconds = clock.seconds

    @property
    def size(self):
        """Unknowns, cells, solves and seconds, as entries of a `rows.Row`."""
        return {
            "unknowns": self.spaces.unknowns,
            "cells": self.spaces.section.cell_count,
            "stokes_solves": 1,
            "wall_s": self.seconds,
        }

    def errors(self, exact, degree=6):
        """Return relative L2 errors of velocity and pressure; pressures count without their mean.

        Args:
            exact: function of points (n, 2) that gives velocity (n, 2) and pressure (n,).
            degree: of the quadrature.
        """
        spaces, flow = self.spaces, self.flow
        mesh, cell = spaces.section.mesh, spaces.section.cell
        dx = ufl.Measure("dx", mesh, metadata={"quadrature_degree": degree})
        element = ufl.VectorElement("Quadrature", cell, degree, 3, quad_scheme="default")
        reference = fem.Function(fem.FunctionSpace(mesh, element))
        u, p = exact(quadrature_points(spaces.section, degree))
        reference.x.array[:] = np.column_stack([u, p]).ravel()
        uh, ph = fem.Function(spaces.V), fem.Function(spaces.Q)
        uh.x.array[:], ph.x.array[:] = flow.u.ravel(), flow.p
        one = fem.Constant(mesh, 1.0)

        def total(integrand):
            return mesh.comm.allreduce(fem.assemble_scalar(fem.form(integrand * dx)), op=MPI.SUM)

        area = total(one)
        shift, level = total(ph - reference[2]) / area, total(reference[2] * one) / area
        u_exact = ufl.as_vector([reference[0], reference[1]])
        off, error = uh - u_exact, ph - reference[2] - shift
        size = total((reference[2] - level) ** 2)
        return (
            np.sqrt(total(ufl.inner(off, off)) / total(ufl.inner(u_exact, u_exact))),
            np.sqrt(total(error**2) / (size or area)),  # absolute where there is no pressure
        )

    def divergence(self):
        """Return the L2 norm of div(u) over that of the velocity gradient."""
        u = fem.Function(self.spaces.V)
        u.x.array[:] = self.flow.u.ravel()
        dx, comm = self.spaces.dx, self.spaces.section.mesh.comm
        squares = [
            comm.allreduce(fem.assemble_scalar(fem.form(ufl.inner(v, v) * dx)), op=MPI.SUM)
            for v in (ufl.div(u), ufl.grad(u))
        ]
        return float(np.sqrt(squares[0] / squares[1]))


def quadrature_points(section, degree):
    """Return the quadrature points of all cells of a rank, shape (cells * points, dim), m."""
    cell = getattr(basix.CellType, section.cell)
    rule, _ = basix.make_quadrature(cell, degree)
    hats = basix.create_element(basix.ElementFamily.P, cell, 1).tabulate(0, rule)[0, :, :, 0]
    return np.einsum("qk,ckd->cqd", hats, section.corners).reshape(-1, section.dim)


def cell_viscosity(of_points):
    """Return what gives `Solved` one viscosity for every cell, by a function of its centre."""

    def viscosity(spaces):
        eta = fem.Function(spaces.D)
        eta.x.array[:] = of_points(spaces.section.corners.mean(axis=1))
        return eta

    return viscosity

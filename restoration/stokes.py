"""The Stokes problem of a section: assembly, and a solve that is checked."""

from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from forms.stokes import gravity_load, source_load, stokes_form
from restoration.boundary import (
    outflow,
    pressure_pin,
    velocity_conditions,
    wall_form,
    wall_load,
)
from restoration.errors import SolveError
from restoration.solvers import make_solver

RESIDUAL = 1e-8


@dataclass
class Counts:
    """What the solver has done so far."""

    solves: int = 0
    factorisations: int = 0
    krylov_iterations: int = 0
    refinements: int = 0
    worst_residual: float = 0.0


@dataclass(frozen=True, eq=False)
class Flow:
    """Velocity and pressure of one instant.

    Attributes:
        u: velocity at the nodes of `Spaces.V`, shape (nodes, dim), m/s.
        p: pressure at the dofs of `Spaces.Q`, Pa; in a closed section zero on average along the
            surface.
        residual: true relative residual of the solve.
    """

    u: np.ndarray
    p: np.ndarray
    residual: float


class StokesProblem:
    """Stokes flow of one mesh, solved for one density and viscosity after another.

    The forms are divided by the smallest viscosity, which keeps the residual at rounding up to a
    contrast of 1e12; divided by the largest, 1e9 would fail.

    Args:
        section: `meshes.data.SectionMesh`.
        spaces: `Spaces` of it.
        rho: density as a UFL expression, kg/m^3.
        eta: viscosity over ``eta0`` as a UFL expression.
        eta0: smallest viscosity of the section, Pa s.
        walls: `scene.Wall` by name.
        gravity: downwards, m/s^2.
        closed: whether the normal velocity is held on every wall.
        steady: whether the viscosity never changes, so that one factorisation serves.
        solver: `solvers.SolverPlan`; None for the default.
        counts: `Counts` to go on with; None begins anew.

    Attributes:
        counts: what was done so far.
        leak: flux out of the walls that the section makes up for by swelling, m^dim/s.
    """

    def __init__(
        self,
        section,
        spaces,
        rho,
        eta,
        eta0,
        walls,
        gravity,
        closed,
        steady,
        solver=None,
        counts=None,
    ):
        self.spaces, self.section, self.eta0, self.steady = spaces, section, eta0, steady
        self.closed = closed
        self.counts = counts or Counts()
        self._comm = section.mesh.comm
        area = section.area
        # One cell size: then pressure and velocity columns are of one size where eta = eta0.
        self.length = float((area / section.cell_count) ** (1 / section.dim))
        self.bcs = velocity_conditions(walls, section, spaces)
        leak = fem.Constant(section.mesh, PETSc.ScalarType(0))
        self.leak = 0.0
        if closed:
            # The walls as the mesh interpolates them may let a little more in than out, which no
            # divergence-free flow can meet: spread over the section it does not spoil the pin.
            self.leak = self._prescribed_outflow(walls)
            leak.value = self.leak / area
            self.bcs = [*self.bcs, pressure_pin(spaces)]
        self._make_forms(rho, eta, walls, gravity, leak)
        self.A = fem.petsc.create_matrix(self.a)
        self.b = fem.petsc.create_vector(self.load)
        self.x, self.r = self.b.duplicate(), self.b.duplicate()
        self.solver = make_solver(solver, self.A, spaces, eta, self.length)
        self._assembled = False
        top = spaces.ds(section.wall_tags["surface"])
        self._p = fem.Function(spaces.Q)
        self._surface_pressure = fem.form(self._p * top)
        one = fem.Constant(section.mesh, PETSc.ScalarType(1))
        self._surface_length = self._total(fem.form(one * top))

    def _total(self, form):
        """Return the value of a form on all ranks."""
        return self._comm.allreduce(fem.assemble_scalar(form), op=MPI.SUM)

    def _make_forms(self, rho, eta, walls, gravity, leak):
        spaces, section = self.spaces, self.section
        trial, test = ufl.TrialFunctions(spaces.W), ufl.TestFunctions(spaces.W)
        a = stokes_form(*trial, *test, eta, self.length, spaces.dx)
        slip = wall_form(trial, test, eta, self.length, walls, section, spaces)
        self.a = fem.form(a if slip is None else a + slip)
        down = np.zeros(section.dim)
        down[-1] = -gravity / self.eta0
        load = gravity_load(test[0], rho, fem.Constant(section.mesh, down), spaces.dx)
        load += source_load(test[1], leak, self.length, spaces.dx)
        push = wall_load(test[0], self.eta0, walls, section, spaces)
        self.load = fem.form(load if push is None else load + push)

    def assemble(self):
        """Assemble the load and, unless it never changes, the matrix."""
        if not self._assembled or not self.steady:
            self._assemble_matrix()
        with self.b.localForm() as local:
            local.set(0)
        fem.petsc.assemble_vector(self.b, self.load)
        fem.petsc.apply_lifting(self.b, [self.a], [self.bcs])
        self.b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        fem.petsc.set_bc(self.b, self.bcs)

    def solve(self):
        """Return the `Flow` of what was assembled last.

        Raises:
            SolveError: the solver failed or the true relative residual stayed above `RESIDUAL`.
        """
        residual = self._checked_solve()
        self.counts.solves += 1
        self.counts.worst_residual = max(self.counts.worst_residual, residual)
        self.x.ghostUpdate(addv=PETSc.InsertMode.INSERT, mode=PETSc.ScatterMode.FORWARD)
        with self.x.localForm() as local:
            x = local.array_r
            u = x[self.spaces.v_in_w].reshape(-1, self.section.dim).copy()
            self._p.x.array[:] = x[self.spaces.q_in_w] * (self.eta0 / self.length)
        if self.closed:
            self._p.x.array[:] -= self._total(self._surface_pressure) / self._surface_length
        return Flow(u, self._p.x.array.copy(), residual)

    def _prescribed_outflow(self, walls):
        """Return the net flux through the walls as the mesh represents it, m^dim/s."""
        w = fem.Function(self.spaces.W)
        fem.petsc.set_bc(w.vector, self.bcs)
        w.x.scatter_forward()
        u, _ = ufl.split(w)
        return self._total(fem.form(outflow(u, walls, self.section, self.spaces)))

    def _assemble_matrix(self):
        self.A.zeroEntries()
        fem.petsc.assemble_matrix(self.A, self.a, self.bcs)
        self.A.assemble()
        self.solver.update()
        self._assembled = True

    def _checked_solve(self):
        """Solve in place and return the true relative residual; raise unless it is small."""
        before = self.solver.factorisations, self.solver.iterations
        self.solver.solve(self.b, self.x)
        scale = self.b.norm() or 1.0
        residual = self._residual() / scale
        for _ in range(3):
            if residual <= RESIDUAL or not np.isfinite(residual):
                break
            self._refine()
            residual = self._residual() / scale
        self.counts.factorisations += self.solver.factorisations - before[0]
        self.counts.krylov_iterations += self.solver.iterations - before[1]
        if not residual <= RESIDUAL:  # also true for NaN
            raise SolveError(
                f"the Stokes solve is not accurate: relative residual {residual:.1e}, allowed "
                f"{RESIDUAL:.0e}; the viscosity contrast may be too high"
            )
        return residual

    def _residual(self):
        self.A.mult(self.x, self.r)
        self.r.aypx(-1, self.b)
        return self.r.norm()

    def _refine(self):
        correction = self.x.duplicate()
        self.solver.solve(self.r, correction)
        self.x.axpy(1, correction)
        correction.destroy()
        self.counts.refinements += 1

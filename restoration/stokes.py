"""The Stokes problem of a section: assembly, factorisation and a solve that is checked."""

from dataclasses import dataclass

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.stokes import gravity_load, source_load, stokes_form
from restoration.boundary import (
    outflow,
    pressure_pin,
    velocity_conditions,
    wall_form,
    wall_load,
)
from restoration.errors import SolveError, TooLargeError

RESIDUAL = 1e-8
# Growth of the workspace over MUMPS's own forecast, per cent; the next is tried when it overflows.
WORKSPACE = (50, 200, 800)
SMALL_WORKSPACE = (-8, -9)
OUT_OF_MEMORY = -13


@dataclass
class Counts:
    """What the solver has done so far."""

    solves: int = 0
    factorisations: int = 0
    refinements: int = 0
    worst_residual: float = 0.0


@dataclass(frozen=True, eq=False)
class Flow:
    """Velocity and pressure of one instant.

    Attributes:
        u: velocity at the P2 nodes, shape (nodes, 2), m/s.
        p: pressure at the vertices, shape (vertices,), Pa; in a closed section zero on average
            along the surface.
        residual: true relative residual of the solve.
    """

    u: np.ndarray
    p: np.ndarray
    residual: float


class StokesProblem:
    """Stokes flow of one mesh, solved by MUMPS for one density and viscosity after another.

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

    Attributes:
        counts: what was done so far.
        leak: flux out of the walls that the section makes up for by swelling, m^2/s.
    """

    def __init__(self, section, spaces, rho, eta, eta0, walls, gravity, closed, steady):
        self.spaces, self.section, self.eta0, self.steady = spaces, section, eta0, steady
        self.closed = closed
        self.counts = Counts()
        # One cell size: then pressure and velocity columns are of one size where eta = eta0.
        self.length = float(np.sqrt(section.areas.mean()))
        self.bcs = velocity_conditions(walls, section, spaces)
        leak = fem.Constant(section.mesh, PETSc.ScalarType(0))
        self.leak = 0.0
        if closed:
            # The walls as the mesh interpolates them may let a little more in than out, which no
            # divergence-free flow can meet: spread over the section it does not spoil the pin.
            self.leak = self._prescribed_outflow(walls)
            leak.value = self.leak / section.areas.sum()
            self.bcs = [*self.bcs, pressure_pin(spaces)]
        self._make_forms(rho, eta, walls, gravity, leak)
        self.A = fem.petsc.create_matrix(self.a)
        self.b = fem.petsc.create_vector(self.load)
        self.x, self.r = self.b.duplicate(), self.b.duplicate()
        self.ksp = None
        top = spaces.ds(section.wall_tags["surface"])
        self._p = fem.Function(spaces.Q)
        self._surface_pressure = fem.form(self._p * top)
        one = fem.Constant(section.mesh, PETSc.ScalarType(1))
        self._surface_length = fem.assemble_scalar(fem.form(one * top))

    def _make_forms(self, rho, eta, walls, gravity, leak):
        spaces, section = self.spaces, self.section
        trial, test = ufl.TrialFunctions(spaces.W), ufl.TestFunctions(spaces.W)
        a = stokes_form(*trial, *test, eta, self.length, spaces.dx)
        slip = wall_form(trial, test, eta, self.length, walls, section, spaces)
        self.a = fem.form(a if slip is None else a + slip)
        g = fem.Constant(section.mesh, np.array([0.0, -gravity]) / self.eta0)
        load = gravity_load(test[0], rho, g, spaces.dx)
        load += source_load(test[1], leak, self.length, spaces.dx)
        push = wall_load(test[0], self.eta0, walls, section, spaces)
        self.load = fem.form(load if push is None else load + push)

    def assemble(self):
        """Assemble the load and, unless it never changes, the matrix."""
        if self.ksp is None or not self.steady:
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
            SolveError: MUMPS failed or the true relative residual stayed above `RESIDUAL`.
        """
        residual = self._checked_solve()
        self.counts.solves += 1
        self.counts.worst_residual = max(self.counts.worst_residual, residual)
        x = self.x.array_r
        u = x[self.spaces.v_in_w].reshape(-1, 2).copy()
        self._p.x.array[:] = x[self.spaces.q_in_w] * (self.eta0 / self.length)
        if self.closed:
            level = fem.assemble_scalar(self._surface_pressure) / self._surface_length
            self._p.x.array[:] -= level
        return Flow(u, self._p.x.array.copy(), residual)

    def _prescribed_outflow(self, walls):
        """Return the net flux through the walls as the mesh represents it, m^2/s."""
        w = fem.Function(self.spaces.W)
        fem.petsc.set_bc(w.vector, self.bcs)
        w.x.scatter_forward()
        u, _ = ufl.split(w)
        return fem.assemble_scalar(fem.form(outflow(u, walls, self.section, self.spaces)))

    def _assemble_matrix(self):
        self.A.zeroEntries()
        fem.petsc.assemble_matrix(self.A, self.a, self.bcs)
        self.A.assemble()
        if self.ksp is None:
            self._new_solver(WORKSPACE[0])
        else:
            self.ksp.setOperators(self.A)
        self.counts.factorisations += 1

    def _new_solver(self, workspace):
        if self.ksp is not None:
            self.ksp.destroy()
        ksp = PETSc.KSP().create(self.section.mesh.comm)
        ksp.setOptionsPrefix("stokes_")
        ksp.setType("preonly")
        pc = ksp.getPC()
        pc.setType("lu")
        pc.setFactorSolverType("mumps")
        ksp.setOperators(self.A)
        pc.setFactorSetUpSolverType()
        pc.getFactorMatrix().setMumpsIcntl(14, workspace)
        ksp.setFromOptions()
        self.ksp = ksp

    def _checked_solve(self):
        """Solve in place and return the true relative residual; raise unless it is small."""
        for workspace in (*WORKSPACE[1:], None):
            self.ksp.solve(self.b, self.x)
            infog = self.ksp.getPC().getFactorMatrix().getMumpsInfog(1)
            if infog not in SMALL_WORKSPACE or workspace is None:
                break
            self._new_solver(workspace)
            self.counts.factorisations += 1
        if infog == OUT_OF_MEMORY:
            raise TooLargeError(
                "the factorisation does not fit into memory (MUMPS INFOG(1) = -13); "
                "lower mesh.cells"
            )
        reason = self.ksp.getConvergedReason()
        if reason <= 0 or infog != 0:
            raise SolveError(
                f"the Stokes solve failed: PETSc reason {reason}, MUMPS INFOG(1) = {infog}; "
                "check that the walls hold the section and the range of viscosities"
            )
        scale = self.b.norm() or 1.0
        residual = self._residual() / scale
        for _ in range(3):
            if residual <= RESIDUAL or not np.isfinite(residual):
                break
            self._refine()
            residual = self._residual() / scale
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
        self.ksp.solve(self.r, correction)
        self.x.axpy(1, correction)
        correction.destroy()
        self.counts.refinements += 1

"""Linear solvers of the Stokes equations: a factorisation, and a field split for large problems.

Both keep one mixed AIJ matrix ``A`` whose strong conditions were applied symmetrically, with a one
on the diagonal. The field split is FGMRES with the upper block-triangular preconditioner

    [ A_uu  B^T ]^-1        z_p = -M^-1 r_p               M: pressure mass over viscosity
    [  0    -M  ]           z_u = K^-1 (r_u - B^T z_p)    K: one cycle of two-level multigrid

where the coarse level of K holds the linear elements in the velocity space: they carry the rigid
motions of a stiff body, which algebraic multigrid on P2 misses. The coarse matrix is factorised
in 2-D and left to smoothed aggregation in 3-D.
"""

import numpy as np
from petsc4py import PETSc

from restoration.blocks import rigid_motions
from restoration.errors import SolveError, TooLargeError
from restoration.plan import FIELDSPLIT_FROM

MANY_ITERATIONS = 100  # more tell that the viscosity is too rough for the field split
# Orderings of MUMPS by unknowns: AMD, and PORD for large matrices. Debian's has no METIS or SCOTCH.
ORDERING = {0: 0, 50_000: 4}
# Growth of the workspace over MUMPS's own forecast, per cent; the next is tried when it overflows.
WORKSPACE = (100, 300, 900)
SMALL_WORKSPACE = (-8, -9)
OUT_OF_MEMORY = (-5, -7, -13)
SINGULAR = (-6, -10)
# What developers ask MUMPS for: error and its detail, entries and rows, memory, pivots.
INFOG, RINFOG = (1, 2, 9, 10, 12, 16, 17, 18, 19, 25, 28), (1, 3, 11)
PREFIX = "stokes_"

# What a factorisation may cost in solves with its factors, on 20 000 unknowns, and how that grows.
# It takes the time of seven; from there to twice as many a run takes as long, and has half as many.
FACTOR_COST, FACTOR_GROWTH = 14.0, 0.13
REUSE_RTOL = 1e-12  # of a solution by old factors: its error over its size, about
REUSE_RTOL_TIGHT = 1e-13  # where that leaves a residual
MOST_REUSE_FAILURES = 4  # doublings of the solves until old factors are tried again
REMEMBERED = (
    "factorisations",
    "iterations",
    "vcycles",
    "_workspace",
    "_changed",
    "_stale",
    "_spent",
    "_solves",
    "_last",
    "_failures",
    "_waits",
    "careful",
)

DIRECT = {
    "ksp_type": "preonly",
    "pc_type": "cholesky",
    "pc_factor_mat_solver_type": "mumps",
}
# What a factorisation is made with that has failed before: pivots are chosen freely among rows and
# columns scaled iteratively. Null pivots stay a failure: a matrix that has some does not tell where
# the section goes, whatever the residual.
CAREFUL = {
    "pc_type": "lu",
    "mat_mumps_icntl_8": 8,
    "mat_mumps_cntl_1": 0.1,
    "mat_mumps_icntl_14": WORKSPACE[-1],
}
FIELDSPLIT = {
    "ksp_type": "fgmres",
    "ksp_gmres_restart": 100,
    "ksp_max_it": 200,
    "ksp_rtol": 1e-8,
    "pressure_ksp_type": "chebyshev",
    "pressure_ksp_max_it": 4,
    "pressure_ksp_chebyshev_esteig": "0,0.2,0,1.1",
    "pressure_ksp_norm_type": "none",
    "pressure_ksp_convergence_test": "skip",
    "pressure_pc_type": "jacobi",
    "velocity_ksp_type": "preonly",
    "velocity_pc_type": "mg",
    "velocity_mg_levels_ksp_type": "chebyshev",
    "velocity_mg_levels_ksp_max_it": 2,
    "velocity_mg_levels_pc_type": "jacobi",
    "velocity_mg_coarse_ksp_type": "preonly",
}
COARSE_2D = {
    "velocity_mg_coarse_pc_type": "cholesky",
    "velocity_mg_coarse_pc_factor_mat_solver_type": "mumps",
}
# Jacobi, not SOR: an aggregate of one node leaves zeros on the diagonal of the next level.
COARSE_3D = {
    "velocity_mg_coarse_pc_type": "gamg",
    "velocity_mg_coarse_pc_gamg_threshold": 0.01,
    "velocity_mg_coarse_pc_gamg_square_graph": 0,
    "velocity_mg_coarse_mg_levels_ksp_type": "chebyshev",
    "velocity_mg_coarse_mg_levels_ksp_max_it": 3,
    "velocity_mg_coarse_mg_levels_pc_type": "jacobi",
}
RESTARTS = 3
# Of the velocity, as the preconditioner tells it, which falls short of the true one some ten to a
# hundred times. The residual tells little of weak rock, and where most of the load is hydrostatic.
VELOCITY_ERROR = 1e-6
AT_REST = 1e-6  # of the velocity by which rock would fall freely: a slower flow is rest


def choose_solver(plan, dim, unknowns):
    """Return the name of the solver, ``direct`` or ``fieldsplit``.

    Args:
        plan: `scene.SolverPlan`, or None for ``auto``.
        dim: dimensions.
        unknowns: number of unknowns.
    """
    name = plan.name if plan else "auto"
    if name != "auto":
        return name
    return "fieldsplit" if unknowns >= FIELDSPLIT_FROM[dim] else "direct"


class DirectSolver:
    """Factorises by MUMPS, and keeps the factors as long as they are worth it.

    Factors of a matrix that has changed since precondition GMRES; where that asks for as many
    solves with them as a factorisation costs, or goes on growing above the mean of the last ones,
    the matrix is factorised. The residual is preconditioned from the left, so that it is the
    error, and what ends the iteration is that, whatever the contrast of the viscosity.

    Args:
        A: matrix, assembled by `update`.
        options: PETSc options that replace those of `DIRECT`, names without prefix.
        symmetric: whether the matrix is, so that LDL^T will do.

    Attributes:
        factorisations, iterations, vcycles: so far; a direct solve is one iteration.
        analyses: so far, of the structure of the matrix, which look at its values too.
        careful: whether it factorises as `CAREFUL` has it.
    """

    def __init__(self, A, options=None, symmetric=True):
        self.A, self.symmetric = A, symmetric
        self.options = DIRECT | ({} if symmetric else {"pc_type": "lu"}) | (options or {})
        unknowns = A.getSize()[0]
        ordering = max(size for size in ORDERING if size <= unknowns)
        self.options.setdefault("mat_mumps_icntl_7", ORDERING[ordering])
        self.factorisations, self.iterations, self.vcycles = 0, 0, 0
        self.cost = FACTOR_COST * max(1.0, unknowns / 20_000) ** FACTOR_GROWTH
        self._workspace, self._changed, self._stale = 0, False, False
        self._spent, self._solves, self._last = 0.0, 1, 0.0  # in solves, since factorised
        self._failures, self._waits = 0, 0
        self.ksp = self._krylov = None
        self.analyses, self.careful, self._infog = 0, False, 0

    def update(self, keep=False):
        """Take the matrix as it is now: factorise it at the next solve; the analysis is kept.

        Args:
            keep: whether it is so near the one before that its factors may still do.
        """
        if self.ksp is None:
            self._make()
            self._changed = True
        elif keep and not self._changed:
            self._stale = True
        else:
            self.refactor()

    def refactor(self):
        """Let the matrix be factorised at the next solve."""
        self.ksp.setOperators(self.A)
        self._changed, self._stale = True, False

    def begin_anew(self):
        """Let the matrix be analysed and factorised as if there had been none before."""
        self._make()
        self._changed, self._stale = True, False

    def rescale(self):
        """Let the matrix be factorised as `CAREFUL` has it, from the next solve on."""
        self.careful = True
        self.options |= CAREFUL
        self.begin_anew()

    @property
    def stale(self):
        """Whether the last solve was by factors of another matrix."""
        return self._stale

    @property
    def singular(self):
        """Whether the last factorisation has found that the matrix is singular."""
        return self._infog in SINGULAR

    def solve(self, b, x, guess=False, rtol=REUSE_RTOL):
        """Solve in place.

        Args:
            b: right-hand side.
            x: solution; what it holds is where an iteration begins if that is a ``guess``.
            guess: see x.
            rtol: error over size at which an iteration with old factors ends.

        Raises:
            TooLargeError: the factors do not fit into memory.
            SolveError: MUMPS or PETSc report a failure.
        """
        if self._stale and not self._iterate(b, x, guess, rtol):
            self.refactor()
        if not self._stale:
            self._solve_directly(b, x)

    def _iterate(self, b, x, guess, rtol):
        """Solve with old factors; return whether that was worth it."""
        if self._waits > 0:
            self._waits -= 1
            return False
        if self._last > self._spent / self._solves:
            return False
        if self._krylov is None:
            self._krylov = _new_ksp(self.A.comm, f"{PREFIX}reuse_", {"ksp_type": "gmres"})
            self._krylov.setPCSide(PETSc.PC.Side.LEFT)
            self._krylov.getPC().setType("python")
            self._krylov.getPC().setPythonContext(self)
            self._krylov.setInitialGuessNonzero(True)
            self._krylov.setOperators(self.A)
        if not guess:
            self.apply(None, b, x)
        krylov, most = self._krylov, int(1.5 * self.cost)
        krylov.setTolerances(rtol=1e-50, atol=rtol * x.norm(), max_it=most)
        krylov.solve(b, x)
        count = krylov.getIterationNumber()
        self.iterations += count
        self._last = count + 1.0
        if krylov.getConvergedReason() <= 0:
            self._failures = min(self._failures + 1, MOST_REUSE_FAILURES)
            self._waits = 2**self._failures
            return False
        self._spent, self._solves, self._failures = self._spent + self._last, self._solves + 1, 0
        return True

    def apply(self, _pc, b, x):
        """Solve with the factors there are, of whatever matrix; PETSc calls this."""
        self.ksp.getPC().getFactorMatrix().solve(b, x)

    def _solve_directly(self, b, x):
        while True:
            self.factorisations += self._changed
            if self._changed:
                self._spent, self._solves, self._last = self.cost, 1, 0.0
            self.ksp.solve(b, x)
            self._changed = False
            infog = self._infog = _infog(self.ksp)
            if infog not in SMALL_WORKSPACE or self._workspace + 1 == len(WORKSPACE):
                break
            self._workspace += 1
            self._make()
            self._changed = True
        self.iterations += 1
        if infog in OUT_OF_MEMORY:
            raise TooLargeError(
                f"the factorisation does not fit into memory (MUMPS INFOG(1) = {infog}); "
                "lower mesh.cells"
            )
        reason = self.ksp.getConvergedReason()
        if reason <= 0 or infog != 0:
            advice = "check that the walls hold the section and the range of viscosities"
            if infog in SMALL_WORKSPACE:
                advice = (
                    f"even {WORKSPACE[-1]} % more workspace than forecast is too little: set "
                    "mat_mumps_icntl_14 in solver.options higher, or lower mesh.cells"
                )
            raise SolveError(f"PETSc reason {reason}, MUMPS INFOG(1) = {infog}; {advice}")

    def memory(self):
        """Return what decides how the next solves are made, beside the factors; see `recall`."""
        return {name: getattr(self, name) for name in REMEMBERED}

    def recall(self, memory):
        """Go on as the solver did that `memory` was asked of, once the factors are those it had."""
        for name in REMEMBERED:
            setattr(self, name, memory[name])

    def prepare(self):
        """Factorise the matrix as it is now."""
        self.update()
        self.ksp.setUp()
        self._changed = self._stale = False

    def analysed_anew(self, workspace):
        """Let the next matrix be analysed too, for a workspace that was found before."""
        self._workspace = workspace
        self.begin_anew()

    def facts(self):
        """Return the numbers by which MUMPS and PETSc tell of the last factorisation."""
        if self.ksp is None:
            return {}
        facts = {"petsc_reason": self.ksp.getConvergedReason(), "careful": self.careful}
        if self.factorisations and self.ksp.getPC().getFactorSolverType() == "mumps":
            factors = self.ksp.getPC().getFactorMatrix()
            told = {f"mumps_infog_{number}": factors.getMumpsInfog(number) for number in INFOG}
            facts |= told | {f"mumps_rinfog_{n}": factors.getMumpsRinfog(n) for n in RINFOG}
        return facts

    def release(self):
        """Give the memory of the factors back."""
        for ksp in (self.ksp, self._krylov):
            if ksp is not None:
                ksp.destroy()
        self._krylov = None

    def _make(self):
        self.release()
        self.analyses += 1
        self.A.setOption(PETSc.Mat.Option.SYMMETRIC, self.symmetric)
        options = {"mat_mumps_icntl_14": WORKSPACE[self._workspace]} | self.options
        self.ksp = _new_ksp(self.A.comm, PREFIX, options)
        self.ksp.setOperators(self.A)


class FieldsplitSolver:
    """FGMRES with an upper block-triangular preconditioner, see above.

    Args:
        A: mixed matrix; attach its null space if the pressure has one.
        blocks: `Blocks` of it; `update` assembles their Schur mass.
        options: PETSc options that replace those of `FIELDSPLIT`, names without prefix; those of
            the blocks begin with ``velocity_`` and ``pressure_``.

    Attributes:
        factorisations, iterations, vcycles: so far, of the coarse velocity, of FGMRES, and of the
            multigrid of the velocity.
        residual: true relative residual of the last solve.
        error: of its velocity over its size, about.
        floor: the same as the residual that rounding of the solution alone may cause, about.
    """

    def __init__(self, A, blocks, options=None):
        self.A, self.blocks = A, blocks
        self.factorisations, self.iterations, self.vcycles = 0, 0, 0
        self.residual, self.floor, self._changed = np.inf, 0.0, False
        self.error = np.inf
        coarse = COARSE_2D if blocks.linear.mesh.topology.dim == 2 else COARSE_3D
        self.ksp = _new_ksp(A.comm, PREFIX, FIELDSPLIT | coarse | (options or {}))
        self.ksp.setPCSide(PETSc.PC.Side.RIGHT)
        self.ksp.setInitialGuessNonzero(True)
        self.ksp.getPC().setType("python")
        self.ksp.getPC().setPythonContext(self)
        self.ksp_u = _new_ksp(A.comm, f"{PREFIX}velocity_")
        self.ksp_p = _new_ksp(A.comm, f"{PREFIX}pressure_")
        first = A.getOwnershipRange()[0]
        self.u_rows = blocks.velocity.getIndices() - first
        self.p_rows = blocks.pressure.getIndices() - first
        self.A_uu = self.A_up = self.coarse = None
        self.ru = self.zu = self.rp = self.zp = None

    def update(self, keep=False):
        """Take the values of the matrix and of the viscosity: set up anew at the next solve.

        Args:
            keep: see `DirectSolver.update`; the blocks are set up in any case.
        """
        self._changed = True

    def refactor(self):
        """Let the blocks be set up anew at the next solve."""
        self._changed = True

    begin_anew = rescale = refactor  # its blocks have no pivots to choose

    def _set_up(self):
        self._changed = False
        self.blocks.assemble()
        u, p = self.blocks.velocity, self.blocks.pressure
        self.A_uu = _extract(self.A, u, u, self.A_uu)
        self.A_up = _extract(self.A, u, p, self.A_up)
        self.A_uu.setOption(PETSc.Mat.Option.SPD, True)
        if self.ksp_u.getPC().getType() == "mg":
            self._update_levels(self.ksp_u.getPC())
        for ksp, matrix in (
            (self.ksp_u, self.A_uu),
            (self.ksp_p, self.blocks.schur),
            (self.ksp, self.A),
        ):
            ksp.setOperators(matrix)
            ksp.setUp()
        self.factorisations += 1
        if self.ru is None:
            self.ru, self.zu = self.A_uu.createVecs()
            self.rp, self.zp = self.blocks.schur.createVecs()

    def release(self):
        """Give the memory of blocks and factors back."""
        solvers = self.ksp, self.ksp_u, self.ksp_p
        blocks = self.blocks
        parts = blocks.schur, blocks.prolongation, blocks.velocity, blocks.pressure
        work = self.ru, self.zu, self.rp, self.zp
        for held in (*solvers, self.A_uu, self.A_up, self.coarse, *parts, *work):
            if held is not None:
                held.destroy()

    def _update_levels(self, pc):
        new, P = self.coarse is None, self.blocks.prolongation
        self.coarse = self.A_uu.ptap(P, result=self.coarse)
        self.coarse.setOption(PETSc.Mat.Option.SPD, True)
        self.coarse.setNearNullSpace(rigid_motions(self.blocks.linear))
        if new:
            self.coarse.setBlockSize(P.getBlockSizes()[1])
            pc.setMGLevels(2)
            pc.setMGInterpolation(1, P)
            pc.setFromOptions()
        pc.getMGCoarseSolve().setOperators(self.coarse)
        pc.getMGSmoother(1).setOperators(self.A_uu)

    def facts(self):
        """Return the numbers by which PETSc tells of the last solve."""
        return {"petsc_reason": self.ksp.getConvergedReason(), "floor": self.floor}

    stale = False  # its blocks are always those of the matrix, and its tolerance that of PETSc
    singular = False
    analyses = 0

    def memory(self):
        """Return what it has done so far; see `DirectSolver.memory`."""
        return {name: getattr(self, name) for name in ("factorisations", "iterations", "vcycles")}

    def recall(self, memory):
        """Go on with these; see `DirectSolver.recall`."""
        for name, value in memory.items():
            setattr(self, name, value)

    def prepare(self):
        """Set up for the matrix as it is now."""
        self._set_up()

    def analysed_anew(self, workspace):
        """Do nothing: there is nothing that the next matrix does not tell."""

    def solve(self, b, x, guess=False, rtol=None):
        """Solve in place.

        Args:
            b, x, guess, rtol: see `DirectSolver.solve`.

        FGMRES starts again while the true residual is above the tolerance and above what
        rounding allows, and with a lower tolerance while the velocity is off.

        Raises:
            SolveError: PETSc reports a failure, or the residual stays too large.
        """
        if self._changed:
            self._set_up()
        r, diagonal = b.duplicate(), self.A.getDiagonal()
        scale = b.norm() or 1.0
        if not guess:
            x.set(0)
        given = rtol = self.ksp.getTolerances()[0]
        for _ in range(RESTARTS):
            self.ksp.setTolerances(rtol=rtol)
            self.ksp.solve(b, x)
            self.iterations += self.ksp.getIterationNumber()
            self.A.mult(x, r)
            r.aypx(-1, b)
            self.residual, self.error = r.norm() / scale, self._velocity_error(r, b, x)
            r.pointwiseMult(diagonal, x)
            self.floor = np.finfo(float).eps * r.norm() / scale
            if self.failure() is None or not np.isfinite(self.residual):
                break
            rtol *= min(1.0, VELOCITY_ERROR / (3 * self.error))
        self.ksp.setTolerances(rtol=given)
        r.destroy()
        diagonal.destroy()
        if (why := self.failure()) is not None:
            raise SolveError(
                f"{why}; the viscosity may be too rough for the iterative solver: take solver: "
                "{name: direct}"
            )

    def failure(self):
        """Return why the last solve cannot be trusted, or None."""
        pc = self.ksp_u.getPC()
        coarse = pc.getMGCoarseSolve() if pc.getType() == "mg" else self.ksp_u
        reason = _mumps_failure(coarse) or _krylov_failure(self.ksp)
        if reason is None and not self.residual <= max(self.ksp.getTolerances()[0], self.floor):
            reason = f"true relative residual {self.residual:.1e}"
        if reason is None and not self.error <= VELOCITY_ERROR:
            reason = f"the velocity is off by more than {self.error:.1e}"
        return reason

    def _velocity_error(self, r, b, x):
        """Return the error of the velocity over its size, of a solution and its residual."""
        z, sizes = r.duplicate(), []
        for given in (r, b):
            self.apply(None, given, z)
            sizes.append(self.zu.norm())
        z.destroy()
        off, free = sizes
        self.ru.array_w[:] = x.array_r[self.u_rows]
        return off / (max(self.ru.norm(), AT_REST * free) or 1.0)

    def apply(self, pc, r, z):
        """Write the preconditioned residual to ``z``; PETSc calls this."""
        held = self.blocks.held
        values = r.array_r
        self.rp.array_w[:] = -values[self.p_rows]
        self.ksp_p.solve(self.rp, self.zp)
        self.zp.array_w[held] = values[self.p_rows[held]]
        self.A_up.mult(self.zp, self.ru)
        self.ru.array_w[:] = values[self.u_rows] - self.ru.array_r
        self.ksp_u.solve(self.ru, self.zu)
        self.vcycles += self.ksp_u.getIterationNumber()
        values = z.array_w
        values[self.u_rows], values[self.p_rows] = self.zu.array_r, self.zp.array_r


def _extract(A, rows, cols, old):
    """Return a block of A, in the matrix ``old`` if there is one.

    PETSc 3.18 fills a reused submatrix wrongly on several ranks when the index set is not sorted.
    """
    if old is None or A.comm.size == 1:
        return A.createSubMatrix(rows, cols, old)
    new = A.createSubMatrix(rows, cols)
    new.copy(old, PETSc.Mat.Structure.SAME_NONZERO_PATTERN)
    new.destroy()
    return old


def _new_ksp(comm, prefix, options=None):
    database = PETSc.Options()
    for name, value in (options or {}).items():
        database[prefix + name] = value
    ksp = PETSc.KSP().create(comm)
    ksp.setOptionsPrefix(prefix)
    try:
        ksp.setFromOptions()
    except PETSc.Error as error:
        given = ", ".join(f"{name}: {value}" for name, value in (options or {}).items())
        raise SolveError(
            f"PETSc (error {error.ierr}) cannot make a solver of these options: {given}; see "
            "solver.options"
        ) from None
    return ksp


def _krylov_failure(ksp):
    reason = ksp.getConvergedReason()
    return None if reason > 0 else f"PETSc reason {reason}"


def _mumps_failure(ksp):
    pc = ksp.getPC()
    if pc.getType() not in ("lu", "cholesky") or pc.getFactorSolverType() != "mumps":
        return None
    infog = _infog(ksp)
    return None if infog == 0 else f"MUMPS INFOG(1) = {infog}"


def _infog(ksp):
    """Return INFOG(1) of MUMPS, zero where all is well or another package is at work."""
    if ksp.getPC().getFactorSolverType() != "mumps":
        return 0
    return ksp.getPC().getFactorMatrix().getMumpsInfog(1)

"""Linear solvers of the Stokes matrix, by name. Settings are data: a table of PETSc options."""

from petsc4py import PETSc

from restoration.errors import SolveError, TooLargeError

# Growth of the workspace over MUMPS's own forecast, per cent; the next is tried when it overflows.
WORKSPACE = (100, 300, 900)
SMALL_WORKSPACE = (-8, -9)
OUT_OF_MEMORY = -13
PREFIX = "stokes_"

DIRECT = {
    "ksp_type": "preonly",
    "pc_type": "lu",
    "pc_factor_mat_solver_type": "mumps",
}


class DirectSolver:
    """Factorises by MUMPS.

    Args:
        A: the matrix; its values may change before `update`.
        options: PETSc options that replace those of `DIRECT`, names without prefix.

    Attributes:
        factorisations: made so far.
        iterations: of the last solve; a direct solve has one.
    """

    def __init__(self, A, options=None):
        self.A, self.options = A, DIRECT | (options or {})
        self.factorisations, self.iterations, self.vcycles = 0, 0, 0
        self._workspace, self._changed = 0, False
        self.ksp = None

    def update(self):
        """Factorise the matrix as it is now at the next solve."""
        if self.ksp is None:
            self._make()
        else:
            self.ksp.setOperators(self.A)
        self._changed = True

    def solve(self, b, x):
        """Solve in place.

        Raises:
            TooLargeError: the factors do not fit into memory.
            SolveError: MUMPS or PETSc report a failure.
        """
        while True:
            self.factorisations += self._changed
            self.ksp.solve(b, x)
            self._changed = False
            infog = self.ksp.getPC().getFactorMatrix().getMumpsInfog(1)
            if infog not in SMALL_WORKSPACE or self._workspace + 1 == len(WORKSPACE):
                break
            self._workspace += 1
            self._make()
            self._changed = True
        self.iterations += 1
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

    def _make(self):
        if self.ksp is not None:
            self.ksp.destroy()
        self.ksp = PETSc.KSP().create(self.A.comm)
        self.ksp.setOperators(self.A)
        apply_options(self.ksp, PREFIX, self.options)
        self.ksp.getPC().setFactorSetUpSolverType()
        factor = self.ksp.getPC().getFactorMatrix()
        factor.setMumpsIcntl(14, WORKSPACE[self._workspace])


def apply_options(ksp, prefix, options):
    """Give a solver its options, and take them out of PETSc's global table again."""
    table = PETSc.Options()
    ksp.setOptionsPrefix(prefix)
    for name, value in options.items():
        table[prefix + name] = value
    ksp.setFromOptions()
    for name in options:
        table.delValue(prefix + name)


def make_solver(plan, A, spaces, eta, length):
    """Return the solver of a matrix."""
    return DirectSolver(A)

"""The Stokes problem of a section: assembly, and a solve that is checked."""

from dataclasses import dataclass
from functools import partial
from math import isclose, prod

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from petsc4py import PETSc

from forms.stokes import gravity_load, schur_mass, source_load, stokes_form
from forms.surface import column_weight, stabilisation
from restoration.acceptance import (
    CONTRAST,
    MOST_DIVERGENCE,
    Divergence,
    Probe,
    add_up,
    climbed,
    tell,
)
from restoration.assembly import assembler
from restoration.blocks import Blocks
from restoration.boundary import (
    WallValues,
    outflow,
    pressure_pin,
    velocity_conditions,
    wall_form,
    wall_load,
)
from restoration.errors import RankFault, SolveError, TooLargeError
from restoration.solvers import (
    MANY_ITERATIONS,
    REUSE_RTOL,
    REUSE_RTOL_TIGHT,
    DirectSolver,
    FieldsplitSolver,
    choose_solver,
)

RESIDUAL = 1e-8
# A stiff body that moves makes the residual larger than that by the rounding of the velocity alone:
# its rows hold large forces that cancel. Such a solution is as exact as double precision holds one;
# up to this residual the velocity was still right to a hundredth (`restore bench falling-block`).
RESIDUAL_BY_ROUNDING = 1e-2
OUT_OF_MEMORY = 55  # error of PETSc
ROUNDINGS = 100  # in the sum of a row
REFINEMENTS = 3  # of a solution, at most
ANEW = "assembled anew"
WORST_ROWS = 5  # of the matrix, that a dump for developers names
REMEMBERED = 3  # solutions through which a polynomial in time leads to the next
FURTHEST = 1.5  # of the time between the first and the last of them, that it is followed


@dataclass
class Counts:
    """What the solver has done so far."""

    solves: int = 0
    factorisations: int = 0
    krylov_iterations: int = 0
    refinements: int = 0
    worst_residual: float = 0.0
    responses: int = 0  # of the surface: back-substitutions beside the solves
    rescued: int = 0  # solves that had failed, until the matrix was assembled or factorised anew


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


def same_time(one, two):
    """Return whether two model times, s, are the same but for rounding; None is no time."""
    return None not in (one, two) and isclose(one, two, rel_tol=1e-12, abs_tol=1.0)


class Past:
    """The last solutions, of different times: where the next solve may begin.

    Args:
        x: vector like them.
    """

    def __init__(self, x):
        self._kept, self._free = {}, [x.duplicate() for _ in range(REMEMBERED)]

    def guess(self, time, x):
        """Write what the solution may be at a time to x; return whether there is anything.

        It is the polynomial through the last solutions.
        """
        if not self._kept or time is None:
            return False
        times = list(self._kept)
        self._kept[times[-1]].copy(x)
        span = abs(times[-1] - times[0])
        if same_time(time, times[-1]) or abs(time - times[-1]) > FURTHEST * span:
            return True
        x.set(0)
        for one, solution in self._kept.items():
            others = [other for other in times if other != one]
            x.axpy(prod((time - other) / (one - other) for other in others), solution)
        return True

    def keep(self, time, x):
        """Keep the solution of a time, in place of an earlier one of that time."""
        if time is None:
            return
        for earlier in self._kept:
            if same_time(time, earlier):
                time = earlier
        held = self._kept.pop(time, None)
        if held is None:
            held = self._free.pop() if self._free else self._kept.pop(next(iter(self._kept)))
        x.copy(held)
        self._kept[time] = held

    @property
    def kept(self):
        """The vectors kept, by their times, the oldest first."""
        return dict(self._kept)

    def release(self):
        """Give the memory back."""
        for held in [*self._kept.values(), *self._free]:
            held.destroy()
        self._kept, self._free = {}, []


class StokesProblem:
    """Stokes flow of one mesh, solved for one density and viscosity after another.

    The forms are divided by the smallest viscosity, which keeps the residual at rounding up to a
    contrast of 1e12 where the stiff rock stands; divided by the largest, 1e9 would fail.

    Args:
        section: `meshes.data.SectionMesh`.
        spaces: `Spaces` of it.
        rho: density as a UFL expression, kg/m^3.
        eta: viscosity over ``eta0`` as a UFL expression.
        eta0: smallest viscosity of the section, Pa s.
        walls: `scene.Wall` by name.
        gravity: downwards, m/s^2.
        closed: whether the normal velocity is held on every wall.
        steady: whether the matrix never changes, so that one factorisation serves.
        solver: `solvers.SolverPlan`; None for the default.
        counts: `Counts` to go on with; None begins anew.
        top: `surface.Top` of a free surface whose weight when moved may count, else None.
        on_facets: density and viscosity as integrals over facets read them; None where those are
            ``rho`` and ``eta``.
        follows: whether the mesh moves with the viscosity, so that the matrix changes slowly.

    Attributes:
        counts: what was done so far.
        leak: flux out of the walls that the section makes up for by swelling, m^dim/s.
        factored: called without arguments whenever the matrix was factorised.
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
        top=None,
        on_facets=None,
        follows=False,
    ):
        self.spaces, self.section, self.eta0, self.steady = spaces, section, eta0, steady
        self._follows = follows
        self.closed, self.top = closed, top
        self.counts = counts or Counts()
        self._comm = section.mesh.comm
        area = section.area
        # One cell size: then pressure and velocity columns are of one size where eta = eta0.
        self.length = float((area / section.cell_count) ** (1 / section.dim))
        # a number in a form would be compiled anew for every mesh
        self._length = fem.Constant(section.mesh, PETSc.ScalarType(self.length))
        self._wall_values = WallValues()
        self.bcs = velocity_conditions(walls, section, spaces, self._wall_values)
        self._leak = fem.Constant(section.mesh, PETSc.ScalarType(0))
        self.leak = 0.0
        if closed:
            self._on_walls = fem.Function(spaces.W)
            u, _ = ufl.split(self._on_walls)
            self._outflow = fem.form(outflow(u, walls, section, spaces))
            self._find_leak()
        self.solver_plan = solver
        name = choose_solver(solver, section.dim, spaces.unknowns)
        if closed and name == "direct":
            self.bcs = [*self.bcs, pressure_pin(spaces)]
        self._make_forms(rho, eta, on_facets or (rho, eta), walls, gravity)
        self.A = self._assembler.A
        self.b = fem.petsc.create_vector(self.load)
        self.x, self.r = self.b.duplicate(), self.b.duplicate()
        self._null_space = None
        self.solver, self._seen = self._make_solver(name, eta), (0, 0)
        self._assembled = self._fell_back = False
        self.factored = lambda: None
        self._time = self._factor_time = None
        self._past = Past(self.x)
        self._divergence = Divergence(section, spaces)
        self._probe, self._wrong = Probe(section, spaces, self.x, viscous=self.top is None), None
        self._sound = False  # whether the matrix that never changes has given such a flow before
        self._off = np.nan  # true relative residual of what `x` holds, once that is known
        top = spaces.ds(section.wall_tags["surface"])
        self._p = fem.Function(spaces.Q)
        self._surface_pressure = fem.form(self._p * top)
        one = fem.Constant(section.mesh, PETSc.ScalarType(1))
        self._surface_length = self._total(fem.form(one * top))

    def _make_solver(self, name, eta):
        options = dict(self.solver_plan.options) if self.solver_plan else {}
        if name == "direct":
            return DirectSolver(self.A, options, symmetric=self.top is None)
        spaces = self.spaces
        p, q = ufl.TrialFunction(spaces.Q), ufl.TestFunction(spaces.Q)
        mass = fem.form(schur_mass(p, q, eta, self._length, spaces.dx))
        if self.closed:
            # A constant pressure; pinning one of its values would cost iterations.
            constant = self.x.duplicate()
            first, last = constant.getOwnershipRange()
            owned = spaces.q_in_w[spaces.q_in_w < last - first]
            constant.array_w[owned] = 1.0
            constant.normalize()
            self._null_space = PETSc.NullSpace().create(vectors=[constant], comm=self._comm)
            self.A.setNullSpace(self._null_space)
        return FieldsplitSolver(self.A, Blocks.build(spaces.W, self.bcs, mass), options)

    def _fall_back(self):
        """Go on with a direct solver: the viscosity is too rough for the field split."""
        if self._null_space is not None:
            self.A.setNullSpace(PETSc.NullSpace())
            self._null_space = None
            self.bcs = [*self.bcs, pressure_pin(self.spaces)]
        self.solver.release()
        self.solver, self._seen = self._make_solver("direct", None), (0, 0)
        self._assembled, self._fell_back = False, True
        self.assemble()

    @property
    def _may_fall_back(self):
        automatic = self.solver_plan is None or self.solver_plan.name == "auto"
        return automatic and isinstance(self.solver, FieldsplitSolver)

    def _total(self, form):
        """Return the value of a form on all ranks."""
        return self._comm.allreduce(fem.assemble_scalar(form), op=MPI.SUM)

    def _make_forms(self, rho, eta, on_facets, walls, gravity):
        spaces, section = self.spaces, self.section
        facet_rho, facet_eta = on_facets
        trial, test = ufl.TrialFunctions(spaces.W), ufl.TestFunctions(spaces.W)
        cells = stokes_form(*trial, *test, eta, self._length, spaces.dx)
        facets = wall_form(trial, test, facet_eta, self._length, walls, section, spaces)
        down = np.zeros(section.dim)
        down[-1] = -gravity / self.eta0
        down = fem.Constant(section.mesh, down)
        load = gravity_load(test[0], rho, down, spaces.dx)
        if self.top:
            # theta dt, and the flow that stands for the moved weight already
            self._lead = fem.Constant(section.mesh, PETSc.ScalarType(0))
            self._before = fem.Function(fem.VectorFunctionSpace(section.mesh, ("Lagrange", 2)))
            self.column = fem.Function(spaces.H)
            top = self.top
            weight = lambda u: stabilisation(u, test[0], facet_rho, down, top.n)  # noqa: E731
            lifted = self._lead * top.over(weight(trial[0]))
            facets = lifted if facets is None else facets + lifted
            load += self._lead * top.over(weight(self._before))
            on_top = column_weight(test[0], facet_rho, down, top.n, self.column)
            self._column_load = fem.form(top.over(on_top))
        load += source_load(test[1], self._leak, self._length, spaces.dx)
        push = wall_load(test[0], self.eta0, walls, section, spaces, self._wall_values)
        self.load = fem.form(load if push is None else load + push)
        self.a = fem.form(cells if facets is None else cells + facets)
        parts = (self.a, None) if facets is None else (fem.form(cells), fem.form(facets))
        self._assembler = assembler(self.a, *parts, spaces.W, section.mesh)

    def set_time(self, time):
        """Set what the walls prescribe for a model time, s, and for the mesh as it stands now.

        Nothing is done where all walls are held by numbers.
        """
        self._time = time
        if self._wall_values:
            self._wall_values.update(time)
            if self.closed:
                self._find_leak()

    def stabilise(self, lead, before=None):
        """Let the weight of the moved surface count in the flows to come.

        Args:
            lead: theta times the signed step, s; 0 for the flow of the instant.
            before: velocity that the surface is known to move with already, a function of points
                (n, 2), m, or None; near that of the flow to come, it leaves an error of second
                order.
        """
        self._lead.value = lead
        dim = self.section.dim
        at = self._before.function_space.tabulate_dof_coordinates()[:, :dim]
        self._before.x.array[:] = 0 if before is None else before(at).ravel()

    def response(self, column):
        """Return the velocity that a column of rock on the surface adds to the flow solved last.

        Args:
            column: its height at the dofs of `Spaces.H`, m.

        Returns:
            Shape (nodes, 2), m/s.
        """
        self.column.x.array[:] = column
        with self.b.localForm() as local:
            local.set(0)
        fem.petsc.assemble_vector(self.b, self._column_load)
        add_up(self.b)
        for condition in self.bcs:  # what is held stays so
            dofs, owned = condition.dof_indices()
            self.b.array_w[dofs[:owned]] = 0
        if self.solver.stale:  # there are many of these
            self.solver.refactor()
        self._solve(self.b, self.x)
        if not self._residual() <= RESIDUAL_BY_ROUNDING * self.b.norm():
            raise SolveError("the response of the surface is not accurate; " + CONTRAST)
        self.counts.responses += 1
        with self.x.localForm() as local:
            return local.array_r[self.spaces.v_in_w].reshape(-1, self.section.dim).copy()

    def assemble(self):
        """Assemble the load and, unless it never changes, the matrix."""
        if not self._assembled or not self.steady:
            self._assemble_matrix()
        with self.b.localForm() as local:
            local.set(0)
        fem.petsc.assemble_vector(self.b, self.load)
        fem.petsc.apply_lifting(self.b, [self.a], [self.bcs])
        add_up(self.b)
        fem.petsc.set_bc(self.b, self.bcs)
        if self._null_space is not None:
            self._null_space.remove(self.b)

    def solve(self):
        """Return the `Flow` of what was assembled last.

        Raises:
            SolveError: no rung of the ladder led to a solution that can be trusted.
            TooLargeError: the problem does not fit into memory.
        """
        guess = self._past.guess(self._time, self.x)
        self.counts.rescued += ANEW in climbed(self._rungs(guess), self._doubt)
        self._past.keep(self._time, self.x)
        residual = self._off
        self.counts.solves += 1
        self.counts.worst_residual = max(self.counts.worst_residual, residual)
        u = self._velocity()
        with self.x.localForm() as local:
            pressure = local.array_r[self.spaces.q_in_w] * (self.eta0 / self.length)
            self._p.x.array[:] = pressure
        if self.closed:
            self._p.x.array[:] -= self._total(self._surface_pressure) / self._surface_length
        return Flow(u, self._p.x.array.copy(), residual)

    def facts(self):
        """Return sizes of matrix and load, the worst rows, and what MUMPS tells; collective."""
        first = self.A.getOwnershipRange()[0]
        residual = np.abs(self.r.array_r)
        worst = first + np.argsort(np.nan_to_num(residual, nan=np.inf))[-WORST_ROWS:][::-1]
        return {
            "solver": type(self.solver).__name__,
            "matrix_norm": self.A.norm(),
            "load_norm": self.b.norm(),
            "solution_norm": self.x.norm(),
            "relative_residual": self._off,
            "worst_rows": worst.tolist(),
            "worst_rows_at_m": [self._place(row - first) for row in worst],
            "worst_row_residuals": residual[worst - first].tolist(),
            "matrix_doubted": self._wrong,
            **self.solver.facts(),
        }

    def _place(self, row):
        """Return where the velocity of a row of this rank is, m; None where it is no velocity."""
        at, dim = np.flatnonzero(self.spaces.v_in_w == row), self.section.dim
        if not len(at):
            return None
        return self.spaces.V.tabulate_dof_coordinates()[at[0] // dim, :dim].tolist()

    @property
    def lead(self):
        """How far ahead the weight of the moved surface counts, s; see `stabilise`."""
        return self._lead.value.item() if self.top else 0.0

    @property
    def analyses(self):
        """How often the structure of the matrix was analysed, before it was factorised."""
        return self.solver.analyses

    def memory(self):
        """Return what the solves to come depend on beside the matrix factorised last.

        Returns:
            A dict of numbers, and the last solutions: their times, velocities and scaled pressures.
        """
        past = []
        for time, held in self._past.kept.items():
            with held.localForm() as local:
                x = local.array_r
                parts = x[self.spaces.v_in_w], x[self.spaces.q_in_w]
            past.append({"time": time, "u": parts[0].reshape(-1, self.section.dim), "p": parts[1]})
        return {
            "fell_back": self._fell_back,
            "factor_time": self._factor_time,
            "solver": self.solver.memory(),
            "past": past,
        }

    def prepare(self, memory, analysed):
        """Assemble and factorise the matrix of the fields and the mesh as they are now.

        Args:
            memory: of `memory`.
            analysed: whether the matrix is analysed too.
        """
        if memory["fell_back"] and not self._fell_back:
            self._fall_back()
        if memory["solver"].get("careful"):
            self.solver.rescale()
        if analysed:
            self.solver.analysed_anew(memory["solver"].get("_workspace"))
        self.assemble()
        self.solver.prepare()

    def recall(self, memory):
        """Go on as after the solve that `memory` followed; the matrix is that of the fields now.

        The factors are those that `prepare` made.
        """
        if memory["solver"].get("_stale"):
            self._assembler.assemble(self.bcs)
        self.solver.recall(memory["solver"])
        self._seen = self.solver.factorisations, self.solver.iterations
        self._factor_time = memory["factor_time"]
        for solution in memory["past"]:
            with self.x.localForm() as local:
                local.array_w[self.spaces.v_in_w] = solution["u"].ravel()
                local.array_w[self.spaces.q_in_w] = solution["p"]
            self._past.keep(solution["time"], self.x)

    def release(self):
        """Give the memory of matrix and factors back; the problem cannot be solved any more.

        PETSc keeps objects that Python has dropped until all ranks agree: a run with a new mesh
        for every step would fill the memory.
        """
        self.factored = None  # which leads back to the grid: a ring is freed late
        self.solver.release()
        for held in (self.A, self.b, self.x, self.r):
            held.destroy()
        self._past.release()
        self._probe.release()

    def _find_leak(self):
        """Spread over the section what the walls let out.

        As the mesh interpolates them they may let a little more in than out, which no
        divergence-free flow can meet: spread it does not spoil the pin.
        """
        # into the array: PETSc would keep for good a vector that wraps it
        fem.set_bc(self._on_walls.x.array, self.bcs)
        self._on_walls.x.scatter_forward()
        self.leak = self._total(self._outflow)
        self._leak.value = self.leak / self.section.area

    def _assemble_matrix(self):
        self._assembler.assemble(self.bcs)
        self._wrong, self._sound = self._probe(self.A), False
        try:
            # At one time the rock moves by what the stages of a step differ in, and no further.
            self.solver.update(keep=self._follows or same_time(self._time, self._factor_time))
        except PETSc.Error as error:
            raise self._fault(error) from None
        self._assembled = True

    def _rungs(self, guess):
        """Yield the ways to the solution, as (name, task): each is asked for if those before fail.

        Args:
            guess: whether ``x`` holds what the solution may be.
        """
        yield "solved", lambda: self._solve_fast(guess)
        if self._may_fall_back:
            yield "solved directly", self._solve_directly
        if self.solver.stale:
            again = partial(self._solve, self.b, self.x, True, REUSE_RTOL_TIGHT)
            yield "iterated further", again
        if self.solver.stale:
            yield "factorised anew", self._solve_anew
        yield from self._refinements()
        yield ANEW, self._reassemble
        yield from self._refinements()
        if not self.solver.singular:
            yield "rescaled", self._rescale
            yield from self._refinements()

    def _refinements(self):
        for _ in range(REFINEMENTS):
            if not np.isfinite(self._off):
                return
            yield "refined", self._refine

    def _solve_fast(self, guess):
        before = self.solver.iterations
        self._solve(self.b, self.x, guess)
        if self._may_fall_back and self.solver.iterations - before > MANY_ITERATIONS:
            self._solve_directly()

    def _solve_directly(self):
        self._fall_back()
        self._solve(self.b, self.x)

    def _solve_anew(self):
        self.solver.refactor()
        self._solve(self.b, self.x)

    def _reassemble(self):
        self._assembled = False
        self.assemble()
        self.solver.begin_anew()
        self._solve(self.b, self.x)

    def _rescale(self):
        self.solver.rescale()
        self._solve(self.b, self.x)

    def _doubt(self):
        """Return why the solution in ``x`` cannot be trusted, or None; collective."""
        if self._wrong:
            return self._wrong
        scale = self.b.norm() or 1.0
        self._off = self._residual() / scale
        allowed = RESIDUAL
        if np.isfinite(self._off) and self._off > RESIDUAL and not self.solver.stale:
            allowed = max(RESIDUAL, min(RESIDUAL_BY_ROUNDING, self._rounding() / scale))
        if not self._off <= allowed:  # also true for NaN
            return f"relative residual {self._off:.1e}, allowed {allowed:.0e}"
        if self._sound and self._comm.size == 1:
            return None
        made = self._divergence(self._velocity(), self._leak.value if self.closed else 0.0)
        if not made <= MOST_DIVERGENCE:
            return f"relative divergence {made:.1e}, allowed {MOST_DIVERGENCE:.0e}"
        self._sound = self.steady
        return None

    def _velocity(self):
        """Return the velocity in ``x`` at the nodes of this rank and its ghosts, a copy."""
        tell(self.x)
        with self.x.localForm() as local:
            return local.array_r[self.spaces.v_in_w].reshape(-1, self.section.dim).copy()

    def _solve(self, b, x, guess=False, rtol=REUSE_RTOL):
        """Solve in place, and count what that and the update before it took."""
        before, self._off = self._seen, np.nan
        try:
            self.solver.solve(b, x, guess, rtol)
        except PETSc.Error as error:
            raise self._fault(error) from None
        finally:
            self._seen = self.solver.factorisations, self.solver.iterations
            if self._seen[0] > before[0]:
                self._factor_time = self._time
                self.factored()
            self.counts.factorisations += self._seen[0] - before[0]
            self.counts.krylov_iterations += self._seen[1] - before[1]

    def _fault(self, error):
        """Return what to raise for an error of PETSc, which one rank may have met alone."""
        kind = SolveError if self._comm.size == 1 else RankFault
        kind = TooLargeError if kind is SolveError and error.ierr == OUT_OF_MEMORY else kind
        return kind(_refused(error))

    def _residual(self):
        self.A.mult(self.x, self.r)
        self.r.aypx(-1, self.b)
        return self.r.norm()

    def _rounding(self):
        """Return the norm of the residual that rounding of the solution alone may cause."""
        diagonal = self.A.getDiagonal()
        diagonal.pointwiseMult(diagonal, self.x)
        size = diagonal.norm()
        diagonal.destroy()
        return ROUNDINGS * np.finfo(float).eps * size

    def _refine(self):
        correction = self.x.duplicate()
        self._solve(self.r, correction)
        self.x.axpy(1, correction)
        correction.destroy()
        self.counts.refinements += 1


def _refused(error):
    """Return what to say where PETSc gives up with an error of its own."""
    if error.ierr == OUT_OF_MEMORY:
        return "PETSc is out of memory; lower mesh.cells"
    return (
        f"PETSc gave up with its error {error.ierr}; check solver.options, and the viscosities and "
        "walls if there are none"
    )

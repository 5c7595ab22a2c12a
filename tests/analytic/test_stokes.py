"""Stokes flow against exact solutions: orders, a viscosity jump, extremes, walls."""

from itertools import chain, repeat

import basix
import numpy as np
import pytest
import ufl
from dolfinx import fem

from meshes.box import section_mesh
from restoration.bench.boxes import Solved, cell_viscosity, unit_square
from restoration.bench.exact import manufactured, solcx
from restoration.bench.solutions import solcx_density
from restoration.bench.solving import sinking_block
from restoration.errors import SolveError, TooLargeError
from restoration.scene import SolverPlan, Wall
from restoration.solvers import DirectSolver, choose_solver
from restoration.spaces import Spaces
from restoration.stokes import StokesProblem

NO_SLIP = Wall("no-slip", (0.0, 0.0), (0.0, 0.0))
SLIP_X = Wall("free-slip", (0.0, None), (0.0, 0.0))
SLIP_Z = Wall("free-slip", (None, 0.0), (0.0, 0.0))
NO_SLIP_BOX = dict.fromkeys(("left", "right", "base", "surface"), NO_SLIP)
SLIP_BOX = {"left": SLIP_X, "right": SLIP_X, "base": SLIP_Z, "surface": SLIP_Z}


def square(n, surface=((0, 1), (1, 1)), base=((0, 0), (1, 0)), up=None):
    section = section_mesh(np.array(surface, float), np.array(base, float), (n, up or n))
    return section, Spaces(section)


def problem(section, spaces, rho, eta, walls, eta0=1.0, gravity=1.0, closed=True):
    return StokesProblem(section, spaces, rho, eta, eta0, walls, gravity, closed, steady=False)


def solved(stokes):
    """The flow of a problem, assembled and solved."""
    stokes.assemble()
    return stokes.solve()


def errors(spaces, flow, exact):
    """Relative L2 errors of velocity and pressure (both of mean zero)."""
    dx = ufl.Measure("dx", spaces.V.mesh, metadata={"quadrature_degree": 6})
    points = fem.FunctionSpace(
        spaces.V.mesh, ufl.VectorElement("Quadrature", "triangle", 6, 3, quad_scheme="default")
    )
    reference = fem.Function(points)
    rule, _ = basix.make_quadrature(basix.CellType.triangle, 6)
    mesh = spaces.V.mesh
    corners = mesh.geometry.x[mesh.geometry.dofmap.array.reshape(-1, 3), :2]
    hat = np.column_stack([1 - rule.sum(axis=1), rule])
    u, p = exact(np.einsum("qk,ckd->cqd", hat, corners).reshape(-1, 2))
    reference.x.array[:] = np.column_stack([u, p]).ravel()
    uh, ph = fem.Function(spaces.V), fem.Function(spaces.Q)
    uh.x.array[:], ph.x.array[:] = flow.u.ravel(), flow.p

    def norm2(v):
        return fem.assemble_scalar(fem.form(ufl.inner(v, v) * dx))

    area = norm2(fem.Constant(spaces.V.mesh, 1.0))
    p_exact = reference[2]
    shift = fem.assemble_scalar(fem.form((ph - p_exact) * dx)) / area
    level = fem.assemble_scalar(fem.form(p_exact * dx)) / area
    u_exact = ufl.as_vector([reference[0], reference[1]])
    return (
        np.sqrt(norm2(uh - u_exact) / norm2(u_exact)),
        np.sqrt(norm2(ph - p_exact - shift) / norm2(p_exact - level)),
    )


def observed_orders(h, error):
    return np.diff(np.log(error)) / np.diff(np.log(h))


def manufactured_errors(n):
    section, spaces = square(n)
    x, z = ufl.SpatialCoordinate(section.mesh)
    u = ufl.as_vector(
        [
            ufl.sin(ufl.pi * x) ** 2 * ufl.sin(2 * ufl.pi * z),
            -ufl.sin(2 * ufl.pi * x) * ufl.sin(ufl.pi * z) ** 2,
        ]
    )
    p = ufl.cos(ufl.pi * x) * ufl.cos(ufl.pi * z)
    eta = 1 + x * z
    stress = 2 * eta * ufl.sym(ufl.grad(u)) - p * ufl.Identity(2)
    stokes = problem(section, spaces, fem.Constant(section.mesh, 0.0), eta, NO_SLIP_BOX)
    v, _ = ufl.TestFunctions(spaces.W)
    stokes.load = fem.form(
        ufl.inner(-ufl.div(stress), v) * ufl.dx(metadata={"quadrature_degree": 8})
    )
    return errors(spaces, solved(stokes), manufactured)


def test_taylor_hood_orders():
    n = np.array([8, 16, 32])
    u_error, p_error = np.transpose([manufactured_errors(k) for k in n])
    assert observed_orders(1 / n, u_error)[-1] == pytest.approx(3, abs=0.1)
    assert observed_orders(1 / n, p_error)[-1] == pytest.approx(2, abs=0.25)


def solcx_flow(n, contrast):
    section, spaces = square(n)
    x, z = ufl.SpatialCoordinate(section.mesh)
    eta = fem.Function(spaces.D)
    eta.x.array[:] = np.where(section.corners[:, :, 0].mean(axis=1) < 0.5, 1, contrast)
    rho = -ufl.sin(ufl.pi * z) * ufl.cos(ufl.pi * x)
    eta0 = min(1, contrast)
    return spaces, solved(problem(section, spaces, rho, eta / eta0, SLIP_BOX, eta0))


# Points and values of the reference table computed independently by finite differences (1e-14).
SOLCX_REFERENCE = np.array(
    [
        [0.1, 0.15, -0.0009167767030607336, 0.0012443426251518245, -0.2237263821183636],
        [0.25, 0.5, 0.0, -0.0006267919372958401, 0.0],
        [0.4, 0.15, -0.0005301140388350611, -0.0013003619291142947, -0.20457445885652364],
        [0.6, 0.15, -4.274843611221158e-08, -1.1907121692024764e-08, -0.04817671284544756],
    ]
)


def test_exact_solcx_meets_the_reference():
    u, p = solcx(1e6)(SOLCX_REFERENCE[:, :2])
    assert np.abs(np.column_stack([u, p]) - SOLCX_REFERENCE[:, 2:]).max() < 1e-14


def test_viscosity_jump_on_a_mesh_line():
    spaces, flow = solcx_flow(64, 1e6)
    u_error, _ = errors(spaces, flow, solcx(1e6))
    assert u_error < 2e-5


@pytest.mark.parametrize("contrast", [1e-9, 1e-6, 1, 1e3, 1e9, 1e12])
def test_residual_stays_small_at_any_contrast(contrast):
    spaces, flow = solcx_flow(16, contrast)
    assert flow.residual < 1e-8
    if contrast < 1:  # the mirror image of a contrast above one, of another viscosity
        return
    assert errors(spaces, flow, solcx(contrast))[0] < 2e-3


@pytest.mark.parametrize("contrast", [1e-9, 1e9])
@pytest.mark.parametrize("blobs", ["random", "layer"])
def test_residual_in_rough_sections(contrast, blobs):
    section, spaces = square(20)
    centre = section.corners.mean(axis=1)
    if blobs == "random":
        weak = np.random.default_rng(3).random(len(centre)) < 0.5
    else:
        weak = np.abs(centre[:, 1] - 0.51) < 0.04
    eta, rho = fem.Function(spaces.D), fem.Function(spaces.D)
    eta.x.array[:] = np.where(weak, contrast, 1) / min(contrast, 1)
    rho.x.array[:] = np.where(weak, 2000, 2600)
    flow = solved(problem(section, spaces, rho, eta, SLIP_BOX, min(contrast, 1), 9.81))
    assert flow.residual < 1e-8
    assert np.isfinite(flow.u).all()


def test_a_uniform_section_rests_under_its_weight():
    section, spaces = square(8)
    rho = fem.Constant(section.mesh, 2600.0)
    flow = solved(
        problem(section, spaces, rho, fem.Constant(section.mesh, 1.0), SLIP_BOX, 1e19, 9.81)
    )
    depth = 1 - spaces.Q.tabulate_dof_coordinates()[:, 1]
    assert flow.p == pytest.approx(2600 * 9.81 * depth, abs=1e-6)
    assert np.abs(flow.u).max() < 1e-12 * 2600 * 9.81 / 1e19


def test_traction_and_prescribed_velocity():
    """Pure shear: the right wall moves out at 2, the top stands under a pressure of 7."""
    section, spaces = square(4)
    walls = {
        "left": SLIP_X,
        "base": SLIP_Z,
        "right": Wall("velocity", (2.0, None), (0.0, 0.0)),
        "surface": Wall("traction", (None, None), (0.0, -7.0)),
    }
    one = fem.Constant(section.mesh, 3.0)
    flow = solved(
        problem(section, spaces, fem.Constant(section.mesh, 0.0), one, walls, 1.0, 1.0, False)
    )
    at = spaces.V.tabulate_dof_coordinates()[:, :2]
    assert flow.u == pytest.approx(at * (2, -2), abs=1e-10)
    assert flow.p == pytest.approx(7 - 2 * 3 * 2, abs=1e-9)


def test_nothing_flows_through_an_inclined_free_slip_surface():
    """Flow over an inclined surface keeps u.n = 0 there, better with a finer mesh."""
    leak = []
    for n in (8, 16):
        section, spaces = square(n, surface=((0, 1), (1, 1.3)))
        x, _ = ufl.SpatialCoordinate(section.mesh)
        walls = {**SLIP_BOX, "base": NO_SLIP}
        stokes = problem(section, spaces, ufl.cos(2 * x), fem.Constant(section.mesh, 1.0), walls)
        u = fem.Function(spaces.V)
        u.x.array[:] = solved(stokes).u.ravel()
        normal = ufl.dot(u, ufl.FacetNormal(section.mesh))
        top = spaces.ds(section.wall_tags["surface"])
        through = fem.assemble_scalar(fem.form(normal**2 * top))
        along = fem.assemble_scalar(fem.form(ufl.inner(u, u) * top))
        leak.append(np.sqrt(through / along))
    assert leak[0] < 5e-3
    assert leak[1] < leak[0] / 2


def test_a_mirrored_section_gives_the_mirrored_flow():
    section, spaces = square(12)
    x, z = ufl.SpatialCoordinate(section.mesh)
    flows = []
    for side in (x, 1 - x):
        eta = 1 + 100 * ufl.exp(-20 * ((side - 0.3) ** 2 + (z - 0.4) ** 2))
        rho = 2000 + 500 * ufl.cos(3 * side) * z
        flows.append(solved(problem(section, spaces, rho, eta, SLIP_BOX)).u)
    at = np.round(spaces.V.tabulate_dof_coordinates()[:, :2], 9)
    order = np.lexsort(at.T)
    mirror = np.lexsort(np.column_stack([np.round(1 - at[:, 0], 9), at[:, 1]]).T)
    assert flows[0][order] == pytest.approx(
        flows[1][mirror] * (-1, 1), abs=1e-10 * np.abs(flows[0]).max()
    )


def test_a_section_that_nothing_holds_is_refused():
    section, spaces = square(6)
    loose = Wall("traction", (None, None), (0.0, 0.0))
    walls = dict.fromkeys(NO_SLIP_BOX, loose)
    one = fem.Constant(section.mesh, 1.0)
    with pytest.raises(SolveError):
        solved(problem(section, spaces, one, one, walls, closed=False))


class Mumps:
    """Stands for a solver whose factorisations end as told."""

    def __init__(self, ends, workspaces):
        self.ends, self.workspaces = chain(ends, repeat(ends[-1])), workspaces

    def solve(self, b, x):
        self.end = next(self.ends)

    def setOperators(self, _):
        pass

    def getPC(self):
        return self

    def getFactorSolverType(self):
        return "mumps"

    def getFactorMatrix(self):
        return self

    def getMumpsInfog(self, _):
        return self.end

    def getConvergedReason(self):
        return 4 if self.end == 0 else -11


@pytest.mark.parametrize(
    ("ends", "error", "message", "tried"),
    [
        ([-13], TooLargeError, "does not fit into memory", []),
        ([-9, -13], TooLargeError, "does not fit into memory", [1]),
        ([-9], SolveError, r"INFOG\(1\) = -9.*mat_mumps_icntl_14", [1, 2, 2, 2]),
        ([-10], SolveError, "check that the walls hold the section", [0]),
    ],
)
def test_a_factorisation_that_fails_is_grown_or_told(ends, error, message, tried):
    section, spaces = square(4)
    one = fem.Constant(section.mesh, 1.0)
    stokes = problem(section, spaces, one, one, SLIP_BOX)
    workspaces = []
    stokes.solver.ksp = Mumps(ends, workspaces)
    stokes.solver._make = lambda: workspaces.append(stokes.solver._workspace)
    with pytest.raises(error, match=message):
        solved(stokes)
    assert workspaces == tried


def test_nan_never_leaves_the_solver():
    section, spaces = square(6)
    eta = fem.Function(spaces.D)
    eta.x.array[:] = 1
    eta.x.array[3] = np.nan
    with pytest.raises(SolveError):
        solved(problem(section, spaces, fem.Constant(section.mesh, 1.0), eta, SLIP_BOX))


def sinking(contrast, solver, n=20, element="P2-P1"):
    return sinking_block(2, n, contrast, solver, element)


@pytest.mark.parametrize("element", ["P2-P1", "P2b-P1dg", "P2-P1dg", "MINI", "Q2-Q1", "Q2-P1dg"])
def test_the_field_split_finds_the_flow_of_a_direct_solve(element):
    one, other = (sinking(1e4, solver, 10, element) for solver in ("direct", "fieldsplit"))
    assert other.flow.residual < 1e-8
    assert other.problem.counts.krylov_iterations <= 60
    scale = np.abs(one.flow.u).max()
    assert other.flow.u == pytest.approx(one.flow.u, abs=1e-5 * scale)


def test_a_stiff_block_that_moves_is_solved_to_rounding():
    """Its rows cancel: the residual is above 1e-8, and the fall still right."""
    soft, stiff = (sinking(contrast, "direct") for contrast in (1e6, 1e9))
    assert 1e-8 < stiff.flow.residual < 1e-4
    up = np.abs(soft.flow.u[:, 1]).max()
    assert np.abs(stiff.flow.u[:, 1]).max() == pytest.approx(up, rel=1e-3)


def test_a_contrast_beyond_double_precision_is_refused():
    with pytest.raises(SolveError, match="the viscosity contrast may be too high"):
        sinking(1e15, "direct")


def test_a_field_split_that_stalls_gives_way_to_a_direct_solver(monkeypatch):
    monkeypatch.setattr("restoration.solvers.FIELDSPLIT_FROM", {2: 0, 3: 0})
    monkeypatch.setattr("restoration.stokes.MANY_ITERATIONS", 5)
    solved = sinking(1e4, "auto", 10)
    assert isinstance(solved.problem.solver, DirectSolver)
    assert solved.problem.counts.krylov_iterations > 5
    assert solved.flow.u == pytest.approx(sinking(1e4, "direct", 10).flow.u, abs=1e-9)


def test_a_field_split_asked_for_by_name_fails_by_name():
    section = unit_square("P2-P1", 10)
    plan = SolverPlan("fieldsplit", (("ksp_max_it", "2"),))
    one = cell_viscosity(lambda x: np.where(x[:, 0] < 0.5, 1, 1e4))
    with pytest.raises(SolveError, match=r"solver: \{name: direct\}"):
        Solved(section, "P2-P1", one, solcx_density, solver=plan)


@pytest.mark.parametrize(("dim", "unknowns"), [(2, 1000), (2, 499_999), (3, 1000)])
def test_small_problems_are_solved_directly(dim, unknowns):
    assert choose_solver(None, dim, unknowns) == "direct"
    assert choose_solver(SolverPlan("fieldsplit"), dim, unknowns) == "fieldsplit"


def test_large_problems_in_three_dimensions_are_split():
    assert choose_solver(SolverPlan(), 3, 30_000) == "fieldsplit"


@pytest.mark.parametrize(
    ("name", "option", "value"),
    [
        ("fieldsplit", "velocity_mg_coarse_pc_type", "foo"),
        ("direct", "pc_factor_mat_solver_type", "foo"),
        ("fieldsplit", "velocity_pc_type", "nonsense"),
    ],
)
def test_options_that_petsc_refuses_later_are_told_too(name, option, value):
    section = unit_square("P2-P1", 4)
    one = cell_viscosity(lambda x: np.ones(len(x)))
    with pytest.raises(SolveError):
        Solved(section, "P2-P1", one, solcx_density, solver=SolverPlan(name, ((option, value),)))


def test_options_that_petsc_cannot_read_are_told():
    section = unit_square("P2-P1", 4)
    plan = SolverPlan("direct", (("ksp_type", "mumps"),))
    one = cell_viscosity(lambda x: np.ones(len(x)))
    with pytest.raises(SolveError, match=r"ksp_type: mumps.*see solver\.options"):
        Solved(section, "P2-P1", one, solcx_density, solver=plan)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("contrast", [1e-9, 1e-6, 1e-3, 1e3])
def test_the_field_split_finds_the_velocity_or_says_that_it_does_not(dim, contrast):
    """A residual of 1e-8 came with a velocity 75 times too large: the load is hydrostatic."""
    n = {2: 16, 3: 4}[dim]
    expected = sinking_block(dim, n, contrast, "direct", rough=True).flow.u
    if contrast < 1e-3:
        with pytest.raises(SolveError, match="too rough"):
            sinking_block(dim, n, contrast, "fieldsplit", rough=True)
    else:
        found = sinking_block(dim, n, contrast, "fieldsplit", rough=True).flow.u
        assert np.linalg.norm(found - expected) < 1e-4 * np.linalg.norm(expected)
    fallen_back = sinking_block(dim, n, contrast, "auto", rough=True).flow.u
    assert np.linalg.norm(fallen_back - expected) < 1e-4 * np.linalg.norm(expected)

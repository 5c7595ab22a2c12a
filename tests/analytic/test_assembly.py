"""Assembly by known places against the general one, and solves that begin from earlier ones."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from petsc4py import PETSc

from meshes.box import section_mesh
from restoration.assembly import Assembler, CellAssembler
from restoration.bench.boxes import free_slip_walls, unit_cube
from restoration.scene import SolverPlan
from restoration.spaces import Spaces
from restoration.stokes import Past, StokesProblem
from tests.analytic.test_stokes import NO_SLIP, SLIP_BOX, problem, solved, square

SLOPE = ((0, 1), (1, 1.3))


def difference(one, other):
    """The largest entry by which the matrices of two problems differ, over the largest."""
    rest = one.A.copy()
    rest.axpy(-1.0, other.A, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
    values = np.abs(rest.getValuesCSR()[2]).max(initial=0.0)
    return values / np.abs(other.A.getValuesCSR()[2]).max()


def twice(make, monkeypatch):
    """A problem that is assembled by known places, and the same one in the general way."""
    known = make()
    assert isinstance(known._assembler, CellAssembler)
    monkeypatch.setattr(CellAssembler, "serves", lambda *_: False)
    general = make()
    assert isinstance(general._assembler, Assembler)
    for one in (known, general):
        one.assemble()
    return known, general


@pytest.mark.parametrize("element", ["P2-P1", "P2b-P1dg", "MINI", "Q2-Q1"])
@pytest.mark.parametrize("surface", [((0, 1), (1, 1)), SLOPE])
def test_known_places_give_the_matrix_of_the_general_assembly(element, surface, monkeypatch):
    cell = "quadrilateral" if element.startswith("Q") else "triangle"
    base = np.array([[0, 0], [1, 0]], float)
    section = section_mesh(np.array(surface, float), base, (4, 3), cell)
    spaces = Spaces(section, element)
    x, z = ufl.SpatialCoordinate(section.mesh)
    eta = fem.Function(spaces.H)
    eta.interpolate(lambda at: 1 + at[0] + 3 * at[1])
    walls = {**SLIP_BOX, "base": NO_SLIP}
    known, general = twice(lambda: problem(section, spaces, x * z, eta, walls), monkeypatch)
    assert difference(known, general) < 1e-14
    section.mesh.geometry.x[:, 0] += 0.03 * np.sin(3 * section.mesh.geometry.x[:, 1])
    eta.x.array[:] *= 1.5
    for one in (known, general):
        one.assemble()
    assert difference(known, general) < 1e-14


def test_known_places_in_three_dimensions(monkeypatch):
    section = unit_cube(2, "tetrahedron")
    spaces = Spaces(section, "P2-P1")
    one = fem.Constant(section.mesh, 1.0)

    def make():
        walls = free_slip_walls(3)
        return StokesProblem(section, spaces, one, one, 1.0, walls, 1.0, True, steady=False)

    assert difference(*twice(make, monkeypatch)) < 1e-14


def moving(contrast, follows=True, n=16, solver=None):
    """A problem with a round inclusion, a function that moves its mesh sideways, and eta."""
    section, spaces = square(n)
    centre = section.corners.mean(axis=1)
    eta, rho = fem.Function(spaces.D), fem.Function(spaces.D)
    rho.x.array[:] = 1 + (np.hypot(*(centre - [0.4, 0.5]).T) < 0.25)
    eta.x.array[:] = np.where(rho.x.array > 1, contrast, 1.0)
    stokes = StokesProblem(
        section, spaces, rho, eta, 1.0, SLIP_BOX, 1.0, True, False, solver, follows=follows
    )
    made = section.mesh.geometry.x.copy()

    def flow_at(time):
        bump = np.sin(np.pi * made[:, 0]) * np.sin(np.pi * made[:, 1])
        section.mesh.geometry.x[:, 0] = made[:, 0] + 0.2 * (time or 0) / n * bump
        stokes.set_time(None if time is None else 1e9 * time)
        return solved(stokes).u

    return stokes, flow_at, eta


@pytest.mark.parametrize(("contrast", "most"), [(1.0, 2), (1e2, 3), (1e4, 6)])
def test_factors_of_a_mesh_that_moves_serve_again(contrast, most):
    """Eight solves over a move of a fifth of a cell each, with the answer of new factors."""
    stokes, flow_at, _ = moving(contrast)
    fresh, exact_at, _ = moving(contrast, follows=False)
    for time in range(8):
        u, exact = flow_at(time), exact_at(time)
        assert np.abs(u - exact).max() < 1e-8 * np.abs(exact).max()
    assert fresh.counts.factorisations == 8
    assert stokes.counts.factorisations <= most
    assert stokes.counts.krylov_iterations > 8


def test_factors_that_do_not_serve_are_made_anew():
    """Another inclusion elsewhere: the old factors are given up, and the answer is right."""
    stokes, flow_at, eta = moving(1e6)
    _, exact_at, other = moving(1e6, follows=False)
    flow_at(0)
    eta.x.array[:] = other.x.array[:] = eta.x.array[::-1].copy()
    again = flow_at(1)
    assert again == pytest.approx(exact_at(1), abs=1e-8 * np.abs(again).max())
    assert stokes.counts.factorisations == 2


def test_a_field_split_is_set_up_for_every_matrix():
    """What was set up for the inclusion elsewhere would take many times the iterations."""
    plan = SolverPlan("fieldsplit")
    stokes, flow_at, eta = moving(1e4, solver=plan)
    fresh, fresh_at, other = moving(1e4, solver=plan)
    flow_at(0)
    before = stokes.counts.krylov_iterations
    eta.x.array[:] = other.x.array[:] = eta.x.array[::-1].copy()
    flow_at(None)
    fresh_at(None)
    again, alone = stokes.counts.krylov_iterations - before, fresh.counts.krylov_iterations
    assert again <= 1.2 * alone
    assert stokes.counts.factorisations == 2


def test_solves_of_one_time_share_their_factors():
    """As the two middle stages of rk4 do, between which the rock has hardly moved."""
    stokes, flow_at, _ = moving(1e2, follows=False)
    for time in (0, 0.5, 0.5, 1, 1, 1.5):
        flow_at(time)
    assert stokes.counts.factorisations == 4


def test_what_a_solution_may_be_is_a_parabola_through_the_last_ones():
    x = PETSc.Vec().createSeq(2)
    past = Past(x)
    assert not past.guess(0.0, x)

    def solution(time):
        return np.array([1 + time, 2 - 3 * time + 0.5 * time**2])

    for time in (0.0, 10.0, 20.0, 40.0):
        x.array[:] = solution(time)
        past.keep(time, x)
    x.array[:] = solution(40.0) + 1
    past.keep(40.0, x)  # the last solve of a time counts
    assert past.guess(50.0, x)
    more = np.prod([50 - t for t in (10, 20)]) / np.prod([40 - t for t in (10, 20)])
    assert x.array == pytest.approx(solution(50.0) + more)
    assert past.guess(40.0, x)
    assert x.array == pytest.approx(solution(40.0) + 1)
    past.guess(400.0, x)  # too far: the last one
    assert x.array == pytest.approx(solution(40.0) + 1)
    past.release()

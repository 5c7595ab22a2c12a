"""Walls of the Stokes problem: inclined ones, loads, corners and what does not balance."""

import numpy as np
import pytest
import ufl
from dolfinx import fem
from scipy.sparse import csr_matrix

from restoration.scene import Table, Wall
from tests.analytic.test_stokes import NO_SLIP, SLIP_BOX, SLIP_X, SLIP_Z, problem, solved, square

SLOPE = ((0, 1), (1, 1.3))


def test_the_reference_viscosity_does_not_show_on_an_inclined_wall():
    """A viscosity of 1000 is 1000 times 1 and once 1000."""
    section, spaces = square(6, surface=SLOPE)
    x, _ = ufl.SpatialCoordinate(section.mesh)
    flows = [
        solved(
            problem(
                section,
                spaces,
                ufl.cos(2 * x),
                fem.Constant(section.mesh, 1e3 / eta0),
                {**SLIP_BOX, "base": NO_SLIP},
                eta0,
            )
        ).u
        for eta0 in (1.0, 1e3)
    ]
    assert flows[0] == pytest.approx(flows[1], abs=1e-9 * np.abs(flows[1]).max())


def test_the_matrix_is_symmetric_with_an_inclined_wall():
    section, spaces = square(3, surface=SLOPE)
    eta = 1 + ufl.SpatialCoordinate(section.mesh)[0]
    stokes = problem(section, spaces, fem.Constant(section.mesh, 1.0), eta, SLIP_BOX)
    stokes.assemble()
    rows, columns, values = stokes.A.getValuesCSR()
    matrix = csr_matrix((values, columns, rows))
    assert abs(matrix - matrix.T).max() < 1e-12 * abs(matrix).max()


def test_a_uniform_section_rests_under_an_inclined_free_slip_surface():
    section, spaces = square(4, surface=SLOPE)
    one = fem.Constant(section.mesh, 1.0)
    flow = solved(problem(section, spaces, one, one, SLIP_BOX))
    z = spaces.Q.tabulate_dof_coordinates()[:, 1]
    assert np.abs(flow.u).max() < 1e-10
    assert flow.p == pytest.approx(1.15 - z, abs=1e-9)  # zero on average along the surface


def test_what_corners_take_from_a_wall_is_spread_over_the_section():
    """In on the left and out at the top; the no-slip base takes its corner's share, a sixth.

    The pressure is pinned at one vertex: without the spread, that vertex would be the source.
    """
    n = 6
    section, spaces = square(n)
    walls = {
        "left": Wall("velocity", (1.0, None), (0.0, 0.0)),
        "right": SLIP_X,
        "base": NO_SLIP,
        "surface": Wall("velocity", (None, 1.0), (0.0, 0.0)),
    }
    one = fem.Constant(section.mesh, 1.0)
    stokes = problem(section, spaces, fem.Constant(section.mesh, 0.0), one, walls)
    assert stokes.leak == pytest.approx(1 / n / 6)
    u = fem.Function(spaces.V)
    u.x.array[:] = solved(stokes).u.ravel()
    q = ufl.TestFunction(spaces.Q)
    swelling, share = (
        fem.petsc.assemble_vector(fem.form(rate * q * spaces.dx)).array
        for rate in (ufl.div(u), one)
    )
    assert swelling / share == pytest.approx(1 / n / 6, abs=1e-9)


@pytest.mark.parametrize("order", [("left", "base"), ("base", "left")])
def test_a_no_slip_wall_holds_its_corners(order):
    """Whatever moves the wall beside it, and in whatever order they are given."""
    section, spaces = square(3)
    beside = {"left": Wall("velocity", (1.0, 2.0), (0.0, 0.0)), "base": NO_SLIP}
    free = Wall("traction", (None, None), (0.0, 0.0))
    walls = {name: beside[name] for name in order} | {"right": free, "surface": free}
    one = fem.Constant(section.mesh, 1.0)
    flow = solved(problem(section, spaces, one, one, walls, closed=False))
    x, z = spaces.V.tabulate_dof_coordinates()[:, :2].T
    assert np.abs(flow.u[z < 1e-9]).max() < 1e-12
    assert flow.u[(x < 1e-9) & (z > 1e-9)] == pytest.approx(np.array([[1, 2]] * 6), abs=1e-12)


def test_a_load_raises_the_pressure_by_itself():
    """5 MPa on rock of 1e19 Pa s that cannot give way."""
    section, spaces = square(3)
    one = fem.Constant(section.mesh, 1.0)
    rho = fem.Constant(section.mesh, 2600.0)
    unloaded, loaded = (
        solved(
            problem(
                section,
                spaces,
                rho,
                one,
                {"left": SLIP_X, "right": SLIP_X, "base": SLIP_Z}
                | {"surface": Wall("traction", (None, None), (0.0, -load))},
                1e19,
                9.81,
                closed=False,
            )
        ).p
        for load in (0.0, 5e6)
    )
    assert loaded - unloaded == pytest.approx(5e6, rel=1e-6)


def held(u, w):
    return Wall("velocity", (u, w), (0.0, 0.0))


def test_simple_shear_from_tables_along_a_wall_and_in_time():
    """u = g(t) z on a square, before and after its nodes have moved: linear, so exact."""
    section, spaces = square(3)
    along = Table(1, (-1.0, 2.0), (0.0, 2.0), ((-1.0, 2.0), (-3.0, 6.0)))  # (1 + t) z
    top = Table(0, (0.0,), (0.0, 2.0), ((1.0,), (3.0,)))
    walls = {"left": held(along, 0.0), "right": held(along, 0.0), "base": NO_SLIP}
    walls["surface"] = held(top, 0.0)
    one = fem.Constant(section.mesh, 1.0)
    stokes = problem(section, spaces, fem.Constant(section.mesh, 0.0), one, walls)
    for time in (0.5, 1.5):
        stokes.set_time(time)
        z = spaces.V.tabulate_dof_coordinates()[:, 1]
        exact = np.column_stack([(1 + time) * z, 0 * z])
        assert solved(stokes).u == pytest.approx(exact, abs=1e-9)
        assert stokes.leak == pytest.approx(0, abs=1e-12)

    walls["surface"] = Wall("traction", (None, None), (1.0, 0.0))  # eta du/dz at time 0
    stokes = problem(section, spaces, fem.Constant(section.mesh, 0.0), one, walls, closed=False)
    section.mesh.geometry.x[:, 1] *= 1.5
    stokes.set_time(0.0)
    z = spaces.V.tabulate_dof_coordinates()[:, 1]
    assert z.max() == pytest.approx(1.5)
    assert solved(stokes).u == pytest.approx(np.column_stack([z, 0 * z]), abs=1e-9)


def test_pure_shear_from_tables_in_time():
    section, spaces = square(3)
    right, top = (
        Table(1 - axis, (0.0,), (0.0, 1.0), ((0.0,), (s,))) for axis, s in ((0, 2), (1, -2))
    )
    walls = {"left": SLIP_X, "right": held(right, None), "base": SLIP_Z, "surface": held(None, top)}
    one = fem.Constant(section.mesh, 1.0)
    stokes = problem(section, spaces, fem.Constant(section.mesh, 0.0), one, walls)
    for time, rate in ((0.25, 0.5), (3.0, 2.0)):
        stokes.set_time(time)
        x, z = spaces.V.tabulate_dof_coordinates()[:, :2].T
        assert solved(stokes).u == pytest.approx(rate * np.column_stack([x, -z]), abs=1e-9)


def test_the_leak_follows_the_time():
    section, spaces = square(2)
    right = Table(1, (0.0, 1.0), (0.0, 1.0), ((0.0, 0.0), (0.0, 3.0)))
    walls = SLIP_BOX | {"right": held(right, None)}
    one = fem.Constant(section.mesh, 1.0)
    stokes = problem(section, spaces, one, one, walls)
    assert stokes.leak == 0
    stokes.set_time(0.5)
    assert stokes.leak == pytest.approx(0.75)


def test_a_load_that_varies_along_the_surface_and_in_time():
    """Weak enough to be carried: the force on the base is the load, at either time."""
    section, spaces = square(4)
    load = Table(0, (0.0, 1.0), (0.0, 1.0), ((-1.0, -1.0), (-1.0, -3.0)))
    walls = {"left": SLIP_X, "right": SLIP_X, "base": SLIP_Z}
    walls["surface"] = Wall("traction", (None, None), (0.0, load))
    one = fem.Constant(section.mesh, 1.0)
    stokes = problem(section, spaces, fem.Constant(section.mesh, 0.0), one, walls, closed=False)
    u, p = fem.Function(spaces.V), fem.Function(spaces.Q)
    base = spaces.ds(section.wall_tags["base"])
    force = fem.form((p - 2 * ufl.grad(u)[1, 1]) * base)
    for time, mean in ((0.0, 1.0), (0.5, 1.5), (1.0, 2.0)):
        stokes.set_time(time)
        flow = solved(stokes)
        u.x.array[:], p.x.array[:] = flow.u.ravel(), flow.p
        assert fem.assemble_scalar(force) == pytest.approx(mean, rel=0.02)

"""What is asked of a solution, each with the fault that it is to find."""

from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest
import ufl
from dolfinx import fem

from meshes.box import box_mesh, section_mesh
from restoration import acceptance
from restoration.acceptance import CONTRAST, Divergence, add_up, climbed
from restoration.bench.boxes import unit_square
from restoration.errors import SolveError, TooLargeError
from restoration.spaces import Spaces
from tests.analytic.test_stokes import NO_SLIP_BOX, problem, square


def climb(*rungs):
    """Climb rungs, each given by what is found doubtful after it or by the error it raises."""
    done, found = [], iter(rungs)

    def task(name, rung):
        done.append(name)
        if isinstance(rung, Exception):
            next(found)
            raise rung

    made = ((f"r{i}", lambda i=i, rung=rung: task(i, rung)) for i, rung in enumerate(rungs))
    try:
        return climbed(made, lambda: next(found)), done
    except SolveError as error:
        return error, done


def test_the_first_rung_that_can_be_trusted_is_the_last():
    assert climb(None, None) == (["r0"], [0])
    assert climb("doubt", None, None) == (["r0", "r1"], [0, 1])
    assert climb(SolveError("met; do this"), "doubt", None) == (["r0", "r1", "r2"], [0, 1, 2])


def test_what_every_rung_met_is_told_with_the_first_advice():
    error, _ = climb("doubt", SolveError("met"), SolveError("too; do this; or that"), "more")
    assert str(error) == (
        "the Stokes solve failed (r0: doubt, then r1: met, then r2: too, then r3: more); "
        "do this; or that"
    )
    assert str(climb(SolveError("a; first"), SolveError("b; second"))[0]).endswith("; first")
    assert str(climb("doubt")[0]) == f"the Stokes solve failed (r0: doubt); {CONTRAST}"


def test_no_other_rung_makes_more_memory():
    error, done = climb("doubt", TooLargeError("large"), None)
    assert isinstance(error, TooLargeError)
    assert done == [0, 1]


class Vector:
    """A vector of two ranks that have the same, as far as `add_up` looks at it."""

    def __init__(self, values, after, size=2):
        self.array_r, self.after, self.told = np.array(values), after, []
        comm = SimpleNamespace(size=size, allreduce=lambda parts, op: 2 * parts)
        self.comm = SimpleNamespace(tompi4py=lambda: comm)

    def localForm(self):
        return nullcontext(self)

    def ghostUpdate(self, addv, mode):
        self.told.append((addv, mode))

    def sum(self):
        return self.after


@pytest.mark.parametrize(
    ("after", "sound"), [(4 + 6e-8, True), (4 + 1e-7, False), (4 - 1e-7, False)]
)
def test_a_load_that_is_lost_between_ranks_is_told(after, sound):
    """The sums are 4 and, of the absolute values, 8."""
    vector = Vector([3.0, -1.0], after)
    if sound:
        add_up(vector)
    else:
        with pytest.raises(SolveError, match="the load is not what the ranks have made of it"):
            add_up(vector)
    add, back = acceptance.PETSc.InsertMode.ADD, acceptance.PETSc.ScatterMode.REVERSE
    assert vector.told == [(add, back)]


def test_a_load_that_is_not_finite_is_told():
    with pytest.raises(SolveError):
        add_up(Vector([3.0, -1.0], np.nan))


def test_one_rank_has_nobody_to_lose_a_load_to():
    vector = Vector([3.0], 0.0, size=1)
    add_up(vector)
    assert len(vector.told) == 1


SIDE = 2.0


def plane():
    return section_mesh(*(np.array([[0, z], [SIDE, z]]) for z in (SIDE, 0.0)), (4, 4))


def nodes_and(section, element, velocity):
    """Return the divergence of a velocity, a function of the nodes (n, dim), and its rms."""
    spaces = Spaces(section, element)
    x = spaces.V.tabulate_dof_coordinates()[:, : section.dim]
    u = velocity(x)
    return Divergence(section, spaces), u, np.sqrt((u**2).sum(axis=1).mean())


def swelling(x):
    """A divergence of one everywhere."""
    u = np.zeros_like(x)
    u[:, 0] = x[:, 0] + 1.0
    return u


@pytest.mark.parametrize(
    ("section", "element", "length"),
    [
        (plane, "P2-P1", SIDE),
        (lambda: unit_square("P2-P1dg", 4), "P2-P1dg", 1.0),
        (lambda: box_mesh((0, 0, 0), (2, 2, 2), (3, 3, 3), "tetrahedron"), "P2-P1", 2.0),
    ],
)
def test_the_divergence_is_that_of_the_velocity(section, element, length):
    section = section()
    divergence, u, rms = nodes_and(section, element, swelling)
    assert divergence(u) == pytest.approx(length / rms, rel=1e-12)
    assert divergence(3 * u) == pytest.approx(length / rms, rel=1e-12)
    assert divergence(u, rate=1.0) < 1e-12
    assert divergence(u, rate=0.5) == pytest.approx(0.5 * length / rms, rel=1e-12)
    assert divergence(0 * u) == 0.0


def test_rock_that_turns_makes_no_volume():
    divergence, u, _ = nodes_and(plane(), "P2-P1", lambda x: np.column_stack([x[:, 1], -x[:, 0]]))
    assert divergence(u) < 1e-12


def test_nothing_that_moves_and_ought_to_swell_is_told():
    divergence, u, _ = nodes_and(plane(), "P2-P1", np.zeros_like)
    assert divergence(u, rate=1.0) > 0.5
    assert not np.isfinite(divergence(u + np.nan))


def at_wall(x):
    """Motion of the middles of the edges on the left wall, of which only cells there know."""
    u = np.zeros_like(x)
    squares = 4 * x[:, 1] / SIDE
    u[(x[:, 0] < 1e-9) & (np.abs(squares % 1 - 0.5) < 1e-9), 0] = 1.0
    return u


def test_what_only_cells_at_a_wall_make_is_not_looked_at():
    divergence, u, _ = nodes_and(plane(), "P2-P1dg", at_wall)
    assert divergence(u) < 1e-12
    assert u.any()


def test_of_hats_those_at_a_wall_are_not_looked_at():
    section, spaces = (found := plane()), Spaces(found, "P2-P1")
    divergence, u, rms = nodes_and(section, "P2-P1", at_wall)
    function, q = fem.Function(spaces.V), ufl.TestFunction(spaces.H)
    function.x.array[:] = u.ravel()
    off = fem.petsc.assemble_vector(fem.form(q * ufl.div(function) * spaces.dx)).array
    weights = fem.petsc.assemble_vector(fem.form(q * spaces.dx)).array
    x = spaces.H.tabulate_dof_coordinates()[:, :2]
    inner = ((x > 1e-9) & (x < SIDE - 1e-9)).all(axis=1)
    assert 0 < inner.sum() < len(inner)
    wanted = np.sqrt((off**2 / weights)[inner].sum() / weights[inner].sum())
    assert divergence(u) == pytest.approx(SIDE * wanted / rms, rel=1e-10)


class Changed:
    """A matrix whose products are changed."""

    def __init__(self, stokes, of_velocity=1.0, of_pressure=1.0):
        self.A, self.factors = stokes.A, (of_velocity, of_pressure)
        self.rows = stokes.spaces.v_in_w, stokes.spaces.q_in_w

    def mult(self, x, y):
        self.A.mult(x, y)
        for rows, factor in zip(self.rows, self.factors, strict=True):
            y.array_w[rows] *= factor


@pytest.fixture(scope="module")
def stokes():
    section, spaces = square(4)
    made = problem(section, spaces, 1.0, 1.0, NO_SLIP_BOX)
    made.assemble()
    return made


def test_the_matrix_of_a_flow_is_sound(stokes):
    assert stokes._probe(stokes.A) is None


def test_blocks_of_the_pressure_that_are_not_those_of_a_flow_are_told(stokes):
    """Rise by one at the 88 inner edges of 64 triangles: 11/12 of the section, over the length."""
    work = 11 / 12 * np.sqrt(64)
    told = stokes._probe(Changed(stokes, of_pressure=2.0))
    assert told == (
        f"the blocks of the pressure are not those of a flow ({work:.2e} and {2 * work:.2e} "
        "instead of two of the same above zero)"
    )
    assert "not those of a flow" in stokes._probe(Changed(stokes, of_pressure=1 + 1e-7))
    assert stokes._probe(Changed(stokes, of_pressure=1 + 1e-10)) is None
    assert "not those of a flow" in stokes._probe(Changed(stokes, -1.0, -1.0))
    assert "not those of a flow" in stokes._probe(Changed(stokes, np.nan, np.nan))
    assert "not those of a flow" in stokes._probe(Changed(stokes, 0.0, 0.0))


def test_rock_that_gains_energy_is_told(stokes):
    class Gaining(Changed):
        def mult(self, x, y):
            super().mult(x, y)
            if x.array_r[self.rows[0]].any():  # a velocity
                y.array_w[self.rows[0]] *= -1

    assert "gains energy by its viscosity" in stokes._probe(Gaining(stokes))
    stokes._probe._viscous = False
    assert stokes._probe(Gaining(stokes)) is None
    stokes._probe._viscous = True

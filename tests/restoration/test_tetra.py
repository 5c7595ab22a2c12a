"""Points and velocities in tetrahedra."""

import numpy as np
import pytest
from dolfinx import fem

from meshes.body_centred import body_centred_mesh
from meshes.box import box_mesh
from restoration.particles import OUTSIDE, CellIndex
from restoration.sampling import VelocitySampler
from restoration.scene import Transfer
from restoration.snapshot import FieldSnapshot
from restoration.spaces import Spaces
from restoration.stokes import Flow
from restoration.transfer import RockFields

LOW, HIGH = np.array([0, 0, -3.0]), np.array([4, 2, 0.0])


@pytest.fixture(scope="module", params=[box_mesh, body_centred_mesh])
def index(request):
    return CellIndex(request.param(LOW, HIGH, (5, 3, 4)))


@pytest.fixture(scope="module")
def section():
    return body_centred_mesh(LOW, HIGH, (4, 2, 3))


def scattered(n=4000):
    return LOW + np.random.default_rng(0).random((n, 3)) * (HIGH - LOW)


def test_every_point_is_found_in_the_cell_that_holds_it(index):
    x, rng = scattered(), np.random.default_rng(1)
    for guess in (np.full(len(x), OUTSIDE), rng.integers(len(index.corners), size=len(x))):
        cell, hats = index.locate(x, guess)
        assert (cell != OUTSIDE).all()
        assert hats.min() > -1e-9
        assert np.einsum("nk,nkd->nd", hats, index.corners[cell]) == pytest.approx(x, abs=1e-12)


def test_points_on_walls_are_inside_and_others_are_marked(index):
    corners = np.array([[x, y, z] for x in (0, 4.0) for y in (0, 2.0) for z in (-3, 0.0)])
    middle = (LOW + HIGH) / 2
    cell, _ = index.locate(corners, np.full(8, OUTSIDE))
    assert (cell != OUTSIDE).all()
    cell, hats = index.locate(middle + 1.01 * (corners - middle), np.full(8, OUTSIDE))
    assert (cell == OUTSIDE).all()
    assert (hats == 0).all()


@pytest.mark.parametrize("element", ["P2-P1", "P2b-P1dg"])
def test_a_quadratic_velocity_is_read_exactly(section, element):
    def velocity(x):
        return np.stack([x[0] * x[1] - 1, x[2] ** 2 + x[0], x[1] * x[2] - x[0] ** 2])

    spaces = Spaces(section, element)
    x, sampler = scattered(200), VelocitySampler(spaces)
    u = fem.Function(spaces.V)
    u.interpolate(velocity)
    cell, hats = CellIndex(section).locate(x, np.full(len(x), OUTSIDE))
    found = sampler(sampler.coefficients(u.x.array.reshape(-1, 3)), cell, hats)
    assert found == pytest.approx(velocity(x.T).T, abs=1e-10)
    cell[:5] = OUTSIDE
    assert (sampler(sampler.coefficients(u.x.array.reshape(-1, 3)), cell, hats)[:5] == 0).all()


@pytest.mark.parametrize(("density", "off"), [("projection", 4e-3), ("hat", 0.05), ("cell", 4e-3)])
def test_rock_goes_to_the_mesh(section, density, off):
    """One rock is found again everywhere; of two the total is kept, by hats about."""
    spaces, index = Spaces(section), CellIndex(section)
    fields = RockFields(spaces, index, [1000, 2000], [1, 10], Transfer(density, "hat", "harmonic"))
    x = scattered(100_000)
    cell, hats = index.locate(x, np.full(len(x), OUTSIDE))
    unit, volume = np.ones(len(x), np.int16), np.ones(len(x))
    fields.fill(x, cell, hats, unit, volume)
    assert fields.rho.x.array == pytest.approx(2000)
    unit[x[:, 2] < -1.2] = 0
    fields.fill(x, cell, hats, unit, volume)
    mean = fields.density_means().mean()  # of cells of one size
    assert mean == pytest.approx(1000 + 1000 * 1.2 / 3, rel=off)
    eta = fields.viscosity_means()
    assert 1 <= eta.min() < 2 < eta.max() <= 10


def test_a_snapshot_has_quadratic_tetrahedra(section):
    """Nodes in VTK's order: after the corners the middles of the edges 01, 12, 20, 03, 13, 23."""
    spaces, index = Spaces(section), CellIndex(section)
    fields = RockFields(spaces, index, [1.0], [1.0], Transfer("hat", "hat", "harmonic"))
    snapshot = FieldSnapshot(spaces, fields, 1.0)
    nodes = snapshot.points[snapshot.cells]
    assert nodes.shape == (section.cell_count, 10, 3)
    for row, (a, b) in enumerate(((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)), start=4):
        assert nodes[:, row] == pytest.approx((nodes[:, a] + nodes[:, b]) / 2, abs=1e-12)
    n = len(snapshot.points)
    u = np.random.default_rng(0).random((n, 3))
    p = np.zeros(spaces.Q.dofmap.index_map.size_local)
    point, cell = snapshot.read(Flow(u, p, 0.0), [])
    assert (point, cell) == ({}, {})

"""Fields as they go into files: whole, and at the nodes they are said to be at."""

import numpy as np
import pytest

from restoration.engine import StokesEngine
from restoration.scene import Outline
from restoration.stokes import Flow
from tests.restoration.conftest import HEIGHT, WIDTH, diapir_scene


@pytest.fixture(scope="module")
def engine():
    relief = np.array([[0, 0], [WIDTH / 2, 500], [WIDTH, -300.0]])
    base = np.array([[0, -HEIGHT], [WIDTH, -HEIGHT]])
    return StokesEngine(diapir_scene(cells=(4, 3), outline=Outline(relief, base)))


def read(engine, names, u=lambda x, z: (0 * x, 0 * x), p=lambda x, z: 0 * x):
    """Snapshot of a velocity and a pressure given as functions of x and z."""
    at_v, at_q = (
        s.tabulate_dof_coordinates()[:, :2].T for s in (engine.grid.spaces.V, engine.grid.spaces.Q)
    )
    return engine.grid.snapshot.read(Flow(np.column_stack(u(*at_v)), p(*at_q), 0.0), names)


def test_nodes_of_a_triangle_are_in_the_order_of_vtk(engine):
    """Three corners, then the middles of edges 01, 12 and 20."""
    snapshot = engine.grid.snapshot
    node = snapshot.points[snapshot.cells]
    assert node[:, :3] == pytest.approx(engine.section.corners, abs=1e-6)
    for k in range(3):
        assert node[:, 3 + k] == pytest.approx((node[:, k] + node[:, (k + 1) % 3]) / 2, abs=1e-6)


def test_a_quadratic_velocity_is_found_inside_by_the_shape_functions_of_vtk(engine):
    def field(x, z):
        return 1 + x * z - 2 * z**2, x**2 - 3 * z

    snapshot = engine.grid.snapshot
    u = read(engine, ["velocity"], field)[0]["velocity"]
    a, b, c = weights = np.array([0.2, 0.5, 0.3])
    shape = [*weights * (2 * weights - 1), 4 * a * b, 4 * b * c, 4 * c * a]
    inside = np.einsum("k,ckd->cd", weights, engine.section.corners)
    found = np.einsum("k,ckd->cd", shape, u[snapshot.cells])
    assert found == pytest.approx(np.column_stack(field(*inside.T)), rel=1e-9)


def test_a_linear_pressure_is_linear_at_all_nodes(engine):
    def pressure(x, z):
        return 7 + 2 * x - 3 * z

    found = read(engine, ["pressure"], p=pressure)[0]["pressure"]
    assert found == pytest.approx(pressure(*engine.grid.snapshot.points.T))


@pytest.mark.parametrize(
    ("u", "invariant"),
    [
        (lambda x, z: (3e-15 * x, -3e-15 * z), 3e-15),
        (lambda x, z: (4e-15 * z, 0 * z), 2e-15),
        (lambda x, z: (4e-15 * z, -4e-15 * x), 0.0),
    ],
    ids=["pure shear", "simple shear", "rotation"],
)
def test_strain_rate_is_the_second_invariant(engine, u, invariant):
    point, cell = read(engine, ["strain_rate"], u)
    assert not point
    assert cell["strain_rate"] == pytest.approx(invariant, rel=1e-9, abs=1e-22)

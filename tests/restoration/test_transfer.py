import numpy as np
import pytest

from meshes.box import section_mesh
from restoration.particles import OUTSIDE, CellIndex
from restoration.scene import Transfer
from restoration.spaces import Spaces
from restoration.transfer import RockFields


@pytest.fixture(scope="module")
def box():
    section = section_mesh(np.array([[0, 0], [1, 0.0]]), np.array([[0, -1], [1, -1.0]]), (6, 6))
    return Spaces(section), CellIndex(section)


def scattered(index, n=4000, seed=0):
    x = np.random.default_rng(seed).random((n, 2)) * (1, -1)
    cell, weights = index.locate(x, np.full(n, OUTSIDE))
    return x, cell, weights


def filled(box, density, viscosity, transfer, unit, cloud, area=None):
    spaces, index = box
    fields = RockFields(spaces, index, density, viscosity, Transfer(*transfer))
    x, cell, weights = cloud
    area = np.ones(len(x)) if area is None else area
    fields.fill(x, cell, weights, unit.astype(np.int16), area)
    return fields


@pytest.mark.parametrize("density", ["hat", "cell", "quadrature"])
@pytest.mark.parametrize("mean", ["arithmetic", "geometric", "harmonic"])
def test_one_rock_is_found_again_everywhere(box, density, mean):
    cloud = scattered(box[1])
    unit = np.ones(len(cloud[0]))
    fields = filled(box, [1000, 2600], [1, 50], (density, "hat", mean), unit, cloud)
    assert fields.rho.x.array == pytest.approx(2600)
    back = {"arithmetic": lambda m: m, "geometric": np.exp, "harmonic": lambda m: 1 / m}[mean]
    assert back(fields.theta.x.array) == pytest.approx(50)


@pytest.mark.parametrize(
    ("mean", "expected"), [("arithmetic", 50.5), ("geometric", 10.0), ("harmonic", 2 / 1.01)]
)
def test_means_of_two_rocks_in_a_cell(box, mean, expected):
    """Two particles per cell, one of viscosity 1 and one of 100."""
    index = box[1]
    x = np.repeat(index.corners.mean(axis=1), 2, axis=0)
    cell, weights = index.locate(x, np.full(len(x), OUTSIDE))
    unit = np.tile([0, 1], len(index.area))
    fields = filled(box, [0, 2], [1, 100], ("cell", "cell", mean), unit, (x, cell, weights))
    back = {"arithmetic": lambda m: m, "geometric": np.exp, "harmonic": lambda m: 1 / m}[mean]
    assert back(fields.theta.x.array) == pytest.approx(expected)
    assert fields.rho.x.array == pytest.approx(1)


def test_particles_count_by_the_area_they_stand_for(box):
    index = box[1]
    x = np.repeat(index.corners.mean(axis=1), 2, axis=0)
    cell, weights = index.locate(x, np.full(len(x), OUTSIDE))
    unit, area = np.tile([0, 1], len(index.area)), np.tile([3.0, 1.0], len(index.area))
    for density in ("hat", "cell", "quadrature"):
        fields = filled(
            box, [0, 4], [1, 1], (density, "hat", "harmonic"), unit, (x, cell, weights), area
        )
        assert fields.rho.x.array == pytest.approx(1)


def test_hat_means_are_continuous_in_the_positions(box):
    """A particle that crosses a facet changes the field by as little as it moved."""
    index = box[1]
    x, cell, _ = scattered(index, 900, seed=2)
    unit = np.arange(900) % 2

    def density(shift):
        moved = x.copy()
        moved[:, 0] = np.clip(moved[:, 0] + shift, 0, 1)
        cells, weights = index.locate(moved, cell)
        cloud = (moved, cells, weights)
        return filled(
            box, [0, 1], [1, 1], ("hat", "hat", "harmonic"), unit, cloud
        ).rho.x.array.copy()

    steps = [np.abs(density(0.05 + d) - density(0.05)).max() for d in (1e-3, 1e-5, 1e-7)]
    assert steps[1] < 0.03 * steps[0]
    assert steps[2] < 0.03 * steps[1]


def test_cells_without_particles_read_their_neighbours(box):
    index = box[1]
    x, cell, weights = scattered(index)
    hole = np.isin(cell, [5, 17])
    cloud = (x[~hole], cell[~hole], weights[~hole])
    unit = np.zeros(len(cloud[0]))
    for density in ("hat", "cell", "quadrature"):
        fields = filled(box, [2600], [7], (density, "cell", "harmonic"), unit, cloud)
        assert fields.rho.x.array == pytest.approx(2600)
        assert 1 / fields.theta.x.array == pytest.approx(7)


def test_particles_outside_do_not_count(box):
    index = box[1]
    x, cell, weights = scattered(index, 3000)
    unit = np.zeros(3000)
    cell[:500], unit[:500] = OUTSIDE, 1
    fields = filled(box, [1, 1e9], [1, 1], ("hat", "hat", "harmonic"), unit, (x, cell, weights))
    assert fields.rho.x.array == pytest.approx(1)


def test_density_mean_around_points_is_local(box):
    """With the jump on a cell row, points far from it see one rock only."""
    index = box[1]
    x, cell, weights = scattered(index, 60000)
    unit = (x[:, 1] > -0.5).astype(int)
    fields = filled(
        box, [0, 1], [1, 1], ("quadrature", "hat", "harmonic"), unit, (x, cell, weights)
    )
    values = fields.rho.x.array.reshape(len(index.area), -1)
    centre = index.corners.mean(axis=1)
    assert (values[centre[:, 1] > -0.3] == 1).all()
    assert (values[centre[:, 1] < -0.7] == 0).all()

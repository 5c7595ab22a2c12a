import numba
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


@pytest.mark.parametrize("density", ["hat", "projection", "cell", "quadrature"])
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
    for density in ("hat", "projection", "cell", "quadrature"):
        fields = filled(
            box, [0, 4], [1, 1], (density, "hat", "harmonic"), unit, (x, cell, weights), area
        )
        assert fields.rho.x.array == pytest.approx(1)


@pytest.mark.parametrize("kind", ["hat", "projection"])
def test_hat_means_are_continuous_in_the_positions(box, kind):
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
            box, [0, 1], [1, 1], (kind, "hat", "harmonic"), unit, cloud
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
    for density in ("hat", "projection", "cell", "quadrature"):
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


def even(section, m=12):
    """Return points that lie evenly in every cell, their areas, cells and hats."""
    index = CellIndex(section)
    corners = index.corners
    i, j = np.divmod(np.arange(m * m), m)
    if section.cell == "triangle":  # the centres of m^2 triangles
        r, s = (np.stack([i, j]) + 1 / 3) / m
        over = r + s > 1
        r, s = np.where(over, 1 - r, r), np.where(over, 1 - s, s)
        hats = np.stack([1 - r - s, r, s], 1)
    else:
        r, s = (np.stack([i, j]) + 0.5) / m
        hats = np.stack([(1 - r) * (1 - s), r * (1 - s), (1 - r) * s, r * s], 1)
    x = np.einsum("qk,ckd->cqd", hats, corners).reshape(-1, 2)
    cell = np.repeat(np.arange(len(corners), dtype=np.int32), m * m)
    area = np.repeat(index.area / (m * m), m * m)
    return index, x, cell, np.tile(hats, (len(corners), 1)), area


def moments(spaces, weights, cell, values):
    """Return the sums of values of particles times the hats, shape (vertices,)."""
    at = spaces.h_nodes[cell].ravel()
    return np.bincount(at, (weights * values[:, None]).ravel())


@pytest.mark.parametrize(("element", "shape"), [("P2-P1", "triangle"), ("Q2-Q1", "quadrilateral")])
def test_projection_has_the_moments_of_the_particles(element, shape):
    """Of a jump that cuts the cells, also on cells of unlike sizes."""
    lines = np.array([[0, 0.3], [0.4, 0.1], [1, 0.0]]), np.array([[0, -1], [1, -1.2]])
    section = section_mesh(*lines, (5, 6), cell=shape)
    spaces = Spaces(section, element)
    index, x, cell, weights, area = even(section)
    unit = (x[:, 1] > -0.5 + 0.2 * x[:, 0]).astype(np.int16)
    transfer = Transfer("projection", "hat", "harmonic")
    fields = RockFields(spaces, index, [2150, 2600], [1, 1], transfer)
    fields.fill(x, cell, weights, unit, area)
    at_points = (fields.rho.x.array[spaces.h_nodes[cell]] * weights).sum(axis=1)
    rock = np.array([2150, 2600.0])[unit]
    wanted = moments(spaces, weights, cell, area * rock)
    assert moments(spaces, weights, cell, area * at_points) == pytest.approx(wanted, rel=5e-3)
    # and by far nearer to them than the means
    means = fields.hat_means(np.array([[2150], [2600.0]]), cell, weights, unit, area)[:, 0]
    lumped = (means[spaces.h_nodes[cell]] * weights).sum(axis=1)
    off = [moments(spaces, weights, cell, area * v - area * rock) for v in (at_points, lumped)]
    assert np.abs(off[0]).max() < 0.05 * np.abs(off[1]).max()


def test_projection_finds_a_linear_density_again():
    """Of layers so many that they are a gradient; the means bend it at the walls."""
    section = section_mesh(np.array([[0, 0], [1, 0.0]]), np.array([[0, -1], [1, -1.0]]), (6, 6))
    spaces = Spaces(section)
    index, x, cell, weights, area = even(section)
    density = np.linspace(2000, 3000, 1001)
    unit = np.rint(-x[:, 1] * 1000).astype(np.int16)
    off = {}
    for kind in ("hat", "projection"):
        transfer = Transfer(kind, "hat", "harmonic")
        fields = RockFields(spaces, index, density, np.ones(1001), transfer)
        fields.fill(x, cell, weights, unit, area)
        z = spaces.H.tabulate_dof_coordinates()[:, 1]
        off[kind] = np.abs(fields.rho.x.array - (2000 - 1000 * z)).max()
    assert off["projection"] < 5
    assert off["hat"] > 50


def test_projection_follows_a_mesh_that_moves():
    section = section_mesh(np.array([[0, 0], [1, 0.0]]), np.array([[0, -1], [1, -1.0]]), (6, 6))
    spaces = Spaces(section)
    index = CellIndex(section)
    transfer = Transfer("projection", "hat", "harmonic")
    fields = RockFields(spaces, index, [2150, 2600], [1, 1], transfer)
    for lift in (0.0, 0.3):
        z = section.mesh.geometry.x[:, 1]
        section.mesh.geometry.x[:, 1] = z + lift * (1 + z) * section.mesh.geometry.x[:, 0]
        index.moved()
        moved, x, cell, weights, area = even(section)
        unit = (x[:, 1] > -0.4).astype(np.int16)
        fields.fill(x, cell, weights, unit, area)
        fresh = RockFields(spaces, moved, [2150, 2600], [1, 1], transfer)
        fresh.fill(x, cell, weights, unit, area)
        assert fields.rho.x.array == pytest.approx(fresh.rho.x.array)
        assert np.ptp(fields.rho.x.array) > 450  # it overshoots


def test_projection_overshoots_by_no_more_than_the_rocks_differ(box, monkeypatch):
    """Where few particles lie unevenly nothing else holds it."""
    cloud = scattered(box[1], 40, seed=3)
    unit = cloud[0][:, 0] > 0.5
    least = {}
    for limited in (True, False):
        if not limited:
            monkeypatch.setattr(RockFields, "_limited", lambda _, values: values)
        fields = filled(box, [2150, 2600], [1, 1], ("projection", "hat", "harmonic"), unit, cloud)
        least[limited] = fields.rho.x.array.min()
        _, _, low, high = fields.ranges()[0]
        assert fields.rho.x.array.max() <= high
        assert (least[limited] >= low) == limited
    assert least[False] < least[True] == 1700


def test_projection_is_that_of_the_rock_below_air():
    found = []
    for air in (None, (0.4, 3)):
        lines = np.array([[0, 0], [1, 0.0]]), np.array([[0, -1], [1, -1.0]])
        section = section_mesh(*lines, (6, 6), air=air)
        spaces = Spaces(section)
        index, x, cell, weights, area = even(section)
        rock = x[:, 1] < 0
        unit = (x[:, 1] > -0.35 + 0.3 * x[:, 0]).astype(np.int16)
        transfer = Transfer("projection", "hat", "harmonic")
        fields = RockFields(
            spaces, index, [2150, 2600], [1, 1], transfer, None if air is None else (1.0, 1.0)
        )
        fields.fill(x[rock], cell[rock], weights[rock], unit[rock], area[rock])
        at = spaces.H.tabulate_dof_coordinates()[:, :2]
        order = np.lexsort(at.round(9).T)
        found.append(fields.rho.x.array[order][at[order, 1] < 1e-9])
    assert found[1] == pytest.approx(found[0], abs=3)


def test_fields_do_not_depend_on_the_number_of_threads(box):
    """To the last bit: the same chunks are summed up in the same order."""
    if numba.config.NUMBA_NUM_THREADS < 2:
        pytest.skip("one core")
    cloud = scattered(box[1], 20_000)
    unit = np.arange(len(cloud[0])) % 2
    found = []
    for threads in (1, 2):
        numba.set_num_threads(threads)
        fields = filled(box, [1000, 2600], [1, 50], ("hat", "hat", "harmonic"), unit, cloud)
        found.append((fields.rho.x.array.copy(), fields.theta.x.array.copy()))
    assert all((one == other).all() for one, other in zip(*found, strict=True))

"""What particles move in is free of divergence at every point, and close to the flow."""

import numpy as np
import pytest
import ufl

from meshes.box import section_mesh
from restoration.advection import SCHEMES
from restoration.bench.boxes import Solved, unit_square
from restoration.bench.exact import solkz
from restoration.conservative import ConservativeSampler, velocity_sampler
from restoration.engine import StokesEngine
from restoration.particles import OUTSIDE, CellIndex
from restoration.sampling import VelocitySampler
from restoration.spaces import Spaces

RELIEF = np.array([[0, 0], [1, 0.2], [3, -0.1]]), np.array([[0, -1], [3, -1.2]])
QUADRATIC = ("P2-P1", "P2b-P1dg")


def stirred(x):
    """A velocity without divergence, which crosses all walls."""
    return np.column_stack(
        [
            -3 * np.sin(2 * x[:, 0]) * np.sin(3 * x[:, 1]),
            -2 * np.cos(2 * x[:, 0]) * np.cos(3 * x[:, 1]),
        ]
    )


def quadratic(x):
    """The curl of a cubic."""
    x, z = x.T
    return np.column_stack([1 + x**2 + 2 * x * z - 3 * z**2, 2 - 2 * x * z - z**2 + 5 * x**2])


class Mesh:
    """A mesh with a sampler, and points in it."""

    def __init__(self, cells=(6, 4), element="P2-P1", lines=RELIEF):
        self.section = section_mesh(*lines, cells)
        self.spaces, self.index = Spaces(self.section, element), CellIndex(self.section)
        self.sampler = ConservativeSampler(self.spaces)
        self.nodes = self.spaces.V.tabulate_dof_coordinates()[:, :2]

    def noise(self):
        """A velocity at the nodes that is anything but free of divergence."""
        return np.random.default_rng(5).normal(size=self.nodes.shape)

    def within(self, n=3000):
        """Points inside random cells, with their cells and hats."""
        rng = np.random.default_rng(3)
        cell = rng.integers(len(self.index.area), size=n)
        hats = rng.dirichlet(np.ones(3), n)
        return np.einsum("nk,nkd->nd", hats, self.index.corners[cell]), cell, hats

    def slopes(self, u, n=3000):
        """The gradient of the velocity at points away from the lines between parts, (n, 2, 2)."""
        _, cell, hats = self.within(n)
        apart = np.sort(hats, axis=1)
        some = (apart[:, 0] > 0.02) & (apart[:, 1] - apart[:, 0] > 0.02)
        cell, hats = cell[some], hats[some]
        made = self.sampler.coefficients(u)
        jacobian = np.diff(self.index.corners[cell], axis=1)
        jacobian[:, 1] += jacobian[:, 0]
        by_hat = []
        for k in (1, 2):  # a central difference is exact for quadratics
            step = np.zeros((len(hats), 3))
            step[:, k], step[:, 0] = 0.005, -0.005
            ahead, behind = (self.sampler(made, cell, hats + way * step) for way in (1, -1))
            by_hat.append((ahead - behind) / 0.01)
        return np.linalg.solve(jacobian, np.stack(by_hat, axis=1))


@pytest.mark.parametrize("element", QUADRATIC)
def test_the_divergence_is_the_same_at_every_point(element):
    """It is the net flow through the walls over the area, whatever the flow on the mesh is."""
    mesh = Mesh(element=element)
    for u in (mesh.noise(), stirred(mesh.nodes)):
        slopes = mesh.slopes(u)
        divergence = np.trace(slopes, axis1=1, axis2=2)
        assert np.ptp(divergence) < 1e-11 * np.abs(slopes).max()
    assert np.abs(divergence).max() < 2e-3  # Simpson's rule along the walls


def test_a_mesh_that_swells_evenly_is_left_to_it():
    mesh = Mesh()
    x, cell, hats = mesh.within()

    def field(x):
        return quadratic(x) + 0.3 * (x - [1.0, 2.0])

    u = field(mesh.nodes)
    assert mesh.sampler(mesh.sampler.coefficients(u), cell, hats) == pytest.approx(
        field(x), abs=1e-11
    )


@pytest.mark.parametrize("element", QUADRATIC)
def test_quadratic_flows_without_divergence_stay_as_they_are(element):
    """So the edges and corners are taken in the order of the elements."""
    mesh = Mesh(element=element)
    x, cell, hats = mesh.within()
    u = quadratic(mesh.nodes)
    found = mesh.sampler(mesh.sampler.coefficients(u), cell, hats)
    assert found == pytest.approx(quadratic(x), abs=1e-11)
    cell[:3] = OUTSIDE
    assert (mesh.sampler(mesh.sampler.coefficients(u), cell, hats)[:3] == 0).all()


def test_it_is_continuous_across_edges_and_between_the_parts_of_a_cell():
    mesh = Mesh()
    made, rng = mesh.sampler.coefficients(mesh.noise()), np.random.default_rng(1)
    across, corners = mesh.index.neighbours, mesh.section.corner_vertices
    for c, k in np.argwhere(across >= 0):
        hats, there = np.zeros(3), np.zeros(3)
        share = rng.uniform()
        i, j = (k + 1) % 3, (k + 2) % 3
        hats[i], hats[j] = share, 1 - share
        other = across[c, k]
        for corner in (i, j):
            there[corners[other] == corners[c, corner]] = hats[corner]
        here, beyond = mesh.sampler(made, np.array([c, other]), np.stack([hats, there]))
        assert here == pytest.approx(beyond, abs=1e-13)
    for k in range(3):  # on the spoke to corner k, from both sides
        hats = np.full((len(corners), 3), 0.2)
        hats[:, k] = 0.6
        aside = np.roll([0.0, 1e-9, -1e-9], k)
        cells = np.arange(len(corners))
        pair = [mesh.sampler(made, cells, hats + way * aside) for way in (1, -1)]
        assert pair[0] == pytest.approx(pair[1], abs=1e-6)


def test_the_flow_through_walls_is_unchanged():
    mesh = Mesh()
    for u in (mesh.noise(), stirred(mesh.nodes)):
        plain = VelocitySampler(mesh.spaces)
        cell, facet = np.argwhere(mesh.index.neighbours < 0).T
        row = np.arange(len(cell))
        for share in (0.0, 0.3, 0.8):
            hats = np.zeros((len(cell), 3))
            hats[row, (facet + 1) % 3], hats[row, (facet + 2) % 3] = share, 1 - share
            exact = plain(plain.coefficients(u), cell, hats)
            found = mesh.sampler(mesh.sampler.coefficients(u), cell, hats)
            assert found == pytest.approx(exact, abs=1e-12)


@pytest.mark.parametrize("element", QUADRATIC)
def test_it_is_of_third_order(element):
    errors = []
    for n in (8, 16, 32):
        mesh = Mesh((n, n // 2), element)
        x, cell, hats = mesh.within()
        made = mesh.sampler.coefficients(stirred(mesh.nodes))
        errors.append(np.sqrt(((mesh.sampler(made, cell, hats) - stirred(x)) ** 2).mean()))
    order = np.log2(errors[:-1]) - np.log2(errors[1:])
    assert order == pytest.approx(3, abs=0.1)


def test_points_a_little_outside_move_as_the_rock_at_the_wall():
    mesh = Mesh()
    made = mesh.sampler.coefficients(quadratic(mesh.nodes))
    hats = np.array([[1 + 1e-9, -5e-10, -5e-10], [-1e-9, 0.5, 0.5 + 1e-9]])
    x = np.einsum("nk,kd->nd", hats, mesh.index.corners[7])
    found = mesh.sampler(made, np.array([7, 7]), hats)
    assert found == pytest.approx(quadratic(x), abs=1e-11)


def test_a_mesh_that_has_moved_is_read_where_it_is():
    mesh = Mesh()
    x = mesh.section.mesh.geometry.x
    x[:, :2] += 0.05 * np.column_stack([np.sin(3 * x[:, 1]), np.cos(2 * x[:, 0])])
    mesh.index.moved()
    mesh.nodes = mesh.spaces.V.tabulate_dof_coordinates()[:, :2]
    x, cell, hats = mesh.within()
    found = mesh.sampler(mesh.sampler.coefficients(quadratic(mesh.nodes)), cell, hats)
    assert found == pytest.approx(quadratic(x), abs=1e-11)
    slopes = mesh.slopes(mesh.noise())
    assert np.ptp(np.trace(slopes, axis1=1, axis2=2)) < 1e-11 * np.abs(slopes).max()


def test_a_mirrored_flow_gives_the_mirrored_velocity():
    lines = [np.array([[-1, z], [0, z + 0.1], [1, z]]) for z in (0.0, -1.0)]
    mesh = Mesh(lines=lines)
    mirror = np.array([-1.0, 1.0])

    def field(x):
        return stirred(x + 0.3)

    x, _, _ = mesh.within()
    pair = []
    for way in (1, mirror):
        u = field(mesh.nodes * way) * way
        cell, hats = mesh.index.locate(x * way, mesh.index.guess(x * way))
        pair.append(mesh.sampler(mesh.sampler.coefficients(u), cell, hats) * way)
    assert pair[0] == pytest.approx(pair[1], abs=1e-12)


@pytest.mark.parametrize(
    ("element", "way", "kind"),
    [
        ("P2-P1", "conservative", ConservativeSampler),
        ("P2b-P1dg", "conservative", ConservativeSampler),
        ("P2-P1", "plain", VelocitySampler),
        ("P2-P1dg", "conservative", VelocitySampler),
        ("MINI", "conservative", VelocitySampler),
        ("Q2-Q1", "conservative", VelocitySampler),
    ],
)
def test_elements_that_need_it_have_it(element, way, kind):
    cell = "quadrilateral" if element.startswith("Q") else "triangle"
    spaces = Spaces(section_mesh(*RELIEF, (3, 2), cell), element)
    assert type(velocity_sampler(spaces, way)) is kind


@pytest.mark.parametrize("element", QUADRATIC)
def test_flows_that_were_solved_for_keep_their_order(element):
    def density(spaces):
        x, z = ufl.SpatialCoordinate(spaces.section.mesh)
        return -ufl.sin(2 * z) * ufl.cos(3 * ufl.pi * x)

    exact, errors = solkz(1e3), []
    x = np.random.default_rng(2).uniform(size=(3000, 2))
    for n in (12, 24):
        solved = Solved(
            unit_square(element, n),
            element,
            lambda spaces: 1e3 ** ufl.SpatialCoordinate(spaces.section.mesh)[1],
            density,
        )
        index = CellIndex(solved.spaces.section)
        sampler = ConservativeSampler(solved.spaces)
        u = sampler(sampler.coefficients(solved.flow.u), *index.locate(x, index.guess(x)))
        errors.append(np.sqrt(((u - exact(x)[0]) ** 2).mean()))
    assert np.log2(errors[0] / errors[1]) > 2.7


@pytest.fixture(scope="module")
def steady(make_scene):
    """The first flow of the diapir, and its grid."""
    engine = StokesEngine(make_scene())
    state = engine.with_flow(engine.start())
    return engine.grid, state.flow


def unevenness(grid, flow, sampler, points=120, crossings=40):
    """How much the counts of an even cloud in 6 x 6 boxes vary after it has been carried around.

    Args:
        grid, flow, sampler: the flow stands still.
        points: along each side.
        crossings: of the section by its fastest point.
    """
    low, high = (f(grid.index.corners, axis=(0, 1)) for f in (np.min, np.max))
    middles = (np.arange(points) + 0.5) / points
    x = low + (high - low) * np.stack(np.meshgrid(middles, middles), axis=2).reshape(-1, 2)
    made, cell = sampler.coefficients(flow.u), grid.index.guess(x)

    def velocity(x):
        found, hats = grid.index.locate(np.clip(x, low, high), cell)
        cell[:] = np.where(found == OUTSIDE, cell, found)
        return sampler(made, found, hats)

    for _ in range(12 * crossings):
        x = SCHEMES["rk4"].step(x, velocity, (high - low).min() / np.abs(flow.u).max() / 12)
    counts = np.histogram2d(*x.T, 6, np.column_stack([low, high]))[0]
    return counts.std() / counts.mean()


def test_an_even_cloud_stays_even(steady):
    """Up to what counts vary by chance; in the flow of the elements it gathers in places."""
    grid, flow = steady
    chance = 6 / 120
    assert unevenness(grid, flow, VelocitySampler(grid.spaces)) > 4 * chance
    assert unevenness(grid, flow, ConservativeSampler(grid.spaces)) < 1.3 * chance

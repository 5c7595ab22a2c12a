"""Points are found in any mesh, and the velocity there is that of the elements."""

import numpy as np
import pytest

from forms.elements import ELEMENTS
from meshes.box import section_mesh
from restoration.particles import OUTSIDE, CellIndex
from restoration.sampling import VelocitySampler
from restoration.spaces import Spaces

RELIEF = np.array([[0, 0], [1, 0.2], [3, -0.1]]), np.array([[0, -1], [3, -1.2]])
PLANE = [name for name, pair in ELEMENTS.items() if {"triangle", "quadrilateral"} & {*pair.cells}]


def squares(relief=True):
    lines = RELIEF if relief else [np.array([[0, z], [3, z]]) for z in (0.0, -1.0)]
    return section_mesh(*lines, (9, 4), "quadrilateral")


def within(index, n=3000):
    """Points inside random cells, and their cells."""
    rng = np.random.default_rng(3)
    cell = rng.integers(len(index.area), size=n)
    share = rng.dirichlet(np.ones(index.corners.shape[1]), n)
    return np.einsum("nk,nkd->nd", share, index.corners[cell]), cell


def test_points_are_found_in_squares_from_anywhere():
    index = CellIndex(squares())
    x, cell = within(index)
    for guess in (cell, np.zeros(len(x), int), np.full(len(x), OUTSIDE)):
        found, hats = index.locate(x, guess)
        assert (found == cell).all()
        assert hats.min() > -1e-9
        assert np.einsum("nk,nkd->nd", hats, index.corners[found]) == pytest.approx(x, abs=1e-12)
    outside, _ = index.locate(np.array([[1, 0.3], [-0.1, -0.5], [3.1, -1], [1, -1.5]]), [0] * 4)
    assert (outside == OUTSIDE).all()


def test_neighbours_of_squares_share_the_facet():
    """Facets of a square come as s = 0, r = 0, r = 1 and s = 1."""
    section = squares()
    corners, across = section.corners, section.neighbours
    for k, ends in enumerate(((0, 1), (0, 2), (1, 3), (2, 3))):
        some = np.flatnonzero(across[:, k] >= 0)
        assert len(some)
        for c in some:
            there = corners[across[c, k]]
            for corner in ends:
                assert np.abs(there - corners[c, corner]).sum(axis=1).min() < 1e-12


@pytest.mark.parametrize("name", PLANE)
def test_velocity_is_that_of_the_element(name):
    def field(x):
        if name == "MINI":
            return np.column_stack([1 + x[:, 1], 2 * x[:, 0]])
        return np.column_stack([1 + x[:, 0] * x[:, 1], x[:, 1] ** 2 - x[:, 0]])

    section = squares(relief=False) if name.startswith("Q") else section_mesh(*RELIEF, (6, 4))
    spaces, index = Spaces(section, name), CellIndex(section)
    x, cell = within(index)
    cell, hats = index.locate(x, cell)
    sampler = VelocitySampler(spaces)
    u = field(spaces.V.tabulate_dof_coordinates())
    assert sampler(sampler.coefficients(u), cell, hats) == pytest.approx(field(x), abs=1e-12)
    cell[:3] = OUTSIDE
    assert (sampler(sampler.coefficients(u), cell, hats)[:3] == 0).all()

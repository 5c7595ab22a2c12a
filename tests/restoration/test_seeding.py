"""Particles where they are seeded and born, and how far the mesh sees them."""

from dataclasses import replace

import basix
import numpy as np
import pytest

from meshes.box import section_mesh
from restoration.particles import (
    OUTSIDE,
    CellIndex,
    Particles,
    born_in,
    empty_cells,
    joined,
    relocate,
    seed,
    subset,
)
from restoration.scene import ParticlePlan, Transfer
from restoration.spaces import Spaces
from restoration.transfer import RockFields
from tests.restoration.conftest import HEIGHT, WIDTH, diapir_scene


@pytest.mark.parametrize("densify", [1, 20])
@pytest.mark.parametrize("jitter", [0.0, 0.6, 1.0])
def test_jitter_has_no_direction(densify, jitter):
    """The middle of all rock stays that of the box, to a fiftieth of a spacing of the lattice."""
    cloud = seed(diapir_scene(particles=ParticlePlan(6, densify, jitter, 1)))
    spacing = np.sqrt(WIDTH * HEIGHT / (4 * 12 * 13 * 6))
    middle = np.average(cloud.x, axis=0, weights=cloud.area)
    assert middle == pytest.approx((WIDTH / 2, -HEIGHT / 2), abs=spacing / 50)


@pytest.fixture(scope="module")
def box():
    """A unit square of 6 by 6 squares, and 4000 particles of the first unit in it."""
    section = section_mesh(np.array([[0, 1], [1, 1.0]]), np.array([[0, 0], [1, 0.0]]), (6, 6))
    index = CellIndex(section)
    x = np.random.default_rng(0).random((4000, 2))
    particles = Particles(
        x, np.zeros(4000, np.int16), np.ones(4000), x.copy(), np.full(4000, OUTSIDE, np.int32)
    )
    return Spaces(section), index, relocate(particles, index)


def fill(fields, index, particles, which=slice(None)):
    x, cell, unit, area = (
        getattr(particles, name)[which] for name in ("x", "cell", "unit", "area")
    )
    fields.fill(x, cell, index.locate(x, cell)[1], unit, area)


def test_a_born_particle_stands_for_its_cell(box):
    _, index, particles = box
    some = subset(particles, particles.x[:, 0] > 0.3)
    cells = empty_cells(some, len(index.area))
    filled = joined(some, born_in(cells, some, index))
    assert len(cells) > 0
    assert filled.area[filled.born] == pytest.approx(index.area[cells])


def test_density_at_a_point_is_of_the_rock_within_half_a_square(box):
    """The paper's radius is the root of a triangle's area: here half the side of a square."""
    spaces, index, particles = box
    heavy = np.argmin(np.linalg.norm(particles.x - 0.52, axis=1))
    particles = replace(particles, unit=(np.arange(4000) == heavy).astype(np.int16))
    fields = RockFields(spaces, index, [0, 1], [1, 1], Transfer("quadrature", "hat", "harmonic"))
    fill(fields, index, particles)
    rule, _ = basix.make_quadrature(basix.CellType.triangle, 4)
    at = np.einsum("qk,ckd->cqd", np.column_stack([1 - rule.sum(axis=1), rule]), index.corners)
    near = np.linalg.norm(at - particles.x[heavy], axis=2) < 1 / 12
    assert near.any()
    assert np.array_equal(fields.rho.x.array > 0, near.ravel())


def test_a_vertex_that_lost_its_particles_keeps_its_rock(box):
    """Inside a step, until particles may be born there."""
    spaces, index, particles = box
    fields = RockFields(spaces, index, [2600, 1], [50, 1], Transfer("hat", "hat", "harmonic"))
    fill(fields, index, particles)
    other = replace(particles, unit=np.ones(4000, np.int16))
    fill(fields, index, other, other.x[:, 0] < 0.2)
    x = spaces.Q.tabulate_dof_coordinates()[:, 0]
    assert fields.rho.x.array[x < 0.2] == pytest.approx(1)
    assert fields.rho.x.array[x > 0.8] == pytest.approx(2600)
    assert 1 / fields.theta.x.array[x > 0.8] == pytest.approx(50)

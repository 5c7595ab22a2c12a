"""Refined meshes: they conform, keep their angles, walls and regions, and stop where asked."""

from dataclasses import replace

import numpy as np
import pytest

from meshes.box import section_mesh
from meshes.refine import adapted_mesh, refined_mesh
from meshes.section import fitted_mesh
from tests.meshes.test_section import FLAT, circle, edges_of, least_angle, wall_lengths


@pytest.fixture(scope="module")
def box():
    section = section_mesh(*FLAT, (16, 4))
    return replace(section, regions=(section.corners[:, :, 0].mean(axis=1) > 2000).astype(np.int32))


def conforms(section):
    """Whether every edge has two cells, or one and a wall, and Euler's formula holds."""
    cells = section.mesh.geometry.dofmap.array.reshape(-1, 3)
    pairs = np.sort(np.stack([cells, np.roll(cells, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    edges, count = np.unique(pairs, axis=0, return_counts=True)
    walls = len(section.facet_tags.indices)
    euler = len(section.mesh.geometry.x) - len(edges) + len(cells)
    return count.max() == 2 and (count == 1).sum() == walls and euler == 1


def test_marked_cells_become_four(box):
    marked = np.zeros(len(box.areas), dtype=bool)
    marked[[10, 77]] = True
    finer = refined_mesh(box, marked)
    assert conforms(finer)
    assert finer.areas.min() == pytest.approx(box.areas.min() / 4)
    assert np.isclose(finer.areas, box.areas.min() / 4).sum() >= 8
    assert len(finer.areas) < len(box.areas) + 30
    assert wall_lengths(finer) == pytest.approx(wall_lengths(box))
    assert np.bincount(finer.regions, finer.areas) == pytest.approx([2e6, 2e6])


def test_nothing_marked_is_the_same_mesh(box):
    same = refined_mesh(box, np.zeros(len(box.areas), dtype=bool))
    assert np.sort(same.areas) == pytest.approx(np.sort(box.areas))
    assert conforms(same)


def test_all_marked_halves_all_edges(box):
    finer = refined_mesh(box, np.ones(len(box.areas), dtype=bool))
    assert finer.areas == pytest.approx(np.full(4 * len(box.areas), box.areas[0] / 4))
    assert least_angle(finer) == pytest.approx(45)


def test_many_passes_keep_the_angles():
    for columns, least in (((16, 4), 45), ((16, 6), 26)):
        section = section_mesh(*FLAT, columns)
        for _ in range(8):
            centres = section.corners.mean(axis=1)
            section = refined_mesh(section, np.hypot(*(centres - [777, -333]).T) < 60)
        assert conforms(section)
        assert least_angle(section) > least - 1e-6
        assert wall_lengths(section)["surface"] == pytest.approx(4000)


def ring(x):
    return 5 + 0.3 * np.abs(np.hypot(x[:, 0] - 1000, x[:, 1] + 500) - 200)


def test_cells_are_as_small_as_wanted(box):
    adapted = adapted_mesh(box, ring, 8)
    assert (np.sqrt(2 * adapted.areas) <= ring(adapted.corners.mean(axis=1))).all()
    assert conforms(adapted)
    assert least_angle(adapted) > 44.9
    assert np.bincount(adapted.regions, adapted.areas) == pytest.approx([2e6, 2e6])
    mean = np.sqrt(2 * adapted.areas) / ring(adapted.corners.mean(axis=1))
    assert np.median(mean) > 0.4  # not far smaller either


@pytest.mark.parametrize("levels", [0, 1, 2])
def test_levels_bound_the_cells(box, levels):
    adapted = adapted_mesh(box, lambda x: np.full(len(x), 1e-3), levels)
    assert adapted.areas.min() == pytest.approx(box.areas.min() / 4**levels)


def test_fitted_meshes_are_refined_along_their_lines():
    section, _ = fitted_mesh(*FLAT, [circle(200)], 100, 50)
    finer = adapted_mesh(section, ring, 3)
    assert conforms(finer)
    assert least_angle(finer) > least_angle(section) / 2
    assert np.bincount(finer.regions, finer.areas) == pytest.approx(
        np.bincount(section.regions, section.areas)
    )
    assert len(edges_of(finer)) > 4 * len(edges_of(section))


def test_a_mesh_without_regions_stays_one(box):
    assert refined_mesh(replace(box, regions=None), box.areas > 0).regions is None

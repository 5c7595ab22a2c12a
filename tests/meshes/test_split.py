from dataclasses import replace

import numpy as np
import pytest

from meshes.box import section_mesh
from meshes.section import fitted_mesh
from meshes.split import barycentric_mesh
from tests.meshes.test_refine import conforms
from tests.meshes.test_section import FLAT, RELIEF, circle, wall_lengths


def test_every_cell_becomes_three_equal_ones():
    section = section_mesh(*RELIEF, (16, 4))
    split = barycentric_mesh(replace(section, regions=np.arange(len(section.areas))))
    assert len(split.areas) == 3 * len(section.areas)
    assert split.areas == pytest.approx(section.areas[split.regions] / 3)
    assert conforms(split)
    assert split.flat == section.flat
    assert wall_lengths(split) == pytest.approx(wall_lengths(section))


def test_regions_keep_their_area():
    section, _ = fitted_mesh(*FLAT, [circle(200)], 100, 50)
    split = barycentric_mesh(section)
    assert np.bincount(split.regions, split.areas) == pytest.approx(
        np.bincount(section.regions, section.areas)
    )


def test_a_mesh_without_regions_stays_one():
    assert barycentric_mesh(section_mesh(*FLAT, (4, 2))).regions is None

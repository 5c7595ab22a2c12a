import numpy as np
import pytest

from meshes.box import PLANE_WALLS, section_mesh
from restoration.scene import Outline

RELIEF = Outline(
    np.array([[0, 0], [300, 120], [700, -80], [1000, 50.0]]), np.array([[0, -900], [1000, -1000.0]])
)


def test_a_mesh_whose_columns_meet_the_kinks_fills_the_outline():
    section = section_mesh(RELIEF.surface, RELIEF.base, (10, 4))
    assert section.areas.sum() == pytest.approx(RELIEF.area, rel=1e-12)


def test_top_and_bottom_rows_lie_on_the_lines():
    section = section_mesh(RELIEF.surface, RELIEF.base, (10, 4))
    x = section.mesh.geometry.x
    section.mesh.topology.create_connectivity(1, 0)
    ends = section.mesh.topology.connectivity(1, 0)
    for name, line in (("surface", RELIEF.surface), ("base", RELIEF.base)):
        facets = section.facet_tags.find(section.wall_tags[name])
        nodes = np.unique(np.concatenate([ends.links(facet) for facet in facets]))
        assert len(nodes) == 11
        assert x[nodes, 1] == pytest.approx(np.interp(x[nodes, 0], *line.T))


def test_rows_share_the_height_of_their_own_column():
    x = section_mesh(RELIEF.surface, RELIEF.base, (10, 4)).corners.reshape(-1, 2)
    here = x[np.abs(x[:, 0] - 700) < 1e-6]
    assert np.unique(here[:, 1].round(6)) == pytest.approx(np.linspace(-970, -80, 5))


def test_a_plane_section_has_four_walls():
    section = section_mesh(RELIEF.surface, RELIEF.base, (10, 4))
    assert tuple(section.wall_tags) == PLANE_WALLS
    assert set(section.facet_tags.values) == set(section.wall_tags.values())

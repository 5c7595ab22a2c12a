import numpy as np
import pytest

from meshes.mirrored import mirrored_box_mesh

LOW, HIGH = np.array([0, 0, -3.0]), np.array([4, 2, 0.0])


@pytest.fixture(scope="module")
def section():
    return mirrored_box_mesh(LOW, HIGH, (4, 2, 2))


def test_the_tetrahedra_fill_the_box(section):
    assert section.cell == "tetrahedron"
    assert section.cell_count == 6 * 4 * 2 * 2
    assert section.areas == pytest.approx(24 / 96)  # all of one size
    assert section.area == pytest.approx(24)


def test_every_wall_has_its_facets(section):
    counts = {"left": 8, "right": 8, "front": 16, "back": 16, "base": 16, "surface": 16}
    for name, count in counts.items():
        assert len(section.facet_tags.find(section.wall_tags[name])) == count, name


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_mesh_is_its_own_mirror_image(section, axis):
    def cells(corners):
        rounded = np.round(corners.reshape(-1, 12) * 8).astype(int).reshape(-1, 4, 3)
        return {frozenset(map(tuple, cell)) for cell in rounded}

    mirrored = section.corners
    mirrored[..., axis] = (LOW + HIGH)[axis] - mirrored[..., axis]
    assert cells(mirrored) == cells(section.corners)

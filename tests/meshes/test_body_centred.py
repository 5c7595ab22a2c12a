import numpy as np
import pytest

from meshes.body_centred import body_centred_mesh

LOW, HIGH = np.array([0, 0, -3.0]), np.array([4, 2, 0.0])


@pytest.fixture(scope="module")
def section():
    return body_centred_mesh(LOW, HIGH, (4, 3, 2))


def test_the_tetrahedra_fill_the_box(section):
    assert section.cell == "tetrahedron"
    assert section.cell_count == 12 * 4 * 3 * 2 + 4 * (4 * 3 + 3 * 2 + 2 * 4)
    assert section.area == pytest.approx(24)
    cube, at_wall = 24 / (4 * 3 * 2), 4 * 2 * (4 * 3 + 3 * 2 + 2 * 4)
    assert np.sort(section.areas)[:at_wall] == pytest.approx(cube / 24)
    assert np.sort(section.areas)[at_wall:] == pytest.approx(cube / 12)


def test_every_wall_has_its_facets(section):
    counts = {"left": 24, "right": 24, "front": 32, "back": 32, "base": 48, "surface": 48}
    for name, count in counts.items():
        assert len(section.facet_tags.find(section.wall_tags[name])) == count, name


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_mesh_is_its_own_mirror_image(section, axis):
    def cells(corners):
        rounded = np.round(corners.reshape(-1, 12) * 24).astype(int).reshape(-1, 4, 3)
        return {frozenset(map(tuple, cell)) for cell in rounded}

    mirrored = section.corners
    mirrored[..., axis] = (LOW + HIGH)[axis] - mirrored[..., axis]
    assert cells(mirrored) == cells(section.corners)

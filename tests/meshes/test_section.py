"""Fitted meshes: every line is on mesh edges, every wall is whole, and regions have their area."""

import resource

import numpy as np
import pytest
import shapely

from meshes import section as section_module
from meshes.section import MeshingError, fitted_mesh

X = np.linspace(0, 4000, 201)
FLAT = np.array([[0, 0], [4000, 0.0]]), np.array([[0, -1000], [4000, -1000.0]])
RELIEF = np.column_stack([X, 50 * np.sin(X / 300)]), FLAT[1]


def circle(radius, x=1000.0, z=-500.0, points=721):
    angle = np.linspace(0, 2 * np.pi, points)
    line = np.column_stack([x + radius * np.cos(angle), z + radius * np.sin(angle)])
    line[-1] = line[0]
    return line


def edges_of(section):
    """Return the ends of the edges of all cells, each edge once, shape (n, 2, 2), m."""
    cells = section.mesh.geometry.dofmap.array.reshape(-1, 3)
    pairs = np.stack([cells, np.roll(cells, -1, axis=1)], axis=2).reshape(-1, 2)
    return section.mesh.geometry.x[np.unique(np.sort(pairs, axis=1), axis=0), :2]


def length_on(section, line):
    """Return the length of the edges whose ends and middle lie on a line, m."""
    ends = edges_of(section)
    spots = shapely.points(np.concatenate([ends, ends.mean(axis=1, keepdims=True)], axis=1))
    on = shapely.dwithin(spots, shapely.LineString(line), 1e-3).all(axis=1)
    return np.hypot(*(ends[on, 1] - ends[on, 0]).T).sum()


def wall_lengths(section):
    mesh = section.mesh
    mesh.topology.create_connectivity(1, 0)
    ends = mesh.topology.connectivity(1, 0).array.reshape(-1, 2)
    mesh.topology.create_connectivity(2, 0)
    node = np.empty(mesh.topology.index_map(0).size_local, dtype=int)
    node[mesh.topology.connectivity(2, 0).array] = mesh.geometry.dofmap.array
    x = mesh.geometry.x[node[ends], :2]
    length = np.hypot(*(x[:, 1] - x[:, 0]).T)
    return {n: length[section.facet_tags.find(t)].sum() for n, t in section.wall_tags.items()}


def least_angle(section):
    corners = section.corners
    a = np.roll(corners, -1, axis=1) - corners
    b = np.roll(corners, 1, axis=1) - corners
    cross = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return np.degrees(np.arctan2(np.abs(cross), (a * b).sum(axis=2))).min()


def region_areas(section):
    return np.bincount(section.regions, section.areas)


def test_a_section_without_lines():
    section, points = fitted_mesh(*RELIEF, [], 100)
    assert len(points) == 1
    ends = edges_of(section)
    assert least_angle(section) > 30
    assert np.hypot(*(ends[:, 1] - ends[:, 0]).T).mean() == pytest.approx(100, rel=0.1)
    assert section.flat == {"left", "right", "base"}
    lengths = wall_lengths(section)
    assert lengths["left"] == pytest.approx(1000)
    assert lengths["right"] == pytest.approx(1000 + RELIEF[0][-1, 1])
    assert lengths["base"] == pytest.approx(4000)
    assert lengths["surface"] == pytest.approx(shapely.LineString(RELIEF[0]).length, rel=2e-3)


def test_straight_lines_with_junctions_and_free_tips():
    lines = {
        "across": np.array([[0, -300], [4000, -500.0]]),
        "crossing": np.array([[500, 0], [1500, -1000.0]]),
        "onto another": np.array([[2500, -1000], [2700, -435.0]]),
        "fault": np.array([[3000, -150], [3400, -350.0], [3500, -600]]),
        "floating": np.array([[1800, -700], [2200, -800.0]]),
        "short": np.array([[3700, -100], [3705, -103.0]]),
    }
    section, points = fitted_mesh(*FLAT, list(lines.values()), 100, 40)
    for name, line in lines.items():
        length = shapely.LineString(line).length
        assert length_on(section, line) == pytest.approx(length), name
    noded = shapely.union_all([shapely.LineString(line) for line in [*lines.values(), *frame()]])
    faces = shapely.get_parts(shapely.polygonize([noded]))
    assert len(points) == len(faces) == 5
    face = [np.flatnonzero(shapely.contains_xy(faces, *point))[0] for point in points]
    assert region_areas(section) == pytest.approx(shapely.area(faces)[face])
    assert least_angle(section) > 15


def frame():
    surface, base = FLAT
    return surface, base, np.vstack([surface[0], base[0]]), np.vstack([surface[1], base[1]])


def test_nodes_of_a_circle_lie_on_it_and_its_area_is_of_second_order():
    errors = []
    for near in (80, 40, 20):
        section, points = fitted_mesh(*FLAT, [circle(200)], 100, near)
        inside = np.argmin(np.hypot(*(points - [1000, -500]).T))
        errors.append(np.pi * 200**2 - region_areas(section)[inside])
        ends = edges_of(section)
        radius = np.hypot(*(ends - [1000, -500]).transpose(2, 0, 1))
        on = np.abs(radius - 200).max(axis=1) < 1e-7
        assert on.sum() == pytest.approx(2 * np.pi * 200 / near, abs=1)
    assert np.log2(np.array(errors[:-1]) / errors[1:]) == pytest.approx([2, 2], abs=0.15)


def test_a_block_keeps_its_corners():
    block = np.array([[1000, -300], [1500, -300], [1500, -600], [1000, -600], [1000, -300.0]])
    section, _ = fitted_mesh(*FLAT, [block], 100, 70)
    areas = region_areas(section)
    assert sorted(areas) == pytest.approx([150e3, 3850e3])
    assert least_angle(section) > 25


def test_small_closed_lines_stay_regions():
    section, points = fitted_mesh(*FLAT, [circle(3), circle(1, x=2000)], 100)
    assert len(points) == 3
    assert region_areas(section).min() == pytest.approx(np.pi, rel=0.15)


def test_a_layer_of_a_thousandth_of_the_height():
    wavy = np.column_stack([X, -300 + 60 * np.sin(X / 250)])
    section, points = fitted_mesh(*RELIEF, [wavy, wavy - [0, 1.0]], 100, 50)
    assert len(points) == 3
    assert region_areas(section).min() == pytest.approx(4000, rel=0.01)
    assert section.areas.min() > 0


def test_a_layer_that_pinches_out():
    top = np.array([[0, -300], [4000, -500.0]])
    bottom = np.array([[0, -400], [3000, -450.0]])
    section, points = fitted_mesh(*FLAT, [top, bottom], 100)
    assert len(points) == 3
    assert region_areas(section).min() == pytest.approx(150e3)


@pytest.mark.parametrize("noise", [0, 1e-9, 1e-4])
def test_what_is_drawn_twice_is_one_line(noise):
    wavy = np.column_stack([X, -300 + 60 * np.sin(X / 250)])
    again = wavy[30:150:3][::-1] + noise * np.sin(np.arange(40.0))[:, None]
    single, _ = fitted_mesh(*FLAT, [wavy], 100)
    section, points = fitted_mesh(*FLAT, [wavy, wavy, wavy[30:150] + [0, noise], again[:2]], 100)
    assert len(points) == 2
    assert region_areas(section).min() == pytest.approx(region_areas(single).min(), rel=1e-3)
    assert least_angle(section) > 10


def test_ends_that_nearly_meet_and_lines_that_stick_out():
    lines = [
        np.array([[3e-4, -300], [4000 - 3e-4, -300.0]]),
        np.array([[2000, 400], [2000, -300 + 4e-4]]),
        np.array([[2000, -300 - 4e-4], [2500, -1400.0]]),
    ]
    section, _ = fitted_mesh(*FLAT, lines, 100)
    left = 700 * (2000 + 2000 + 500 * 700 / 1100) / 2  # the line goes on to (2500, -1400)
    areas = [600e3, 600e3, 2800e3 - left, left]
    assert sorted(region_areas(section)) == pytest.approx(areas, rel=1e-5)


def test_a_line_along_the_surface_makes_it_finer():
    section, _ = fitted_mesh(*RELIEF, [RELIEF[0]], 200, 50)
    coarse, _ = fitted_mesh(*RELIEF, [], 200)
    tag = section.wall_tags["surface"]
    assert len(section.facet_tags.find(tag)) > 3 * len(coarse.facet_tags.find(tag))
    assert wall_lengths(section)["base"] == pytest.approx(4000)


def test_a_mirrored_section_is_meshed_too():
    line = np.array([[0, -200], [1000, -500], [1700, -1000.0]])
    fault = np.array([[3000, 0], [2500, -600.0]])
    left, _ = fitted_mesh(*FLAT, [line, fault, circle(100)], 100, 50)
    mirror = [np.array([4000, 0]) + np.array([-1, 1]) * part for part in (line, fault, circle(100))]
    right, _ = fitted_mesh(*FLAT, mirror, 100, 50)
    assert sorted(region_areas(right)) == pytest.approx(sorted(region_areas(left)), rel=1e-3)
    assert len(right.areas) == pytest.approx(len(left.areas), rel=0.05)
    assert least_angle(right) > 20


def test_the_same_lines_give_the_same_mesh():
    one, two = (fitted_mesh(*RELIEF, [circle(200)], 100, 40) for _ in range(2))
    assert np.array_equal(one[0].mesh.geometry.x, two[0].mesh.geometry.x)
    assert np.array_equal(one[1], two[1])


def test_points_are_in_their_regions():
    section, points = fitted_mesh(*FLAT, [circle(200), circle(100)], 100, 50)
    ring = np.digitize(np.hypot(*(section.corners.mean(axis=1) - [1000, -500]).T), [99, 199])
    of_point = np.digitize(np.hypot(*(points - [1000, -500]).T), [99, 199])
    assert np.array_equal(of_point[section.regions], ring)


def test_repeated_calls_keep_no_memory():
    def peak():
        return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss  # kB

    for _ in range(10):
        fitted_mesh(*FLAT, [circle(200)], 200)
    before = peak()
    for _ in range(50):
        fitted_mesh(*FLAT, [circle(200)], 200)
    assert peak() - before < 5000


def test_walls_that_cross_are_refused():
    with pytest.raises(MeshingError, match="surface and base cross"):
        fitted_mesh(np.array([[0, 0], [100, -200.0]]), np.array([[0, -100], [100, -100.0]]), [], 10)


def test_points_that_are_not_finite_are_refused():
    with pytest.raises(MeshingError, match="not finite"):
        fitted_mesh(*FLAT, [np.array([[0, 0], [np.nan, 1]])], 100)


def test_degenerate_lines_do_no_harm():
    spot = np.array([[500, -500], [500, -500.0]])
    dash = np.array([[700, -500], [700 + 1e-9, -500.0]])
    section, points = fitted_mesh(*FLAT, [spot, dash, spot[:1], spot[:0]], 200)
    assert len(points) == 1
    assert section.areas.sum() == pytest.approx(4e6)


def test_an_error_inside_gmsh_ends_no_process():
    """Of these lines gmsh finds a point outside of the field of sizes, and throws in its loop."""
    block = np.array([[0.4, 0.7], [0.6, 0.7], [0.6, 0.9], [0.4, 0.9], [0.4, 0.7]])
    flat = [np.array([[0.0, z], [1.0, z]]) for z in (1.0, 0.0)]
    section, points = fitted_mesh(*flat, [block], 1 / 30, 0.125 / 30)
    inside = np.argmin(np.abs(points - [0.5, 0.8]).max(axis=1))
    assert region_areas(section) == pytest.approx(np.where(np.arange(2) == inside, 0.04, 0.96))
    assert least_angle(section) > 15


def test_a_mesh_with_a_hole_or_an_overlap_is_refused(monkeypatch):
    whole = section_module._meshed

    def meshed(drop):
        def faulty(*given):
            x, cells = whole(*given)
            return x, drop(cells)

        return faulty

    inner = [  # the cell nearest to the middle: taken out, and there twice
        lambda cells: np.delete(cells, len(cells) // 2, axis=0),
        lambda cells: np.vstack([cells, cells[len(cells) // 2]]),
        lambda cells: np.vstack([cells[:1, ::-1], cells[1:]]),
    ]
    for drop in inner:
        monkeypatch.setattr(section_module, "_meshed", meshed(drop))
        with pytest.raises(MeshingError, match="cells overlap or leave a gap near"):
            fitted_mesh(*FLAT, [], 200)
    monkeypatch.setattr(section_module, "_meshed", meshed(lambda cells: cells[:0]))
    with pytest.raises(MeshingError, match="gmsh made no cells"):
        fitted_mesh(*FLAT, [], 200)

"""Moments of rock between lines against polygons cut by the cells; what is done at gaps."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
import shapely

from meshes.box import section_mesh
from restoration.engine import StokesEngine
from restoration.line_rock import LineRock
from restoration.particles import CellIndex
from restoration.run import march
from restoration.scene import Line, TimePlan, Transfer
from restoration.spaces import Spaces
from tests.restoration.conftest import MYR, diapir_scene
from tests.restoration.test_engine import INITIAL_RMS

DENSITY = np.array([2150.0, 2600.0, 2300.0, 2000.0])
LINES = Transfer("lines", "lines", "harmonic")


@dataclass(frozen=True, eq=False)
class Section:
    """What `LineRock` reads of a scene: rock by polygons, the last in which a point is counts."""

    lines: tuple
    faces: tuple
    units: tuple = (0, 1, 2, 3)

    def unit_at(self, x):
        unit = np.zeros(len(x), np.int16)
        for row, face in enumerate(self.faces, start=1):
            unit[shapely.contains_xy(face, *x.T)] = row
        return unit


@pytest.fixture(scope="module")
def box():
    section = section_mesh(np.array([[0, 0], [1, 0.0]]), np.array([[0, -1], [1, -1.0]]), (6, 6))
    return Spaces(section), CellIndex(section)


def line(points, name="a / b"):
    return Line(name, "horizon", np.asarray(points, float))


def moments(box, section, lines=None):
    spaces, index = box
    rock = LineRock(section, spaces, index, np.ones(len(index.area), bool))
    x, cells = index.corners.mean(axis=1), np.arange(len(index.area))
    particles = cells, np.full((len(cells), 3), 1 / 3), section.unit_at(x), index.area
    lines = section.lines if lines is None else lines
    found, unsure = rock.moments(lines, DENSITY[:, None], particles)
    return found[..., 0], unsure


def by_polygons(box, faces):
    """Return the same by pieces of cells: of linear hats the value at the centroid is the mean."""
    corners = box[1].corners
    cells = shapely.polygons(corners)
    found = np.repeat(DENSITY[0] * box[1].area[:, None] / 3, 3, axis=1)
    matrix = np.concatenate([corners, np.ones((len(corners), 3, 1))], axis=2)
    for row, face in enumerate(faces, start=1):
        piece = shapely.intersection(cells, face)
        area = shapely.area(piece)
        at = np.where(area > 0)[0]
        centre = shapely.get_coordinates(shapely.centroid(piece[at]))
        ones = np.column_stack([centre, np.ones(len(at))])
        hats = np.linalg.solve(np.swapaxes(matrix[at], 1, 2), ones[..., None])[..., 0]
        found[at] += (DENSITY[row] - DENSITY[0]) * area[at, None] * hats
    return found


TILTED = [[0, -0.61], [0.37, -0.47], [1, -0.23]]
ROW = [[0, -0.5], [0.4, -0.5], [1, -0.5]]
CORNERS = [[0, -1 / 3], [1 / 3, -1 / 3], [2 / 3, -2 / 3], [1, -2 / 3]]  # diagonals, vertices


@pytest.mark.parametrize("points", [TILTED, ROW, CORNERS])
@pytest.mark.parametrize("way", [1, -1])
def test_moments_above_a_line_are_exact(box, points, way):
    above = shapely.Polygon([*points, (1, 0), (0, 0)])
    found, unsure = moments(box, Section((line(points[::way]),), (above,)))
    assert not unsure.any()
    assert found == pytest.approx(by_polygons(box, [above]), rel=1e-11)


@pytest.mark.parametrize("radius", [0.31, 0.02])
def test_moments_of_a_circle_are_exact(box, radius):
    """Also of one that lies in a single cell, which no edge tells of."""
    t = np.linspace(0, 2 * np.pi, 200)
    ring = np.column_stack([0.52 + radius * np.cos(t), -0.57 + radius * np.sin(t)])
    ring[-1] = ring[0]
    inside = shapely.Polygon(ring)
    found, unsure = moments(box, Section((line(ring),), (inside,)))
    assert not unsure.any()
    assert found == pytest.approx(by_polygons(box, [inside]), rel=1e-11)
    assert found.sum() == pytest.approx(DENSITY[0] + np.ptp(DENSITY[:2]) * inside.area, rel=1e-12)


def wedge(tip, dz=0.0):
    """A layer between two others that pinches out in the section: three lines meet there."""
    tip = np.asarray(tip, float)
    low, high = np.array([[0, -0.71], [0.3, -0.66], tip]), np.array([[0, -0.41], tip])
    rest = np.array([tip, [1, -0.52 + dz]])
    lines = line(low, "a / b"), line(high[::-1], "b / c"), line(rest, "a / c")
    middle = shapely.Polygon([*low, *high[::-1][1:]])
    top = shapely.Polygon([*high, rest[-1], (1, 0), (0, 0)])
    return Section(lines, (middle, top))


@pytest.mark.parametrize("tip", [(0.63, -0.55), (0.5, -0.5), (0.6, -0.5)])
def test_three_layers_and_a_pinch_out(box, tip):
    """With the tip in a cell, on a vertex and on an edge."""
    section = wedge(tip)
    found, unsure = moments(box, section)
    assert not unsure.any()
    assert found == pytest.approx(by_polygons(box, section.faces), rel=1e-11)


def test_layers_without_thickness_do_not_count(box):
    """Two lines on each other, or crossed by rounding, are one."""
    points = np.array(CORNERS)
    above = shapely.Polygon([*points, (1, 0), (0, 0)])
    apart = line(points + [0, 0.01], "b / c")
    faces = shapely.Polygon([*points, *apart.points[::-1]]), above
    section = Section((line(points), apart), faces)
    wanted = by_polygons(box, (shapely.Polygon(), above))
    for off in (0, 1e-12, -1e-12, -1e-9):
        both = line(points), line(points + [0, off], "b / c")
        found, unsure = moments(box, section, both)
        assert not unsure.any()
        assert found == pytest.approx(wanted, rel=1e-7)


def test_moments_are_continuous_in_the_lines(box):
    """Through vertices, along edges and with a tip that crosses edges."""
    section = wedge((0.6, -0.51))
    before = moments(box, section)[0]
    for shift in np.arange(1, 200) * 1e-3:
        lines = [replace(one, points=one.points + [0, shift]) for one in section.lines]
        found, unsure = moments(box, section, lines)
        assert not unsure.any()
        assert np.abs(found - before).max() < 1e-3 * 0.2 * np.ptp(DENSITY)
        before = found


@pytest.mark.parametrize("gap", [1e-4, 0.05, 0.2, 0.4])
def test_a_gap_in_a_contact_leaves_its_cells_to_the_particles(box, gap):
    above = shapely.Polygon([*TILTED, (1, 0), (0, 0)])
    way = np.array([0.63, 0.24])
    middle = TILTED[1] + 0.2 * way
    ends = middle - gap / 2 * way, middle + gap / 2 * way
    lines = line([*TILTED[:2], ends[0]]), line([ends[1], TILTED[2]])
    found, unsure = moments(box, Section(lines, (above,)))
    assert np.count_nonzero(unsure) <= 12
    centre = box[1].corners.mean(axis=1)
    assert (np.linalg.norm(centre[unsure] - middle, axis=1) < 0.4 + gap).all()
    far = np.linalg.norm(centre - middle, axis=1) > 0.4 + gap / 2
    assert found[far] == pytest.approx(by_polygons(box, [above])[far], rel=1e-11)


def test_ends_on_walls_but_for_rounding_are_on_them(box):
    """In the mesh by what the first look tells and beyond it by the next."""
    for z in np.linspace(-0.93, -0.07, 40):
        points = np.array([[1e-16, z], [0.4, -0.5], [1 + 2.3e-16, -1 - z]])
        for off in (0, 1e-15, -1e-15, 1e-12, -1e-12, 1e-10, 1e-8, -1e-8):
            moved = points + [[off, 0], [0, 0], [-off, 0]]
            above = shapely.Polygon([*points, (1, 0), (0, 0)])
            found, unsure = moments(box, Section((line(moved),), (above,)))
            assert not unsure.any()
            assert found.sum() == pytest.approx(by_polygons(box, [above]).sum(), rel=1e-6)


def test_ends_that_a_step_left_beside_a_wall_go_through_it(box):
    above = shapely.Polygon([*TILTED, (1, 0), (0, 0)])
    wanted = by_polygons(box, [above])
    for off in (1e-3, -1e-3):
        points = np.array(TILTED) + [[off, 0], [0, 0], [-off, 0]]
        found, unsure = moments(box, Section((line(points),), (above,)))
        assert not unsure.any()
        assert found == pytest.approx(wanted, rel=1e-2)
        assert found.sum() == pytest.approx(wanted.sum(), rel=1e-5)


def test_a_mirrored_section_has_the_mirrored_moments(box):
    index, section = box[1], wedge((0.63, -0.55))
    mirror = [shapely.transform(face, lambda x: x * [-1, 1] + [1, 0]) for face in section.faces]
    lines = [replace(one, points=one.points * [-1, 1] + [1, 0]) for one in section.lines]
    one, other = moments(box, section)[0], moments(box, Section(tuple(lines), tuple(mirror)))[0]

    sums = [np.bincount(box[0].h_nodes.ravel(), values.ravel()) for values in (one, other)]
    place = np.empty((len(sums[0]), 2))
    place[box[0].h_nodes] = index.corners
    order = [np.lexsort(x.round(9).T) for x in (place, place * [-1, 1] + [1, 0])]
    assert sums[0][order[0]] == pytest.approx(sums[1][order[1]], rel=1e-11)


@pytest.mark.parametrize(("ratio", "bound"), [(1, 1e-3), (10, 8e-3)])
def test_initial_velocity_of_lines_meets_theory(ratio, bound):
    scene = diapir_scene(cells=(16, 17), viscosity=(1e19 / ratio, 1e19), transfer=LINES)
    engine = StokesEngine(scene)
    rms, _ = engine.grid.speeds(engine.with_flow(engine.start()).flow)
    scale = (2600 - 2150) * 9.81 * scene.outline.height**2 / 1e19
    assert rms / scale == pytest.approx(INITIAL_RMS[ratio], rel=bound)


def test_rk4_is_of_third_order_with_lines_at_least():
    """Stokes solved at every stage, with the density of the lines at that stage."""
    found = {}
    for n in (4, 8, 32):
        plan = TimePlan((0.0, 1.0 * MYR), "rk4", 1e9, n)
        engine = StokesEngine(diapir_scene(time=plan, transfer=LINES))
        end = march(engine.start(), engine, plan)
        assert engine.grid.fields.unsure == 0
        found[n] = end.particles.x
    gap = [np.linalg.norm(found[n] - found[32], axis=1).mean() for n in (4, 8)]
    assert np.log2(gap[0] / gap[1]) > 2.9

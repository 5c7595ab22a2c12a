"""Rock that crosses walls: particles and line ends, in many small steps as in a few large ones."""

import numpy as np
import pytest
from scipy.spatial import cKDTree

from restoration.errors import ParticleError
from restoration.inflow import cast_off, cut, extended, flowed_in, touching
from restoration.lines import as_drawn, begin
from restoration.particles import OUTSIDE, Particles, joined
from restoration.scene import Line, Outline

H = 10.0
BOX = Outline(np.array([[0, 0], [400, 0.0]]), np.array([[0, -200], [400, -200.0]]))
RELIEF = Outline(np.array([[0, 0], [200, 60], [400, 40.0]]), np.array([[0, -200], [400, -150.0]]))


def cloud(x, unit=None, area=H * H):
    n = len(x)
    unit = np.zeros(n, np.int16) if unit is None else unit.astype(np.int16)
    return Particles(x, unit, np.full(n, area), x.copy(), np.zeros(n, np.int32))


def lattice(low, high, jitter=0.0):
    axes = [np.arange(a + H / 2, b, H) for a, b in zip(low, high, strict=True)]
    x = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)
    return x + jitter * H * (np.random.default_rng(1).random(x.shape) - 0.5)


def column(name, outline=BOX):
    """Points that stand on a wall."""
    if name in ("base", "surface"):
        x = np.linspace(outline.surface[0, 0], outline.surface[-1, 0], 300)
        return np.column_stack([x, np.interp(x, *getattr(outline, name).T)])
    end = 0 if name == "left" else -1
    z = np.linspace(outline.base[end, 1], outline.surface[end, 1], 300)
    return np.column_stack([np.full(300, outline.surface[end, 0]), z])


def marched(particles, name, move, steps, outline=BOX, flow=None):
    """Particles after steps that each move all rock by ``move``, m, or by a flow of places."""
    flow = flow or (lambda x: np.broadcast_to(move, x.shape))
    for _ in range(steps):
        wall = column(name, outline)
        moved = Particles(particles.x + flow(particles.x), *values(particles))
        kept, _ = cast_off(moved, outline)
        born = flowed_in(kept, name, outline, wall + flow(wall), H)
        particles = kept if born is None else joined(kept, born)
    return particles


def values(particles):
    return particles.unit, particles.area, particles.start, particles.cell


def crowding(particles, low, high):
    """Greatest and least number of particles in squares of five spacings, over what it should be,
    and the greatest distance of any point from a particle, in spacings."""
    edges = [np.arange(a, b + 1, 5 * H) for a, b in zip(low, high, strict=True)]
    counts = np.histogram2d(*particles.x.T, bins=edges)[0] / 25
    probes = lattice(low, high)
    gap = cKDTree(particles.x).query(probes)[0].max() / H
    return counts.max(), counts.min(), gap


WAYS = {"left": (1, 0), "right": (-1, 0), "base": (0, 1), "surface": (0, -1)}


@pytest.mark.parametrize("name", WAYS)
@pytest.mark.parametrize(("steps", "size"), [(160, 0.1), (23, 0.7), (16, 1.0), (7, 2.3), (4, 4.0)])
@pytest.mark.parametrize("jitter", [0.0, 0.5])
def test_what_flows_in_is_neither_void_nor_crowded(name, steps, size, jitter):
    start = cloud(lattice((0, -200), (400, 0), jitter))
    end = marched(start, name, size * H * np.array(WAYS[name]), steps)
    greatest, least, gap = crowding(end, (0, -200), (400, 0))
    assert 0.79 < least  # the last row waits
    assert greatest < 1.2
    assert gap < 1.5
    assert end.area.sum() == pytest.approx(BOX.area, rel=0.03)
    born = np.isnan(end.start[:, 0])
    assert 0 < born.sum() < len(end.x)
    assert (end.cell[born] == OUTSIDE).all()


def test_twenty_spacings_in_two_hundred_steps_of_shear():
    """Faster above than below, and rising: what has flowed in moves through the rows."""
    start = cloud(lattice((0, -200), (400, 0), 0.5))

    def flow(x):
        share = (x[:, 1] + 200) / 200
        return H * np.column_stack([0.1 * share, np.full(len(x), 0.02)])

    end = marched(start, "left", None, 200, flow=flow)
    greatest, least, gap = crowding(end, (0, -150), (150, 0))
    assert 0.79 < least
    assert greatest < 1.21
    assert gap < 1.5


def test_layers_flow_in_as_they_stand():
    x = lattice((0, -200), (400, 0), 0.5)
    layers = np.digitize(x[:, 1], [-150.0, -80.0, -70.0])
    for steps, size in ((200, 1.0), (5, 40.0)):
        end = marched(cloud(x, layers), "right", (-size, 0.0), steps)
        born = np.isnan(end.start[:, 0])
        off = end.unit[born] != np.digitize(end.x[born, 1], [-150.0, -80.0, -70.0])
        assert off.mean() < 0.06
        assert (
            np.abs(end.x[born][off][:, 1, None] - [-150, -80, -70]).min(axis=1).max(initial=0)
            < 0.6 * H
        )


def test_columns_flow_in_through_the_base_as_they_stand():
    x = lattice((0, -200), (400, 0))
    end = marched(cloud(x, x[:, 0] > 200), "base", (0.0, 5.0), 8)
    assert (end.unit == (end.x[:, 0] > 200)).all()


@pytest.mark.parametrize("name", ["left", "right"])
def test_under_a_relief_the_strip_is_filled_to_the_top(name):
    x = lattice((0, -200), (400, 60))
    base, top = (np.interp(x[:, 0], *line.T) for line in (RELIEF.base, RELIEF.surface))
    start = cloud(x[(x[:, 1] > base) & (x[:, 1] < top)])
    end = marched(start, name, np.multiply(WAYS[name], (5.0, 0.0)), 20, RELIEF)
    assert cast_off(end, RELIEF)[1] == dict.fromkeys(("left", "right", "base", "surface"), 0)
    strip = (0, 100) if name == "left" else (300, 400)
    new = np.isnan(end.start[:, 0]) & (end.x[:, 0] > strip[0]) & (end.x[:, 0] < strip[1])
    at = np.linspace(*strip, 2001)
    height = np.interp(at, *RELIEF.surface.T) - np.interp(at, *RELIEF.base.T)
    assert end.area[new].sum() == pytest.approx(np.trapz(height, at), rel=0.1)


def test_nothing_is_born_where_rock_flows_out_or_rests():
    start = cloud(lattice((0, -200), (400, 0)))
    wall = column("left")
    assert flowed_in(start, "left", BOX, wall, H) is None
    assert flowed_in(start, "left", BOX, wall - (30, 0), H) is None
    lower = start.x[:, 1] < -100
    half = Particles(start.x + 40 * lower[:, None] * np.array([1, 0]), *values(start))
    moved = wall + 40 * (wall[:, 1:] < -100) * np.array([1, 0])
    born = flowed_in(half, "left", BOX, moved, H)
    assert len(born.x) == 40
    assert born.x[:, 1].max() < -100


def test_the_same_again_is_the_same():
    start = cloud(lattice((0, -200), (400, 0), 0.5))
    one, two = (marched(start, "left", (3.0, 0.0), 10) for _ in range(2))
    assert np.array_equal(one.x, two.x)


def test_an_empty_section_cannot_tell_what_flows_in():
    wall = column("left")
    with pytest.raises(ParticleError, match="no particle is left"):
        flowed_in(cloud(np.empty((0, 2))), "left", BOX, wall + (30, 0), H)


def test_what_is_beyond_an_open_wall_goes_and_is_counted():
    x = np.array([[-1, -5], [-1, 9], [401, -5], [5, 1], [6, 2], [5, -201], [0, 0], [9, -9.0]])
    kept, out = cast_off(cloud(x), BOX)
    assert out == {"left": 2, "right": 1, "base": 1, "surface": 2}
    assert kept.x.tolist() == [[0, 0], [9, -9]]
    kept, out = cast_off(cloud(x), BOX, ("right",))
    assert out == {"right": 1}
    assert len(kept.x) == len(x) - 1


def moving(points):
    return begin((Line("a", "horizon", np.array(points, float)),), 1e9)[0]


def test_ends_on_side_walls_are_known():
    assert touching(moving([[0, 1], [9, 1]]), 0.0, 9.0, 0.1) == (0.0, 9.0)
    assert touching(moving([[8.95, 1], [4, 1]]), 0.0, 9.0, 0.1) == (9.0, None)


def test_a_line_is_cut_where_it_crosses_the_wall():
    line = moving([[-30, 0], [-10, 0], [10, 2], [50, 2], [90, 2], [110, 4]])
    short = cut(line, 0.0, 100.0)
    assert short.points == pytest.approx(np.array([[0, 1], [10, 2], [50, 2], [90, 2], [100, 3]]))
    assert np.isnan(short.added).all()
    assert as_drawn((short,))[0].points == pytest.approx(short.points)
    assert cut(short, 0.0, 100.0) is short
    assert cut(line, -np.inf, np.inf) is line
    assert cut(moving([[-30, 0], [-10, 0]]), 0.0, 100.0) is None
    bulge = cut(moving([[10, 0], [-5, 1], [10, 2]]), 0.0, 100.0)
    assert bulge.points.tolist() == [[10, 0], [0, 1], [10, 2]]


@pytest.mark.parametrize("flip", [1, -1])
@pytest.mark.parametrize(("steps", "size"), [(200, 0.1), (5, 4.0)])
def test_a_line_is_drawn_on_to_the_wall_that_it_leaves(flip, steps, size):
    """It goes on at the height its end has risen to, with vertices a spacing apart."""
    line = moving([[0, 0], [40, 0], [100, 0]][::flip])
    walls = touching(line, 0.0, np.inf, 1e-6)
    for _ in range(steps):
        moved = line.points + (size, 0.05 * size)
        line = type(line)(line.name, line.kind, moved, line.added, line.way)
        line = extended(line, walls, 1.0)
    points = line.points[::flip]
    assert points[0] == pytest.approx((0, 1))
    assert points[:, 1] == pytest.approx(np.ones(len(points)))
    assert (np.diff(points[:, 0])[1:] > 0.99).all()
    assert len(points) <= min(steps, 20) + 4
    assert (line.way == 0).all()
    assert np.isnan(line.added).all()


def test_a_line_that_left_no_wall_stays():
    line = moving([[5, 0], [40, 0]])
    assert extended(line, (None, None), 1.0) is line
    assert extended(line, (5.0, None), 1.0) is line

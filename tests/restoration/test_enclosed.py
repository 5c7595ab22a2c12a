"""Areas that horizons enclose are kept between closed walls."""

from dataclasses import replace

import numpy as np
import pytest

from restoration.enclosed import kept
from restoration.lines import MovingLine
from restoration.scene import Outline

FRAME = Outline(np.array([[0, 0], [1000, 0.0]]), np.array([[0, -500], [1000, -600.0]]))


def line(points, name="h", kind="horizon"):
    points = np.asarray(points, float)
    return MovingLine(name, kind, points, np.full(len(points), np.nan), np.zeros(len(points), int))


def area(points, *corners):
    x, z = np.vstack([points, *corners]).T
    return 0.5 * abs(np.dot(x, np.roll(z, 1)) - np.dot(z, np.roll(x, 1)))


def wavy(n=100):
    x = np.linspace(0, 1000, n)
    return np.column_stack([x, -250 + 60 * np.cos(x / 130)])


@pytest.mark.parametrize("way", [1, -1])
def test_a_horizon_from_side_to_side_keeps_the_area_below(way):
    rng = np.random.default_rng(1)
    before = wavy()
    off = rng.normal(size=before.shape) * [0, 1.0] + [0, 0.5]
    (found,), shift = kept((line(before[::way]),), (line((before + off)[::way]),), FRAME, False)
    base = [[1000, -600], [0, -500]][:: 1 if way > 0 else -1]
    assert area(found.points, base) == pytest.approx(area(before[::way], base), rel=1e-12)
    assert found.points[[0, -1], 0] == pytest.approx([0, 1000][::way])
    assert shift == pytest.approx(0.5, abs=0.3)


def test_ends_on_base_and_surface_stay_where_they_are():
    angle = np.linspace(0, np.pi, 60)
    arch = np.column_stack([500 - 200 * np.cos(angle), 0 * angle])
    arch[:, 1] = np.interp(arch[:, 0], *FRAME.base.T) + 200 * np.sin(angle)
    moved = arch + np.outer(np.sin(angle), [0, 2.0])
    (found,), _ = kept((line(arch),), (line(moved),), FRAME, False)
    assert area(found.points) == pytest.approx(area(arch), rel=1e-12)
    assert np.array_equal(found.points[[0, -1]], arch[[0, -1]])
    shaft = np.array([[300, -530.0], [350, -300], [400, 0]])
    moved = shaft + [[0, 0], [3, 0], [0, 0]]
    corners = [[0, 0], [0, -500]]
    (found,), shift = kept((line(shaft),), (line(moved),), FRAME, False)
    assert area(found.points, corners) == pytest.approx(area(shaft, corners), rel=1e-12)
    (open_,), none = kept((line(shaft),), (line(moved),), FRAME, True)  # below a free surface
    assert np.array_equal(open_.points, moved)
    assert none == 0 != shift


def test_a_closed_horizon_keeps_its_area_and_stays_closed():
    angle = np.linspace(0, 2 * np.pi, 80)
    ring = np.column_stack([500 + 100 * np.cos(angle), -300 + 80 * np.sin(angle)])
    ring[-1] = ring[0]
    moved = (ring - [500, -300]) * 1.01 + [520, -290]
    (found,), _ = kept((line(ring),), (line(moved),), FRAME, False)
    assert area(found.points) == pytest.approx(area(ring), rel=1e-12)
    assert np.array_equal(found.points[0], found.points[-1])


def test_what_ends_inside_or_is_no_horizon_is_left_alone():
    before, after = wavy(), wavy() + [0, 1.0]
    inside, faults = line(before[:50]), line(before, kind="fault")
    lines, shift = kept(
        (inside, faults), (line(after[:50]), replace(faults, points=after)), FRAME, False
    )
    assert shift == 0
    assert np.array_equal(lines[0].points, after[:50])
    assert np.array_equal(lines[1].points, after)


@pytest.mark.parametrize("ways", [(1, 1, 1), (1, -1, 1), (-1, -1, -1)])
def test_contacts_that_meet_end_to_end_count_as_one(ways):
    rng = np.random.default_rng(2)
    before = wavy()
    after = before + rng.normal(size=before.shape) * [0, 1.0] + [0, 0.5]
    cuts = [(0, 31), (30, 71), (70, 100)]

    def pieces(points):
        parts = [line(points[a:b][::w], "salt / b") for (a, b), w in zip(cuts, ways, strict=True)]
        return (*parts, line([points[30], [400, -50], [450, 0]], "a / b"))

    found, shift = kept(pieces(before), pieces(after), FRAME, False, {"salt / b"})
    parts = [x.points[::w] for x, w in zip(found, ways, strict=False)]
    assert np.array_equal(parts[0][-1], parts[1][0])
    assert np.array_equal(parts[1][-1], parts[2][0])
    assert np.array_equal(found[3].points[0], parts[1][0])  # what ended there still does
    whole = np.concatenate([parts[0], parts[1][1:], parts[2][1:]])
    base = [[1000, -600], [0, -500]]
    assert area(whole, base) == pytest.approx(area(before, base), rel=1e-12)
    assert shift > 0.1
    apart, none = kept(pieces(before), pieces(after), FRAME, False)
    assert none == 0
    assert np.array_equal(apart[0].points, pieces(after)[0].points)


def test_contacts_that_go_round_keep_what_they_enclose():
    angle = np.linspace(0, 2 * np.pi, 81)
    ring = np.column_stack([500 + 100 * np.cos(angle), -300 + 80 * np.sin(angle)])
    ring[-1] = ring[0]

    def halves(points):
        return line(points[:41], "salt / a"), line(points[40:], "salt / b")

    moved = (ring - [500, -300]) * 1.01 + [520, -290]
    names = {"salt / a", "salt / b"}
    (one, two), _ = kept(halves(ring), halves(moved), FRAME, False, names)
    whole = np.concatenate([one.points, two.points[1:]])
    assert np.array_equal(whole[0], whole[-1])
    assert area(whole) == pytest.approx(area(ring), rel=1e-12)

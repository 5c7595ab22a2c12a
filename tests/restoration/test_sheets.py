from dataclasses import replace

import numpy as np
import pytest

from restoration.scene import Sheet
from restoration.sheets import crossing, flatness, joined, sheet_distances, triangles


def sheet(height, shape=(4, 5)):
    y, x = np.mgrid[0:1:4j, 0:2:5j]
    points = np.column_stack([x.ravel(), y.ravel(), height(x.ravel(), y.ravel())])
    return Sheet("salt / sediment", "horizon", points, shape)


LEVEL = sheet(lambda x, y: 0 * x - 3)
RAMP = sheet(lambda x, y: x + 2 * y)


def test_triangles_cover_the_sheet_once():
    a, b, c = np.moveaxis(LEVEL.points[triangles(LEVEL.shape)], 1, 0)
    assert np.cross(b - a, c - a)[:, 2].min() > 0  # all of one turn
    assert np.cross(b - a, c - a)[:, 2].sum() / 2 == pytest.approx(2)


def test_sheets_are_joined_with_their_numbers():
    points, cells, of = joined([LEVEL, RAMP])
    assert points.shape == (40, 3)
    assert cells.shape == (48, 3)
    assert (of[cells] == of[cells][:, :1]).all()
    assert np.bincount(of).tolist() == [20, 20]


def test_a_cut_crosses_a_ramp_along_a_line():
    ends = crossing(RAMP, 0.4)
    assert ends[..., 1] == pytest.approx(ends[..., 0] + 0.8)
    length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum()
    assert length == pytest.approx(2 * np.sqrt(2))


def test_a_cut_beside_a_sheet_crosses_nothing():
    assert crossing(RAMP, 7.0).shape == (0, 2, 2)


def test_points_tell_how_far_a_sheet_is_from_where_it_was():
    shift = np.zeros(LEVEL.points.shape)
    shift[3] = 0, 0.3, 0.4
    (row,) = sheet_distances([LEVEL], [replace(LEVEL, points=LEVEL.points + shift)])
    assert row["name"] == "salt / sediment"
    assert row["max_m"] == pytest.approx(0.5)
    assert row["mean_m"] == pytest.approx(0.5 / 20)


def test_a_level_sheet_is_flat():
    assert flatness([LEVEL]) == 0
    assert flatness([]) is None
    assert flatness([LEVEL, RAMP]) == pytest.approx(np.sqrt(np.var(RAMP.points[:, 2]) / 2))

"""Which rank has which particles, as far as one rank can tell; tests/test_mpi.py runs on more."""

import numpy as np
import pytest

from restoration.engine import StokesEngine
from restoration.sharing import bisected


@pytest.mark.parametrize("parts", [1, 2, 3, 7, 64])
def test_parts_hold_about_the_same(parts):
    rng = np.random.default_rng(3)
    centres = rng.random((20_000, 2)) * (5.0, 1.0)
    weights = 1 + 19.0 * (np.abs(centres[:, 1] - 0.4) < 0.05)  # particles crowd at a contact
    held = np.bincount(bisected(centres, weights, parts), weights, parts)
    assert held.max() < 1.05 * held.mean()


def test_parts_are_compact():
    x = np.stack(np.meshgrid(np.arange(40.0), np.arange(10.0)), axis=-1).reshape(-1, 2)
    part = bisected(x, np.ones(400), 4)
    sides = [np.ptp(x[part == p], axis=0) for p in range(4)]
    assert np.allclose(sides, [9, 9])


def test_parts_of_boxes_are_cut_across_all_axes():
    x = np.stack(np.meshgrid(*[np.arange(8.0)] * 3), axis=-1).reshape(-1, 3)
    part = bisected(x, np.ones(512), 8)
    assert all(np.allclose(np.ptp(x[part == p], axis=0), 3) for p in range(8))


def test_one_rank_has_the_whole_cloud(make_scene):
    engine = StokesEngine(make_scene())
    state = engine.with_flow(engine.start())
    assert state.particles.number is None
    assert engine.whole(state).particles is state.particles
    assert engine.sharing.load == 1.0

"""The rows beside another code: what is held, and that the waves are those of the theory."""

import numpy as np
import pytest

from restoration.bench.peers import LESS, Match, growth
from restoration.bench.reference import PEERS, RAMBERG_VELOCITY


@pytest.mark.parametrize(
    ("errors", "seconds", "held"),
    [
        ((1e-3, 2e-3), (1.0, 20.0), (True, True)),
        ((-3e-3, 2e-3), (1.0, 20.0), (False, True)),
        ((1e-3, -2e-3), (1.0, 9.0), (True, False)),
    ],
)
def test_error_and_seconds_are_held_against_theirs(errors, seconds, held):
    rows = list(Match("case", errors, seconds, (1, 2)).rows(False))
    assert [row.metric for row in rows] == ["relative error", "CPU seconds", "times less CPU"]
    assert rows[1].held is None
    assert (rows[0].held, rows[2].held) == held
    assert rows[2].value == seconds[1] / seconds[0]
    assert rows[2].reference == LESS
    assert list(Match("case", errors, seconds, (1, 2)).rows(True))[2].held is None


def test_a_polygon_that_is_higher_carries_the_wave():
    """A polygon through points of the wave is lower by 0.8 and 0.2 % on these edges."""
    for near, most in ((0.1, 2.5e-3), (0.05, 4e-4)):
        _, found = growth(128e3, 1e21, 2, near)
        off = found / np.array(RAMBERG_VELOCITY[128e3, 1e21]) - 1
        assert np.abs(off).max() < most


def test_the_numbers_of_the_peer_are_whole():
    assert {row["eta_block"] for row in PEERS["sinking_block"]["rows"]} >= {1e19, 1e23, 1e27}
    waves = PEERS["rayleigh_taylor"]
    assert {len(errors) for errors in waves["relative_error"].values()} == {len(waves["eta2"])}

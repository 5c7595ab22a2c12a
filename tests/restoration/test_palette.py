from itertools import pairwise

import pytest

from restoration.palette import unit_colors


def lightness(color):
    return sum(int(color[i : i + 2], 16) for i in (1, 3, 5))


@pytest.mark.parametrize("count", range(2, 20))
def test_units_of_one_rock_get_shades_of_their_own(count):
    _, units = unit_colors(["sediment"], [0] * count, [None])
    assert len(set(units)) == count
    steps = [abs(lightness(a) - lightness(b)) for a, b in pairwise(units)]
    assert min(steps) > 0.2 * (max(map(lightness, units)) - min(map(lightness, units))) / 2


def test_given_and_usual_colours():
    rocks, units = unit_colors(["salt", "Upper Shale", "x"], [0, 1, 2], ["#112233", None, None])
    assert rocks[0] == units[0] == "#112233"
    assert rocks[1] == "#93a08a"
    assert len(set(rocks)) == 3

"""What the benchmarks of free surfaces are made of: their theory and how they read a surface."""

from types import SimpleNamespace

import numpy as np
import pytest

from restoration.bench.reliefs import load_stress
from restoration.bench.surfaces import (
    BOX,
    HILLS,
    KYR,
    THRESHOLD,
    growth_of_tilt,
    plume,
    relaxation_rate,
    theory_of_tilt,
    tilts,
)

# computed independently of restoration.layered, 1/s
RATES = {10.0: 2.139529850853621e-12, 9.81: 2.0988787836874023e-12}


@pytest.mark.parametrize("gravity", RATES)
def test_the_rate_of_the_hill(gravity):
    gamma = relaxation_rate(gravity)
    assert gamma == pytest.approx(RATES[gravity], rel=1e-9)
    # 7 km is not small: crest and trough go their own ways, their mean nearly as theory says
    for kyr, (crest, trough) in HILLS[gravity].items():
        mean = (crest - trough) / 2
        assert mean == pytest.approx(7 * np.exp(-gamma * kyr * KYR), rel=1e-2)


def test_a_step_of_the_threshold_turns_the_tilt_over():
    assert theory_of_tilt(THRESHOLD, 0.0) == pytest.approx(-1, abs=1e-6)
    assert abs(theory_of_tilt(3900, 0.0)) < 1 < abs(theory_of_tilt(4300, 0.0))
    assert -1 < theory_of_tilt(25000, 0.5) < theory_of_tilt(10000, 0.5) < 0
    assert 0 < theory_of_tilt(25000, 1.0) < 0.1


def ran(amplitudes):
    """A course whose surfaces have tilts of these amplitudes on a wave and a slow drift."""
    x = np.linspace(0, BOX, 2001)
    return SimpleNamespace(
        surfaces=[
            np.column_stack(
                [x, BOX + a * np.cos(np.pi * x / BOX) - 140 * np.cos(2 * np.pi * x / BOX)]
            )
            for a in amplitudes
        ]
    )


@pytest.mark.parametrize("factor", [-1.1, -0.9, -0.2, 0.3])
def test_the_factor_of_a_step_is_found(factor):
    amplitudes = 100 * factor ** np.arange(9) + 2 + 1e-3 * np.arange(9)
    assert tilts(ran(amplitudes)) == pytest.approx(amplitudes, abs=1e-3)
    assert growth_of_tilt(ran(amplitudes)) == pytest.approx(factor, rel=2e-3)


def test_the_load_is_heavy_where_it_pulls():
    assert load_stress() == pytest.approx(0.0165521, rel=1e-5)


def test_the_plume_lies_on_the_axis():
    scene = plume(8, 1, 4)
    middle = np.array([[0.0, 300e3], [40e3, 300e3], [60e3, 300e3], [0.0, 650e3], [0.0, 100e3]])
    assert scene.unit_at(middle).tolist() == [2, 2, 0, 1, 0]
    (around,) = (line.points for line in scene.lines if line.name == "plume")
    assert np.hypot(around[:, 0], around[:, 1] - 300e3) == pytest.approx(50e3)
    assert around[[0, -1], 0].tolist() == [0.0, 0.0]

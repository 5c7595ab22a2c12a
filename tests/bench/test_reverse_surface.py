"""Salt restored under a free surface: its truth, surface noise, and what a way that fails tells."""

import numpy as np
import pytest

from restoration.bench import reverse_surface as bench
from restoration.bench.two_interface import WIDTH, exact, system
from restoration.scene import SurfacePlan
from restoration.units import MYR

PAIR = bench.VISCOSITIES["two viscosities"]


def test_a_surface_at_rest_moves_with_the_horizon():
    moment = bench.start(PAIR, 100.0, True)
    assert moment.amplitude == pytest.approx(100.0)
    wave = np.array([100.0, moment.relief / 2])
    later = exact(system(*PAIR), 0.1 * MYR) @ wave
    assert later[1] / later[0] == pytest.approx(wave[1] / wave[0], rel=1e-6)
    assert bench.start(PAIR, 100.0, False).relief == 0


def test_integration_off_the_scale_ends_the_march():
    moment = bench.start(PAIR, 100.0, False)
    rough = moment.surface + [[0.0, 20.0]] * np.cos(np.pi * moment.surface / WIDTH)[:, :1]
    moment = bench.Moment(0.3 * MYR, moment.horizon, rough)
    case = bench.scene(
        PAIR,
        moment,
        (moment.time, 0.0),
        8,
        "particles",
        SurfacePlan(reverse="integrate"),
        scheme="midpoint",
        min_steps=4,
    )
    way, _, stopped = bench.moved(case)
    assert isinstance(stopped, bench.OffScaleError)
    assert way[-1].relief > bench.OFF_SCALE > way[-2].relief
    assert 0 < way[-1].time < moment.time


@pytest.mark.slow
def test_surface_noise_grows_integrated_and_is_forgotten_slaved():
    rows = list(bench.run_noise())
    assert [row.held for row in rows] == [True, True]


@pytest.mark.slow
@pytest.mark.parametrize("interfaces", ["fitted", "particles"])
def test_salt_is_restored_on_another_mesh(interfaces):
    truth = bench.Truth("two viscosities", 100.0, True, (0.1,), "particles", 16)
    ((moment, highest),) = truth.moments()
    rows = list(bench.restored(truth, moment, highest, interfaces, 12, "slave", bench.Clock()))
    found = {row.metric: row for row in rows}
    assert abs(found["restored amplitude, m"].relative_error) < 0.05
    assert found["greatest relief of the surface on the way back, m"].relative_error < 0.5

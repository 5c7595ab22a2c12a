"""Linear theory of layers against independent numbers, closed forms and its own symmetries."""

from dataclasses import replace

import numpy as np
import pytest

from restoration import layered
from restoration.bench.exact import two_layer_growth_rate
from restoration.layered import Layer, growth_matrix, rates, restorability, surface_rate
from restoration.scene import Wall

MYR = 31557600e6
FREE = Wall("free", (None, None), (0.0, 0.0))
# Free-surface Rayleigh-Taylor of Kaus et al. (2010): wavelength, km, and A, 1/s, of horizon and
# surface; computed independently, to 1e-12.
KAUS = (Layer(400e3, 3200.0, 1e20), Layer(100e3, 3300.0, 1e21))
KAUS_MATRIX = {
    1000: [
        [4.72212700720615e-13, -1.5410200223445123e-11],
        [4.66975764346822e-13, -1.5975034275672594e-11],
    ],
    125: [
        [8.914000218969359e-15, -2.323681682418399e-14],
        [7.041459643692119e-16, -3.234224057331911e-13],
    ],
}
# Relaxation of a cosine below a stiff lid, Crameri et al. (2012): (g, base) and the decay, 1/s;
# computed independently, to 1e-12.
CRAMERI = (Layer(600e3, 3300.0, 1e21), Layer(100e3, 3300.0, 1e23))
CRAMERI_DECAY = {
    (9.81, "no-slip"): 2.0988787836874023e-12,
    (9.81, "free-slip"): 3.862993774856075e-12,
    (10.0, "no-slip"): 2.139529850853621e-12,
    (10.0, "free-slip"): 3.9378122067849896e-12,
}


def relaxation_time(eta, rho, g, k, depth):
    """E-folding time of a cosine surface of a uniform layer, s; no slip at the base."""
    kd, tanh = k * depth, np.tanh(k * depth)
    sech2 = 1 - tanh**2
    return 2 * k * eta / (rho * g) * (1 + kd**2 * sech2) / (tanh - kd * sech2)


def random_layers(rng, count):
    return [
        Layer(10 ** rng.uniform(-2, 1), rng.uniform(2e3, 3e3), 10 ** rng.uniform(-5, 5))
        for _ in range(count)
    ]


@pytest.mark.parametrize("cuts", [(), (0.3,), (0.001, 0.5, 0.999)])
def test_a_uniform_layer_relaxes_as_in_closed_form(cuts):
    depth, k = 7e5, np.geomspace(3e-6, 1e-1, 40)
    layers = [Layer(h * depth, 3300.0, 1e21) for h in np.diff([0, *cuts, 1])]
    a = growth_matrix(layers, k, 9.81)[:, -1, -1]
    assert -1 / a == pytest.approx(relaxation_time(1e21, 3300.0, 9.81, k, depth), rel=1e-10)


@pytest.mark.parametrize(("slip", "product"), [("free-slip", 1 / 4), ("no-slip", 0.3214 / 2)])
def test_the_fastest_decay_of_a_uniform_layer(slip, product):
    """rho g H / 4 eta on a base that slips, and 0.3214 rho g H / 2 eta at k H = 2.12 on one that
    does not."""
    k = np.geomspace(1e-3, 10, 400)
    found = layered.fastest_decay([Layer(1.0, 1.0, 1.0)], k, 1.0, slip)
    assert found == pytest.approx(product, rel=1e-4)


@pytest.mark.parametrize(("g", "base"), CRAMERI_DECAY)
def test_relaxation_below_a_lid(g, base):
    found = layered.fastest_decay(CRAMERI, 2 * np.pi / 2800e3, g, base)
    assert found == pytest.approx(CRAMERI_DECAY[g, base], rel=1e-9, abs=0)


def test_horizon_and_free_surface():
    k = 2 * np.pi / (1e3 * np.array(list(KAUS_MATRIX)))
    assert growth_matrix(KAUS, k, 9.81) == pytest.approx(
        np.array([*KAUS_MATRIX.values()]), rel=1e-9
    )
    found = rates(KAUS, k[0], 9.81)
    assert found == pytest.approx([-1.5525199647969827e-11, 2.237807301784538e-14], rel=1e-9)


@pytest.mark.parametrize("eta2", [1e17, 1.25e20, 1e21, 2.5e23, 1e27])
def test_two_layers_between_plates(eta2):
    k = 2 * np.pi / np.array([5e4, 256e3, 512e3])
    layers = [Layer(300e3, 3000.0, eta2), Layer(200e3, 3300.0, 1e21)]
    found = growth_matrix(layers, k, 9.81, "no-slip", "no-slip")[:, 0, 0]
    exact = two_layer_growth_rate(k, 200e3, 300e3, 1e21, eta2, 300.0, 9.81)
    assert found == pytest.approx(exact, rel=1e-10, abs=0)


@pytest.mark.parametrize(
    ("ratio", "rate"), [(1, 0.010940189), (10, 0.047054839), (100, 0.103834616)]
)
def test_growth_of_van_keken(ratio, rate):
    layers = [Layer(0.2, 0.0, 1 / ratio), Layer(0.8, 1.0, 1.0)]
    found = growth_matrix(layers, np.pi / 0.9142, 1.0, "no-slip", "no-slip")
    assert found == pytest.approx(np.array([[rate]]), rel=1e-7)


def test_thick_layers_do_not_overflow():
    """Horizons far apart against the wave do not know of each other."""
    a = growth_matrix([Layer(1e6, 2.0, 1.0), Layer(1e6, 3.0, 1e10)], 1.0, 1.0)
    assert a == pytest.approx(np.diag([1 / (2 * (1 + 1e10)), -3 / 2e10]), rel=1e-9, abs=1e-30)


def test_a_stiff_thin_lid_over_a_weak_layer():
    """As a beam bending under its load, 4 eta k (k h)^3 / 12, beside the weak rock below it."""
    h, contrast = 1e-4, 1e8
    a = growth_matrix([Layer(50.0, 1.0, 1.0), Layer(h, 1.0, contrast)], 1.0, 1.0, "free-slip")
    bending = contrast * h**3 / 3
    assert -1 / a[-1, -1] == pytest.approx(2 + bending, rel=2e-4)


def test_responses_are_symmetric_and_all_rates_real():
    rng = np.random.default_rng(3)
    for count in (2, 3, 5):
        layers = random_layers(rng, count)
        jumps = np.diff([layer.density for layer in layers] + [0.0])
        a = growth_matrix(layers, np.array([0.1, 1.0, 10.0]), 9.81, "free-slip")
        response = a / jumps
        size = np.abs(response).max()
        assert response == pytest.approx(response.transpose(0, 2, 1), abs=1e-12 * size)
        assert (np.einsum("kii->ki", response) > 0).all()
        assert np.abs(np.linalg.eigvals(a).imag).max() < 1e-9 * np.abs(a).max()


def test_a_section_upside_down():
    """Between plates, turned over and with weights reversed, horizons grow at the same rates."""
    layers = random_layers(np.random.default_rng(4), 4)
    turned = [replace(layer, density=-layer.density) for layer in layers[::-1]]
    for walls in (("no-slip", "free-slip"), ("no-slip", "no-slip")):
        there = growth_matrix(layers, 0.7, 9.81, *walls)
        back = growth_matrix(turned, 0.7, 9.81, *walls[::-1])
        assert back[::-1, ::-1] == pytest.approx(there, rel=1e-8, abs=0)


def test_wave_numbers_keep_their_shape():
    assert growth_matrix(KAUS, 1e-5, 9.81).shape == (2, 2)
    assert growth_matrix(KAUS, np.full((3, 2), 1e-5), 9.81, surface="no-slip").shape == (3, 2, 1, 1)
    assert layered.fastest_decay(KAUS[:1], 1e-5, 9.81, surface="no-slip") == 0


def under_air(scene, **walls):
    return replace(scene, walls=scene.walls | {"surface": FREE} | walls)


def test_layers_of_a_section(make_scene):
    scene = make_scene(viscosity=(1.4e17, 2.8e19))
    stacks = layered.layers_of(scene, 200)
    assert {len(stack) for stack in stacks} == {2}
    assert {(layer.density, layer.viscosity) for stack in stacks for layer in stack} == {
        (2150.0, 1.4e17),
        (2600.0, 2.8e19),
    }
    salt = [stack[0].thickness for stack in stacks]
    assert (min(salt), max(salt)) == pytest.approx((1800, 2200), abs=15)
    assert [sum(layer.thickness for layer in stack) for stack in stacks] == pytest.approx(
        [10000] * len(stacks)
    )


def test_layers_of_one_rock_are_one(make_scene):
    scene = make_scene()
    scene = replace(scene, rocks=(scene.rocks[0], replace(scene.rocks[0], name="more salt")))
    assert layered.layers_of(scene) == [(Layer(10000.0, 2150.0, 1e19),)]


def test_gamma_of_the_diapir(make_scene):
    """72 e-foldings in 1.5 Myr, computed independently; the weakest column is a little faster."""
    scene = make_scene(viscosity=(1.4e17, 2.8e19))
    flat = replace(scene, unit_at=lambda p: (p[:, 1] > -8000).astype(np.int16))
    assert surface_rate(flat) * 1.5 * MYR == pytest.approx(72.3, rel=2e-3)
    assert 1 < surface_rate(scene) / surface_rate(flat) < 1.05


def test_a_base_that_slips_relaxes_faster(make_scene):
    scene, push = make_scene(), (0.0, 0.0)
    held = surface_rate(under_air(scene, base=Wall("velocity", (1e-10, 0.0), push)))
    slips = surface_rate(under_air(scene, base=Wall("free-slip", (None, 0.0), push)))
    assert held == surface_rate(scene)
    assert slips > 1.03 * held


def test_many_columns_are_thinned_without_loss(make_scene, monkeypatch):
    scene = make_scene(cells=(400, 400))
    thinned = surface_rate(scene)
    monkeypatch.setattr(layered, "WAVES", 10000)
    assert thinned / surface_rate(scene) == pytest.approx(1, rel=1e-2)


@pytest.mark.parametrize(
    ("marks", "way"),
    [
        ((0, 6), 0),
        ((0, 6, 0), 6),
        ((0, -1, -5), 5),
        ((0, 3, 1, 2, -2, -3), 5),
        ((5, 4, 6, 3, 3.5), 3),
        ((0, 1, 2, 0), 2),
    ],
)
def test_longest_way_back(marks, way):
    assert layered.longest_way_back(marks) == way


def test_no_free_surface(make_scene):
    found = restorability(make_scene())
    assert (found.gamma, found.growth, found.horizon) == (None, None, None)
    assert "no free surface" in found.verdict


def test_a_short_way_back_can_be_integrated(make_scene):
    found = restorability(under_air(make_scene(marks=(0, -0.02, -0.03))))
    assert found.growth == pytest.approx(found.gamma * 0.03 * MYR, rel=1e-12)
    assert found.horizon == pytest.approx(np.log(100) / found.gamma)
    assert found.verdict == (
        "the surface can be integrated backward: in 30 kyr its errors grow 26.9-fold at most; "
        "it takes 42 kyr backward to grow from 1 m of error to 100 m"
    )


def test_a_long_way_back_has_to_be_slaved(make_scene):
    scene = under_air(make_scene(marks=(0, 6, 0)))
    found = restorability(scene)
    assert found.growth == pytest.approx(658, rel=2e-3)
    assert found.verdict == (
        "the surface cannot be integrated backward: in 6 Myr its errors would grow 10^286-fold; "
        "modes that relax faster than in 1.3 Myr must be slaved to the rock below"
    )
    known = restorability(scene, noise=0.01, tolerance=1000.0)
    assert known.horizon == pytest.approx(2.5 * found.horizon)
    worse = restorability(scene, noise=10.0, tolerance=1.0)
    assert worse.horizon == 0
    assert "all its modes must be slaved" in worse.verdict


def test_forward_only(make_scene):
    found = restorability(under_air(make_scene(marks=(0, 1))))
    assert found.growth is None
    assert found.horizon > 0
    assert found.verdict.startswith("forward only; it takes 42 kyr backward")


def test_nothing_decays_without_gravity(make_scene):
    found = restorability(under_air(make_scene(gravity=0.0)))
    assert (found.gamma, found.growth, found.horizon) == (0, 0, None)

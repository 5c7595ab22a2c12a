"""The exact solutions against their equations, by finite differences, and the stored numbers."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from restoration.advection import SCHEMES
from restoration.bench import exact, reference

POINTS = np.random.default_rng(1).uniform(0.05, 0.95, (60, 2))
S = np.linspace(0, 1, 9)
WALLS = {(axis, end): np.insert(S[:, None], axis, end, 1) for axis in (0, 1) for end in (0, 1)}
ROUND = np.column_stack([np.cos(2 * np.pi * S), np.sin(2 * np.pi * S)])


def gradient(f, points, h=1e-3):
    """Derivatives of f by central differences of sixth order, the axis last."""
    axes = []
    for step in h * np.eye(2):
        pairs = [f(points + i * step) - f(points - i * step) for i in (1, 2, 3)]
        axes.append((45 * pairs[0] - 9 * pairs[1] + pairs[2]) / (60 * h))
    return np.stack(axes, axis=-1)


def divergence(velocity, points):
    return np.einsum("nii->n", gradient(velocity, points))


class Flow:
    """A Stokes solution with its viscosity and upward force, and a stress by differences."""

    def __init__(self, name, contrast, **options):
        self.solution = getattr(exact, name)(contrast, **options)
        self.force = lambda p: np.zeros(len(p))
        self.eta = lambda p: np.where(self.beyond(p) > 0, contrast, 1.0)
        self.beyond = lambda p: 0.2 - np.hypot(*p.T)
        if name == "solkz":
            self.beyond = lambda p: np.ones(len(p))
            self.eta = lambda p: contrast ** p[:, 1]
            self.force = lambda p: -exact.solkz_density(p, **options)
        elif name == "solcx":
            self.beyond = lambda p: p[:, 0] - options["at"]
            self.force = lambda p: np.sin(np.pi * p[:, 1]) * np.cos(np.pi * p[:, 0])

    def u(self, points):
        return self.solution(points)[0]

    def stress(self, points):
        du = gradient(self.u, points)
        viscous = self.eta(points)[:, None, None] * (du + du.transpose(0, 2, 1))
        return viscous - self.solution(points)[1][:, None, None] * np.eye(2)

    def jumps(self, points, normal):
        """Largest jump of velocity and traction across an interface, by extrapolation to it."""
        x = np.arange(1, 9)
        weights = np.array([np.prod([k / (k - j) for k in x if k != j]) for j in x])
        jump = 0
        for side in (-1, 1):
            near = [points + 0.004 * side * j * normal for j in x]
            values = [[self.u(p), np.einsum("nij,nj->ni", self.stress(p), normal)] for p in near]
            jump = jump + side * np.tensordot(weights, values, 1)
        return np.abs(jump).max(axis=(1, 2))


FLOWS = [
    *[("solcx", c, {"at": at}) for c in (1e-6, 1, 1e3, 1e9) for at in (0.3, 0.5)],
    *[("solkz", c, {"m": m}) for c in (1e-3, 1, 1e3, 1e6) for m in (2, 1.6 * np.pi)],
    *[("solvi", c, {}) for c in (0, 1e-3, 1, 1e3)],
]


@pytest.mark.parametrize(("name", "contrast", "options"), FLOWS)
def test_stokes_flow(name, contrast, options):
    flow = Flow(name, contrast, **options)
    points = POINTS[np.abs(flow.beyond(POINTS)) > 0.01]
    speed = max(1, np.abs(flow.u(points)).max())
    balance = np.einsum("nijj->ni", gradient(flow.stress, points))
    balance[:, 1] += flow.force(points)
    assert np.abs(divergence(flow.u, points)).max() < 1e-11 * speed
    assert np.abs(balance).max() < 3e-9
    for (axis, end), wall in WALLS.items():
        if name != "solvi" or end == 0:  # free slip; SolVi by symmetry on two walls only
            assert np.abs(flow.u(wall)[:, axis]).max() < 1e-14 * speed
            assert np.abs(flow.stress(wall)[:, 0, 1]).max() < 1e-11 * speed
    if name == "solcx":
        step = np.column_stack([np.full(9, options["at"]), S])
        assert (flow.jumps(step, np.tile([1.0, 0.0], (9, 1))) < 1e-11 * speed).all()
    elif name == "solvi":
        assert (flow.jumps(0.2 * ROUND, ROUND) < (1e-8, 1e-6)).all()


def test_no_contrast():
    """SolCx becomes one harmonic, SolKz has no seam at B = 0, SolVi is pure shear."""
    x, z = np.pi * POINTS.T
    u, p = exact.solcx(1)(POINTS)
    harmonic = np.column_stack([-np.sin(x) * np.cos(z), np.cos(x) * np.sin(z)])
    assert u * (2 * np.pi) ** 2 == pytest.approx(harmonic, abs=1e-13)
    assert p * 2 * np.pi == pytest.approx(-np.cos(x) * np.cos(z), abs=1e-13)
    below, equal, above = (np.column_stack(exact.solkz(1 + d)(POINTS)) for d in (-1e-5, 0, 1e-5))
    assert equal == pytest.approx((below + above) / 2, abs=1e-11)
    u, p = exact.solvi(1)(POINTS)
    assert u == pytest.approx(POINTS * (1, -1), abs=1e-15)
    assert not p.any()
    assert exact.solvi(1e3)(1e4 * ROUND)[0] == pytest.approx(1e4 * ROUND * (1, -1), abs=1e-5)


# Contrast and (x, z, u, w, p) of sol_cx_kz_vi.json, computed independently to 1e-14.
TABLE = """
solcx 1e6 0.1  0.15 -0.0009167767030607336  0.0012443426251518245  -0.2237263821183636
solcx 1e6 0.6  0.15 -4.274843611221158e-08  -1.1907121692024764e-08 -0.04817671284544756
solkz 1e6 0.1  0.15  1.652363147360518e-05  3.35833306429682e-05    0.006555172004088469
solkz 1e6 0.4  0.85 -2.424427822411023e-08 -2.4202992256443826e-08 -0.0799318585303443
solvi 1e3 0.1  0.15  0.0001998001998001998 -0.0002997002997002997   0.0
solvi 1e3 0.25 0.15  0.13624442929348282   -0.151950095497826      -0.8840432923477907
solvi 1e3 0.9  0.85  0.8967808193581692    -0.8518844929388731     -0.005949198777771651
"""


@pytest.mark.parametrize("row", TABLE.strip().splitlines())
def test_stored_values(row):
    name, *numbers = row.split()
    contrast, x, z, *expected = map(float, numbers)
    u, p = getattr(exact, name)(contrast)(np.array([[x, z]]))
    assert [*u[0], *p] == pytest.approx(expected, rel=1e-12)


def test_manufactured():
    assert np.abs(divergence(lambda p: exact.manufactured(p)[0], POINTS)).max() < 1e-11
    assert max(np.abs(exact.manufactured(wall)[0]).max() for wall in WALLS.values()) < 1e-15


def growth_by_eight_constants(k, h1, h2, eta1, eta2, drho, g):
    """Growth rate by the boundary value problem, W = (a + bz) exp(kz) + (c + dz) exp(-kz)."""

    def state(z, eta):
        """W, W', shear and normal stress of the four solutions, but for a sine or cosine."""
        columns = []
        for s, n in ((k, 0), (k, 1), (-k, 0), (-k, 1)):
            w = np.array([s**i * z**n + n * i * s ** (i - 1) for i in range(4)]) * np.exp(s * z)
            p = eta * (w[3] - k**2 * w[1]) / k**2
            columns.append([w[0], w[1], -eta * (w[2] / k + k * w[0]), 2 * eta * w[1] - p])
        return np.transpose(columns)

    matrix, right = np.zeros((8, 8)), np.zeros(8)
    matrix[:2, :4], matrix[2:4, 4:] = state(h1, eta1)[:2], state(-h2, eta2)[:2]
    matrix[4:, :4], matrix[4:, 4:] = state(0.0, eta1), -state(0.0, eta2)
    right[7] = -drho * g  # so much less hydrostatic stress at an interface raised by 1
    return state(0.0, eta1)[0] @ np.linalg.solve(matrix, right)[:4]


@pytest.mark.parametrize("contrast", [1e-4, 0.1, 1, 30])
@pytest.mark.parametrize(("k", "h1"), [(0.3, 1), (1.7, 0.4), (3.4, 0.8), (9, 0.6)])
def test_growth_rate_solves_the_boundary_value_problem(k, h1, contrast):
    layers = (k, h1, 1 - h1 / 2, 1.0, contrast, 2.0, 3.0)
    expected = growth_by_eight_constants(*layers)
    assert exact.two_layer_growth_rate(*layers) == pytest.approx(expected, rel=1e-9)


def test_growth_rate_limits():
    rate = exact.two_layer_growth_rate
    k = np.geomspace(1e-7, 1e4, 40)
    swapped = rate(k, 0.7, 0.3, 50, 1, 1, 1)
    assert rate(k, 0.3, 0.7, 1, 50, 1, 1) == pytest.approx(swapped, rel=1e-12)
    assert rate(1e4, 1, 1, 1, 3, 2, 10) == pytest.approx(2 * 10 / (2 * 1e4 * (1 + 3)), rel=1e-12)
    # lubrication: two equal layers, thin against the wavelength, grow with k^2 h^3 / 24
    assert rate(1e-5, 1, 1, 1, 1, 1, 1) == pytest.approx(1e-10 / 24, rel=1e-9)


# v_linear / 3 km of two rows of ramberg.json, and the models of the paper's sect. 4.1.
GROWTH = [
    ((np.pi / 128e3, 256e3, 256e3, 1e21, 1.25e20, 300, 9.81), 1.597750089177336e-10 / 3e3),
    ((np.pi / 32e3, 256e3, 256e3, 1e21, 2.5e23, 300, 9.81), 1.7914632574449006e-13 / 3e3),
    ((np.pi / 9142, 8e3, 2e3, 1e19, 1e19, 450, 9.81), 4.8295464950736194e-14),
    ((np.pi / 9142, 8e3, 2e3, 2.8e19, 1.4e17, 450, 9.81), 1.7725122763992706e-13),
]


@pytest.mark.parametrize(("layers", "expected"), GROWTH)
def test_stored_growth_rates(layers, expected):
    assert exact.two_layer_growth_rate(*layers) == pytest.approx(expected, rel=1e-12)


def test_finite_amplitude_is_slower_than_linear_theory():
    r = reference.RAMBERG
    drho = r["rho1"] - r["rho2"]
    assert len(reference.RAMBERG_VELOCITY) == 45
    for (wavelength, eta2), (crest, trough) in reference.RAMBERG_VELOCITY.items():
        slope = 2 * np.pi / wavelength * r["amplitude"]
        layers = (2 * np.pi / wavelength, r["h1"], r["h2"], r["eta1"], eta2, drho, r["g"])
        linear = exact.two_layer_growth_rate(*layers) * r["amplitude"]
        for v in (crest, -trough):
            assert 0.15 * slope**2 < 1 - v / linear < 0.4 * slope**2


def test_sinking_block_velocity():
    x, value = np.transpose(reference.SINKING_BLOCK)
    velocity = reference.sinking_block_velocity
    assert velocity(x) == pytest.approx(value, rel=2e-7)
    assert (np.diff(velocity(np.linspace(-12, 12, 200))) >= 0).all()
    assert velocity([-12, 12]) == pytest.approx(value[[0, -1]], rel=2e-5)
    assert velocity(0) == pytest.approx(reference.SINKING_BLOCK_EQUAL, rel=1e-5)


def test_van_keken_starts_at_the_linear_rate():
    for ratio, ((_, v0), (t1, v1), *_, (_, last)) in reference.VAN_KEKEN_EARLY.items():
        growth = exact.two_layer_growth_rate(np.pi / 0.9142, 0.8, 0.2, 1, 1 / ratio, 1, 1)
        assert growth == pytest.approx(reference.VAN_KEKEN_GROWTH[ratio], rel=1e-12)
        assert np.log(v1 / v0) / t1 == pytest.approx(growth, rel=0.03)
        assert all(v > last for _, v, _ in reference.VAN_KEKEN_PEAK[ratio])


def test_constant_speed_rotation():
    velocity, place = exact.constant_speed_rotation(0.3, (0.5, 0.4))
    v = velocity(POINTS)
    assert np.hypot(*v.T) == pytest.approx(0.3, rel=1e-14)
    assert (v * (POINTS - (0.5, 0.4))).sum(axis=1) == pytest.approx(0, abs=1e-15)
    moved = (place(POINTS, 1.7 + 1e-4) - place(POINTS, 1.7 - 1e-4)) / 2e-4
    assert moved == pytest.approx(velocity(place(POINTS, 1.7)), abs=1e-6)
    start = np.array([[0.7, 0.4]])
    assert velocity(start) == pytest.approx(np.array([[0, 0.3]]))
    assert place(start, 2 * np.pi * 0.2 / 0.3) == pytest.approx(start)


@pytest.mark.parametrize("name", reference.ROTATION_GAIN)
def test_rotation_gains_the_stored_radius(name):
    speed, step = reference.ROTATION["speed_m_per_yr"], SCHEMES[name].step
    centre, start = (1e3 * np.array([reference.ROTATION[key]]) for key in ("centre_km", "start_km"))
    velocity, _ = exact.constant_speed_rotation(speed, centre[0])
    radius = np.hypot(*(start - centre)[0])
    turn, dt, x = 2 * np.pi * radius / speed, 2000.0, start
    for _ in range(int(turn // dt)):
        x = step(x, velocity, dt)
    gain = np.hypot(*(step(x, velocity, turn % dt) - centre)[0]) - radius
    assert gain == pytest.approx(reference.ROTATION_GAIN[name][dt], rel=1e-8, abs=2e-11)


@pytest.mark.parametrize("period", reference.VORTEX_HALF)
def test_single_vortex(period):
    velocity = exact.single_vortex(period)
    assert np.abs(divergence(lambda p: velocity(p, 0.3), POINTS)).max() < 1e-11
    for (axis, _), wall in WALLS.items():
        assert np.abs(velocity(wall, 0.3)[:, axis]).max() < 1e-15
    assert velocity(POINTS, 0.3) == pytest.approx(-velocity(POINTS, period - 0.3), abs=1e-14)
    rim, half = np.array(reference.VORTEX_RIM), np.array(reference.VORTEX_HALF[period][1])

    def flat(t, x):
        return velocity(x.reshape(-1, 2), t).ravel()

    path = solve_ivp(flat, (0, period / 2), rim.ravel(), "DOP853", rtol=1e-11, atol=1e-12)
    assert path.y[:, -1].reshape(-1, 2) == pytest.approx(half, abs=1e-8)

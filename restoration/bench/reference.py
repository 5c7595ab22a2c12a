"""Reference numbers that the benchmarks compare with, each with its source.

Copied by a script from the reference tables; (x, z) with z up, gravity downwards.
"""

import numpy as np

# Rayleigh-Taylor of the paper's appendix A: SI units, g = 9.81 m/s^2, eta1 and rho1 on top,
# no slip at lid and base. The paper prints h1 + h2 only; h1 = h2 is in the manual of ASPECT.
RAMBERG = {
    "rho1": 3300,
    "rho2": 3000,
    "eta1": 1e21,
    "width": 512000.0,
    "h1": 256000.0,
    "h2": 256000.0,
    "amplitude": 3000.0,
    "g": 9.81,
}
# (wavelength, m; eta2, Pa s): vertical velocity of the crest and the trough, m/s, of the interface
# with the *finite* amplitude of 3 km. Source: computed from the exact Stokes flow, to 1e-10 (1e-7
# at the shortest wave); 0.12 to 2.4 % below the linear theory, exact.two_layer_growth_rate.
RAMBERG_VELOCITY = {
    (256000.0, 1e20): (1.6317161623656364e-10, -1.6320015718563825e-10),
    (256000.0, 1.25e20): (1.5954616042755264e-10, -1.595726890062818e-10),
    (256000.0, 2.5e20): (1.4359390058261952e-10, -1.4361231894808923e-10),
    (256000.0, 5e20): (1.196646792338021e-10, -1.1967320623238247e-10),
    (256000.0, 1e21): (8.975160144598752e-11, -8.975160144597895e-11),
    (256000.0, 2e21): (5.983660311619698e-11, -5.983233961690437e-11),
    (256000.0, 4e21): (3.590307973702163e-11, -3.5898475145655195e-11),
    (256000.0, 8e21): (1.994658612578509e-11, -1.994327005344383e-11),
    (256000.0, 1e22): (1.6320015718563453e-11, -1.6317161623655645e-11),
    (256000.0, 1.6e22): (1.0560094796333856e-11, -1.0558103182246107e-11),
    (256000.0, 3.2e22): (5.4400879839408225e-12, -5.438995673549296e-12),
    (256000.0, 6.4e22): (2.761901295063794e-12, -2.761329123395856e-12),
    (256000.0, 1e23): (1.7774637152600253e-12, -1.7770913192163857e-12),
    (256000.0, 1.28e23): (1.3916584012260293e-12, -1.391365556807831e-12),
    (256000.0, 2.5e23): (7.152354846801103e-13, -7.150838269251192e-13),
    (128000.0, 1e20): (8.128688357637106e-11, -8.13568394939401e-11),
    (128000.0, 1.25e20): (7.948160839976792e-11, -7.954663141597918e-11),
    (128000.0, 2.5e20): (7.153812226453341e-11, -7.158326554642355e-11),
    (128000.0, 5e20): (5.962175673636726e-11, -5.964265580681043e-11),
    (128000.0, 1e21): (4.47235837508732e-11, -4.4723583750888584e-11),
    (128000.0, 2e21): (2.9821327903404915e-11, -2.981087836819757e-11),
    (128000.0, 4e21): (1.789581638660775e-11, -1.788453056613301e-11),
    (128000.0, 8e21): (9.94332892700168e-12, -9.935201049970915e-12),
    (128000.0, 1e22): (8.135683949397596e-12, -8.128688357640558e-12),
    (128000.0, 1.6e22): (5.264509608126351e-12, -5.2596279633343735e-12),
    (128000.0, 3.2e22): (2.712133770821067e-12, -2.7094563800992825e-12),
    (128000.0, 6.4e22): (1.376960049923313e-12, -1.3755575765800903e-12),
    (128000.0, 1e23): (8.861696919662481e-13, -8.852568947809195e-13),
    (128000.0, 1.28e23): (6.938250222146003e-13, -6.931072170701334e-13),
    (128000.0, 2.5e23): (3.5658938422241405e-13, -3.562176479728819e-13),
    (64000.0, 1e20): (3.9927945931693585e-11, -4.01937814519373e-11),
    (64000.0, 1.25e20): (3.904274431515005e-11, -3.928980911736336e-11),
    (64000.0, 2.5e20): (3.5149070296051685e-11, -3.532053186593269e-11),
    (64000.0, 5e20): (2.93100987923604e-11, -2.938944530311647e-11),
    (64000.0, 1e21): (2.200812555474603e-11, -2.200812554642061e-11),
    (64000.0, 2e21): (1.4694722652348505e-11, -1.4655049385921066e-11),
    (64000.0, 4e21): (8.830132964344927e-12, -8.787267563359371e-12),
    (64000.0, 8e21): (4.911226137963026e-12, -4.880343030131279e-12),
    (64000.0, 1e22): (4.019378144095698e-12, -3.992794584666249e-12),
    (64000.0, 1.6e22): (2.601937190698525e-12, -2.583383484450951e-12),
    (64000.0, 3.2e22): (1.340940629582807e-12, -1.3307629569807858e-12),
    (64000.0, 6.4e22): (6.809340462498819e-13, -6.756022822041435e-13),
    (64000.0, 1e23): (4.382604242019078e-13, -4.3479013667082387e-13),
    (64000.0, 1.28e23): (3.431450758631191e-13, -3.404160754351895e-13),
    (64000.0, 2.5e23): (1.7636731952211716e-13, -1.7495399367178616e-13),
}

# Sinking block of the paper's appendix B, 500 km and 100 km, centre at (250, 400) km, free slip all
# around: log10(eta2/eta1), with eta1 the block's viscosity, and |v| eta2 / ((rho1 - rho2) g L^2) at
# its centre, L = 500 km; times g L^2 it is the ordinate of Fig. B2. Source: extrapolated numerical
# solution, to 1e-4; at equal viscosities, by Fourier series, the value below is exact.
SINKING_BLOCK = (
    (-6.0, 0.0014417718487695678),
    (-4.0, 0.0014424591066874864),
    (-3.0, 0.001448679702854741),
    (-2.0, 0.001508479273067667),
    (-1.5, 0.001636957313811414),
    (-1.0, 0.0019499964562192445),
    (-0.5, 0.002534831061825122),
    (0.0, 0.003344465057091913),
    (0.5, 0.004209017735384313),
    (1.0, 0.004907842325490427),
    (1.5, 0.005308499100135904),
    (2.0, 0.0054779496346923015),
    (3.0, 0.005557720087803591),
    (5.0, 0.005566885604176594),
)
# The same as a function of r = eta2/eta1: stiff limit + sum of c r / (r + s), rows (s, c).
# Source: fitted to SINKING_BLOCK by least squares, to 1e-7 at every row.
SINKING_BLOCK_STIFF = 0.0014417650385708711
SINKING_BLOCK_FIT = (
    (0.13218099471329744, 0.00031342910436712155),
    (0.3169281532240151, 0.0009622774331343995),
    (0.9856485248990958, 0.001051858498688459),
    (3.1787047768103447, 0.0012416225266814072),
    (7.140515318071361, 0.0005560259706888206),
)
SINKING_BLOCK_EQUAL = 0.003344495854166206

# van Keken et al. (1997): box 0.9142 x 1, interface 0.2 + 0.02 cos(pi x / 0.9142), no-slip lid and
# base, eta_top = drho g = 1. Keys are the viscosity ratio top / bottom.
# Linear growth rate of the interface. Source: Ramberg (1968), to 1e-15; 0.01094019 in fieldstone.
VAN_KEKEN_GROWTH = {1: 0.010940189138234498, 10: 0.04705483921807609, 100: 0.10383461556852445}
# Early (t, v_rms), from t = 0. Source: exact flow by layered Fourier series, residual below 1e-5.
VAN_KEKEN_EARLY = {
    1: (
        (0.0, 0.00018529497938115524),
        (20.0, 0.00023152785871566838),
        (40.0, 0.00029098459685655663),
        (60.0, 0.00036970855821489527),
        (80.0, 0.0004787209682254143),
    ),
    10: (
        (0.0, 0.0006729607400473165),
        (6.0, 0.0008870438139384662),
        (12.0, 0.001164371454414258),
        (18.0, 0.001518124130628323),
        (24.0, 0.0019588330242850623),
    ),
    100: (
        (0.0, 0.0014418507881196231),
        (3.0, 0.0019638421106296135),
        (6.0, 0.0026687634602173015),
        (9.0, 0.003610727233798587),
        (12.0, 0.004841468402867954),
    ),
}
# Maximum of v_rms: (t, v_rms, who). Source: the publications as collected by fieldstone. At ratio
# 100 a lower local maximum comes first, 0.00893 at t = 21.6 in the data of van Keken.
VAN_KEKEN_PEAK = {
    1: (
        (211.1, 0.0030958, "HS 41x41 extrap vaks97"),
        (209.17, 0.0031022, "HS 61x61 extrap vaks97"),
        (208.99, 0.0030916, "HS 81x81 extrap vaks97"),
        (208.4, 0.003092, "CND 32x32 vaks97"),
        (208.5, 0.0030943, "CND 48x48 vaks97"),
        (215.67, 0.00299279, "SK 80x80 vaks97"),
        (206.38, 0.0028922, "SK 120x120 vaks97"),
        (207.84, 0.002897, "SK 160x160 vaks97"),
        (213.38, 0.003, "PvK splines 30x30 vaks97"),
        (211.81, 0.003016, "PvK splines 50x50 vaks97"),
        (210.75, 0.00305, "PvK splines 80x80 vaks97"),
        (210.59, 0.0031, "PvK C1 30x30 vaks97"),
        (207.05, 0.003091, "PvK C1 80x80 vaks97"),
        (230.1, 0.003093, "ISMM 160x160 Sobouti+2001"),
        (231.4, 0.003085, "MSOU 160x160 Sobouti+2001"),
        (217.3, 0.003118, "FSOU 160x160 Sobouti+2001"),
        (209.9, 0.00311, "tracers 40/cell 64x64 Tackley&King2003"),
        (209.2, 0.003102, "tracers 40/cell 128x128 Tackley&King2003"),
        (208.9, 0.003097, "tracers 15/cell 128x128 Tackley&King2003"),
        (211.2, 0.00301, "level set 120x132 Suckale+2010"),
        (215.3, 0.003106, "DynEarthSol 67 m Choi+2013"),
        (215.0, 0.00311, "LaCoDe 1808 elts deMontserrat+2019"),
        (212.0, 0.00308, "LaCoDe 7093 elts deMontserrat+2019"),
        (211.0, 0.003075, "LaCoDe 17960 elts deMontserrat+2019"),
        (211.0, 0.003107, "Maierova PhD 2012"),
    ),
    10: ((73.0, 0.009411, "Maierova PhD 2012"), (74.0, 0.00942, "PvK 80x80 data of vaks97")),
    100: ((51.0, 0.013938, "Maierova PhD 2012"), (51.0, 0.0145, "PvK 80x80 data of vaks97")),
}

# Rotation at constant speed of the paper's appendix C. For a stepper and dt in years: radius
# gained, m, after one turn by whole steps and one shorter last step, in the exact velocity. Source:
# advection.json, met to 1e-11 m by restoration.advection; ``paper`` is of sect. 3.6.
ROTATION = {"centre_km": (5, 5), "start_km": (8, 5), "speed_m_per_yr": 0.03}
ROTATION_GAIN = {
    "euler": {
        250.0: 23.468286060450282,
        500.0: 46.750944143031575,
        1000.0: 92.78051527043317,
        1500.0: 138.15466013528203,
        2000.0: 182.84327538074876,
    },
    "paper": {
        250.0: 11.757001885558111,
        500.0: 23.465835397875253,
        1000.0: 46.74345126369735,
        1500.0: 69.85461145383988,
        2000.0: 92.77313390720838,
    },
    "midpoint": {
        250.0: 1.8405784430797212e-05,
        500.0: 0.00014720609669893747,
        1000.0: 0.001177496531909128,
        1500.0: 0.003973226048401557,
        2000.0: 0.00941926859513842,
    },
    "rk4": {
        250.0: -6.821210263296962e-12,
        500.0: -2.496562956366688e-10,
        1000.0: -8.182269084500149e-09,
        1500.0: -6.206028047017753e-08,
        2000.0: -2.6165434974245727e-07,
    },
}

# Time-reversed single vortex of LeVeque (1996), disc of radius 0.15 around (0.5, 0.75). Period:
# perimeter at half the period, and where four points of its rim are then. Source: integrated with
# tight tolerance; all points return to 1e-13, 4e-12 and 3e-10.
VORTEX_RIM = ((0.5, 0.9), (0.65, 0.75), (0.5, 0.6), (0.35, 0.75))
VORTEX_HALF = {
    2.0: (
        1.8430870030252504,
        (
            (0.8026839713238323, 0.8214694909781952),
            (0.6668772279887935, 0.25944868370325136),
            (0.4458026619119079, 0.4155486754736818),
            (0.7825132384843294, 0.5203030008475368),
        ),
    ),
    4.0: (
        3.3287281194165645,
        (
            (0.8992365911161514, 0.5385491613531316),
            (0.2191814267903421, 0.45845871618431955),
            (0.5909093008963411, 0.5422413961170988),
            (0.38462644855902756, 0.23534575286931758),
        ),
    ),
    8.0: (
        6.450336485361438,
        (
            (0.5764797842036643, 0.10306368021826573),
            (0.7097714966223198, 0.29353609405960995),
            (0.5764284296856818, 0.4348791088704367),
            (0.7743732459897492, 0.5808930749671247),
        ),
    ),
}


# Greatest velocity near the contact of the waves above over that of linear theory, less one; eta2
# of 1e20, 1e21 and 1e23 Pa s. From the same exact Stokes flow.
RAMBERG_GREATEST = {
    64000.0: (-0.006909, -0.009749, -0.005772),
    128000.0: (-0.002255, -0.002588, -0.002171),
    256000.0: (-0.000642, -0.00067, -0.000635),
}
# CPU seconds, unknowns and answers of another code, from the reference tables: one process on two
# shared cores, start-up excluded, repeats spread by 20 to 50 %; 7 cycles of adaption for the waves.
PEERS = {
    "code": "ASPECT 2.5.0, deal.II 9.4.1, block AMG and GMRES to 1e-7, release build",
    "sinking_block": {
        "rows": [
            {
                "mesh": 160,
                "how": "function",
                "eta_block": 1e19,
                "v": -1.38113e-09,
                "unknowns": 335044,
                "total_s": 4.54,
            },
            {
                "mesh": 320,
                "how": "function",
                "eta_block": 1e19,
                "v": -1.37539e-09,
                "unknowns": 1335684,
                "total_s": 20.6,
            },
            {
                "mesh": 160,
                "how": "function",
                "eta_block": 1e21,
                "v": -8.36124e-10,
                "unknowns": 335044,
                "total_s": 3.63,
            },
            {
                "mesh": 160,
                "how": "function",
                "eta_block": 1e23,
                "v": -3.78777e-10,
                "unknowns": 335044,
                "total_s": 4.75,
            },
            {
                "mesh": 320,
                "how": "function",
                "eta_block": 1e23,
                "v": -3.77995e-10,
                "unknowns": 1335684,
                "total_s": 24.3,
            },
            {
                "mesh": 320,
                "how": "function",
                "eta_block": 1e27,
                "v": -3.60779e-10,
                "unknowns": 1335684,
                "total_s": 73.7,
            },
        ]
    },
    "rayleigh_taylor": {
        "relative_error": {
            "64 km": [-0.0054, -0.0094, -0.0042],
            "128 km": [-0.002, -0.0024, -0.002],
            "256 km": [-0.0002, -0.0003, -0.0002],
        },
        "eta2": [1e20, 1e21, 1e23],
        "total_s": [2.3, 3.4],
        "unknowns": 115000,
    },
    "crameri_1": {
        "rows": [
            {
                "mesh": "300x75",
                "unknowns": 385880,
                "steps": 160,
                "total_s": 1170,
                "crest_m_at_14825_yr": 2576.4,
            },
            {
                "mesh": "140x35",
                "unknowns": 84880,
                "steps": 76,
                "total_s": 78.8,
                "crest_m_at_14825_yr": 2551.8,
            },
        ]
    },
    "van_keken": {
        "unknowns": 70789,
        "rows": [
            {
                "how": "Q2 field",
                "steps": 191,
                "peak_v_rms": 0.00305606,
                "at": 209.9,
                "total_s": 67.3,
            },
            {
                "how": "102,400 particles",
                "steps": 183,
                "peak_v_rms": 0.00308314,
                "at": 216.0,
                "total_s": 59.0,
            },
        ],
    },
}


def sinking_block_velocity(log10_ratio):
    """Return the velocity of the sinking block at any viscosity contrast.

    Args:
        log10_ratio: log10(eta2 / eta1), medium over block; a number or an array.

    Returns:
        ``|v| eta2 / ((rho1 - rho2) g L^2)`` at the centre of the block, of the shape of
        ``log10_ratio``. It is within 1e-7 of SINKING_BLOCK, itself good to 1e-4, and within 1e-4 of
        a row that is left out of the fit; monotone, and constant far beyond either end.
    """
    ratio = 10.0 ** np.asarray(log10_ratio, float)
    return SINKING_BLOCK_STIFF + sum(c / (1 + s / ratio) for s, c in SINKING_BLOCK_FIT)

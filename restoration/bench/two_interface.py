"""A horizon and a free surface in linear theory: which ways back restore the horizon.

The first half-wave of the paper's section 4.1 under a free surface is a system of two deflections,
``dz/dt = A z``. It is moved forward exactly, from a horizon of amplitude 1 under a flat surface,
and back in several ways: every way is a matrix, so its errors are known exactly too.
"""

from functools import reduce

import numpy as np

from restoration.advection import rk4
from restoration.bench.rows import Clock, Row, compared
from restoration.layered import Layer, growth_matrix
from restoration.units import MYR

NAME = "two-interface"
WIDTH, GRAVITY = 9142.0, 9.81
SALT, SEDIMENT = (2000.0, 2150.0), (8000.0, 2600.0)  # thickness, m; density, kg/m^3
# Case: viscosity of salt and sediment, Pa s; duration, Myr; gamma times it, to three digits.
CASES = {
    "one viscosity, 6 Myr": (1e19, 1e19, 6.0, 658),
    "two viscosities, 1.5 Myr": (1.4e17, 2.8e19, 1.5, 72.3),
}
NOISE = 1e-6  # of the surface, in parts of the amplitude of the horizon
PRODUCTS = (0.5, 4.0)  # gamma times a step: of rk4 (stable below 2.8), of implicit Euler (above 2)
THEORY = "linear theory of layered flow, computed independently"
TRUTH = "the amplitude that the forward run began with"


def system(salt, sediment):
    """Return A for viscosities of salt and sediment, Pa s: 1/s, horizon first, then the surface."""
    layers = (Layer(*SALT, salt), Layer(*SEDIMENT, sediment))
    return growth_matrix(layers, np.pi / WIDTH, GRAVITY)


def exact(a, time):
    """Return ``exp(a time)``, what takes deflections to those after a time, s; backward if < 0."""
    rate, modes = np.linalg.eig(a)
    return modes * np.exp(rate * time) @ np.linalg.inv(modes)


def integrated(a, time, steps):
    """Return the matrix of steps by rk4; arguments as `exact`."""
    rows = np.eye(2)
    for _ in range(steps):
        rows = rk4(rows, lambda x: x @ a.T, time / steps)
    return rows.T


def implicit(a, time, steps):
    """Return the matrix of implicit Euler steps with their sign; arguments as `exact`."""
    return np.linalg.matrix_power(np.linalg.inv(np.eye(2) - time / steps * a), steps)


def slaved(a, time, corrections=0):
    """Return the matrix of a horizon whose surface is slaved to it; arguments as `exact`.

    A surface at rest stands at ``h = s z`` over the horizon z. That moves with z: each correction
    asks for the surface that moves at the rate of the last one, ``dh/dt = s dz/dt``, instead of
    resting. Many give the slow mode, along which both move together.

    Args:
        a: of `system`.
        time: s.
        corrections: how often; 0 is the quasi-static surface.
    """
    (zz, zh), (hz, hh) = a

    def corrected(s, _):
        return (s * (zz + zh * s) - hz) / hh

    s = reduce(corrected, range(corrections), -hz / hh)
    return np.exp((zz + zh * s) * time) * np.array([[1.0, 0.0], [s, 0.0]])


def run_two_interface(quick):
    """Restoration under a free surface: linear theory of a horizon and the surface.

    Args:
        quick: makes no difference; it takes no time.
    """
    for case, (salt, sediment, duration, product) in CASES.items():
        clock, time = Clock(), duration * MYR
        a = system(salt, sediment)
        gamma_t = -np.linalg.eigvals(a).min() * time
        end = exact(a, time)[:, 0]  # of the horizon at 1 and the surface at 0
        noise = np.array([0.0, NOISE * end[0]])
        steps = [int(np.ceil(gamma_t / product)) for product in PRODUCTS]
        ways = {
            "integrated exactly": (exact(a, -time), None),
            "integrated by rk4": (integrated(a, -time, steps[0]), steps[0]),
            "quasi-static": (slaved(a, -time), None),
            "slaved, one correction": (slaved(a, -time, 1), None),
            "slaved to the slow mode": (slaved(a, -time, 20), None),
            "implicit Euler": (implicit(a, -time, steps[1]), steps[1]),
        }
        common = {"name": NAME, "parameters": {"duration": duration, "gamma_t": float(gamma_t)}}
        yield compared(
            case=case,
            metric="gamma times the duration",
            value=gamma_t,
            reference=product,
            bound=2e-3,
            source=THEORY,
            wall_s=clock.seconds,
            **common,
        )
        for way, (back, count) in ways.items():
            more = common | {"case": f"{case}, {way}", "steps": count, "wall_s": clock.seconds}
            grown = float(abs(back[1, 1]))
            yield compared(
                metric="restored amplitude of the horizon",
                value=(back @ (end + noise))[0],
                reference=1.0,
                bound=0.05 if "slaved" in way else None,
                source=TRUTH,
                **more,
            )
            if "integrated" in way:
                yield compared(
                    metric="ln of the growth of surface noise",
                    value=np.log(grown),
                    reference=gamma_t,
                    bound=1e-2,
                    source="gamma times the duration",
                    **more,
                )
            else:  # it does not grow
                yield Row(metric="growth of surface noise", value=grown, bound=1.0, **more)

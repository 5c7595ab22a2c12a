"""Linear theory of layers under gravity: how fast the waves of horizons and surface grow or decay.

Layers of Newtonian rock lie flat on a base. Where each horizon j is deflected by ``z_j cos(k x)``,
small against the layers, Stokes flow moves all of them at once, ``dz/dt = A z``. The eigenvalues of
the `growth_matrix` A are real: growth where a heavy layer lies on a light one, decay of a free
surface and of stable layering. What decays at a rate gamma forward grows as ``exp(gamma t)`` when
it is integrated backward, and that sets how far a section can be restored: `restorability`.

The flow is exact: velocities ``U sin(k x), W cos(k x)`` and, beyond the weight of the flat layers,
``sigma_xz = X sin(k x)`` and ``sigma_zz = Z cos(k x)``. With lengths counted in 1/k and stresses in
``k eta``, the state ``s = (U, W, X, Z)`` obeys ``ds/dz = M s`` in a layer:

    U' = W + X,    W' = -U,    X' = 4 U + Z,    Z' = -X,    (M^2 - 1)^2 = 0
"""

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from restoration.units import number, show

NOISE = 1.0  # m, how well the height of a surface is known
TOLERANCE = 100.0  # m, error of a restored surface that can be borne
COLUMNS = 24  # where the layers of a scene are read
SAMPLES = 400  # points of a column
WAVES = 64  # wave numbers that are tried

# What grows upwards as exp(z) and z exp(z): (M - 1) a = 0 and (M - 1) b = a, in columns. Upside
# down, where W and X change their sign, it decays.
GROWING = np.array([[1, 0.5], [-1, 0.5], [2, 1], [-2, 1]])
FLIP = np.array([1.0, -1.0, -1.0, 1.0])
M = np.array([[0.0, 1, 1, 0], [-1, 0, 0, 0], [4, 0, 0, 1], [0, 0, -1, 0]])
N = M @ M - np.eye(4)  # N^2 = 0
HELD = {"no-slip": (0, 1), "free-slip": (1, 2), "free": (2, 3)}  # entries of s that are given


@dataclass(frozen=True)
class Layer:
    """A flat layer.

    Attributes:
        thickness: m.
        density: kg/m^3.
        viscosity: Pa s.
    """

    thickness: float
    density: float
    viscosity: float


@dataclass(frozen=True)
class Restorability:
    """How far back a free surface can be integrated.

    Attributes:
        gamma: fastest decay, 1/s; None where there is no free surface.
        growth: gamma times the longest way back between the marks; None where nothing is restored.
        horizon: time back after which an error has grown from the noise to the tolerance, s; None
            where there is no such time.
        verdict: in words.
    """

    gamma: float | None
    growth: float | None
    horizon: float | None
    verdict: str


def growth_matrix(layers, k, g, base="no-slip", surface="free"):
    """Return A of ``dz/dt = A z`` for the deflections z of the horizons and a free surface.

    Four constants for each layer meet the conditions at base and top and the continuity of velocity
    and stress at every horizon, where ``sigma_zz`` jumps by the weight of the deflection. Waves are
    written by what grows up to the top and decays from the bottom of a layer, which does not
    overflow; layers thinner than 1/k by the state at their bottom, which stays well conditioned.
    Source: the layer matrices of Ramberg (1968), derived anew here.

    Args:
        layers: `Layer` from the base up.
        k: wave number 2 pi / lambda, 1/m; a number or an array.
        g: gravity downwards, m/s^2.
        base: ``no-slip`` or ``free-slip``.
        surface: ``free`` (it moves, and its deflection weighs), ``free-slip`` or ``no-slip``.

    Returns:
        1/s, shape ``k.shape + (n, n)``; horizons from the base up, then the surface where it is
        free.
    """
    shape, k = np.shape(k), np.ravel(np.asarray(k, float))
    last, free = len(layers) - 1, surface == "free"
    scale = math.sqrt(min(i.viscosity for i in layers) * max(i.viscosity for i in layers))
    eta = [layer.viscosity / scale for layer in layers]
    level = [max(pair) for pair in pairwise(eta)]  # of the stresses at every horizon
    count = last + free
    system = np.zeros((len(k), 4 * len(layers), 4 * len(layers)))
    right, lift = np.zeros((*system.shape[:2], count)), np.zeros((len(k), count, system.shape[1]))
    for i, layer in enumerate(layers):
        own = slice(4 * i, 4 * i + 4)
        bottom, top = _ends(k * layer.thickness)
        if i == 0:
            system[:, :2, own] = bottom[:, HELD[base]]
        else:
            system[:, 4 * i - 2 : 4 * i + 2, own] = -_stressed(bottom, eta[i] / level[i - 1])
        if i < last:
            system[:, 4 * i + 2 : 4 * i + 6, own] = _stressed(top, eta[i] / level[i])
            right[:, 4 * i + 5, i] = 1 / level[i]
        else:
            system[:, -2:, own] = top[:, HELD[surface]]
            right[:, -1, last:] = 1 / eta[i]  # where it is free
        if i < count:
            lift[:, i, own] = top[:, 1]
    response = lift @ np.linalg.solve(system, right)  # W for a unit of stress
    jumps = np.diff([layer.density for layer in layers] + [0.0])[:count]
    return (response * g / (scale * k)[:, None, None] * jumps).reshape(*shape, count, count)


def _stressed(states, factor):
    """Return states (n, 4, 4) with their stresses times a factor."""
    return states * np.array([1.0, 1.0, factor, factor])[:, None]


def _ends(h):
    """Return the states at the bottom and the top of a layer for its constants, (n, 4, 4) each.

    Args:
        h: k times the thickness, (n,).
    """
    e = np.exp(-h)[:, None]
    a, b = GROWING.T
    fallen = np.stack([e * a, e * (b - h[:, None] * a)], axis=-1)  # what grows, at the bottom
    grown = np.broadcast_to(GROWING, fallen.shape)
    flip = FLIP[:, None]
    bottom = np.concatenate([fallen, flip * grown], axis=-1)
    top = np.concatenate([grown, flip * fallen], axis=-1)
    thin = h < 1
    bottom[thin], top[thin] = np.eye(4), _across(h[thin])
    return bottom, top


def _across(h):
    """Return exp(M h) for h < 1, (n, 4, 4): the state at the top for that at the bottom."""
    bent = sum(2 * n / math.factorial(2 * n + 1) * h ** (2 * n + 1) for n in range(1, 9))
    parts = (np.cosh(h), np.sinh(h), h * np.sinh(h) / 2, bent / 2)  # bent: h cosh(h) - sinh(h)
    return sum(p[:, None, None] * m for p, m in zip(parts, (np.eye(4), M, N, M @ N), strict=True))


def rates(layers, k, g, base="no-slip", surface="free"):
    """Return the rates of all modes, 1/s, ascending: the fastest decay first; see `growth_matrix`.

    A is a symmetric positive response times the weights, so its eigenvalues are real.
    """
    found = np.linalg.eigvals(growth_matrix(layers, k, g, base, surface))
    return np.sort(found.real, axis=-1)


def fastest_decay(layers, k, g, base="no-slip", surface="free"):
    """Return the fastest decay of any mode at any of the wave numbers, 1/s, or 0 if none decays."""
    found = rates(layers, k, g, base, surface)
    return max(0.0, float(-found.min())) if found.size else 0.0


def layers_of(scene, columns=COLUMNS):
    """Return the different stacks of layers below points of the surface, each from the base up.

    A mode of the surface is slowed by all the rock below it, and theory knows flat layers only. The
    stack of every column is taken as if it filled the section: that of the weakest column decays
    fastest and is on the safe side, while one mean stack would call a section with a weld or a
    diapir in one place too stiff or too weak by the mean that was chosen. Horizons lie midway
    between sampled points; neighbours of one rock are one layer.

    Args:
        scene: `scene.Scene`.
        columns: number of columns, evenly spaced.
    """
    outline = scene.outline
    x = outline.surface[0, 0] + outline.width * (np.arange(columns) + 0.5) / columns
    low, high = (np.interp(x, *line.T) for line in (outline.base, outline.surface))
    part = (np.arange(SAMPLES) + 0.5) / SAMPLES
    z = low[:, None] + part * (high - low)[:, None]
    points = np.column_stack([np.repeat(x, SAMPLES), z.ravel()])
    units = np.asarray(scene.unit_at(points)).reshape(columns, SAMPLES)
    stacks = {_stack(scene, row, h): None for row, h in zip(units, high - low, strict=True)}
    return list(stacks)


def _stack(scene, units, height):
    """Return the layers of one column as a tuple, for the units at its samples."""
    rocks = np.column_stack([scene.unit_density[units], scene.unit_viscosity[units]])
    starts = np.flatnonzero(np.r_[True, (np.diff(rocks, axis=0) != 0).any(axis=1)])
    thick = np.diff(np.r_[starts, len(units)]) * float(height) / len(units)
    return tuple(
        Layer(float(h), *map(float, rock)) for h, rock in zip(thick, rocks[starts], strict=True)
    )


def surface_rate(scene, columns=COLUMNS):
    """Return gamma, the fastest decay below a free surface, 1/s; see `layers_of`.

    The wave numbers are those that a section between free-slip sides and its mesh can hold,
    ``n pi / width`` up to one half-wave for each mesh column; of many n, some that stand ever wider
    apart, for gamma varies slowly with them. All modes of the layers count: what
    decays inside is lost backward in the same way, though the surface is nearly always fastest.

    A weak fault that reaches the surface has a mode of its own there, about as wide as the fault:
    that of a half-space at a wavelength of its width (measured: 2/3 of that at 25 m, as much at
    50 m).

    Args:
        scene: `scene.Scene`; the surface is taken as free, whatever its wall.
        columns: as `layers_of`.
    """
    n = np.unique(np.geomspace(1, scene.cells[0], WAVES).round())
    k = n * np.pi / scene.outline.width
    held = None not in scene.walls["base"].velocity
    base = "no-slip" if held else "free-slip"
    stacks = layers_of(scene, columns)
    layered = max(fastest_decay(stack, k, scene.gravity, base) for stack in stacks)
    return max([layered, *_outcrops(scene)])


def _outcrops(scene):
    """Return the decay rates of the faults that reach the surface, 1/s."""
    rates = []
    for fault in scene.faults:
        points = np.concatenate([x.points for x in scene.lines if x.name == fault.name])
        top = points[points[:, 1].argmax()]
        if np.interp(top[0], *scene.outline.surface.T) - top[1] < fault.width:
            rho, eta = scene.unit_density[fault.unit], scene.unit_viscosity[fault.unit]
            rates.append(rho * scene.gravity * fault.width / (4 * np.pi * eta))
    return rates


def longest_way_back(marks):
    """Return the longest time between marks that follow each other downwards, s."""
    longest = top = 0.0
    for i, mark in enumerate(marks):
        top = max(top, mark) if i and mark < marks[i - 1] else mark
        longest = max(longest, top - mark)
    return longest


def restorability(scene, noise=NOISE, tolerance=TOLERANCE):
    """Return how far back the free surface of a scene can be integrated, as `Restorability`.

    Args:
        scene: `scene.Scene`.
        noise: how well the surface is known, m.
        tolerance: error of the restored surface that can be borne, m.
    """
    if scene.walls["surface"].kind != "free":
        return Restorability(None, None, None, "no free surface, so none that limits the way back")
    gamma, way = surface_rate(scene), longest_way_back(scene.time.marks)
    growth = gamma * way if way else None
    if gamma == 0:
        return Restorability(gamma, growth, None, "nothing makes the surface decay")
    borne = max(0.0, math.log(tolerance / noise))
    horizon = borne / gamma
    return Restorability(gamma, growth, horizon, _verdict(gamma, way, borne, noise, tolerance))


def restorable(scene):
    """Return what `restorability` tells of a scene, as entries of the run record."""
    plan = scene.surface
    found = restorability(scene, plan.noise, plan.tolerance)
    return {
        "gamma_max_per_s": found.gamma,
        "growth": found.growth,
        "horizon_s": found.horizon,
        "verdict": found.verdict,
    }


def _verdict(gamma, way, borne, noise, tolerance):
    """Return in words what becomes of an error of the surface.

    Args:
        gamma: fastest decay, 1/s.
        way: longest time back, s.
        borne: ln(tolerance / noise), or 0.
        noise, tolerance: m.
    """
    errors = f"{show(noise, 'length')} of error to {show(tolerance, 'length')}"
    reach = f"it takes {show(borne / gamma, 'time')} backward to grow from {errors}"
    if not way:
        return f"forward only; {reach}"
    growth = gamma * way
    fold = f"{number(math.exp(growth))}" if growth < 16 else f"10^{growth / math.log(10):.0f}"
    if growth <= borne:
        return (
            f"the surface can be integrated backward: in {show(way, 'time')} its errors grow "
            f"{fold}-fold at most; {reach}"
        )
    if borne:
        slaved = f"modes that relax faster than in {show(way / borne, 'time')} must be slaved"
    else:
        slaved = "all its modes must be slaved"
    return (
        f"the surface cannot be integrated backward: in {show(way, 'time')} its errors would grow "
        f"{fold}-fold; {slaved} to the rock below"
    )

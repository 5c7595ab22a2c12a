"""Free surfaces that move: relaxation (paper, appendix D), sloshing (appendix E), a plume."""

from dataclasses import dataclass, replace

import numpy as np

from restoration.bench.rows import Clock, Row, at_least, compared, observed_order
from restoration.bench.scenes import two_rocks, velocity_at
from restoration.engine import StokesEngine
from restoration.layered import Layer, growth_matrix, rates
from restoration.lines import surface_of
from restoration.run import march
from restoration.scene import (
    Air,
    Line,
    MeshPlan,
    Outline,
    RefinePlan,
    Rock,
    SurfacePlan,
    Transfer,
    Unit,
    Wall,
)
from restoration.units import MYR

WALLS = {"left": "free-slip", "right": "free-slip", "base": "no-slip", "surface": "free-slip"}
FREE = Wall("free", (None, None), (0.0, 0.0))
FITTED = MeshPlan("P2b-P1dg", "fitted")
EVERY_STEP = 1e9  # limit of a `SurfacePlan`: the marks alone set the steps
YEAR = MYR / 1e6
LINEAR = "linear theory of layered flow (restoration.layered)"


def below_air(scene, surface, **plan):
    """Return a scene with a free surface along a line, whose steps the marks alone set.

    Args:
        scene: `scene.Scene`.
        surface: shape (n, 2), m.
        plan: entries of `scene.SurfacePlan`.
    """
    return replace(
        scene,
        outline=Outline(surface, scene.outline.base),
        walls=scene.walls | {"surface": FREE},
        surface=SurfacePlan(**{"limit": EVERY_STEP} | plan),
    )


@dataclass(frozen=True, eq=False)
class Course:
    """What a march has passed.

    Attributes:
        times: s, shape (n,).
        surfaces: the surface at these times, n arrays of shape (m, 2), m.
        engine: `StokesEngine`.
        state: the last one.
        size: unknowns, cells, steps, solves and seconds, as entries of a `rows.Row`.
    """

    times: np.ndarray
    surfaces: list
    engine: StokesEngine
    state: object
    size: dict

    @property
    def ends(self):
        """Heights of the surface at the left and the right side, shape (n, 2), m."""
        return np.array([points[[0, -1], 1] for points in self.surfaces])


def course(scene):
    """March through a scene and return its `Course`, from the first mark on, step by step."""
    clock, engine = Clock(), StokesEngine(scene)
    first = engine.start()
    passed = [first]
    state = march(first, engine, scene.time, every_step=(lambda _, s: passed.append(s),))
    size = {
        "unknowns": engine.grid.spaces.unknowns,
        "cells": engine.grid.section.cell_count,
        "steps": len(passed) - 1,
        "stokes_solves": engine.counts.solves,
        "wall_s": clock.seconds,
    }
    times = np.array([s.time for s in passed])
    surfaces = [surface_of(s.lines).points for s in passed]
    return Course(times, surfaces, engine, state, size)


# Relaxation: Crameri et al. (2012), Geophys. J. Int. 189, 38-54, case 1.
WAVE, MANTLE, LID, HILL = 2800e3, 600e3, 100e3, 7e3  # m
RHO, ETA_MANTLE, ETA_LID = 3300.0, 1e21, 1e23
KYR = 365 * 86400e3  # the times of the table below are counted in years of 365 days
# Crest and trough, km, of the cosine of 7 km after 5, 15 and 50 kyr, by gravity.
HILLS = {
    10.0: {
        5: (5.017616602, -4.974653592),
        15: (2.587413597, -2.502889732),
        50: (0.2664513762, -0.2171483959),
    },
    9.81: {
        5: (5.049403253, -5.007105564),
        15: (2.636537042, -2.552537113),
        50: (0.2830757114, -0.2322816888),
    },
}
EXACT = "fully non-linear relaxation, computed independently to 1e-6"


def hill(gravity, amplitude, squares, marks, mesh=FITTED, lid=True, scheme="rk4", steps=1, **plan):
    """Return the scene of the relaxing cosine, one half of it: the other mirrors it.

    Args:
        gravity: m/s^2.
        amplitude: m.
        squares: rows of them.
        marks: s.
        mesh: `scene.MeshPlan`.
        lid: whether there is one; else mantle fills the section, and needs no mesh lines.
        scheme, steps: of the time; steps is the number between two marks.
        plan: entries of `scene.SurfacePlan`.
    """
    width, height = WAVE / 2, MANTLE + LID
    x = np.linspace(0, width, 801)
    box = two_rocks(
        width,
        height,
        lambda points: (points[:, 1] > MANTLE).astype(np.int16),
        np.column_stack([x, np.full(len(x), MANTLE)]),
        (RHO, RHO),
        (ETA_MANTLE, ETA_LID if lid else ETA_MANTLE),
        (2 * squares, squares),
        WALLS,
        gravity=gravity,
        mesh=mesh if lid else MeshPlan(),
        transfer=Transfer("hat", "linear", "geometric"),
        marks=marks,
        courant=np.inf,
        min_steps=steps,
        scheme=scheme,
    )
    surface = np.column_stack([x, height + amplitude * np.cos(2 * np.pi * x / WAVE)])
    return below_air(box, surface, **plan)


def relaxation_rate(gravity, lid=True):
    """Return gamma of the set-up in linear theory, 1/s."""
    lids = (Layer(LID, RHO, ETA_LID),) if lid else (Layer(LID, RHO, ETA_MANTLE),)
    return -rates((Layer(MANTLE, RHO, ETA_MANTLE), *lids), 2 * np.pi / WAVE, gravity).min()


def run_surface_relaxation(quick):
    """Relaxation of a cosine topography (paper, appendix D; Crameri et al. 2012, case 1)."""
    name = "surface-relaxation"
    yield from _uniform_layers(name, quick)
    yield from _small_hill(name, quick)
    yield from _large_hill(name, quick)
    yield from _orders_in_time(name, quick)
    if not quick:
        yield from _other_ways(name)


def _uniform_layers(name, quick):
    """Rates of layers of one rock, from the velocity of the crest."""
    k, g, amplitude = 2 * np.pi / WAVE, 10.0, 70.0
    for base in ("no-slip", "free-slip"):
        for kh in (0.5, 2.12) if quick else (0.5, 1.0, 2.12, 4.0):
            clock, depth = Clock(), kh / k
            x = np.linspace(0, WAVE / 2, 801)
            box = two_rocks(
                WAVE / 2,
                depth,
                lambda points: np.zeros(len(points), np.int16),
                np.array([[0.0, depth / 2], [WAVE / 2, depth / 2]]),
                (RHO, RHO),
                (ETA_MANTLE, ETA_MANTLE),
                (48, max(8, round(48 * kh / np.pi))),
                WALLS | {"base": base},
                gravity=g,
            )
            wave = amplitude * np.cos(k * x)
            engine = StokesEngine(below_air(box, np.column_stack([x, depth + wave])))
            state = engine.with_flow(engine.start())
            top = engine.grid.top.line[[0, -1]]
            crest, trough = velocity_at(state, top)[:, 1]
            reference = growth_matrix((Layer(depth, RHO, ETA_MANTLE),), k, g, base)[0, 0]
            yield compared(
                name,
                f"one layer, {base} base, kH = {kh:g}",
                "rate of relaxation, 1/s",
                (crest - trough) / (2 * amplitude),
                reference,
                bound=2e-3,
                source=LINEAR,
                parameters={"kh": kh, "base": base},
                unknowns=engine.grid.spaces.unknowns,
                cells=engine.section.cell_count,
                stokes_solves=1,
                wall_s=clock.seconds,
            )
            engine.grid.stokes.release()


def _small_hill(name, quick):
    for gravity in (10.0,) if quick else (10.0, 9.81):
        gamma, amplitude = relaxation_rate(gravity), 70.0
        ran = course(hill(gravity, amplitude, 8 if quick else 16, (0, 1 / gamma), steps=3))
        crest, trough = ran.ends[-1] - MANTLE - LID
        yield compared(
            name,
            f"70 m, g = {gravity:g}, fitted",
            "half the relief at the relaxation time, m",
            (crest - trough) / 2,
            amplitude * np.exp(-1),
            bound=2e-3,
            source=LINEAR,
            parameters={"gravity": gravity, "gamma": float(gamma)},
            **ran.size,
        )


def _large_hill(name, quick):
    last = 15 if quick else 50
    for gravity in (10.0,) if quick else (10.0, 9.81):
        for squares in (8,) if quick or gravity != 10 else (6, 8, 16):
            marks = np.arange(0, last + 1, 5) * KYR
            ran = course(hill(gravity, HILL, squares, marks, steps=1 if quick else 2))
            yield from _hills(name, gravity, f"fitted, {squares} rows", ran, squares, quick)


def _hills(name, gravity, how, ran, squares, quick, held=None):
    """Yield the rows of a hill against the table, those of fine meshes held to a bound.

    Args:
        name, gravity, squares, quick: of the benchmark.
        how: in words.
        ran: `Course`.
        held: whether the rows are held; None asks the number of squares.
    """
    held = squares >= 8 if held is None else held
    kyr = np.round(ran.times / KYR).astype(int)
    for when, pair in HILLS[gravity].items():
        if when > kyr[-1]:
            continue
        for i, (where, reference) in enumerate(zip(("crest", "trough"), pair, strict=True)):
            heights = ran.ends[:, i] - MANTLE - LID
            yield compared(
                name,
                f"7 km, g = {gravity:g}, {how}",
                f"{where} after {when} kyr, m",
                heights[kyr == when][-1],
                1e3 * reference,
                bound=2e-3 if held else None,
                source=EXACT,
                parameters={
                    "gravity": gravity,
                    "where": where,
                    "squares": squares,
                    "how": how,
                    "kyr": when,
                    "times": (ran.times / KYR).tolist(),
                    "heights": heights.tolist(),
                },
                **ran.size,
            )


def _orders_in_time(name, quick):
    """Orders of the schemes with the weight of the moved surface counted for half the step."""
    # a relief of 7 m: the mesh of the step's start is wrong by its slope, to first order
    small = 7.0
    ways = [("euler", 0.5, small, 2), ("midpoint", 0.5, small, 2)]
    if not quick:
        ways += [("midpoint", 0.5, HILL, 2), ("euler", 0.5, HILL, None)]
    counts = (4, 8, 16)
    exact = {}
    for scheme, theta, amplitude, order in ways:
        lid = not quick
        marks = (0, 1 / relaxation_rate(10.0, lid))

        def end(scheme, steps, theta=0.0, marks=marks, amplitude=amplitude, lid=lid):
            ran = course(hill(10.0, amplitude, 8, marks, FITTED, lid, scheme, steps, theta=theta))
            return ran.ends[-1, 0] - MANTLE - LID, ran

        if amplitude not in exact:
            exact[amplitude] = end("rk4", 12)[0]
        errors = []
        for steps in counts:
            found, ran = end(scheme, steps, theta)
            errors.append(abs(found / exact[amplitude] - 1))
        parameters = {"counts": counts, "errors": errors, "scheme": scheme, "theta": theta}
        parameters |= {"amplitude": amplitude}
        sizes = 1 / np.array(counts)
        case = f"{amplitude:g} m, {scheme}, theta = {theta:g}"
        metric = f"order in time from {counts[-2]} to {counts[-1]} steps"
        value = observed_order(sizes, errors)
        more = {"parameters": parameters, **ran.size}
        if order is None:
            yield Row(name, case, metric, value, source="first order on a slope", **more)
        else:
            source = "theory of the scheme; errors against small steps on the same mesh"
            yield at_least(name, case, metric, value, order, source=source, **more)


def _other_ways(name):
    """The same hill by particles in refined cells, and under air that is solved for."""
    marks = np.array([0, 5, 10, 15]) * KYR
    refined = MeshPlan(refine=RefinePlan(3, ("interfaces",), 1))
    ran = course(hill(10.0, HILL, 14, marks, refined))
    yield from _hills(name, 10.0, "particles, 14 rows halved 3 times", ran, 14, False, True)
    ran = course(hill(10.0, HILL, 14, marks, MeshPlan()))
    yield from _hills(name, 10.0, "particles, 14 rows", ran, 14, False, False)
    for viscosity in (1e18, 1e19):
        air = Air(150e3, 0.0, viscosity)
        ran = course(hill(10.0, HILL, 14, marks, MeshPlan(), air=air))
        how = f"particles, 14 rows, air of {viscosity:g} Pa s"
        yield from _hills(name, 10.0, how, ran, 14, False, False)


# Sloshing: Kaus et al. (2010), Phys. Earth Planet. Inter. 181, 12-20; paper, appendix E.
BOX, LAYER, AMPLITUDE = 500e3, 400e3, 5e3  # side; thickness of the lower rock; wave, m
SLOSHING = (Layer(LAYER, 3200.0, 1e20), Layer(BOX - LAYER, 3300.0, 1e21))
TILT = 100.0  # m, put on the surface: half a wave across the box, which decays fastest
# Surface at the left side, m, after Myr, from the wave of 5 km under a flat surface.
CORNER = {
    0.05: -140.4629149,
    0.1: -146.4984274,
    0.2: -157.6031928,
}
THRESHOLD = 4082.148833  # years: 2 / gamma of the tilt


def sloshing(dt, steps, theta=0.0, wave=AMPLITUDE, tilt=0.0, squares=25):
    """Return the scene of the sloshing surface, by explicit steps.

    Args:
        dt: step, years.
        steps: number of them.
        theta: of `scene.SurfacePlan`.
        wave: amplitude of the contact, m; it is low at the sides and high in the middle.
        tilt: amplitude of half a wave on the surface, m.
        squares: along a side.
    """
    x = np.linspace(0, BOX, 401)

    def height(x):
        return LAYER - wave * np.cos(2 * np.pi * x / BOX)

    box = two_rocks(
        BOX,
        BOX,
        lambda points: (points[:, 1] > height(points[:, 0])).astype(np.int16),
        np.column_stack([x, height(x)]),
        tuple(layer.density for layer in SLOSHING),
        tuple(layer.viscosity for layer in SLOSHING),
        (squares, squares),
        WALLS,
        mesh=FITTED if wave == 0 else replace(FITTED, refine=RefinePlan(2, ("interfaces",), 1)),
        marks=(0, steps * dt * YEAR),
        courant=np.inf,
        min_steps=steps,
        scheme="euler",
    )
    surface = np.column_stack([x, BOX + tilt * np.cos(np.pi * x / BOX)])
    return below_air(box, surface, theta=theta)


def tilts(ran):
    """Return the amplitude of half a wave across the box in the surfaces of a `Course`, m."""
    found = []
    for points in ran.surfaces:
        wave = (points[:, 1] - BOX) * np.cos(np.pi * points[:, 0] / BOX)
        found.append(2 / BOX * np.trapz(wave, points[:, 0]))
    return np.array(found)


def growth_of_tilt(ran):
    """Return by what a step multiplies the tilt, its sign included.

    Differences of the tilt leave out what the layers themselves do, which is slow. The last three
    that stand out from it tell.
    """
    steps = np.diff(tilts(ran))
    last = max(2, np.flatnonzero(np.abs(steps) > 0.02 * np.abs(steps).max())[-1])
    return np.copysign(np.sqrt(abs(steps[last] / steps[last - 2])), steps[1] / steps[0])


def theory_of_tilt(dt, theta):
    """Return by what a step of ``dt`` years multiplies the tilt in linear theory.

    The weight of the moved surface counts for the share theta of the step, that of the moved
    contact does not.
    """
    a, dt = growth_matrix(SLOSHING, np.pi / BOX, 9.81), dt * YEAR
    on_surface = np.diag([0.0, 1.0])
    rate = np.linalg.solve(np.eye(2) - theta * dt * a @ on_surface, a)
    return 1 + dt * np.linalg.eigvals(rate).real.min()


def run_sloshing(quick):
    """Sloshing surface: which steps are stable, and where the surface goes (paper, appendix E)."""
    name = "sloshing"
    yield from _factors(name, 12 if quick else 25, quick)
    if not quick:
        yield _threshold(name, 25)
    yield from _stable_and_not(name, *((12, 6) if quick else (16, 20)), quick)
    yield from _corner(name, quick)


def _factors(name, squares, quick):
    """Factors of a step over flat layers, where linear theory knows them."""
    ways = (2500, 0), (3900, 0), (4300, 0), (5000, 0.5), (10000, 0.5), (25000, 0.5)
    for dt, theta in ways[1::2] if quick else ways:
        steps = 4 if quick else 8
        ran = course(sloshing(dt, steps, theta, 0.0, TILT, squares))
        yield compared(
            name,
            f"flat layers, {dt} yr, theta = {theta:g}",
            "factor of the tilt in a step",
            growth_of_tilt(ran),
            theory_of_tilt(dt, theta),
            bound=1e-2,
            source=LINEAR,
            parameters={"dt": dt, "theta": theta, "flat": True},
            **ran.size,
        )


def _threshold(name, squares):
    """The row of the longest stable step, bracketed by bisection."""
    clock, low, high, solves = Clock(), 3900.0, 4300.0, 0
    while high - low > 10:
        middle = (low + high) / 2
        ran = course(sloshing(middle, 12, 0.0, 0.0, TILT, squares))
        solves += ran.size["stokes_solves"]
        low, high = (low, middle) if abs(growth_of_tilt(ran)) > 1 else (middle, high)
    return compared(
        name,
        f"flat layers, explicit: stable at {low:g}, unstable at {high:g}",
        "longest stable step, years",
        (low + high) / 2,
        THRESHOLD,
        bound=5e-3,
        source=f"2 / gamma, {LINEAR}",
        **ran.size | {"stokes_solves": solves, "wall_s": clock.seconds},
    )


def _stable_and_not(name, squares, steps, quick):
    """Whether a tilt grows above the wave of the paper; the wave puts the limit a little higher."""
    explicit = ((3900, 0.0, True), (4300, 0.0, False), (5000, 0.0, False))
    ways = (*explicit, (5000, 0.5, True), (10000, 0.5, True), (25000, 0.5, True))
    for dt, theta, stable in ways[1::4] if quick else ways:
        ran = course(sloshing(dt, steps, theta, tilt=TILT, squares=squares))
        found, growth = tilts(ran), abs(growth_of_tilt(ran))
        yield Row(
            name,
            f"wave of 5 km, {dt} yr, theta = {theta:g}: {'stable' if stable else 'unstable'}",
            f"factor of the tilt in a step{'' if stable else ', inverted'}",
            growth if stable else 1 / growth,
            bound=1.0,
            source="below 1 the surface is " + ("stable" if stable else "unstable"),
            parameters={
                "dt": dt,
                "theta": theta,
                "times": (ran.times / YEAR).tolist(),
                "tilts": found.tolist(),
            },
            **ran.size,
        )


def _corner(name, quick):
    """Height of the top left corner through time, nothing but the wave moving it."""
    last, squares = (0.05, 12) if quick else (0.2, 16)
    ways = (2500, 0.0), (5000, 0.5), (10000, 0.5), (25000, 0.5)
    small = None
    for dt, theta in ways[1:2] if quick else ways:
        ran = course(sloshing(dt, round(last * 1e6 / dt), theta, squares=squares))
        years, heights = ran.times / YEAR, ran.ends[:, 0] - BOX
        small = small or (years, heights)
        parameters = {"dt": dt, "theta": theta}
        parameters |= {"times": years.tolist(), "heights": heights.tolist()}
        for when, reference in CORNER.items():
            at = np.flatnonzero(np.abs(years - when * 1e6) < 1)
            if when > last or not len(at):
                continue
            yield compared(
                name,
                f"wave of 5 km, {dt} yr, theta = {theta:g}",
                f"corner after {when:g} Myr, m",
                heights[at[0]],
                reference,
                # a surface that begins flat is far from its rest, and the longest steps overshoot
                bound=1e-2 if dt <= 10000 else None,
                source=EXACT.replace("relaxation", "flow"),
                parameters=parameters,
                **ran.size,
            )
        if not quick and dt > small[0][1]:
            off = np.abs(np.interp(years, *small) - heights)[years > 1e5]
            yield Row(
                name,
                f"wave of 5 km, {dt} yr, theta = {theta:g}",
                f"corner off that of steps of {small[0][1]:g} yr, from 0.1 Myr on",
                float(off.max() / np.abs(heights[-1])),
                bound=1e-2,
                source="a run with smaller steps",
                parameters=parameters,
                **ran.size,
            )


# The rising plume: Crameri et al. (2012), case 2.
PLUME = (300e3, 50e3, 3200.0, 1e20)  # height of the centre and radius, m; kg/m^3; Pa s
TOPOGRAPHY = {1.44: 310.8081, 3.0: 398.1387}  # m after Myr; 3 is between two rows of the table
MILAMIN = "MILAMIN_VEP, free surface, tabulated beside ASPECT's benchmark crameri_et_al"
ASPECT, ASPECT_AT_3 = "ASPECT, the value that its manual says it converges to", 396.0  # m


def plume(squares, levels, steps, last=3.0):
    """Return the scene of the plume under a lid, one half of it: the other mirrors it.

    Args:
        squares: rows of them.
        levels: how often cells are halved at the contacts.
        steps: number of them.
        last: Myr.
    """
    centre, radius, density, viscosity = PLUME
    box = hill(
        10.0,
        0.0,
        squares,
        (0, 0.12 * MYR, last * MYR),  # at first the surface finds its rest, in short steps
        MeshPlan("P2b-P1dg", "fitted", RefinePlan(levels, ("interfaces",), 1)),
        scheme="midpoint",
        steps=steps // 2,
        theta=0.5,
    )
    turn = np.linspace(-np.pi / 2, np.pi / 2, 181)
    around = np.column_stack([radius * np.cos(turn), centre + radius * np.sin(turn)])
    around[[0, -1], 0] = 0.0

    def unit_at(points):
        inside = np.hypot(points[:, 0], points[:, 1] - centre) < radius
        return np.where(inside, 2, box.unit_at(points)).astype(np.int16)

    return replace(
        box,
        rocks=(*box.rocks, Rock("plume", density, viscosity, "#b04030")),
        units=(*box.units, Unit("plume", 2, "#b04030")),
        lines=(*box.lines, Line("plume", "horizon", around)),
        unit_at=unit_at,
    )


def run_crameri_2(quick):
    """Topography above a rising plume (Crameri et al. 2012, case 2)."""
    name = "crameri-2"
    ways = ((10, 2, 8),) if quick else ((12, 2, 20), (12, 3, 20), (20, 3, 20))
    for squares, levels, steps in ways:
        ran = course(plume(squares, levels, steps))
        heights = np.array([points[:, 1].max() for points in ran.surfaces]) - MANTLE - LID
        myr = ran.times / MYR
        case = f"fitted, {squares} rows, halved {levels} times, {steps} steps"
        known = [(when, MILAMIN, reference) for when, reference in TOPOGRAPHY.items()]
        for when, source, reference in (*known, (3.0, ASPECT, ASPECT_AT_3)):
            yield compared(
                name,
                case,
                f"greatest topography after {when:g} Myr, m",
                np.interp(when, myr, heights),
                reference,
                bound=3e-2 if quick else 2e-2 if squares < 20 else 1e-2,
                source=source,
                parameters={"times": myr.tolist(), "heights": heights.tolist(), "myr": when},
                **ran.size,
            )

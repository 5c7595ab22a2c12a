"""Cases at their extremes: size, gravity, steps, particles, layers, flat cells, mirrors, units.

Each is a case file with some entries changed; what comes of it is held to theory, to the same case
told in another way, or to a reason for which it is refused.
"""

import math
import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import shapely
from dolfinx import fem

from restoration.bench.boxes import Solved, unit_square
from restoration.bench.contrasts import refusal
from restoration.bench.exact import two_layer_growth_rate
from restoration.bench.rows import Clock, Row
from restoration.bench.scenes import velocity_at
from restoration.engine import StokesEngine
from restoration.errors import RestorationError
from restoration.layered import Layer, fastest_decay
from restoration.lines import surface_of
from restoration.particles import subset
from restoration.resolve import load
from restoration.run import march

NAME = "extremes"
CASE = """
section:
  box: {width: 9.142 km, height: 10 km}
  layers:
    - {rock: salt, top: {depth: 8 km, cosine: {amplitude: 0.2 km, wavelength: 18.284 km}}}
    - {rock: sediment}
rocks:
  salt:     {density: 2150 kg/m^3, viscosity: 1e18 Pa s}
  sediment: {density: 2600 kg/m^3, viscosity: 1e19 Pa s}
boundary: {surface: no-slip}
mesh: {cells: 8}
transfer: {density: lines, viscosity: lines}
time: {marks: [0 Myr, 0.4 Myr], courant: 1, min_steps: 2}
certificate: off
"""
WIDTH, HEIGHT, SALT = 9142.0, 10000.0, 2000.0
HILL = """
section: {box: {width: 9.142 km, height: 10 km}, layers: [{rock: rock}]}
rocks: {rock: {density: 2600 kg/m^3, viscosity: 1e19 Pa s}}
boundary: {surface: free}
mesh: {cells: 12}
time: {marks: [0 Myr, 1 Myr], courant: 1e3, min_steps: 1, scheme: euler}
certificate: off
"""
SAME, NEAR = 1e-9, 1e-2  # relative: but for rounding; on other meshes
# What a horizon may be off over the height, and a velocity, about 1.5 times what was found.
OFF_BY_COURANT = {0.001: 1e-6, 0.01: 1e-6, 0.5: 1e-3, 1.0: 5e-3, 2.0: 0.02, 10.0: 0.2}
OFF_BY_COUNT = {1: 1.2, 4: 0.4, 20: 0.15, 100: 0.03, 1000: 0.03}


def loaded(text, *overrides):
    """Return the scene of the text of a case, with ``a.b=value`` texts."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "case.yaml"
        path.write_text(text, encoding="utf-8")
        return load(path, overrides).scene


def marched(scene):
    """Return the state at the last mark, and the engine."""
    engine = StokesEngine(scene)
    return march(engine.start(), engine, scene.time), engine


def first(scene):
    """Return the state at the first mark with its flow."""
    engine = StokesEngine(scene)
    return engine.with_flow(engine.start())


def end_of(scene):
    """Return the vertices of the horizon at the last mark, over the height of the section."""
    state, _ = marched(scene)
    return state.lines[0].points / scene.outline.height


def told(extreme, case, metric, bound, make, source, **parameters):
    """Return the row of what ``make`` returns, an error, or of why it was refused."""
    clock = Clock()
    parameters |= {"extreme": extreme}
    case = f"{extreme}: {case}"
    try:
        value = make()
    except RestorationError as refused:
        return refusal(NAME, case, refused, parameters)
    more = {"source": source, "parameters": parameters, "wall_s": clock.seconds}
    return Row(NAME, case, metric, float(value), 0.0, None, bound, **more)


def distance(one, other):
    """Return the greatest distance between lines; infinite where they have other vertices."""
    same = one.shape == other.shape
    return np.abs(one - other).max() if same else math.inf


def run_extremes(quick):
    """Extremes of size, gravity, steps, particles, layers, cells, mirrors and units."""
    yield from _sizes(quick)
    yield from _gravity()
    yield from _one_rock()
    yield from _mirrors()
    yield from _units()
    yield from _courant(quick)
    yield from _surface_steps()
    yield from _particles(quick)
    yield from _thin_layers()
    yield from _flat_cells()


def _sizes(quick):
    """The same dimensionless section from 10 cm to 3000 km: stiffer as it is larger."""
    expected = end_of(loaded(CASE))
    for width in (0.1, 3e6) if quick else (0.1, 1.0, 100.0, 1e5, 3e6):
        k = width / WIDTH

        def make(k=k):
            wave = f"{{amplitude: {200 * k!r} m, wavelength: {2 * WIDTH * k!r} m}}"
            scene = loaded(
                CASE,
                f"section.box={{width: {WIDTH * k!r} m, height: {HEIGHT * k!r} m}}",
                f"section.layers=[{{rock: salt, top: {{depth: {8000 * k!r} m, cosine: {wave}}}}}, "
                "{rock: sediment}]",
                f"rocks.salt.viscosity={1e18 * k!r} Pa s",
                f"rocks.sediment.viscosity={1e19 * k!r} Pa s",
            )
            return distance(end_of(scene), expected)

        yield told(
            "size",
            f"{width:g} m wide",
            "horizon off, over the height",
            SAME,
            make,
            "the section of 9 km, scaled",
            width_m=width,
        )


def _gravity():
    def still():
        state, _ = marched(loaded(CASE, "gravity=0 m/s^2"))
        return np.abs(state.flow.u).max() + distance(
            state.lines[0].points, marched(loaded(CASE, "gravity=0 m/s^2"))[0].lines[0].points
        )

    yield told("gravity", "none", "greatest velocity, m/s", 0.0, still, "nothing drives anything")
    yield told(
        "gravity",
        "100 times, a hundredth of the time",
        "horizon off, over the height",
        SAME,
        lambda: distance(
            end_of(loaded(CASE, "gravity=981 m/s^2", "time.marks=[0 Myr, 0.004 Myr]")),
            end_of(loaded(CASE)),
        ),
        "the same at 9.81 m/s^2",
    )
    for case, text in (
        ("upward", "gravity=-9.81 m/s^2"),
        ("tilted", "gravity=[1 m/s^2, 9.7 m/s^2]"),
    ):
        yield told("gravity", case, "horizon off", 0.0, lambda t=text: _nothing(t), "")
    yield told(
        "gravity",
        "upward, by a block turned over with its buoyancy",
        "velocity off, relative",
        SAME,
        _turned_over,
        "the block that falls, mirrored in z",
    )


def _nothing(override):
    """March a case that is expected to be refused."""
    marched(loaded(CASE, override))
    return math.inf


def _block(up, side):
    """Return the velocity of a block of 0.2 in a unit square, at (side, up), heavy or light."""

    def density(spaces):
        x = spaces.section.corners.mean(axis=1)
        rho = fem.Function(spaces.D)
        inside = (np.abs(x - [side, up]) < 0.1).all(axis=1)
        rho.x.array[:] = np.where(inside, 1.0 if up > 0.5 else -1.0, 0.0)
        return rho

    def viscosity(spaces):
        x = spaces.section.corners.mean(axis=1)
        eta = fem.Function(spaces.D)
        eta.x.array[:] = np.where((np.abs(x - [side, up]) < 0.1).all(axis=1), 1e3, 1.0)
        return eta

    solved = Solved(unit_square("P2-P1", 20), "P2-P1", viscosity, density)
    x = solved.spaces.V.tabulate_dof_coordinates()[:, :2]
    solved.problem.release()
    return x, solved.flow.u


def _by_place(x, u):
    """Return velocities in the order of their places."""
    return u[np.lexsort(np.round(x, 9).T)]


def _turned_over():
    (x, u), (y, v) = _block(0.8, 0.3), _block(0.2, 0.3)
    one, other = _by_place(x, u), _by_place(y * [1, -1] + [0, 1], v * [1, -1])
    return np.abs(one - other).max() / np.abs(u).max()


def _one_rock():
    for interfaces in ("particles", "fitted", "auto"):

        def still(interfaces=interfaces):
            text = "\n".join(row for row in CASE.splitlines() if not row.startswith("transfer"))
            scene = loaded(
                text,
                "section.layers=[{rock: salt}]",
                f"mesh.interfaces={interfaces}",
            )
            state = first(scene)
            falling = 2150 * 9.81 * HEIGHT**2 / 1e18
            return state.grid.speeds(state.flow)[1] / falling

        yield told(
            "one rock",
            interfaces,
            "greatest velocity, over rho g H^2 / eta",
            SAME,
            still,
            "rock at rest",
        )


def _mirrors():
    particles = CASE.replace("transfer: {density: lines, viscosity: lines}\n", "")
    for case, text, bound, *overrides in (
        ("lines", CASE, SAME),
        ("fitted, the mesh without a mirror", particles, 5 * NEAR, "mesh.interfaces=fitted"),
        ("particles, seeded without a mirror", particles, 10 * NEAR),
    ):
        yield told(
            "mirror",
            case,
            "velocity off, relative",
            bound,
            partial(_mirrored_off, text, *overrides),
            "the scene in a mirror",
        )


def _mirrored_off(text, *overrides):
    """Return the greatest difference of the velocity of a scene and of its image in a mirror."""
    at = np.random.default_rng(1).uniform([0, -HEIGHT], [WIDTH, 0], (60, 2))
    found = []
    for phase, points in ((1000.0, at), (WIDTH - 1000.0, at * [-1, 1] + [WIDTH, 0])):
        wave = f"{{amplitude: 0.2 km, wavelength: 7 km, phase: {phase} m}}"
        scene = loaded(text, f"section.layers.0.top.cosine={wave}", *overrides)
        found.append(velocity_at(first(scene), points))
    return np.abs(found[0] - found[1] * [-1, 1]).max() / np.abs(found[0]).max()


SPELLED = {
    "m, s": (
        "section.box={width: 9142 m, height: 10000 m}",
        "time.marks=[0 s, 12623040000000 s]",
    ),
    "cm, kyr, g/cm^3": (
        "section.box={width: 914200 cm, height: 1000000 cm}",
        "time.marks=[0 kyr, 400 kyr]",
        "rocks.salt.density=2.15 g/cm^3",
        "rocks.sediment.density=2600 kg m^-3",
    ),
    "mm, years, powers of ten": (
        "section.box={width: 9.142e6 mm, height: 1e7 mm}",
        "time.marks=[0 yr, 4e5 years]",
        "rocks.salt.viscosity=0.1e19 Pa·s",
        "gravity=9.81 m s^-2",
    ),
}
SPEEDS = ("31.5576 mm/yr", "3.15576 cm/yr", "31.5576 km/Myr", "0.0315576 m/a", "1e-9 m/s")


def _units():
    expected = end_of(loaded(CASE))
    source = "the case in km, Myr, kg/m^3"
    for case, overrides in SPELLED.items():

        def make(overrides=overrides):
            return distance(end_of(loaded(CASE, *overrides)), expected)

        yield told("units", case, "horizon off, over the height", 1e-12, make, source)

    def speeds():
        walls = [
            loaded(CASE, f"boundary.left={{velocity: [{speed}, free]}}", "boundary.right=no-slip",
                   "boundary.surface={traction: [0 MPa, 0 MPa]}").walls["left"].velocity[0]
            for speed in SPEEDS
        ]  # fmt: skip
        return np.ptp(walls) / 1e-9

    yield told(
        "units", f"{len(SPEEDS)} spellings of 1e-9 m/s", "range, relative", 1e-15, speeds, ""
    )
    for case, override in (
        ("feet", "section.box={width: 30000 ft, height: 33000 ft}"),
        ("no unit", "section.box={width: 9.142, height: 10}"),
    ):
        yield told("units", case, "horizon off", 0.0, partial(_nothing, override), "")


LID = """
section:
  box: {width: 10 km, height: 10 km}
  layers: [{rock: rock, top: {depth: 4 km}}, {rock: rock, name: cover}]
rocks: {rock: {density: 2600 kg/m^3, viscosity: 1e19 Pa s}}
boundary: {surface: {velocity: [10 mm/yr, 0 mm/yr]}}
mesh: {cells: 10}
time: {marks: [0 Myr, 1 Myr], min_steps: 1}
certificate: off
"""


def _courant(quick):
    """Steps of 0.001 to 10 cells below a moving lid, over the same way."""
    begin = first(loaded(LID))
    cell = 1 / begin.grid.fastest(begin.flow)  # s to cross one
    for cells, finest, counts in ((10, 0.1, (0.5, 1.0, 2.0, 10.0)), (0.05, 0.05, (0.01, 0.001))):
        marks = f"time.marks=[0 s, {cells * cell:.17g} s]"
        expected = shapely.LineString(end_of(loaded(LID, marks, f"time.courant={finest}")))
        for courant in counts[:-1] if quick and cells < 1 else counts:

            def make(marks=marks, courant=courant, expected=expected):
                found = end_of(loaded(LID, marks, f"time.courant={courant}"))
                return shapely.hausdorff_distance(shapely.LineString(found), expected)

            yield told(
                "Courant number",
                f"{courant:g}, over {cells:g} cells",
                "horizon off, over the height",
                OFF_BY_COURANT[courant],
                make,
                f"steps of {finest:g} cells",
                courant=courant,
            )


def _surface_steps():
    """Steps of 0.5 to 10 times the longest that an explicit surface bears."""
    k = math.pi / WIDTH
    rate = fastest_decay([Layer(HEIGHT, 2600.0, 1e19)], np.array([k]), 9.81)
    for limit in (0.5, 0.99, 1.01, 2, 10):
        yield told(
            "surface step",
            f"{limit:g} of the longest, theta 0",
            "amplitude after 6 steps, over that before",
            1.0,
            partial(_relaxed, k, 2.0, 6 * limit * 2 / rate, 0, f"surface.limit={limit}"),
            "a stable surface sinks",
            factor=limit,
            theta=0,
        )
        steps = 6
        yield told(
            "surface step",
            f"{limit:g} of the longest, theta 1/2",
            "amplitude after 6 steps, over that before",
            1.0,
            partial(_relaxed, k, 2.0, steps * limit * 2 / rate, steps, "surface.theta=0.5"),
            "a stable surface sinks",
            factor=limit,
            theta=0.5,
        )


def _relaxed(k, height, seconds, steps, *overrides):
    """Return how high a hill of half a cosine stands after a time, over how high it was."""
    scene = loaded(HILL, "surface={}", *overrides, f"time.marks=[0 s, {seconds:.17g} s]")
    x = np.linspace(0, WIDTH, 201)
    outline = replace(scene.outline, surface=np.column_stack([x, height * np.cos(k * x)]))
    time = replace(scene.time, min_steps=max(1, steps))
    state, _ = marched(replace(scene, outline=outline, time=time))
    surface = surface_of(state.lines).points[:, 1]
    return np.abs(surface).max() / height


def _particles(quick):
    """One to a thousand particles a cell, and holes without any."""
    text = CASE.replace("lines, viscosity: lines", "projection, viscosity: cell")
    at = np.random.default_rng(1).uniform([0, -HEIGHT], [WIDTH, 0], (200, 2))
    expected = velocity_at(first(loaded(CASE)), at)
    size = np.abs(expected).max()
    for count in (1, 4, 100) if quick else (1, 4, 20, 100, 1000):

        def make(count=count):
            scene = loaded(text, f"particles.per_cell={count}", "particles.densify=1")
            return np.abs(velocity_at(first(scene), at) - expected).max() / size

        yield told(
            "particles",
            f"{count} a cell",
            "velocity off, relative",
            OFF_BY_COUNT[count],
            make,
            "the rock between the lines, exactly",
            per_cell=count,
        )
    for cells in (0.5, 2.0):

        def hole(cells=cells):
            engine = StokesEngine(loaded(text))
            state = engine.start()
            full = velocity_at(engine.with_flow(state), at)
            far = np.hypot(*(state.particles.x[:, :2] - [0.5 * WIDTH, -0.35 * HEIGHT]).T)
            kept = subset(state.particles, far > cells * engine.cell_size)
            engine = StokesEngine(loaded(text))
            state = replace(engine.start(), particles=engine._settled(kept))
            found = velocity_at(engine.with_flow(state), at)
            return np.abs(found - full).max() / size

        yield told(
            "particles",
            f"none within {cells:g} cells of a point in one rock",
            "velocity off, relative",
            NEAR,
            hole,
            "the same with all particles",
        )


def _thin_layers():
    """A layer of a ten thousandth of the height that is no other rock than that around it."""
    text = CASE.replace("transfer: {density: lines, viscosity: lines}\n", "")
    layers = "section.layers=[{rock: salt, top: {depth: 8 km, cosine: %s}}, %s{rock: sediment}]"
    wave = "{amplitude: 0.2 km, wavelength: 18.284 km}"
    at = np.random.default_rng(1).uniform([0, -HEIGHT], [WIDTH, 0], (100, 2))
    for interfaces in ("fitted", "auto", "particles"):
        for thick in (1e-4, 1e-6):

            def make(interfaces=interfaces, thick=thick):
                how = f"mesh.interfaces={interfaces}"
                u = velocity_at(first(loaded(text, how, layers % (wave, ""))), at)
                rock = "{density: 2600 kg/m^3, viscosity: 1e19 Pa s}"
                thin = f"{{rock: thin, top: {{depth: {5000 - HEIGHT * thick!r} m}}}}, "
                below = "{rock: sediment, name: below, top: {depth: 5000 m}}, "
                v = velocity_at(
                    first(loaded(text, how, layers % (wave, below + thin), f"rocks.thin={rock}")),
                    at,
                )
                return np.abs(u - v).max() / np.abs(u).max()

            yield told(
                "thin layer",
                f"{thick:g} of the height, {interfaces}",
                "velocity off, relative",
                5 * NEAR,
                make,
                "without the layer, which is of the rock around it",
            )


def _flat_cells():
    """Flat cells, and waves that are long for their height: growth by linear theory."""
    columns, fitted = (), ("mesh.interfaces=fitted",)
    for aspect, amplitude, cells, how in (
        (1, 500.0, "[8, 20]", columns),
        (3, 500.0, "[8, 20]", columns),
        (1000, 500.0, "[8, 20]", columns),
        (30, 50.0, "[240, 20]", fitted),
        (30, 50.0, "[240, 20]", columns),
    ):
        relief = f"{amplitude / 500:g} cells of relief, {2 * 8 * aspect / 20:g} heights long"
        yield told(
            "flat cells",
            f"{cells} squares, wave with {relief}, {'fitted' if how else 'columns'}",
            "growth rate off, relative",
            # a tenth of a cell is not resolved by cells through which rock moves: see the page
            None if amplitude < 500 and not how else 0.2,
            partial(_growth_off, aspect, amplitude, cells, how),
            "linear theory, Ramberg (1968)",
            aspect=aspect,
        )


def _growth_off(aspect, amplitude, cells, overrides):
    """Return how far the growth of a wave is from linear theory, relative."""
    width = 8 * aspect * HEIGHT / 20
    text = CASE
    if overrides:
        text = CASE.replace("transfer: {density: lines, viscosity: lines}\n", "")
    wave = f"{{amplitude: {amplitude} m, wavelength: {2 * width} m}}"
    scene = loaded(
        text,
        f"section.box={{width: {width} m, height: 10 km}}",
        f"section.layers.0.top.cosine={wave}",
        f"mesh.cells={cells}",
        *overrides,
    )
    state = first(scene)
    rise = velocity_at(state, np.array([[0.0, SALT - HEIGHT + amplitude]]))[0, 1]
    k = math.pi / width
    rate = two_layer_growth_rate(k, HEIGHT - SALT, SALT, 1e19, 1e18, 450.0, 9.81)
    return abs(rise / amplitude / rate - 1)


def panels(rows):
    """Return the panel of the figure, see `pictures.draw`: every number over its bound."""
    series = {}
    for number, row in enumerate(rows, start=1):
        if row.bound:
            x, y, _ = series.setdefault(row.parameters["extreme"], ([], [], ""))
            x.append(number)
            y.append(max(row.value, 1e-17) / row.bound)
    title, label = "numbers over their bounds", "error over what it is held to"
    return [(title, "row of the table", label, ("linear", "log"), series)]

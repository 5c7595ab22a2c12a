"""What another code takes for the same answers: error against error, CPU seconds against seconds.

The other code is ASPECT 2.5.0, run on a machine of the kind that ours are measured on, one process;
`reference.PEERS` has its numbers. Ours are CPU seconds from the scene to the number, without the
start of the program, as theirs are. Its errors of the waves are taken to be those of the greatest
velocity against linear theory: they follow what the exact flow of a wave of finite height is
slower, 0.1 to 1 %. Here they are turned into errors against that flow, which are much smaller.
"""

import time
from dataclasses import dataclass

import numpy as np
from dolfinx import fem

from meshes.section import fitted_mesh
from restoration.bench import surfaces, van_keken
from restoration.bench.boxes import Solved
from restoration.bench.gravity import block_section, fall
from restoration.bench.reference import (
    PEERS,
    RAMBERG,
    RAMBERG_GREATEST,
    RAMBERG_VELOCITY,
    sinking_block_velocity,
)
from restoration.bench.rows import Row
from restoration.engine import StokesEngine
from restoration.particles import CellIndex
from restoration.run import march
from restoration.sampling import VelocitySampler
from restoration.scene import MeshPlan, ParticlePlan, Wall

NAME = "peers"
LESS = 10.0  # times less CPU seconds that are asked for
# The peer's block: m, Pa s, kg/m^3, m/s^2.
SIDE, MEDIUM, EXCESS, GRAVITY = 500e3, 1e21, 100.0, 10.0
# Squares and elements with which the block falls at least as exactly as the peer's.
BLOCKS = {
    (1e19, 160): (6, "P2b-P1dg"),
    (1e19, 320): (10, "P2b-P1dg"),
    (1e23, 160): (14, "P2-P1"),
    (1e23, 320): (31, "P2-P1"),
    (1e27, 320): (20, "P2-P1"),
}
# Cells across half a wave, and of the wave along the contact.
WAVES = {64e3: (2, 0.05), 128e3: (2, 0.05), 256e3: (4, 0.05)}
CREST_AT = 14.825  # kyr
CREST = 2617.5  # m, non-linear relaxation computed independently
PEAK, PEAK_AT = 0.0030943, 208.5  # van Keken et al. (1997), CND on 48 x 48; see docs/benchmarks.md


@dataclass(frozen=True)
class Match:
    """An answer of ours beside one of theirs.

    Attributes:
        case: what is asked for, in words.
        errors: relative errors, ours and theirs.
        seconds: CPU seconds, ours and theirs.
        unknowns: ours and theirs, of the mesh.
    """

    case: str
    errors: tuple[float, float]
    seconds: tuple[float, float]
    unknowns: tuple[int, int]

    def rows(self, quick):
        """Yield its rows; seconds of a quick run are not held, other work may go on beside it."""
        ours, theirs = self.errors
        parameters = {
            "errors": list(self.errors),
            "seconds": list(self.seconds),
            "their_unknowns": self.unknowns[1],
        }
        more = {"unknowns": self.unknowns[0], "source": PEERS["code"], "parameters": parameters}
        worse = max(0.0, abs(ours) / abs(theirs) - 1)
        yield Row(NAME, self.case, "relative error", abs(ours), abs(theirs), worse, 0.0, **more)
        yield Row(NAME, self.case, "CPU seconds", *self.seconds, **more)
        less = self.seconds[1] / self.seconds[0]
        short = min(0.0, less / LESS - 1)
        bound = None if quick else 0.0
        yield Row(NAME, self.case, "times less CPU", less, LESS, short, bound, **more)


def run_peers(quick):
    """Errors and CPU seconds beside those of another code, ASPECT 2.5.0."""
    yield from (row for match in _blocks(quick) for row in match.rows(quick))
    yield from (row for match in _waves(quick) for row in match.rows(quick))
    yield from _relaxation(quick).rows(quick)
    yield from (row for match in _overturn() for row in match.rows(quick))


def panels(rows):
    """Return the panel of the figure, see `pictures.draw`: errors against seconds, both codes."""
    series = {}
    for code, i in (("ASPECT 2.5.0", 1), ("this program", 0)):
        for family in ("sinking block", "Rayleigh-Taylor", "relaxing hill", "overturn"):
            of = [
                row.parameters
                for row in rows
                if row.case.startswith(family) and row.metric == "relative error"
            ]
            seconds = [row["seconds"][i] for row in of]
            errors = [abs(row["errors"][i]) for row in of]
            series[f"{family}, {code}"] = (seconds, errors, "")
    title = "the same questions, two codes"
    return [(title, "CPU seconds", "relative error", ("log", "log"), series)]


def _blocks(quick):
    theirs = {
        (row["eta_block"], row["mesh"]): row
        for row in PEERS["sinking_block"]["rows"]
        if row["how"] == "function"
    }
    for (viscosity, mesh), (squares, element) in list(BLOCKS.items())[:: 2 if quick else 1]:
        contrast = float(np.log10(MEDIUM / viscosity))
        exact = float(sinking_block_velocity(contrast))
        fall(*block_section(squares), contrast, element)  # compiles
        begin = time.process_time()
        solved, value = fall(*block_section(squares), contrast, element)
        seconds = time.process_time() - begin
        row = theirs[viscosity, mesh]
        scale = EXCESS * GRAVITY * SIDE**2 / MEDIUM
        yield Match(
            f"sinking block of {viscosity:g} Pa s, beside {mesh} x {mesh} cells",
            (value / exact - 1, -row["v"] / scale / exact - 1),
            (seconds, row["total_s"]),
            (solved.size["unknowns"], row["unknowns"]),
        )


def growth(wavelength, eta2, across, near):
    """Return the `Solved` wave of the paper's appendix A, and the velocity of crest and trough.

    It is half a wave, which mirrors make whole. The contact is a polygon; its wave is as much
    higher as makes its first Fourier coefficient that of the cosine.

    Args:
        wavelength, eta2: m and Pa s, of the lower layer.
        across: cells across the half wave, away from the contact.
        near: edges along the contact, in half waves.
    """
    width, middle, amplitude = wavelength / 2, RAMBERG["h2"], RAMBERG["amplitude"]
    height = RAMBERG["h1"] + middle
    x = np.linspace(0, width, 201)
    higher = amplitude / np.sinc(near / 2) ** 2
    contact = np.column_stack([x, middle + higher * np.cos(np.pi * x / width)])
    top, base = (np.array([[0.0, z], [width, z]]) for z in (height, 0.0))
    section, points = fitted_mesh(top, base, [contact], width / across, near * width)
    below = (points[:, 1] < middle)[section.regions]
    least = min(eta2, RAMBERG["eta1"])

    def viscosity(spaces):
        eta = fem.Function(spaces.D)
        eta.x.array[:] = np.where(below, eta2, RAMBERG["eta1"]) / least
        return eta

    def density(spaces):
        rho = fem.Function(spaces.D)
        rho.x.array[:] = RAMBERG["g"] * np.where(below, RAMBERG["rho2"] - RAMBERG["rho1"], 0.0)
        return rho

    zero = (0.0, 0.0)
    side, plate = Wall("free-slip", (0.0, None), zero), Wall("no-slip", zero, zero)
    walls = {"left": side, "right": side, "base": plate, "surface": plate}
    solved = Solved(section, "P2b-P1dg", viscosity, density, walls, eta0=least)
    index, sampler = CellIndex(section), VelocitySampler(solved.spaces)
    ends = np.array([[0.0, middle + amplitude], [width, middle - amplitude]])
    cell, hats = index.locate(ends, index.guess(ends))
    u = sampler(sampler.coefficients(solved.flow.u), cell, hats)
    solved.problem.release()
    return solved, u[:, 1]


def _waves(quick):
    peer = PEERS["rayleigh_taylor"]
    growth(256e3, 1e20, 2, 0.1)  # compiles
    for wavelength, choice in WAVES.items():
        errors = [
            (1 + error) / (1 + exact) - 1
            for error, exact in zip(
                peer["relative_error"][f"{wavelength / 1e3:g} km"],
                RAMBERG_GREATEST[wavelength],
                strict=True,
            )
        ]
        for eta2, theirs in list(zip(peer["eta2"], errors, strict=True))[:: 2 if quick else 1]:
            begin = time.process_time()
            solved, found = growth(wavelength, eta2, *choice)
            seconds = time.process_time() - begin
            off = found / np.array(RAMBERG_VELOCITY[wavelength, eta2]) - 1
            yield Match(
                f"Rayleigh-Taylor, wave of {wavelength / 1e3:g} km over {eta2:g} Pa s",
                (float(np.abs(off).max()), theirs),
                (seconds, min(peer["total_s"])),
                (solved.size["unknowns"], peer["unknowns"]),
            )


def _relaxation(quick):
    theirs = PEERS["crameri_1"]["rows"][1]
    last = 20 if quick else 100
    marks = np.r_[0, 5, 10, CREST_AT, np.arange(20, last + 1, 10)] * surfaces.KYR
    scene = surfaces.hill(10.0, surfaces.HILL, 6, marks)
    surfaces.course(surfaces.hill(10.0, surfaces.HILL, 6, marks[:2]))  # compiles
    begin = time.process_time()
    ran = surfaces.course(scene)
    seconds = time.process_time() - begin
    at = np.abs(ran.times - CREST_AT * surfaces.KYR).argmin()
    crest = ran.ends[at, 0] - surfaces.MANTLE - surfaces.LID
    return Match(
        f"relaxing hill of 7 km to {last} kyr, its crest at {CREST_AT} kyr",
        (crest / CREST - 1, theirs["crest_m_at_14825_yr"] / CREST - 1),
        (seconds, theirs["total_s"] * last / 100),
        (ran.size["unknowns"], theirs["unknowns"]),
    )


def _overturn():
    """Yield our run on mesh lines beside both of theirs: by a field, and by particles."""

    def ran(last):
        scene = van_keken.scene(
            1,
            cells=12,
            particles=ParticlePlan(1, 1, 0.5, 1),
            mesh=MeshPlan("P2-P1", "fitted"),
            marks=(0.0, last),
            courant=1.0,
            min_steps=max(1, round(last / 10)),
        )
        engine, passed = StokesEngine(scene), []

        def note(_, state):
            passed.append((state.time, state.grid.speeds(state.flow)[0]))

        march(engine.start(), engine, scene.time, every_step=(note,))
        engine.grid.stokes.release()
        return engine, np.array(passed)

    ran(5.0)  # compiles
    begin = time.process_time()
    engine, passed = ran(300.0)
    seconds = time.process_time() - begin
    peak, when = van_keken.peak_of(*passed.T)
    for theirs in PEERS["van_keken"]["rows"]:
        for what, ours, other, exact in (
            ("greatest v_rms", peak, theirs["peak_v_rms"], PEAK),
            ("time of the greatest v_rms", when, theirs["at"], PEAK_AT),
        ):
            yield Match(
                f"overturn of van Keken et al. to t = 300, {what}, beside {theirs['how']}",
                (ours / exact - 1, other / exact - 1),
                (seconds, theirs["total_s"]),
                (engine.grid.spaces.unknowns, PEERS["van_keken"]["unknowns"]),
            )

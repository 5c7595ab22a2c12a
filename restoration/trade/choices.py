"""What can be chosen for a scene: settings by axis, one value each."""

from dataclasses import dataclass, field
from itertools import chain

from restoration.entries import ELEMENTS, PRESETS
from restoration.words import counted

CELLS = (0.5, 0.7, 1.4)  # times as many squares along a side
FINER = 1.7  # that the reference has
STEPS = {"steps 2x longer": 0.5, "steps 4x longer": 0.25, "steps 2x shorter": 2.0}
SCHEMES = ("euler", "midpoint", "rk3", "rk4")
AVERAGES = (
    ("transfer lines", "lines", "lines"),
    ("transfer hat", "hat", "hat"),
    ("transfer linear", "linear", "linear"),
    ("viscosity linear", "projection", "linear"),
    ("transfer cell", "cell", "cell"),
)
HALVED = "{levels: 1}"
MOST_COURANT = 1e3  # that a case takes


@dataclass(frozen=True, eq=False)
class Choice:
    """One value of one kind of setting.

    Attributes:
        axis: ``mesh``, ``element``, ``rock``, ``mean``, ``refine``, ``particles``, ``stepper``,
            ``step``, ``solver`` or ``preset``; several are joined by ``+``.
        name: in words.
        entries: values by entry of the case.
    """

    axis: str
    name: str
    entries: dict = field(default_factory=dict)


def together(*choices):
    """Return several choices as one, its axes in a row; later ones win where they meet."""
    parts = [choice for choice in choices if choice.entries]
    # What averages particles has no use for them where mesh lines carry the rock.
    if any(choice.entries.get("mesh.interfaces") == "fitted" for choice in parts):
        parts = [c for c in parts if not any(name.startswith("transfer") for name in c.entries)]
    entries = dict(chain.from_iterable(choice.entries.items() for choice in parts))
    axes = tuple(dict.fromkeys(axis for choice in parts for axis in choice.axis.split("+")))
    return Choice("+".join(axes), ", ".join(choice.name for choice in parts), entries)


def cells_of(scene, factor, named=None):
    """Return the choice of a mesh with ``factor`` times as many squares along a side."""
    across, up = (max(2, round(n * factor)) for n in scene.cells)
    return Choice("mesh", f"{named or ''}{min(across, up)} cells", {"mesh.cells": [across, up]})


def steps_of(scene, factor, name):
    """Return the choice of ``factor`` times as many steps."""
    plan = scene.time
    courant = min(plan.courant / factor, MOST_COURANT)
    return Choice(
        "step",
        name,
        {
            "time.courant": float(f"{courant:.4g}"),
            "time.min_steps": max(1, round(plan.min_steps * factor)),
        },
    )


def choices_of(scene, quick=False):
    """Return the choices that depart from a scene along one axis each.

    Args:
        scene: `scene.Scene` as given.
        quick: few of them.
    """
    found = [cells_of(scene, factor) for factor in (CELLS[1:] if quick else CELLS)]
    found += _rock(scene, quick)
    found += _particles(scene, quick)
    found += _time(scene, quick)
    if not quick:
        found += [
            Choice("element", name, {"mesh.element": name})
            for name in ELEMENTS
            if name != scene.mesh.element and not (name.startswith("Q") and _triangles_only(scene))
        ]
        found += _solver(scene)
    return found


def _triangles_only(scene):
    """Return whether squares cannot do what the scene asks for."""
    return scene.mesh.interfaces != "particles" or scene.mesh.refine or scene.faults


def _rock(scene, quick):
    """Return how else rock may come to the mesh."""
    if len(scene.rocks) < 2:
        return []
    fitted = Choice("rock", "fitted", {"mesh.interfaces": "fitted"})
    if scene.mesh.interfaces != "particles":
        carried = Choice("rock", "particles", {"mesh.interfaces": "particles"})
        return [carried] if scene.mesh.interfaces == "fitted" else [fitted, carried]
    found = [fitted] + [
        Choice("rock", name, {"transfer.density": density, "transfer.viscosity": viscosity})
        for name, density, viscosity in (AVERAGES[:1] if quick else AVERAGES)
        if (density, viscosity) != (scene.transfer.density, scene.transfer.viscosity)
    ]
    if quick:
        return found
    if not scene.one_viscosity:
        means = {"harmonic", "geometric", "arithmetic"} - {scene.transfer.mean}
        found += [Choice("mean", f"{m} mean", {"transfer.mean": m}) for m in sorted(means)]
    if scene.mesh.refine is None:
        found.append(Choice("refine", "contacts refined once", {"mesh.refine": HALVED}))
    return found


def _particles(scene, quick):
    """Return other numbers of particles."""
    if scene.cloud is not None:
        return []
    now = scene.particles.per_cell
    counts = {max(1, now // 4), 3 * now} if not quick else {3 * now}
    return [
        Choice("particles", f"{counted(count, 'particle')} a cell", {"particles.per_cell": count})
        for count in sorted(counts - {now})
    ]


def _time(scene, quick):
    """Return other steppers and steps."""
    plan = scene.time
    schemes = ("midpoint", "rk4") if quick else SCHEMES
    found = [
        Choice("stepper", name, {"time.scheme": name})
        for name in schemes
        if name != plan.scheme and plan.tolerance is None
    ]
    if plan.tolerance is not None:
        return [
            Choice("step", f"{size:g} m a step", {"time.tolerance": f"{size:g} m"})
            for size in (10 * plan.tolerance, plan.tolerance / 10)
        ]
    steps = list(STEPS.items())
    return found + [steps_of(scene, n, name) for name, n in (steps[:1] if quick else steps)]


def _solver(scene):
    """Return other tolerances of the linear solver; a factorisation has none."""
    plan, options = scene.solver, dict(scene.solver.options)
    at = float(options.get("ksp_rtol", 1e-8))
    tolerances = (at, 1e-10) if plan.name != "fieldsplit" else (1e2 * at, 1e-2 * at)
    return [
        Choice(
            "solver",
            f"field split to {rtol:.0e}".replace("e-0", "e-"),
            {"solver": f"{{name: fieldsplit, options: {{ksp_rtol: {rtol:g}}}}}"},
        )
        for rtol in tolerances
    ]


def presets_of(scene):
    """Return the presets as choices: cells along the shorter side, particles and steps.

    Each comes as it is and, where particles carry the rock, fitted too.
    """
    found = []
    for name, preset in PRESETS.items():
        cells = cells_of(scene, preset["cells"] / min(scene.cells)).entries
        plan = scene.time
        courant = preset["courant"] if plan.courant <= 1 else plan.courant
        entries = {"time.courant": courant, "time.min_steps": preset["min_steps"]}
        if scene.cloud is None:
            entries["particles.per_cell"] = preset["per_cell"]
        found.append(Choice("preset", f"preset {name}", cells | entries))
    if scene.mesh.interfaces == "particles" and len(scene.rocks) > 1:
        fitted = Choice("rock", "fitted", {"mesh.interfaces": "fitted"})
        found += [together(preset, fitted) for preset in found]
    return found


def references_of(scene):
    """Return settings of the reference, the best first; the next where one fails.

    Each is finer than the scene and has half its steps, of another stepper, so that it shares none
    of its errors.
    """
    scheme = "rk4" if scene.time.scheme != "rk4" else "rk3"
    parts = [cells_of(scene, FINER)]
    if scene.time.tolerance is None:
        parts += [
            Choice("stepper", scheme, {"time.scheme": scheme}),
            steps_of(scene, 2.0, "steps 2x shorter"),
        ]
    else:
        parts += _time(scene, False)[-1:]
    ways = [Choice("rock", "fitted", {"mesh.interfaces": "fitted"})]
    if scene.mesh.interfaces == "particles":
        ways.append(Choice("rock", *_lines()))
    else:
        ways.append(Choice("rock", "particles", {"mesh.interfaces": "particles"}))
    return [together(way, *parts) for way in ways] + [together(*parts)]


def _lines():
    """Return name and entries of rock that is read between lines."""
    name, density, viscosity = AVERAGES[0]
    return name, {"transfer.density": density, "transfer.viscosity": viscosity}

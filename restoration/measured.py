"""What the presets gave where they were measured, and what that lets a scene expect.

The measurements are those of `docs/trade.py`: each preset on a case of a kind, its horizons against
those of a finer run. What they say of another scene is a guess by its kind and its height.
"""

import json
from dataclasses import dataclass
from pathlib import Path

from restoration.entries import PRESETS

KEPT = Path(__file__).parents[1] / "docs/trade"
ONE_VISCOSITY = 2.0  # contrast up to which a scene counts as one of one viscosity


@dataclass(frozen=True)
class Expected:
    """What presets may give for a scene.

    Attributes:
        case: name of the case that was measured.
        command: that measured it.
        like: whether the case is of the kind of the scene.
        carried: mean error of the horizons by preset, m, rock as the scene has it come to the mesh.
        fitted: the same with mesh lines on the contacts; empty where the scene has them already.
    """

    case: str
    command: str
    like: bool
    carried: dict[str, float]
    fitted: dict[str, float]


def kind_of(scene):
    """Return what decides what settings give for a scene, as plain values."""
    viscosity = scene.unit_viscosity
    return {
        "height_m": scene.outline.height,
        "free": scene.free,
        "faults": bool(scene.faults),
        "contrast": float(f"{viscosity.max() / viscosity.min():.3g}"),
        "interfaces": scene.mesh.interfaces,
    }


def expected(scene, folder=KEPT):
    """Return what the presets may give for a scene, or None where nothing was measured.

    Args:
        scene: `scene.Scene`.
        folder: of the measurements.
    """
    if scene.dim == 3:  # the fronts are of two dimensions
        return None
    found = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.json"))]
    found = [search for search in found if search["about"]]
    if not found:
        return None
    kind = kind_of(scene)
    search = min(found, key=lambda search: _unlike(kind, search["about"]))
    scale = kind["height_m"] / search["about"]["height_m"]
    # What is below the error of the reference is not known to be better than that.
    least = search["truth_good_to"] or 0.0
    errors = {
        row["label"]: max(row["error"], least)
        for row in search["trials"]
        if row["error"] is not None
    }
    as_it_is = errors if search["about"]["interfaces"] == "particles" else {}
    carried, fitted = {}, {}
    for name in PRESETS:
        plain, lines = f"preset {name}", f"preset {name}, fitted"
        if not as_it_is:
            lines = plain
        if plain in as_it_is:
            carried[name] = scale * errors[plain]
        if lines in errors:
            fitted[name] = scale * errors[lines]
    if kind["interfaces"] != "particles":
        carried, fitted = fitted, {}
    like = _unlike(kind, search["about"]) == 0
    return Expected(search["name"], search["command"], like, carried, fitted)


def _unlike(kind, other):
    """Return in how many ways two kinds of scenes differ, what matters most counted most."""
    contrasts = [entry["contrast"] > ONE_VISCOSITY for entry in (kind, other)]
    return (
        2 * (kind["faults"] != other["faults"])
        + (kind["free"] != other["free"])
        + (contrasts[0] != contrasts[1])
    )

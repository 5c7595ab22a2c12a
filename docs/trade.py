"""The fronts of docs/trade.md: ``.venv/bin/python docs/trade.py [NAME...]``, by default all.

Each is searched by the command that its block of the page begins with, kept in docs/trade/, and its
block written anew. With ``--page`` nothing is searched.
"""

import json
import subprocess
import sys
from pathlib import Path

from pages import asked, write_blocks

from restoration.entries import PRESETS
from restoration.trade.report import cost_text, error_text, table_markdown, table_of
from restoration.trade.trials import Trial

ROOT = Path(__file__).parents[1]
PAGE, KEPT = ROOT / "docs/trade.md", ROOT / "docs/trade"
# Case or benchmark by the name of its files, and overrides that keep the search short.
SUBJECTS = {
    "rayleigh-taylor": ("rayleigh-taylor",),
    "falling-block": ("falling-block",),
    "solcx": ("solcx",),
    "surface-relaxation": ("surface-relaxation",),
    "van-keken": ("van-keken",),
    "diapir-isoviscous": (
        "cases/diapir-isoviscous",
        "mesh.cells=20",
        "time.marks=[0 Myr, 3 Myr]",
        "time.courant=1",
    ),
    "diapir-two-viscosities": (
        "cases/diapir-two-viscosities",
        "mesh.cells=20",
        "time.marks=[0 Myr, 0.6 Myr]",
        "time.courant=1",
    ),
    "graben": (
        "cases/graben",
        "mesh.cells=[24, 8]",
        "time.marks=[0 kyr, 10 kyr]",
        "time.min_steps=3",
    ),
}


def measure(name):
    """Search a case or a benchmark by the command, and keep what it finds."""
    what, *sets = SUBJECTS[name]
    flags = [part for text in sets for part in ("--set", text)]
    command = [sys.executable, "-m", "restoration.cli", "trade", what, *flags, "--out", str(KEPT)]
    subprocess.run(command, check=True, cwd=ROOT, stdout=subprocess.DEVNULL)


def kept(name):
    """Return what a search has found, or None where it was not made yet."""
    path = KEPT / f"{name}.json"
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else None


def block(name):
    """Return what the page says of a search."""
    found = kept(name)
    ahead = [row.pop("front") for row in found["trials"]]
    trials = [Trial(**{**row, "axes": tuple(row["axes"])}) for row in found["trials"]]
    shown = [
        trial
        for trial, best in zip(trials, ahead, strict=True)
        if best or not trial.axes or "preset" in trial.axes
    ]
    seconds = sum(trial.cpu_s or 0 for trial in trials)
    truth = f"Errors ({' / '.join(found['columns'])}) against {found['truth']}"
    if found["truth_good_to"]:
        truth += f", itself good to about {error_text(found['truth_good_to'], found['unit'])}"
    return "\n\n".join(
        [
            f"`{found['command']}`: {len(trials)} trials, {seconds:.0f} CPU s. {truth}.",
            table_markdown(table_of(shown, found["unit"], found["columns"])),
            "\n".join(f"- {advice}" for advice in found["recommendation"]),
            f"![error against cost: {found['title']}](trade/{name}.png)",
        ]
    )


def presets():
    """Return what the page says of the presets: what they set, and what that gave."""
    rows = [("preset", *next(iter(PRESETS.values())))]
    rows += [(name, *map(str, preset.values())) for name, preset in PRESETS.items()]
    gave = [("case", *(f"{name}{way}" for way in ("", ", fitted") for name in PRESETS))]
    for name in SUBJECTS:
        found = kept(name)
        trials = {trial["label"]: trial for trial in found["trials"]} if found else {}
        texts = [gave_text(trials.get(f"preset {column}")) for column in gave[0][1:]]
        if found and found["about"] and found["about"]["interfaces"] != "particles":
            texts = [""] * len(PRESETS) + texts[: len(PRESETS)]  # fitted as it is
        if any(texts):
            gave.append((name, *texts))
    return f"{table_markdown(rows)}\n\n{table_markdown(gave)}"


def gave_text(trial):
    """Return what a preset gave and cost, in words."""
    if trial is None:
        return ""
    if trial["failed"]:
        return trial["failed"]
    return f"{error_text(trial['error'], 'm')}, {cost_text(trial['cpu_s'])}"


def main():
    """Search what is asked for, and write the page."""
    for name in asked("search", SUBJECTS, __doc__):
        measure(name)
    blocks = {name: block(name) for name in SUBJECTS if kept(name)} | {"presets": presets()}
    write_blocks(PAGE, blocks)


if __name__ == "__main__":
    main()

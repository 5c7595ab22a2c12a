"""The map of docs/limits.md: ``.venv/bin/python docs/limits.py [NAME...]``, by default all.

Each benchmark is run by the command that its block of the page begins with, kept in docs/limits/
with its figure, and its block written anew. With ``--page`` nothing is run.
"""

import json
import subprocess
import sys
from pathlib import Path

from pages import asked, write_blocks

from restoration.trade.report import table_markdown

ROOT = Path(__file__).parents[1]
PAGE, KEPT = ROOT / "docs/limits.md", ROOT / "docs/limits"
NAMES = ("contrasts", "extremes", "shapes")


def measure(name):
    """Run a benchmark by the command, and keep what it finds; it may miss a bound."""
    command = [sys.executable, "-m", "restoration.cli", "bench", name, "--out", str(KEPT)]
    subprocess.run(command, check=False, cwd=ROOT, stdout=subprocess.DEVNULL)


def verdict(row):
    """Return what a row says: held to its bound, refused and why, or missed."""
    if "refused" in row["parameters"]:
        return f"refused ({row['value']:.0f}): {row['parameters']['refused']}"
    if row["held"] is None:
        return "not held to a bound"
    return f"{'held to' if row['held'] else '**missed**:'} {row['bound']:g}"


def by_contrast(rows):
    """Return the table of errors: a row for every geometry, a column for every contrast."""
    shown = [row for row in rows if "how" in row["parameters"]]
    shown = [row for row in shown if row["parameters"]["geometry"] != "density ratio"]
    contrasts = sorted({row["parameters"]["contrast"] for row in shown})
    table = [("error / true residual", *(f"{contrast:g}" for contrast in contrasts))]
    keys = dict.fromkeys((row["parameters"]["geometry"], row["parameters"]["how"]) for row in shown)
    for key in keys:
        cells = []
        for contrast in contrasts:
            here = [
                row
                for row in shown
                if (row["parameters"]["geometry"], row["parameters"]["how"]) == key
                and row["parameters"]["contrast"] == contrast
            ]
            text = " / ".join(f"{row['value']:.0e}" for row in here if row["metric"] != "exit code")
            refused = any(row["metric"] == "exit code" for row in here)
            missed = any(row["held"] is False for row in here)
            cells.append("refused" if refused else f"**{text}**" if missed else text)
        table.append((", ".join(key), *cells))
    return table_markdown(table)


def one_by_one(rows):
    """Return the table of the rows, one after another."""
    table = [("what", "number", "against", "verdict")]
    for row in rows:
        number = f"{row['metric']}: {row['value']:.1e}"
        if row["reference"] and row["relative_error"] is not None:
            number += f", off by {row['relative_error']:.0e}"
        number = "" if "refused" in row["parameters"] else number
        table.append((row["case"], number, row["source"], verdict(row).replace("|", "/")))
    return table_markdown(table)


def by_kind(rows):
    """Return the table of the shapes by kind, with a reason of refusal of each."""
    table = [("kind", "solved", "refused", "silent", "worst residual", "rock off", "one reason")]
    for row in rows:
        p = row["parameters"]
        why = p["why"][0].replace("|", "/") if p["why"] else ""
        worst = ["" if p[name] is None else f"{p[name]:.0e}" for name in ("residual", "rock")]
        table.append((row["case"], p["solved"], p["refusals"], p["silent"], *worst, why))
    return table_markdown([tuple(map(str, line)) for line in table])


def block(name):
    """Return what the page says of a benchmark."""
    rows = json.loads((KEPT / f"{name}.json").read_text(encoding="utf-8"))
    held = [row for row in rows if row["held"] is not None]
    missed = sum(not row["held"] for row in held)
    tables = {
        "contrasts": lambda: f"{by_contrast(rows)}\n\n{one_by_one(others(rows))}",
        "extremes": lambda: one_by_one(rows),
        "shapes": lambda: by_kind(rows),
    }
    told = f"{len(rows)} numbers, {len(held)} held to a bound, {missed} missed"
    picture = f"![{name}](limits/{name}.png)"
    return f"`restore bench {name}`: {told}.\n\n{tables[name]()}\n\n{picture}"


def others(rows):
    """Return the rows of contrasts that are in no column: orders, density ratios and refusals."""
    return [
        row
        for row in rows
        if row["parameters"].get("geometry") in (None, "density ratio")
        or row["metric"] == "exit code"
    ]


def main():
    """Run what is asked for, and write the page."""
    for name in asked("benchmark", NAMES, __doc__):
        measure(name)
    write_blocks(PAGE, {name: block(name) for name in NAMES if (KEPT / f"{name}.json").is_file()})


if __name__ == "__main__":
    main()

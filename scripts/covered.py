"""Says what share of lines and branches the tests have run; fails where it is too small.

`make coverage` calls it once the tests have left their data.
"""

import json
import sys
from pathlib import Path

from coverage import Coverage

LEAST = {"lines": 0.92, "branches": 0.85}
WORST = 20  # modules that are listed


def shares(summary):
    """Return the shares of lines and branches of a summary of coverage, and what was missed."""
    lines, branches = summary["num_statements"], summary["num_branches"]
    found = summary["covered_lines"] / max(lines, 1), summary["covered_branches"] / max(branches, 1)
    missed = lines - summary["covered_lines"], branches - summary["covered_branches"]
    return dict(zip(LEAST, found if branches else (found[0], 1.0), strict=True)), missed


def main():
    """Print the modules with the most that was missed, and the shares of all; return 1 if low."""
    measured = Coverage()
    measured.combine()
    measured.save()
    path = Path(measured.config.data_file).with_name("coverage.json")
    measured.json_report(outfile=str(path))
    report = json.loads(path.read_text(encoding="utf-8"))
    rows = [(*shares(file["summary"]), name) for name, file in report["files"].items()]
    rows.sort(key=lambda row: -sum(row[1]))
    print(f"{'lines':>7}{'branches':>10}{'missed':>12}  module")
    for share, missed, name in rows[:WORST]:
        told = f"{missed[0]} + {missed[1]}"
        print(f"{share['lines']:>7.1%}{share['branches']:>10.1%}{told:>12}  {name}")
    share, _ = shares(report["totals"])
    low = [name for name in LEAST if share[name] < LEAST[name]]
    told = ", ".join(f"{name} {share[name]:.1%} (at least {LEAST[name]:.0%})" for name in LEAST)
    print(f"covered: {told}{': too few' if low else ''}")
    return int(bool(low))


if __name__ == "__main__":
    sys.exit(main())

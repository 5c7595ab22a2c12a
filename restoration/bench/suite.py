"""The benchmarks by name: run them, tell them, keep them."""

import json
from pathlib import Path

from restoration.bench import (
    advection,
    certificate,
    contrasts,
    extremes,
    graben,
    gravity,
    paper,
    peers,
    pictures,
    reliefs,
    rest,
    reverse_surface,
    shapes,
    solutions,
    solving,
    surfaces,
    two_interface,
    van_keken,
)
from restoration.errors import CaseError
from restoration.words import hint, listed
from restoration.writing import disk_faults, write_text

BENCHMARKS = {
    "rayleigh-taylor": gravity.run_rayleigh_taylor,
    "falling-block": gravity.run_falling_block,
    "rotation": advection.run_rotation,
    "single-vortex": advection.run_single_vortex,
    "solcx": solutions.run_solcx,
    "solkz": solutions.run_solkz,
    "solvi": solutions.run_solvi,
    "van-keken": van_keken.run_van_keken,
    "hydrostatic": rest.run_hydrostatic,
    "solvers": solving.run_solvers,
    "adaption": solving.run_adaption,
    "contrasts": contrasts.run_contrasts,
    "extremes": extremes.run_extremes,
    "shapes": shapes.run_shapes,
    "surface-relaxation": surfaces.run_surface_relaxation,
    "sloshing": surfaces.run_sloshing,
    "crameri-2": surfaces.run_crameri_2,
    "advective-volume": reliefs.run_advective_volume,
    "topography-rest": reliefs.run_topography_rest,
    "dynamic-topography": reliefs.run_dynamic_topography,
    "two-interface": two_interface.run_two_interface,
    "reverse-surface": reverse_surface.run_reverse_surface,
    "graben": graben.run_graben,
    "certificate": certificate.run_certificate,
    "paper": paper.run_paper,
    "peers": peers.run_peers,
}


def chosen(names):
    """Return the names of the benchmarks to run, all where none is given.

    Raises:
        CaseError: a name is not known.
    """
    for name in names:
        if name not in BENCHMARKS:
            raise CaseError(f"there is no benchmark '{name}'{hint(name, BENCHMARKS)}")
    return list(dict.fromkeys(names)) or list(BENCHMARKS)


def run_benchmarks(names, quick=False, folder=None, tell=None):
    """Run benchmarks and return their rows.

    Args:
        names: of the benchmarks.
        quick: coarser and fewer.
        folder: where ``<name>.json`` and ``<name>.png`` are written; None writes nothing.
        tell: function of a text, called with a line for every row and at every beginning.
    """
    tell = tell or (lambda text: None)
    if folder is not None:
        with disk_faults(folder):
            Path(folder).mkdir(parents=True, exist_ok=True)
    rows = []
    for name in names:
        run = BENCHMARKS[name]
        tell(f"\n{name}: {run.__doc__.splitlines()[0]}")
        found = []
        for row in run(quick):
            found.append(row)
            tell(line(row))
        if folder is not None:
            keep(found, name, Path(folder))
        rows += found
    return rows


def keep(rows, name, folder):
    """Write the rows of a benchmark and its figure.

    Raises:
        OutputError: they cannot be written.
    """
    plain = [row.plain() for row in rows]
    text = ",\n".join(json.dumps(row, allow_nan=False) for row in plain)
    write_text(folder / f"{name}.json", f"[\n{text}\n]\n")
    pictures.draw(name, rows, folder / f"{name}.png")


def line(row):
    """Return a row as a line of text."""
    parts = [f"  {row.case}: {row.metric} {row.value:.6g}"]
    if row.reference is not None and row.relative_error is not None:
        parts.append(f"(reference {row.reference:.6g}, {row.relative_error:+.2e})")
    if row.held is not None:
        parts.append(f"held to {row.bound:g}" if row.held else f"MISSED: held to {row.bound:g}")
    if "refused" in row.parameters:
        parts.append(row.parameters["refused"])
    if row.unknowns:
        parts.append(f"{row.unknowns} unknowns")
    if row.wall_s:
        parts.append(f"{row.wall_s:.2f} s")
    return ", ".join([parts[0], *parts[1:]])


def verdict(rows):
    """Return the last line: how many numbers were held to a bound, and which missed theirs."""
    held = [row for row in rows if row.held is not None]
    missed = [row for row in held if not row.held]
    text = f"{len(rows)} numbers, {len(held)} held to a bound, {len(missed)} missed"
    names = [f"{row.name}, {row.case}, {row.metric}" for row in missed]
    return f"{text}: {listed(names, last='and')}" if missed else text

"""The runs of a sweep before any is made: their cases read, their folders named."""

import json
import re
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path

from restoration.case import in_order
from restoration.errors import CaseError
from restoration.resolve import load
from restoration.run_folder import Job
from restoration.sweep.file import Variation, assignment
from restoration.words import quoted

LONGEST = 60  # characters of a label
# Of a run, about: measured by docs/scaling.py for direct solves, and what any run loads.
PER_UNKNOWN_MB, PER_PARTICLE_MB, BASE_MB = 6e-3, 2e-4, 300
UNKNOWNS_PER_CELL = {2: 4.5, 3: 5.0}
CELLS_PER_SQUARE = {2: 4, 3: 12}


@dataclass(frozen=True, eq=False)
class Run:
    """A run of a sweep.

    Attributes:
        number: in the order of the sweep file, from 1.
        variation: `file.Variation`.
        sets: overrides, texts ``a.b=value``.
        sha256: of its resolved case; None where that is refused.
        memory_mb: about what it will take; 0 where it is refused.
        faults: why its case is refused, a tuple of `errors.Fault`.
    """

    number: int
    variation: Variation
    sets: tuple
    sha256: str | None = None
    memory_mb: float = 0.0
    faults: tuple = ()

    @property
    def folder(self):
        """Name of its run folder: what it is, and the hash of its case; None where refused."""
        if self.sha256 is None:
            return None
        return f"{self.label}-{self.sha256[:8]}"

    @property
    def label(self):
        """Its name, or its values, as part of a file name."""
        text = self.variation.name or "_".join(map(written, self.variation.entries.values()))
        return re.sub(r"[^A-Za-z0-9.+_]+", "-", text)[:LONGEST].strip("-.") or str(self.number)


def written(value):
    """Return a value of an entry as a table shows it."""
    return value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)


def planned(sweep, sets=(), allow_outside=False):
    """Read the case of every variation, and return the runs.

    Args:
        sweep: `file.Sweep`.
        sets: overrides of all runs, texts ``a.b=value``.
        allow_outside: whether cases may name files outside their folder.

    Returns:
        The runs, a list of `Run`, of which some may be refused; and notes, a list of texts.

    Raises:
        CaseError: all variations are refused, or an override is of what is varied.
    """
    for text in sets:
        name = text.partition("=")[0].strip()
        if name in sweep.entries:
            raise CaseError(f"--set {name}: is varied by {sweep.path}; change it there")
    shared = (*(assignment(*item) for item in sweep.shared.items()), *sets)
    runs, notes, first = [], [], {}
    for number, variation in enumerate(sweep.variations, start=1):
        own = tuple(assignment(*item) for item in variation.entries.items())
        run = _read(sweep, Run(number, variation, (*shared, *own)), allow_outside)
        same = first.setdefault(run.sha256, run) if run.sha256 else run
        if same is not run:
            notes.append(f"run {number} is run {same.number} again and left out")
            continue
        runs.append(run)
    if all(run.faults for run in runs):
        raise CaseError(in_order([fault for run in runs for fault in run.faults]))
    return runs, notes


def _read(sweep, run, allow_outside):
    """Return a run whose case has been read, or refused."""
    try:
        loaded = load(sweep.case, run.sets, allow_outside)
    except CaseError as error:
        faults = tuple(_placed(fault, sweep, run.variation) for fault in error.faults)
        return replace(run, faults=faults)
    job = Job(sweep.case, loaded.text, loaded.resolved, loaded.scene)
    return replace(run, sha256=job.sha256, memory_mb=memory_mb(loaded.scene))


def _placed(fault, sweep, variation):
    """Return a fault of an override at the place in the sweep file where that stands."""
    places = {name: ("set", name) for name in sweep.shared} | variation.places
    for name, path in places.items():
        if fault.file == f"--set {quoted(name)[1:-1]}":
            found = sweep.tree.fault(path, fault.message)
            return replace(found, entry=fault.entry or name)
    return fault


def memory_mb(scene):
    """Return about what a run of a scene takes at most, MB."""
    cells = CELLS_PER_SQUARE[scene.dim] * prod(scene.cells)
    unknowns, particles = UNKNOWNS_PER_CELL[scene.dim] * cells, scene.particles.per_cell * cells
    return BASE_MB + PER_UNKNOWN_MB * unknowns + PER_PARTICLE_MB * particles


def folders_of_others(out, runs):
    """Return the names of run folders in the folder of a sweep that are of none of its runs."""
    known = {run.folder for run in runs}
    found = (path.parent.name for path in Path(out).glob("*/resolved.yaml"))
    return sorted(name for name in found if name not in known)

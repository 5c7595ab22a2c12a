"""A run of many small steps in a process of its own, which tells its memory and open files.

    python -m tests.long_runs KIND STEPS FOLDER

prints JSON: resident memory, MB, and number of open files after every step, and the meshes made.
"""

import json
import os
import sys
from pathlib import Path

from restoration.cli import main
from restoration.recorder import Recorder

CASE = """\
section:
  box: {width: 10 km, height: 4 km}
  layers:
    - {rock: salt, top: {depth: 3 km, cosine: {amplitude: 0.3 km, wavelength: 20 km}}}
    - {rock: sediment}
rocks:
  salt: {density: 2150 kg/m^3, viscosity: 1e19 Pa s}
  sediment: {density: 2600 kg/m^3, viscosity: 2e19 Pa s}
particles: {per_cell: 4, densify: 2}
certificate: off
"""
TIME = "time: {{marks: [0 Myr, {end} Myr, 0 Myr], scheme: midpoint, min_steps: {steps}}}\n"
# Further entries of each kind, and how far it goes, Myr.
KINDS = {
    "particles": ("mesh: {cells: 6}\n", 2),
    "fitted": ("mesh: {cells: 6, interfaces: fitted}\n", 2),
    "refined": ("mesh: {cells: 6, refine: {levels: 1}}\n", 2),  # a new mesh for every step
    "free": ("mesh: {cells: 6}\nboundary: {surface: free}\n", 0.2),
}


def resident_mb():
    """Return the memory of this process that is resident, MB."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("VmRSS")) / 1024


def run(kind, steps, folder):
    """Run a kind for so many steps, and return what is told of it."""
    more, end = KINDS[kind]
    (folder / "case.yaml").write_text(CASE + more + TIME.format(end=end, steps=steps // 2))
    told = {"rss_mb": [], "files": []}
    step = Recorder.step

    def noted(self, before, state):
        step(self, before, state)
        told["rss_mb"].append(resident_mb())
        told["files"].append(len(os.listdir("/proc/self/fd")))

    Recorder.step = noted
    code = main(["run", str(folder / "case.yaml"), "--quiet", "--out", str(folder / "run")])
    record = json.loads((folder / "run/run.json").read_text())
    log = (folder / "run/log.txt").stat().st_size
    return told | {"code": code, "log_bytes": log, "record": record}


if __name__ == "__main__":
    kind, steps, folder = sys.argv[1:]
    streams = os.dup(1)
    os.dup2(2, 1)  # what a run prints is no part of the answer
    answer = run(kind, int(steps), Path(folder))
    os.write(streams, json.dumps(answer).encode())

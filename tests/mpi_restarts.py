"""Runs small cases on any number of ranks, stopped after a step or gone on with; prints the end.

Arguments: a folder for the runs, and the step after which they are stopped, 0 for never.
"""

import hashlib
import json
import os
import signal
import sys
from pathlib import Path

from restoration import recorder
from restoration.environment import use_jit_cache
from restoration.errors import StoppedError
from restoration.ranks import world
from restoration.run import run_job
from restoration.run_folder import Job
from restoration.saved import read_particles
from tests.mpi_runs import AWAY, SCENES

NAMES = "free surface", "fitted"


def stopped_after(step):
    """Let the last rank alone be asked to stop after a step."""
    made = recorder.Recorder.step

    def asked(self, before, state):
        made(self, before, state)
        if self.steps == step and self.ranks.rank == self.ranks.size - 1:
            os.kill(os.getpid(), signal.SIGUSR1)

    recorder.Recorder.step = asked


def main(folder, step):
    """Run all, and print for each exit code, where the particles are, and a digest of that."""
    use_jit_cache()
    if step:
        stopped_after(step)
    found = {}
    for name in NAMES:
        scene, code = SCENES[name](), 0
        out = Path(folder) / name.replace(" ", "-")
        job = Job(Path("x/case.yaml"), "title: x\n", f"name: {name}\n", scene, out, checkpoint=1)
        try:
            run_job(job)
        except StoppedError as error:
            code = error.exit_code
        if world().first:
            x = read_particles(out / "particles.h5").x
            rows = (out / "diagnostics.csv").read_text().splitlines()[1:]
            found[name] = {
                "code": code,
                "x": (x + AWAY).ravel().tolist(),
                "digest": hashlib.sha256(x.tobytes()).hexdigest(),
                "steps": len(rows),
            }
    if world().first:
        print(json.dumps(found))


if __name__ == "__main__":
    for name in ("draw_section", "draw_strip", "draw_there_and_back"):
        setattr(recorder, name, lambda *_, **__: None)  # take longer than the runs
    main(sys.argv[1], int(sys.argv[2]))

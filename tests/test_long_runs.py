"""R20: runs of many steps keep their memory, their open files and their log within bounds."""

import gc
import json
import os
import subprocess
import sys
import weakref
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from restoration.engine import StokesEngine
from restoration.resolve import load
from tests.long_runs import CASE, KINDS, TIME
from tests.torture import tries

ROOT = Path(__file__).parents[1]
GROWTH = 0.05  # of the resident memory, from a tenth of the steps on
LINE = 120  # bytes of the log for a step
SETTLED = 0.1  # share of the steps until all is loaded that a run needs


@pytest.mark.slow
@pytest.mark.torture
@pytest.mark.parametrize("kind", KINDS)
def test_a_long_run_stays_within_bounds(kind, tmp_path):
    steps = tries(200, 2000)
    done = subprocess.run(
        [sys.executable, "-m", "tests.long_runs", kind, str(steps), str(tmp_path)],
        cwd=ROOT,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["code"] == 0, done.stderr
    assert told["record"]["steps"] >= steps
    assert told["record"]["meshes"] >= (steps if kind == "refined" else 1)
    memory, files = np.array(told["rss_mb"]), told["files"]
    settled = int(SETTLED * steps)
    assert memory[settled:].max() < (1 + GROWTH) * memory[settled]
    assert len(set(files[1:])) == 1
    assert told["log_bytes"] < 2000 + LINE * told["record"]["steps"]


@pytest.mark.parametrize("kind", ["fitted", "refined", "free"])
def test_an_old_mesh_is_freed_at_once(kind, tmp_path):
    """Not when the collector finds a ring, by which time many lie about in pieces."""
    more, end = KINDS[kind]
    (tmp_path / "case.yaml").write_text(CASE + more + TIME.format(end=end, steps=4))
    engine = StokesEngine(load(tmp_path / "case.yaml").scene)
    state = engine.with_flow(engine.start())
    old = {
        name: weakref.ref(getattr(engine.grid, name))
        for name in ("spaces", "fields", "stokes", "sampler", "section")
    }
    old |= {"grid": weakref.ref(engine.grid), "mesh": weakref.ref(engine.grid.section.mesh)}
    gc.collect()
    gc.disable()
    try:
        section, points = engine.mesher.mesh(state.lines)
        engine._take(section, state.lines, engine._units(points))
        particles = engine._nowhere(state.particles)
        state = engine.with_flow(replace(state, particles=particles, flow=None, grid=None))
        alive = [name for name, ref in old.items() if ref() is not None]
    finally:
        gc.enable()
    assert alive == []

"""Three dimensions on two ranks: the same run."""

import json

import h5py
import numpy as np
import pytest

from restoration.cli import main

CASE = """
section:
  box: {width: 4 km, length: 3 km, height: 2 km}
  layers:
    - rock: salt
      top: {depth: 1.4 km, cosine: {amplitude: 0.2 km, wavelength: 8 km, wavelength_y: 6 km}}
    - {rock: sediment}
rocks:
  salt: {density: 2150 kg/m^3, viscosity: 1e18 Pa s}
  sediment: {density: 2600 kg/m^3, viscosity: 1e19 Pa s}
mesh: {cells: 3}
time: {marks: [0 Ma, 0.2 Ma], min_steps: 3}
"""


@pytest.mark.slow
def test_two_ranks_make_the_run_of_one(tmp_path):
    (tmp_path / "case.yaml").write_text(CASE, encoding="utf-8")
    ends = []
    for ranks in ("1", "2"):
        folder = tmp_path / f"ranks-{ranks}"
        command = ["run", str(tmp_path / "case.yaml"), "--quiet", "--out", str(folder)]
        assert main([*command, "--ranks", ranks]) == 0
        assert json.loads((folder / "run.json").read_text())["ranks"] == int(ranks)
        with h5py.File(folder / "particles.h5") as h5:
            ends.append(h5["frames"][max(h5["frames"])]["points"][()])
    one, two = ends
    assert np.linalg.norm(one - two, axis=1).max() < 1e-6

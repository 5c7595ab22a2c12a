"""A case that runs in a few seconds, as a file."""

CASE = """\
title: small
section:
  box: {width: 9 km, height: 10 km}
  layers:
    - {rock: salt, top: {depth: 8 km, cosine: {amplitude: 0.2 km, wavelength: 18 km}}}
    - {rock: sediment}
rocks:
  salt: {density: 2150 kg/m^3, viscosity: 1e19 Pa s}
  sediment: {density: 2600 kg/m^3, viscosity: 1e20 Pa s}
mesh: {cells: 9}
time: {marks: [0 Myr, 0.2 Myr], scheme: midpoint, min_steps: 2}
output: {at: 1}
certificate: off
"""


def small_case(folder):
    """Write the case into a folder, and return its path."""
    path = folder / "case.yaml"
    path.write_text(CASE)
    return path

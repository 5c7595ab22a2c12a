"""What a scene requires of an engine, and how large the problem is; solves nothing."""

from restoration.advection import FROZEN
from restoration.units import show


def unknowns(cells):
    """Return triangles and unknowns of P2/P1 on crossed squares.

    Args:
        cells: columns and rows of squares.
    """
    across, up = cells
    triangles = 4 * across * up
    vertices = (across + 1) * (up + 1) + across * up
    edges = vertices + triangles - 1  # Euler's formula for a disc
    return triangles, 2 * (vertices + edges) + vertices


def active(scene):
    """Return what the scene requires, and nothing else, with the reason for each."""
    parts = ["plane strain Stokes flow on P2/P1 triangles, solved directly"]
    if scene.one_viscosity:
        parts.append("one factorisation for the whole run: one viscosity, a mesh that stands still")
    else:
        parts.append("a factorisation for every solve: the viscosity moves with the rock")
    if scene.closed:
        parts.append("the level of the pressure is set at the surface: no wall is left to itself")
    else:
        parts.append("the level of the pressure comes from the wall that is left to itself")
    if len(scene.rocks) == 1:
        parts.append("one rock: only the walls can move it")
    if scene.gravity == 0:
        parts.append("no gravity")
    frozen = scene.time.scheme in FROZEN
    parts.append(
        f"steps by {scene.time.scheme}, "
        + ("one flow for each step" if frozen else "Stokes solved at every stage")
    )
    if not scene.sealed:
        parts.append("particles born where rock flows in; rock that flows out does not come back")
    parts.append(
        f"density by {scene.transfer.density}, viscosity by {scene.transfer.viscosity} "
        f"({scene.transfer.mean} mean)"
    )
    return parts


def counts_back(scene):
    """Return whether model times are ages: the marks are today and before."""
    return max(scene.time.marks) <= 0


def time_label(scene, time):
    """Return a model time for a line of text: an age where the marks count back from today.

    Args:
        scene: whose marks tell which.
        time: model time, s.
    """
    return show(-time if time else 0.0, "age") if counts_back(scene) else show(time, "time")

"""From the walls of a case to those of a scene, and what walls cannot do together."""

from restoration.scene import Wall, normal_axis, normal_velocity
from restoration.units import YEAR


def wall_of(name, entry):
    """Return a wall of the scene."""
    zero = (0.0, 0.0)
    if entry.kind == "no-slip":
        return Wall("no-slip", zero, zero)
    if entry.kind == "free-slip":
        held = [None, None]
        held[normal_axis(name, 2)] = 0.0
        return Wall("free-slip", tuple(held), zero)
    values = tuple(None if value is None else value.si for value in entry.values)
    if entry.kind == "velocity":
        return Wall("velocity", values, zero)
    return Wall("traction", (None, None), values)


def loose(walls):
    """Return messages about motions that no wall holds, for which Stokes has no single answer."""
    messages = []
    for axis, way in enumerate(("sideways", "up or down")):
        if all(wall.velocity[axis] is None for wall in walls.values()):
            messages.append(
                f"no wall holds the section from moving {way}; make one no-slip or free-slip"
            )
    turning = any(
        wall.velocity[normal_axis(name, 2)] is not None or None not in wall.velocity
        for name, wall in walls.items()
    )
    if not turning and not messages:
        messages.append("no wall holds the section from turning; make one no-slip or free-slip")
    return messages


def unbalanced(walls, outline):
    """Return the message about a closed section whose walls let more in than out."""
    if any(normal_velocity(name, wall, outline) is None for name, wall in walls.items()):
        return []
    flux = {}
    for name, line, sign in (("surface", outline.surface, 1), ("base", outline.base, -1)):
        u, w = (value or 0.0 for value in walls[name].velocity)
        run, rise = line[-1] - line[0]
        flux[name] = 0.0 if walls[name].kind == "free-slip" else sign * (w * run - u * rise)
    for name, end, sign in (("left", 0, -1), ("right", -1, 1)):
        side = outline.surface[end, 1] - outline.base[end, 1]
        flux[name] = sign * walls[name].velocity[0] * side
    net, gross = sum(flux.values()), sum(map(abs, flux.values()))
    if abs(net) <= 1e-6 * gross:
        return []
    return [
        f"the walls let {abs(net) * YEAR:.3g} m^2/yr more {'out' if net > 0 else 'in'} than "
        f"{'in' if net > 0 else 'out'}, and rock keeps its volume; balance them, or leave one wall "
        "to itself, such as surface: {traction: [0 MPa, 0 MPa]}"
    ]

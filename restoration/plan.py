"""What a scene requires of an engine, and how large the problem is; solves nothing."""

from restoration.advection import SCHEMES
from restoration.scene import Table
from restoration.units import show

# Unknowns from which `auto` takes the field split, by dimensions. See docs/benchmarks.md.
FIELDSPLIT_FROM = {2: 500_000, 3: 20_000}


def unknowns(cells, element="P2-P1"):
    """Return cells and unknowns of a mesh of squares, crossed into triangles for most elements.

    Args:
        cells: columns and rows of squares; or cubes along x, y and z.
        element: name of the pair of elements.
    """
    if len(cells) == 3:
        return _box_unknowns(cells, element)
    across, up = cells
    squares = across * up
    if element.startswith("Q"):
        vertices, count = (across + 1) * (up + 1), squares
    else:
        vertices, count = (across + 1) * (up + 1) + squares, 4 * squares
    edges = vertices + count - 1  # Euler's formula for a disc
    if element == "P2-P1dg":  # on triangles that are split in three
        vertices, edges, count = vertices + count, edges + 3 * count, 3 * count
    nodes = vertices + edges
    velocity, pressure = {
        "P2-P1": (nodes, vertices),
        "P2b-P1dg": (nodes + count, 3 * count),
        "P2-P1dg": (nodes, 3 * count),
        "MINI": (vertices + count, vertices),
        "Q2-Q1": (nodes + count, vertices),
        "Q2-P1dg": (nodes + count, 3 * count),
    }[element]
    return count, 2 * velocity + pressure


def _box_unknowns(cells, element):
    """Return cells and unknowns of a box of cubes, see `meshes.body_centred`."""
    x, y, z = cells
    cubes, outside = x * y * z, 2 * (x * y + y * z + z * x)
    count = 12 * cubes + 2 * outside
    vertices = (x + 1) * (y + 1) * (z + 1) + cubes + outside
    faces = 2 * count + 2 * outside  # inner ones have two cells
    edges = vertices + faces - count - 1  # Euler's formula for a ball
    nodes = vertices + edges
    if element == "P2b-P1dg":
        return count, 3 * (nodes + faces + count) + 4 * count
    return count, 3 * nodes + vertices


def active(scene):
    """Return what the scene requires, and nothing else, with the reason for each."""
    plan = scene.mesh
    kind = "plane strain" if scene.dim == 2 else "three-dimensional"
    parts = [f"{kind} Stokes flow on {plan.element} elements", _solver(scene), _mesh(scene)]
    fitted = plan.interfaces != "particles"
    if scene.one_viscosity and plan.refine is None and not fitted and not scene.free:
        parts.append("one factorisation for the whole run: one viscosity, a mesh that stands still")
    elif scene.one_viscosity and not fitted and not scene.free:
        parts.append("a factorisation for every mesh: one viscosity")
    elif fitted or scene.one_viscosity:
        parts.append(
            "the last factorisation as preconditioner of the next solves, as long as that costs "
            "less than a new one: the mesh moves with the rock"
        )
    else:
        parts.append("a factorisation for every new moment: the viscosity moves with the rock")
    if scene.closed:
        parts.append("the level of the pressure is set at the surface: no wall is left to itself")
    else:
        parts.append("the level of the pressure comes from the wall that is left to itself")
    if _tables(scene):
        parts.append("walls that vary: their values are set anew for every flow")
    if len(scene.rocks) == 1:
        relief = " and the relief of the surface" if scene.free else ""
        parts.append(f"one rock: only the walls{relief} can move it")
    if scene.gravity == 0:
        parts.append("no gravity")
    frozen = SCHEMES[scene.time.scheme].frozen
    parts.append(
        f"steps by {scene.time.scheme}, "
        + ("one flow for each step" if frozen else "Stokes solved at every stage")
    )
    if scene.particles.velocity == "plain":
        parts.append("particles in the velocity of the elements, free of divergence on average")
    else:
        parts.append("particles in a velocity that is free of divergence at every point")
    parts += _surface(scene)
    if not scene.sealed:
        parts.append("rock leaves through open walls, and flows in as the column that stands there")
    if plan.interfaces == "particles":
        parts.append(
            f"density by {scene.transfer.density}, viscosity by {scene.transfer.viscosity} "
            f"({scene.transfer.mean} mean)"
        )
        if "lines" in (scene.transfer.density, scene.transfer.viscosity):
            parts.append("rock by lines: exact between the horizons, and particles where they end")
    return parts


def _tables(scene):
    """Return whether a wall is held or pushed by a table."""
    walls = scene.walls.values()
    return any(isinstance(v, Table) for wall in walls for v in (*wall.velocity, *wall.traction))


def _surface(scene):
    """Return how a free surface is carried, in words."""
    plan, parts = scene.surface, []
    if not scene.free:
        return parts
    parts.append("a free surface: a line of its own that the mesh follows")
    if plan.air:
        parts.append(f"air {show(plan.air.thickness, 'length')} thick above it is solved for")
    if plan.theta:
        parts.append(f"its weight when moved counts in the flow, theta {plan.theta:g}")
    if min(scene.time.marks[1:]) < max(scene.time.marks[:-1]):
        ways = {
            "auto": "backward, its modes that relax fast are slaved where they could not return",
            "integrate": "backward, it is integrated as it is",
            "slave": "backward, its modes that relax fast are slaved to the rock below",
            "stabilise": "backward, its weight counts with the sign of a forward step",
        }
        parts.append(ways[plan.reverse])
    return parts


def _solver(scene):
    """Return how the matrix is solved, in words."""
    given = "".join(f", {name}: {value}" for name, value in scene.solver.options)
    names = {
        "auto": "solved directly: two dimensions" if scene.dim == 2 else _solver_of_box(scene),
        "direct": "solved directly",
        "fieldsplit": "solved by FGMRES, velocity and pressure split",
    }
    return names[scene.solver.name] + given


def solved_directly(scene):
    """Return whether a box is solved by a factorisation."""
    if scene.solver.name != "auto":
        return scene.solver.name == "direct"
    return unknowns(scene.cells, scene.mesh.element)[1] < FIELDSPLIT_FROM[3]


def _solver_of_box(scene):
    """Return which solver the size of a box takes, in words."""
    if solved_directly(scene):
        return f"solved directly: below {FIELDSPLIT_FROM[3]} unknowns"
    return "solved by FGMRES, velocity and pressure split: three dimensions"


def _mesh(scene):
    """Return what the mesh does, in words."""
    plan, refine = scene.mesh, scene.mesh.refine
    if plan.interfaces != "particles":
        text = "mesh lines follow the rock, nothing is averaged"
        if plan.interfaces == "auto":
            text += "; where no mesh can, particles go on by themselves"
        return text + (f"; up to 2^{refine.levels} times finer there" if refine else "")
    if refine is None:
        moves = "moves with the surface" if scene.free else "stands still"
        return f"a mesh that {moves}; particles carry the rock"
    often = "every step" if refine.every == 1 else f"every {refine.every} steps"
    at = " and ".join(refine.where)
    return f"cells halved up to {refine.levels} times at {at}, {often}; particles carry the rock"


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

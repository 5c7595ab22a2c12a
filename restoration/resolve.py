"""From a case to a scene: names become rows, quantities become SI, a section becomes shapes."""

import hashlib
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from restoration.case import (
    FILE_ENTRIES,
    Case,
    Entry,
    Layer,
    Particles,
    Time,
    WallEntry,
    is_age,
    read_case,
)
from restoration.errors import CaseError
from restoration.files import inside
from restoration.palette import unit_colors
from restoration.scene import (
    NORMAL,
    WALLS,
    Cloud,
    Line,
    Outline,
    OutputPlan,
    ParticlePlan,
    Rock,
    Scene,
    TimePlan,
    Transfer,
    Unit,
    Wall,
)
from restoration.units import YEAR, Quantity, show
from restoration.words import hint, listed

SCALES = {"m": 1.0, "km": 1e3}
SIGNS = {"up": 1.0, "down": -1.0}
HORIZON_POINTS = 401
WAVE_POINTS = 40  # of a horizon, in one wave
MOST_POINTS = 8000
MOST_CELLS = 1_000_000  # triangles; about 4.5 unknowns and 20 kB of memory each
MOST_PARTICLES = 20_000_000


@dataclass(frozen=True, eq=False)
class Loaded:
    """A case file, read.

    Attributes:
        case: the entries.
        scene: what they mean, in SI.
        text: the file as given.
        resolved: the case with every default written out, as YAML; hashes what decides the run.
    """

    case: Case
    scene: Scene
    text: str
    resolved: str


@dataclass(frozen=True, eq=False)
class _Shape:
    """Where the rock is, from whichever source."""

    outline: Outline
    names: tuple[str, ...]
    rocks: tuple[str, ...]  # name of the rock of every unit
    unit_at: object
    lines: tuple[Line, ...]
    notes: tuple[str, ...] = ()
    cloud: Cloud | None = None


def load(path, overrides=(), allow_outside=False):
    """Read a case file and resolve it.

    Args:
        path: the case file.
        overrides: ``a.b=value`` texts.
        allow_outside: whether it may name files outside its own folder.

    Returns:
        `Loaded`.

    Raises:
        CaseError: with all faults that can be told at once.
    """
    path = Path(path)
    case, text, tree = read_case(path, overrides)
    source, digest = _source(case, path, tree, allow_outside)
    shape = _from_layers(case, tree) if source is None else _from_file(case, source, tree)
    walls = {name: _wall(name, getattr(case.boundary, name)) for name in WALLS}
    faults = [tree.fault(("boundary",), text) for text in _loose(walls) + _unbalanced(walls, shape)]
    cells = _cells(case, shape.outline)
    faults += _too_large(case, cells, tree)
    if faults:
        raise CaseError(faults)
    used = [name for name in case.rocks if name in shape.rocks]
    unused = [name for name in case.rocks if name not in shape.rocks]
    notes = list(shape.notes)
    if unused:
        notes.append(f"rocks not in the section: {listed(unused, last='and')}")
    colors = unit_colors(
        used, [used.index(rock) for rock in shape.rocks], [case.rocks[name].color for name in used]
    )
    scene = Scene(
        title=case.title or _title(path),
        outline=shape.outline,
        rocks=tuple(
            Rock(name, case.rocks[name].density.si, case.rocks[name].viscosity.si, color)
            for name, color in zip(used, colors[0], strict=True)
        ),
        units=tuple(
            Unit(name, used.index(rock), color)
            for name, rock, color in zip(shape.names, shape.rocks, colors[1], strict=True)
        ),
        unit_at=shape.unit_at,
        lines=shape.lines,
        walls=walls,
        gravity=case.gravity.si,
        cells=cells,
        particles=ParticlePlan(
            case.preset("particles", "per_cell"),
            case.particles.densify,
            float(case.particles.jitter),
            case.particles.seed,
        ),
        transfer=Transfer(case.transfer.density, case.transfer.viscosity, case.transfer.mean),
        time=TimePlan(
            tuple(0.0 - mark.si if is_age(mark) else mark.si for mark in case.time.marks),
            case.time.scheme,
            float(case.preset("time", "courant")),
            case.preset("time", "min_steps"),
        ),
        output=OutputPlan(
            case.output.at,
            tuple(case.output.fields),
            case.output.particles,
            case.output.arrows,
            float(case.output.exaggeration),
        ),
        cloud=shape.cloud,
        notes=tuple(notes),
    )
    return Loaded(case, scene, text, resolved_yaml(case, scene, digest))


def load_scene(path, overrides=(), allow_outside=False):
    """Return the case and the scene of a file; arguments and errors as `load`."""
    loaded = load(path, overrides, allow_outside)
    return loaded.case, loaded.scene


def _title(path):
    """Return the title of a case without one: the name of its folder or its file."""
    return path.absolute().parent.name if path.stem == "case" else path.stem


def resolved_yaml(case, scene, digest=None):
    """Return the case with every default written out, as YAML that is a case again.

    Args:
        case: the entries.
        scene: its scene.
        digest: sha256 of the section file, noted so that another file is another run.
    """
    from ruamel.yaml import YAML

    entries = _plain(case) | {"title": scene.title}
    if case.section.layers:
        for name in FILE_ENTRIES:
            entries["section"].pop(name, None)
    entries["mesh"]["cells"] = list(scene.cells)
    entries["particles"]["per_cell"] = scene.particles.per_cell
    entries["time"] |= {"courant": scene.time.courant, "min_steps": scene.time.min_steps}
    for name, model in (("particles", Particles), ("time", Time)):
        entries[name] = _in_order(entries[name], model)
    layers = entries["section"].get("layers", [])
    for i, unit in enumerate(scene.units[: len(layers)]):
        layers[i] = _in_order(layers[i] | {"name": unit.name}, Layer)
    for rock in scene.rocks:
        entries["rocks"][rock.name]["color"] = rock.color
    stream = io.StringIO()
    if digest:
        stream.write(f"# sha256 of the section file: {digest}\n")
    yaml = YAML(typ="safe", pure=True)
    yaml.default_flow_style, yaml.width, yaml.sort_base_mapping_type_on_output = None, 100, False
    yaml.dump(_in_order(entries, Case), stream)
    return stream.getvalue()


def _in_order(entries, model):
    """Return entries in the order of their model, so that equal cases are equal text."""
    return {name: entries[name] for name in model.model_fields if name in entries}


def _plain(value):
    """Return entries as YAML knows them; what is not given is left out."""
    if isinstance(value, Quantity):
        return value.text
    if isinstance(value, WallEntry):
        if value.values is None:
            return value.kind
        return {value.kind: ["free" if v is None else v.text for v in value.values]}
    if isinstance(value, Entry):
        given = {name: getattr(value, name) for name in type(value).model_fields}
        return {name: _plain(entry) for name, entry in given.items() if entry is not None}
    if isinstance(value, dict):
        return {name: _plain(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return value


def _source(case, path, tree, allow_outside):
    """Return the path of the section file and its sha256, or two Nones for layers."""
    section = case.section
    name = section.file or section.particles
    if name is None:
        return None, None
    at = ("section", "file" if section.file else "particles")
    try:
        source = inside(path.parent, name, allow_outside)
    except ValueError as error:
        raise CaseError([tree.fault(at, str(error))]) from None
    if not source.is_file():
        raise CaseError([tree.fault(at, f"there is no file '{name}' beside the case")])
    return source, hashlib.sha256(source.read_bytes()).hexdigest()


def _from_layers(case, tree):
    """Return the shape of box and layers."""
    section = case.section
    width, height = section.box.width.si, section.box.height.si
    waves = [layer.top.cosine.wavelength.si for layer in section.layers[:-1] if layer.top.cosine]
    count = HORIZON_POINTS
    if waves:
        count = max(count, 1 + min(MOST_POINTS, round(WAVE_POINTS * width / min(waves))))
    x = np.linspace(0, width, count)
    below, tops, faults = np.full_like(x, -height), [], []
    for i, layer in enumerate(section.layers[:-1]):
        top = _top(layer.top)
        z = top(x)
        at = ("section", "layers", i, "top")
        if layer.top.cosine and layer.top.cosine.wavelength.si * MOST_POINTS < WAVE_POINTS * width:
            most = f"{MOST_POINTS // WAVE_POINTS} waves along the section are the most possible"
            message = f"'{layer.top.cosine.wavelength.text}' is too short; {most}"
            faults.append(tree.fault((*at, "cosine", "wavelength"), message))
            continue
        for wrong, what in (
            (z <= below, "is not above the layer before it" if i else "is not above the base"),
            (z >= 0, "is not below the surface"),
        ):
            if wrong.any():
                where = show(float(x[wrong.argmax()]), "length")
                faults.append(
                    tree.fault(
                        at,
                        f"the top of '{layer.name or layer.rock}' {what} at x = {where}, "
                        f"z = {show(float(z[wrong.argmax()]), 'length')}; tops are given from the "
                        "base up and may not touch",
                    )
                )
                break
        below = z
        tops.append(top)
    if faults:
        raise CaseError(faults)
    names = _layer_names(section.layers)
    lines = tuple(
        Line(f"{lower} / {upper}", "horizon", np.column_stack([x, top(x)]))
        for lower, upper, top in zip(names, names[1:], tops, strict=False)
    )

    def unit_at(points):
        above = [points[:, 1] > top(points[:, 0]) for top in tops]
        return np.sum(above, axis=0, dtype=np.int16) if above else np.zeros(len(points), np.int16)

    outline = Outline(
        np.array([[0.0, 0.0], [width, 0.0]]), np.array([[0.0, -height], [width, -height]])
    )
    return _Shape(outline, names, tuple(layer.rock for layer in section.layers), unit_at, lines)


def _top(entry):
    """Return the height of a horizon as a function of x, m."""
    depth, wave = entry.depth.si, entry.cosine
    if wave is None:
        return lambda x: np.full_like(x, -depth)
    k = 2 * np.pi / wave.wavelength.si
    return lambda x: -depth + wave.amplitude.si * np.cos(k * (x - wave.phase.si))


def _layer_names(layers):
    """Return the names of layers: their own or their rock's, numbered where one comes again."""
    names = [layer.name or layer.rock for layer in layers]
    return tuple(
        f"{name} {names[: i + 1].count(name)}" if names.count(name) > 1 else name
        for i, name in enumerate(names)
    )


def _from_file(case, source, tree):
    """Return the shape of a file of polygons or of particles."""
    section = case.section
    settings = (SCALES[section.coordinates], SIGNS[section.vertical])
    if section.particles:
        from restoration.cloud import read_cloud

        return _from_cloud(case, read_cloud(source, section.particles, *settings), tree)
    from restoration.section import read_section

    found = read_section(
        source,
        section.file,
        section.property,
        *settings,
        tolerance=section.tolerance.si if section.tolerance else None,
        rock_property=section.rock_property,
    )
    rocks = _rocks_of_units(case, found.units, found.keys, tree, source)
    return _Shape(found.outline, found.units, rocks, found.unit_at, found.lines, found.notes)


def _rocks_of_units(case, units, keys, tree, source):
    """Return the name of the rock of every unit of a section file.

    A unit is of the rock that names it in ``unit``, or whose own name is the unit's, or that
    names (or is named like) the value of ``rock_property``.
    """
    chosen = {}
    for name, rock in case.rocks.items():
        for unit in rock.unit or (name,):
            chosen.setdefault(unit, []).append(name)
    result, faults, missing = [], [], []
    for unit in units:
        found = chosen.get(unit) or [
            rock for key in keys.get(unit, ()) for rock in chosen.get(key, ())
        ]
        if len(set(found)) > 1:
            message = f"unit '{unit}' is claimed by {listed(sorted(set(found)), last='and')}"
            faults.append(tree.fault(("rocks",), f"{message}; one rock only"))
        elif not found:
            missing.append(unit)
        result.append(found[0] if found else None)
    if missing:
        what = f"{source.name} has units without a rock: {listed(missing, last='and')}"
        ask = f"add 'unit: [{', '.join(missing[:3])}{', ..' if missing[3:] else ''}]' to their rock"
        near = hint(missing[0], case.rocks) if len(missing) == 1 else ""
        faults.append(tree.fault(("rocks",), f"{what}; {ask}{near}"))
    known = {*units, *(key for values in keys.values() for key in values)}
    for name, rock in case.rocks.items():
        for unit in rock.unit or ():
            if unit not in known:
                message = f"{source.name} has no unit '{unit}'{hint(unit, sorted(known))}"
                faults.append(tree.fault(("rocks", name, "unit"), message))
    if faults:
        raise CaseError(faults)
    return tuple(result)


def _from_cloud(case, cloud, tree):
    """Return the shape of a saved cloud, a tuple of positions, rows and unit names."""
    from scipy.spatial import cKDTree

    x, unit, names = cloud
    width, height = case.section.box.width.si, case.section.box.height.si
    low, high = np.array([0.0, -height]), np.array([width, 0.0])
    slack = 1e-9 * max(width, height)
    outside = np.any((x < low - slack) | (x > high + slack), axis=1)
    if outside.any():
        first = x[outside.argmax()]
        raise CaseError(
            [
                tree.fault(
                    ("section", "particles"),
                    f"{outside.sum()} of {len(x)} particles are outside the box (x from 0 to "
                    f"{show(width, 'length')}, z from {show(-height, 'length')} to 0), the first "
                    f"at x = {show(first[0], 'length')}, z = {show(first[1], 'length')}",
                )
            ]
        )
    rocks = _rocks_of_units(case, names, {}, tree, Path(case.section.particles))
    x = np.clip(x, low, high)
    nearest = cKDTree(x)
    outline = Outline(
        np.array([[0.0, 0.0], [width, 0.0]]), np.array([[0.0, -height], [width, -height]])
    )
    return _Shape(
        outline,
        names,
        rocks,
        lambda points: unit[nearest.query(points)[1]],
        (),
        ("a cloud of particles brings no horizons; none are followed",),
        Cloud(x, unit),
    )


def _wall(name, entry):
    """Return a wall of the scene."""
    zero = (0.0, 0.0)
    if entry.kind == "no-slip":
        return Wall("no-slip", zero, zero)
    if entry.kind == "free-slip":
        held = [None, None]
        held[NORMAL[name]] = 0.0
        return Wall("free-slip", tuple(held), zero)
    values = tuple(None if value is None else value.si for value in entry.values)
    if entry.kind == "velocity":
        return Wall("velocity", values, zero)
    return Wall("traction", (None, None), tuple(value or 0.0 for value in values))


def _loose(walls):
    """Return messages about motions that no wall holds, for which Stokes has no single answer."""
    messages = []
    for axis, way in enumerate(("sideways", "up or down")):
        if all(wall.velocity[axis] is None for wall in walls.values()):
            messages.append(
                f"no wall holds the section from moving {way}; make one no-slip or free-slip"
            )
    turning = any(
        wall.velocity[NORMAL[name]] is not None or None not in wall.velocity
        for name, wall in walls.items()
    )
    if not turning and not messages:
        messages.append("no wall holds the section from turning; make one no-slip or free-slip")
    return messages


def _unbalanced(walls, shape):
    """Return the message about a closed section whose walls let more in than out."""
    outline = shape.outline
    if any(walls[name].velocity[axis] is None for name, axis in NORMAL.items()):
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


def _cells(case, outline):
    """Return columns and rows of squares."""
    cells = case.preset("mesh", "cells")
    if isinstance(cells, tuple):
        return cells
    size = min(outline.width, outline.height) / cells
    return max(1, round(outline.width / size)), max(1, round(outline.height / size))


def _too_large(case, cells, tree):
    """Return the faults of a mesh or a cloud beyond what a machine holds."""
    triangles = 4 * cells[0] * cells[1]
    if triangles > MOST_CELLS:
        message = f"make {triangles} triangles; at most {MOST_CELLS} are possible"
        return [tree.fault(("mesh", "cells"), f"{cells[0]} x {cells[1]} squares {message}")]
    if triangles * case.preset("particles", "per_cell") > MOST_PARTICLES:
        return [
            tree.fault(
                ("particles", "per_cell"),
                f"{triangles} triangles make more than {MOST_PARTICLES} particles",
            )
        ]
    return []

"""From a case to a scene: names become rows, quantities become SI, a section becomes shapes."""

import io
from dataclasses import dataclass, replace
from math import prod
from pathlib import Path

from restoration.case import FILE_ENTRIES, read_case
from restoration.entries import (
    BOX_CELLS,
    QUADRATIC,
    Case,
    Entry,
    Layer,
    Mesh,
    Particles,
    Time,
    WallEntry,
    is_age,
)
from restoration.errors import CaseError
from restoration.fault_entries import FaultEntry
from restoration.faults import slim_notes, too_thin, with_faults
from restoration.palette import unit_colors
from restoration.scene import (
    BOX_WALLS,
    WALLS,
    Air,
    CertificatePlan,
    MeshPlan,
    OutputPlan,
    ParticlePlan,
    RefinePlan,
    Rock,
    Scene,
    SolverPlan,
    SurfacePlan,
    TimePlan,
    Transfer,
    Unit,
    normal_velocity,
)
from restoration.shapes import digest_of, find_source, from_file, from_layers, on_columns
from restoration.stopping import find_stop
from restoration.stopping import notes as stop_notes
from restoration.units import Quantity, show
from restoration.walls import loose, misplaced, unbalanced, wall_of
from restoration.words import listed

MOST_CELLS = 1_000_000  # triangles or tetrahedra, of about 4.5 unknowns each
MOST_PARTICLES = 20_000_000
# Length of cells over their height: at 30 a long wave sank where it should rise (docs/limits.md).
MOST_FLAT = 10


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
    source, digest = find_source(case, path, tree, allow_outside)
    shape = from_layers(case, tree) if source is None else from_file(case, source, tree)
    if source is not None and digest_of(source, str(source.name)) != digest:
        raise CaseError([tree.fault(("section",), f"{source.name} was changed while it was read")])
    names, dim = (BOX_WALLS, 3) if _has_length(case) else (WALLS, 2)
    walls = {name: wall_of(name, getattr(case.boundary, name), dim) for name in names}
    faults = _wall_faults(case, walls, shape, tree) if dim == 2 else []
    cells = _cells(case, shape.outline)
    outline, cut = on_columns(shape.outline, cells[0], walls["surface"].kind == "free")
    faults += _too_large(case, cells, tree) + _too_flat(case, cells, shape.outline, tree)
    stop, unmet = find_stop(case, shape, walls, tree)
    faults += unmet
    if faults:
        raise CaseError(faults)
    shape, bands = with_faults(case, shape, outline, tree)
    if case.mesh.interfaces != "particles" and (thin := too_thin(bands, shape.lines, tree)):
        raise CaseError(thin)
    notes = (*shape.notes, *cut)
    scene = _scene(case, shape, outline, walls, cells, case.title or _title(path), notes)
    notes = (*scene.notes, *slim_notes(bands, cells, outline, scene.mesh))
    notes += stop_notes(stop)
    scene = replace(scene, faults=bands, notes=notes, time=replace(scene.time, stop=stop))
    return Loaded(case, scene, text, resolved_yaml(case, scene, digest))


def _has_length(case):
    """Return whether a case is of three dimensions."""
    return case.section.box is not None and case.section.box.length is not None


def _wall_faults(case, walls, shape, tree):
    """Return the faults of walls that cannot be what they are together."""
    faults = [
        tree.fault(("boundary",), text) for text in loose(walls) + unbalanced(walls, shape.outline)
    ]
    faults += [
        tree.fault(("boundary", name), text)
        for name, text in misplaced(case.boundary, walls, shape.outline, case.time.marks)
    ]
    crossed = [
        name
        for name, wall in walls.items()
        if name in ("base", "surface")
        and wall.kind != "free"
        and normal_velocity(name, wall, shape.outline) != 0
    ]
    if case.mesh.interfaces != "particles" and crossed:
        message = f"rock may cross the {listed(crossed, last='and')}, and mesh lines that follow it"
        message += " would lose their ends there; let particles carry it"
        faults.append(tree.fault(("mesh", "interfaces"), message))
    return faults


def _scene(case, shape, outline, walls, cells, title, notes):
    """Return the scene of a case whose parts have been found sound."""
    used = [name for name in case.rocks if name in shape.rocks]
    unused = [name for name in case.rocks if name not in shape.rocks]
    notes, deep = [*notes], _has_length(case)
    conservative = case.mesh.element in QUADRATIC and not deep
    if unused:
        notes.append(f"rocks not in the section: {listed(unused, last='and')}")
    colors = unit_colors(
        used, [used.index(rock) for rock in shape.rocks], [case.rocks[name].color for name in used]
    )
    return Scene(
        title=title,
        outline=outline,
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
            case.particles.velocity or ("conservative" if conservative else "plain"),
        ),
        transfer=Transfer(case.transfer.density, case.transfer.viscosity, case.transfer.mean),
        time=TimePlan(
            tuple(0.0 - mark.si if is_age(mark) else mark.si for mark in case.time.marks),
            case.time.scheme,
            float(case.preset("time", "courant")),
            case.preset("time", "min_steps"),
            case.time.tolerance.si if case.time.tolerance else None,
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
        mesh=MeshPlan(
            case.mesh.element,
            case.mesh.interfaces,
            case.mesh.refine and RefinePlan(**dict(case.mesh.refine)),
        ),
        solver=SolverPlan(case.solver.name, case.solver.options, case.solver.reproducible),
        surface=_surface(case.surface),
        certificate=None if deep else _certificate(case.certificate),
        length=case.section.box.length.si if deep else None,
        sheets=shape.sheets,
    )


def _certificate(entry):
    """Return the plan of the certificate, or None where it is off."""
    return None if entry == "off" else CertificatePlan(entry.noise.si, entry.tolerance.si)


def _surface(entry):
    """Return the plan of a free surface."""
    if entry is None:
        return SurfacePlan()
    air = entry.air and Air(entry.air.thickness.si, entry.air.density.si, entry.air.viscosity.si)
    return SurfacePlan(
        float(entry.theta),
        entry.reverse,
        entry.motion,
        float(entry.limit),
        air,
        entry.noise.si,
        entry.tolerance.si,
    )


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
    if scene.length:
        entries["boundary"] |= {name: scene.walls[name].kind for name in ("front", "back")}
        entries["certificate"] = "off"
    entries["mesh"] = _in_order(entries["mesh"] | {"cells": list(scene.cells)}, Mesh)
    if case.mesh.interfaces == "fitted":  # which averages nothing
        entries.pop("transfer")
        if case.mesh.refine:  # for every flow
            del entries["mesh"]["refine"]["every"]
    entries["solver"]["options"] = dict(case.solver.options)
    entries["particles"] |= {
        "per_cell": scene.particles.per_cell,
        "velocity": scene.particles.velocity,
    }
    entries["time"] |= {"courant": scene.time.courant, "min_steps": scene.time.min_steps}
    for name, model in (("particles", Particles), ("time", Time)):
        entries[name] = _in_order(entries[name], model)
    layers = entries["section"].get("layers", [])
    for i, unit in enumerate(scene.units[: len(layers)]):
        layers[i] = _in_order(layers[i] | {"name": unit.name}, Layer)
    for entry, fault in zip(entries.get("faults", []), scene.faults, strict=True):
        entry |= {"name": fault.name}
    entries["faults"] = [_in_order(entry, FaultEntry) for entry in entries.get("faults", [])]
    if not entries["faults"]:
        del entries["faults"]
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
        return {value.kind: ["free" if v is None else _plain(v) for v in value.values]}
    if isinstance(value, Entry):
        given = {name: getattr(value, name) for name in type(value).model_fields}
        return {name: _plain(entry) for name, entry in given.items() if entry is not None}
    if isinstance(value, dict):
        return {name: _plain(entry) for name, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(entry) for entry in value]
    return value


def _cells(case, outline):
    """Return columns and rows of squares, in three dimensions cubes along x, y and z."""
    cells, extent = case.preset("mesh", "cells"), [outline.width, outline.height]
    if _has_length(case):
        cells = case.mesh.cells or BOX_CELLS[case.accuracy]
        extent.insert(1, case.section.box.length.si)
    if isinstance(cells, tuple):
        return cells
    size = min(extent) / cells
    return tuple(max(1, round(side / size)) for side in extent)


def _too_large(case, cells, tree):
    """Return the faults of a mesh or a cloud beyond what a machine holds."""
    share, squares, names = 4, "squares", "triangles"
    if len(cells) == 3:
        share, squares, names = 12, "cubes", "tetrahedra"
    count = share * prod(cells)
    if count > MOST_CELLS:
        message = f"make {count} {names}; at most {MOST_CELLS} are possible"
        shape = " x ".join(map(str, cells))
        return [tree.fault(("mesh", "cells"), f"{shape} {squares} {message}")]
    if count * case.preset("particles", "per_cell") > MOST_PARTICLES:
        return [
            tree.fault(
                ("particles", "per_cell"),
                f"{count} {names} make more than {MOST_PARTICLES} particles",
            )
        ]
    return []


def _too_flat(case, cells, outline, tree):
    """Return the fault of cells in columns that are much longer than high, or higher than long."""
    if case.mesh.interfaces == "fitted" or not isinstance(case.mesh.cells, tuple):
        return []
    length = [case.section.box.length.si] if _has_length(case) else []
    sides = [
        side / count
        for side, count in zip([outline.width, *length, outline.height], cells, strict=True)
    ]
    if max(sides) <= MOST_FLAT * min(sides):
        return []
    best = min(outline.width, outline.height) / min(cells[0], cells[-1])
    message = (
        f"cells are {show(max(sides), 'length')} by {show(min(sides), 'length')}; at most "
        f"{MOST_FLAT} times as long as high are possible, such as squares of "
        f"{show(best, 'length')}; mesh.interfaces: fitted makes its own"
    )
    return [tree.fault(("mesh", "cells"), message)]

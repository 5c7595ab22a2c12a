"""The case file: read, and all its faults told at once, each with its place."""

from pathlib import Path

from pydantic import BaseModel, ValidationError

from restoration.box_rules import box_faults
from restoration.entries import ELEMENTS, OPTIONS, QUADRATIC, Boundary, Case, RockEntry
from restoration.errors import CaseError
from restoration.fault_entries import wrong_faults
from restoration.files import read_text
from restoration.tree import override, read_tree, shortened
from restoration.units import advice
from restoration.words import hint, listed, nearest, quoted

FITTED = ("fitted", "auto")  # of mesh.interfaces: with mesh lines that follow the rock
MOST_TOLD = 100  # wrong entries for which the one meant is looked for
SYNONYMS = {"top": "surface", "bottom": "base", "walls": "boundary", "colour": "color"}
# Entries of a section that only a file has a use for.
FILE_ENTRIES = ("property", "rock_property", "coordinates", "vertical", "tolerance")


def read_case(path, overrides=()):
    """Return the `Case` of a file, its text and the `Tree` that knows the place of every entry.

    Args:
        path: the case file.
        overrides: ``a.b=value`` texts.

    Raises:
        CaseError: with all faults of the file.
    """
    shown = str(path)
    text = read_text(Path(path), shown)
    tree = read_tree(text, shown)
    for assignment in overrides:
        override(tree, assignment)
    if not isinstance(tree.data, dict):
        message = f"holds {quoted(tree.data)} and not entries such as 'section:' and 'rocks:'"
        raise CaseError([*tree.faults, tree.fault((), message)])
    faults, case, more = list(tree.faults), None, 0
    try:
        case = Case.model_validate(tree.data)
    except ValidationError as error:
        errors = error.errors()
        faults += told(tree, errors[:MOST_TOLD])
        more = max(0, len(errors) - MOST_TOLD)
    faults += _cross_faults(tree)
    if faults:
        raise CaseError(in_order(faults, more))
    return case, text, tree


def in_order(faults, more=0):
    """Return faults by their place, each once, and not too many; ``more`` are not given."""
    placed = sorted(faults, key=lambda f: (f.line is None, f.line or 0, f.column or 0))
    return shortened(list(dict.fromkeys(placed)), more)


def told(tree, errors, root=Case):
    """Return a fault for every error; a misspelt name is not told as missing too.

    Args:
        tree: `Tree` of the file.
        errors: of pydantic.
        root: the model of the whole file.
    """
    meant = {
        (*error["loc"][:-1], _meant(error["loc"][-1], _names_at(error["loc"][:-1], root)))
        for error in errors
        if error["type"] == "extra_forbidden"
    }
    return [
        _fault(tree, error, root)
        for error in errors
        if error["type"] != "missing" or error["loc"] not in meant
    ]


def _meant(name, known):
    """Return the entry that a name stands for, or None."""
    synonym = SYNONYMS.get(nearest(name, SYNONYMS))
    return nearest(name, known) or (synonym if synonym in known else None)


def _fault(tree, found, root):
    """Return the fault behind one error of pydantic."""
    path = tuple(part for part in found["loc"] if part != "[key]")
    kind, context = found["type"], found.get("ctx", {})
    if kind == "extra_forbidden":
        known = _names_at(path[:-1], root)
        meant = _meant(path[-1], known)
        near = f"; did you mean '{meant}'? (possible: {listed(known)})" if meant else ""
        near = near or hint(path[-1], known)
        return tree.fault(path, f"no such entry{near}", at="key")
    if kind == "missing":
        return tree.fault(path, f"is missing{_missing(path)}", at="key")
    if kind == "value_error":
        return tree.fault(path, str(context["error"]))
    value = quoted(found["input"])
    bounds = {
        "greater_than": "must be above {gt:g}",
        "greater_than_equal": "must not be below {ge:g}",
        "less_than_equal": "must not be above {le:g}",
    }
    if kind in bounds:
        return tree.fault(path, f"{value} {bounds[kind].format(**context)}")
    expected = {
        "int_type": "is not a whole number",
        "float_type": "is not a number",
        "bool_type": "is not true or false",
        "list_type": "is not a list",
        "dict_type": "is not a group of entries",
        "model_type": "is not a group of entries",
        "string_type": "is not text",
    }
    told = f"{value} {expected.get(kind, found['msg'])}"
    if found["input"] is None:
        told = "is empty; fill it in or remove it"
    return tree.fault(path, f"{told}{_group_hint(path, kind, root)}")


def _model_at(path, root):
    """Return the model of the group at a path."""
    model = root
    for part in path:
        if isinstance(part, int) or model is None:
            continue
        if model is Case and part == "rocks":
            model = {"rocks": RockEntry}
            continue
        if isinstance(model, dict):
            model = model["rocks"]
            continue
        field = model.model_fields.get(part)
        model = _inner_model(field.annotation) if field else None
    return model


def _inner_model(annotation):
    """Return the model inside an annotation such as ``list[Layer] | None``."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        return annotation
    for inner in getattr(annotation, "__args__", ()):
        if (model := _inner_model(inner)) is not None:
            return model
    return None


def _names_at(path, root):
    """Return the names of the entries a group may have."""
    model = _model_at(path, root)
    return list(model.model_fields) if isinstance(model, type) else []


def _group_hint(path, kind, root):
    names = _names_at(path, root) if kind in ("model_type", "dict_type") else []
    return f"; its entries are {listed(names, last='and')}" if names else ""


def _missing(path):
    asks = {
        ("section",): "; give a box and layers, a file of polygons, or particles",
        ("rocks",): "; give every rock a density and a viscosity",
        ("time",): "; give marks, such as time: {marks: [0 Myr, 6 Myr, 0 Myr]}",
        ("case",): "; name the case file that is varied, such as case: case.yaml",
        ("latin", "samples"): "; give the number of runs, such as samples: 20",
        ("latin", "ranges"): "; such as ranges: {rocks.salt.viscosity: log 1e17 .. 1e19 Pa s}",
        ("time", "marks"): "; such as [0 Myr, 6 Myr, 0 Myr], or ages [0 Ma, 2 Ma] to restore",
    }
    kind = dict.fromkeys(("width", "height", "depth", "amplitude", "wavelength"), "length")
    kind |= {"density": "density", "viscosity": "viscosity"}
    if path in asks:
        return asks[path]
    return f"; {advice(kind[path[-1]])}" if path[-1] in kind else ""


def _cross_faults(tree):
    """Return the faults between entries; reads the raw values, so that others do not hide them."""
    faults = []
    section, rocks = tree.raw(("section",)), tree.raw(("rocks",))
    if isinstance(section, dict):
        faults += _section_faults(tree, section)
    layers = tree.raw(("section", "layers"))
    if isinstance(layers, list) and isinstance(rocks, dict) and rocks:
        for i, layer in enumerate(layers):
            rock = layer.get("rock") if isinstance(layer, dict) else None
            if (
                isinstance(rock, (str, int))
                and not isinstance(rock, bool)
                and str(rock) not in rocks
            ):
                path = ("section", "layers", i, "rock")
                faults.append(tree.fault(path, f"there is no rock '{rock}'{hint(rock, rocks)}"))
    for name in Boundary.model_fields:
        if tree.raw(("boundary", name)) == "free" and name != "surface":
            message = "only the surface can be free; {traction: [0 MPa, 0 MPa]} leaves a wall alone"
            faults.append(tree.fault(("boundary", name), message))
    faults += wrong_faults(tree) + _surface_faults(tree) + _mesh_faults(tree) + box_faults(tree)
    return faults + _line_faults(tree)


def _surface_faults(tree):
    """Return the faults of what is said about a free surface."""
    at, free = ("surface",), tree.raw(("boundary", "surface")) == "free"
    given, faults = tree.raw(at), []
    if given is not None and not free:
        message = "says how a free surface moves; write boundary: {surface: free}, or remove it"
        faults.append(tree.fault(at, message, at="key"))
    if free and tree.raw(("section", "particles")) is not None:
        message = "a cloud of particles has no surface line that could move; give layers or a file"
        faults.append(tree.fault(("boundary", "surface"), message))
    if isinstance(given, dict) and given.get("air") is not None:
        if tree.raw(("mesh", "interfaces")) in FITTED:
            message = "air is solved for on column meshes only; remove it, or the fitted mesh"
            faults.append(tree.fault((*at, "air"), message, at="key"))
        if given.get("motion") == "normal":
            message = "below air the surface nodes move vertically only"
            faults.append(tree.fault((*at, "motion"), message))
    return faults


def _line_faults(tree):
    """Return the faults of rock that cannot be told by the lines between it."""
    given, element = tree.raw(("transfer",)), tree.raw(("mesh", "element"))
    wrong = []
    if tree.raw(("section", "particles")) is not None:
        wrong.append("a cloud of particles brings no lines that could tell its rock")
    if isinstance(element, str) and element.startswith("Q"):
        wrong.append(f"lines tell the rock of triangles only, and {element} lives on squares")
    if tree.raw(("faults",)):
        wrong.append("bands of faults lie on top of the lines, which do not tell their rock")
    names = ("density", "viscosity") if isinstance(given, dict) else ()
    return [
        tree.fault(("transfer", name), f"{message}; take {instead}")
        for name, instead in zip(names, ("projection", "hat"), strict=False)
        if given.get(name) == "lines"
        for message in wrong
    ]


def _mesh_faults(tree):
    """Return the faults of a mesh that cannot be what its entries say together."""
    at = ("mesh",)
    element, refine = tree.raw((*at, "element")), tree.raw((*at, "refine"))
    squares = isinstance(element, str) and element.startswith("Q")
    interfaces, faults = tree.raw((*at, "interfaces")), []
    fitted = interfaces in FITTED
    if squares and refine is not None:
        message = f"squares cannot be refined in part; {element} needs a mesh that stands still"
        faults.append(tree.fault((*at, "refine"), f"{message}; take P2-P1 to refine", at="key"))
    if squares and fitted:
        message = f"mesh lines follow the rock in triangles only, and {element} lives on squares"
        faults.append(tree.fault((*at, "interfaces"), f"{message}; take P2-P1"))
    if interfaces == "fitted" and tree.raw(("transfer",)) is not None:
        message = "a fitted mesh averages nothing: every cell has one rock; remove it"
        faults.append(tree.fault(("transfer",), message, at="key"))
    if fitted and tree.raw(("section", "particles")) is not None:
        message = "a cloud of particles brings no horizons that mesh lines could follow"
        faults.append(tree.fault((*at, "interfaces"), message))
    where = refine.get("where") if isinstance(refine, dict) else None
    if fitted and "velocity-gradient" in (where if isinstance(where, list) else [where]):
        message = "a fitted mesh is refined at interfaces and faults only"
        faults.append(tree.fault((*at, "refine", "where"), message))
    if fitted and isinstance(refine, dict) and "every" in refine:
        message = "a fitted mesh moves, and is made anew where it must be; remove it"
        faults.append(tree.fault((*at, "refine", "every"), message, at="key"))
    if element in ELEMENTS and element not in QUADRATIC:
        if tree.raw(("particles", "velocity")) == "conservative":
            message = f"the velocity of {element} cannot be made free of divergence at every point"
            message = f"{message}; take plain, or {listed(QUADRATIC, last='or')}"
            faults.append(tree.fault(("particles", "velocity"), message))
    return faults + _solver_faults(tree)


def _solver_faults(tree):
    """Return the faults of options that the solver asked for would not heed."""
    options = tree.raw(("solver", "options"))
    if tree.raw(("solver", "name")) != "direct" or not isinstance(options, dict):
        return []
    other = [
        name
        for name in options
        if str(name).startswith(("velocity_", "pressure_", "ksp_rtol", "ksp_max_it", "ksp_gmres"))
    ]
    message = "is an option of the field split; a direct solver has no use for it"
    return [
        tree.fault(("solver", "options"), f"'{name}' {message}")
        for name in other
        if name in OPTIONS
    ]


def _section_faults(tree, section):
    """Return the faults of the ways to give a section."""
    at = ("section",)
    ways = [way for way in ("layers", "file", "particles") if section.get(way) is not None]
    if len(ways) > 1:
        return [tree.fault(at, f"{listed(ways, last='and')} are given; a section comes from one")]
    if not ways:
        ask = "give box and layers, or file, or particles"
        return [tree.fault(at, f"nothing says where the rock is; {ask}")]
    (way,) = ways
    faults = []
    if way != "file" and section.get("box") is None:
        faults.append(tree.fault(at, f"{way} need a box: {{width: .., height: ..}}"))
    if way == "file" and section.get("box") is not None:
        faults.append(tree.fault((*at, "box"), "the outline comes from the file; remove the box"))
    if way == "layers":
        for name in FILE_ENTRIES:
            if name in section:
                message = "says nothing about layers; remove it"
                faults.append(tree.fault((*at, name), message, at="key"))
        layers = section["layers"]
        for i, layer in enumerate(layers if isinstance(layers, list) else []):
            has_top = isinstance(layer, dict) and layer.get("top") is not None
            if i + 1 < len(layers) and not has_top:
                faults.append(
                    tree.fault((*at, "layers", i), "has no top; only the last layer fills the rest")
                )
            elif i + 1 == len(layers) and has_top:
                faults.append(
                    tree.fault(
                        (*at, "layers", i, "top"),
                        "the last layer fills up to the surface; "
                        "remove its top, or add a layer above",
                    )
                )
        if layers == []:
            faults.append(tree.fault((*at, "layers"), "holds no layer"))
    return faults

"""A bare section: what is in it, and a case file to start from."""

from pathlib import Path

from restoration.section import survey
from restoration.words import counted, listed, printable

# Typical density, kg/m^3, and viscosity, Pa s, by a word in the name (paper, sect. 4.2).
TYPICAL = {
    "salt": (2160, "1e17"),
    "halite": (2160, "1e17"),
    "evaporite": (2160, "1e17"),
    "basement": (2700, "1e21"),
}
SEDIMENT = (2600, "1e19")
# Properties that sort units into rocks, where a section has one besides its units.
SORTS = ("rock", "kind", "lithology", "material", "type", "class")
MANY = 8  # more units than this want to be sorted into rocks


def survey_text(path):
    """Return what a section file holds, and a case to start from, as text.

    Args:
        path: a GeoJSON file.

    Raises:
        CaseError: it is no collection of polygons.
    """
    found = survey(Path(path), str(path))
    lines = [
        f"# {path}: {counted(found['polygons'], 'polygon')}, "
        f"{counted(found['fault_lines'], 'fault line')}, {found['vertices']} vertices"
    ]
    if found["extent"]:
        (west, east), (low, high) = found["extent"]["x"], found["extent"]["z"]
        lines.append(f"# x from {west:g} to {east:g}, z from {low:g} to {high:g}, as in the file")
    for name, values in found["properties"].items():
        lines.append(f"# property '{name}': {listed(values, last='and')}")
    lines += [f"# note: {hint}" for hint in found["hints"]]
    lines += [f"# to mend: {fault}" for fault in found["faults"]]
    return "\n".join([*map(printable, lines), "", starter_case(path, found)])


def starter_case(path, found):
    """Return a case file for a section; densities and viscosities are to be replaced.

    Args:
        path: a GeoJSON file.
        found: what `section.survey` says of it.
    """
    name = Path(path).name
    unit = found["unit_property"] or "unit"
    units = found["properties"].get(unit, [])
    sort = next((p for p in found["properties"] if p.casefold() in SORTS and p != unit and p), None)
    of = found["properties"][sort] if sort else units
    settings = [f"file: {_yaml(name)}", f"property: {_yaml(unit)}"]
    if sort:
        settings.append(f"rock_property: {_yaml(sort)}")
    if found["coordinates"] == "km":
        settings.append("coordinates: km")
    if found["vertical"] == "down":
        settings.append("vertical: down")
    lines = [
        "# A case to start from: save it beside the section, then replace the densities and",
        "# viscosities, which are only typical (a viscosity is rarely known to a factor of ten).",
        f"title: {_yaml(_title(Path(path)))}",
        f"section: {{{', '.join(settings)}}}",
        "rocks:",
    ]
    for value in of:
        density, viscosity = next(
            (typical for word, typical in TYPICAL.items() if word in value.casefold()), SEDIMENT
        )
        lines.append(
            f"  {_yaml(value)}: {{density: {density} kg/m^3, viscosity: {viscosity} Pa s}}"
        )
    if not sort and len(units) > MANY:
        lines.append("  # units of one rock can share an entry: sediment: {.., unit: [A, B, C]}")
    lines += [
        "boundary: {left: free-slip, right: free-slip, base: no-slip, surface: free-slip}",
        "time: {marks: [0 Ma, 1 Ma]} # from today back to 1 Ma",
        "accuracy: draft # then balanced, then fine",
    ]
    return "\n".join(lines)


def _title(path):
    """Return the name of the file, or of its folder where the file only says what it is."""
    folder = path.absolute().parent.name
    return folder if path.stem in ("section", "polygons", "units") and folder else path.stem


def _yaml(text):
    """Return text as a YAML scalar that stays text, on its line."""
    text = printable(text)
    plain = text.replace("_", "").replace("-", "").replace(".", "").replace(" ", "")
    if plain.isalnum() and plain.isascii() and text[0].isalpha() and text == text.strip():
        if text.casefold() not in ("null", "true", "false", "yes", "no", "on", "off"):
            return text
    return "'" + text.replace("'", "''") + "'"

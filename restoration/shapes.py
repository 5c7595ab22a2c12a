"""Where the rock is: a box of layers, a file of polygons, or a cloud of particles."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from restoration import cloud, geojson, saved
from restoration.errors import CaseError
from restoration.files import digest, inside, near_file
from restoration.scene import Cloud, Line, Outline, Sheet
from restoration.units import show
from restoration.words import hint, listed

SCALES = {"m": 1.0, "km": 1e3}
SIGNS = {"up": 1.0, "down": -1.0}
HORIZON_POINTS = 401
WAVE_POINTS = 40  # of a horizon, in one wave
MOST_POINTS = 8000
SHEET_POINTS = 101  # of a horizon in three dimensions, along the longer side
SHEET_WAVE_POINTS, MOST_SHEET_POINTS = 16, 401
# What is read, by the end of its name, with the greatest size, bytes.
READ = {
    "file": dict.fromkeys((".geojson", ".json"), geojson.LARGEST),
    "particles": dict.fromkeys((".csv", ".txt"), cloud.LARGEST) | {".h5": saved.LARGEST},
}
KINDS = {
    "file": "a section is a .geojson: export the layer as GeoJSON (in QGIS: Export, Save Features "
    "As); particles are named as section.particles",
    "particles": "particles are a .csv with the columns x, z and unit, or the particles.h5 of a "
    "run; polygons are named as section.file",
}


@dataclass(frozen=True, eq=False)
class Shape:
    """Where the rock is, from whichever source."""

    outline: Outline
    names: tuple[str, ...]
    rocks: tuple[str, ...]  # name of the rock of every unit
    unit_at: object
    lines: tuple[Line, ...]
    notes: tuple[str, ...] = ()
    cloud: Cloud | None = None
    sheets: tuple[Sheet, ...] = ()


def find_source(case, path, tree, allow_outside):
    """Return the path of the section file and its sha256, or two Nones for layers."""
    section = case.section
    name = section.file or section.particles
    if name is None:
        return None, None
    way = "file" if section.file else "particles"
    try:
        source = inside(path.parent, name, allow_outside)
        if source.suffix.lower() not in READ[way]:
            raise ValueError(f"'{name}' is of no kind that is read here; {KINDS[way]}")
        if not source.is_file():  # nor a folder, a pipe or a device, which may never end
            raise ValueError(f"there is no file '{name}' beside the case{near_file(source)}")
        if not allow_outside:
            for part in _files_of(source)[1:]:
                inside(path.parent, str(part.relative_to(path.parent)))
    except OSError as error:
        raise CaseError(
            [tree.fault(("section", way), f"'{name}' cannot be read: {error.strerror}")]
        ) from None
    except ValueError as error:
        raise CaseError([tree.fault(("section", way), str(error))]) from None
    return source, digest_of(source, name)


def digest_of(source, shown):
    """Return the sha256 of a section file, with all that belongs to it.

    Raises:
        CaseError: it cannot be read, or is too large.
    """
    longest = READ["file"] | READ["particles"]
    whole = hashlib.sha256()
    for part in _files_of(source):
        whole.update(digest(part, shown, longest[part.suffix.lower()]))
    return whole.hexdigest()


def on_columns(outline, columns, free=False):
    """Return the outline as the columns of a mesh carry it, and a note where that cuts off much.

    Args:
        outline: as drawn.
        columns: of the mesh.
        free: whether the surface is free: then it is a line of its own, kept as drawn.
    """
    x = np.linspace(outline.surface[0, 0], outline.surface[-1, 0], columns + 1)
    surface = outline.surface if free else _sampled(outline.surface, x)
    carried = Outline(surface, _sampled(outline.base, x))
    off = carried.area / outline.area - 1
    relief = max(
        np.abs(np.interp(line[:, 0], *other.T) - line[:, 1]).max()
        for line, other in ((outline.surface, carried.surface), (outline.base, carried.base))
    )
    if abs(off) < 1e-3 and relief < 1e-2 * outline.height:
        return carried, []
    return carried, [
        f"the {columns} columns of the mesh cut off up to {show(relief, 'length')} of the relief "
        f"of surface or base ({off:+.2%} of the area); raise mesh.cells to keep it"
    ]


def _sampled(line, x):
    """Return a line at columns; a level one stays as it is."""
    if np.ptp(line[:, 1]) == 0:
        return line
    return np.column_stack([x, np.interp(x, *line.T)])


def _files_of(source):
    """Return the files that hold a source: the particles of a run may go on in more than one."""
    if source.suffix.lower() != ".h5":
        return [source]
    return saved.parts(source)


def from_layers(case, tree):
    """Return the shape of box and layers, in two or three dimensions."""
    section = case.section
    width, height = section.box.width.si, section.box.height.si
    waves = [layer.top.cosine for layer in section.layers[:-1] if layer.top.cosine]
    x, y, shape = _stations(section.box, waves)
    below, tops, faults = np.full_like(x, -height), [], []
    for i, layer in enumerate(section.layers[:-1]):
        top, at = _top(layer.top), ("section", "layers", i, "top")
        short = _too_short(section.box, layer.top.cosine)
        faults += [tree.fault((*at, "cosine", name), message) for name, message in short]
        if short:
            continue
        z = top(x, y)
        floor = "the layer before it" if i else "the base"
        place = x, y if section.box.length else None, z
        if told := _touches(layer, floor, below, *place):
            faults.append(tree.fault(at, told))
        below = z
        tops.append(top)
    if faults:
        raise CaseError(faults)
    names = _layer_names(section.layers)
    horizons = [
        (f"{lower} / {upper}", "horizon", top(x, y))
        for lower, upper, top in zip(names, names[1:], tops, strict=False)
    ]
    if section.box.length:
        lines = ()
        sheets = tuple(Sheet(*of, np.column_stack([x, y, z]), shape) for *of, z in horizons)
    else:
        lines = tuple(Line(*of, np.column_stack([x, z])) for *of, z in horizons)
        sheets = ()

    def unit_at(points):
        x, *y, z = points.T
        above = [z > top(x, *y) for top in tops]
        return np.sum(above, axis=0, dtype=np.int16) if above else np.zeros(len(points), np.int16)

    outline = Outline(
        np.array([[0.0, 0.0], [width, 0.0]]), np.array([[0.0, -height], [width, -height]])
    )
    rocks = tuple(layer.rock for layer in section.layers)
    return Shape(outline, names, rocks, unit_at, lines, sheets=sheets)


def _too_short(box, cosine):
    """Return (entry, message) of the wavelengths that are too short to be drawn."""
    shortest = max(box.width.si, box.length.si if box.length else 0) / _most_waves(box)
    most = f"{_most_waves(box)} waves along the section are the most possible"
    return [
        (name, f"'{getattr(cosine, name).text}' is too short; {most}")
        for name in WAVELENGTHS
        if _wave(cosine, name) < shortest
    ]


def _touches(layer, floor, below, x, y, z):
    """Return the message about a top that meets what is below it or the surface, or None.

    Args:
        layer: `entries.Layer`.
        floor: what is below it, in words.
        below: height of that, shape (n,), m.
        x, y, z: points of the top, shape (n,), m; y is None in two dimensions.
    """
    for wrong, what in (
        (z <= below, f"is not above {floor}"),
        (z >= 0, "is not below the surface"),
    ):
        if wrong.any():
            axes = {"x": x, "y": y, "z": z}
            row = wrong.argmax()
            where = ", ".join(
                f"{name} = {show(float(axis[row]), 'length')}"
                for name, axis in axes.items()
                if axis is not None
            )
            return (
                f"the top of '{layer.name or layer.rock}' {what} at {where}; tops are given from "
                "the base up and may not touch"
            )
    return None


WAVELENGTHS = ("wavelength", "wavelength_y")


def _wave(cosine, name):
    """Return a wavelength, m; infinite where there is no wave."""
    given = cosine and getattr(cosine, name)
    return given.si if given else np.inf


def _most_waves(box):
    """Return how many waves along the longer side are drawn as such at the most."""
    if box.length:
        return MOST_SHEET_POINTS // SHEET_WAVE_POINTS
    return MOST_POINTS // WAVE_POINTS


def _stations(box, waves):
    """Return where horizons are drawn: x and y, shape (n,), m, and the shape of their grid.

    Args:
        box: `entries.Box`.
        waves: `entries.Cosine`s of the horizons.
    """
    width, lengths = box.width.si, [_wave(wave, name) for wave in waves for name in WAVELENGTHS]
    shortest = min(lengths, default=np.inf)
    if not box.length:
        count = max(HORIZON_POINTS, 1 + min(MOST_POINTS, round(WAVE_POINTS * width / shortest)))
        x = np.linspace(0, width, count)
        return x, np.zeros_like(x), x.shape
    sides = np.array([width, box.length.si])
    wanted = SHEET_WAVE_POINTS * sides.max() / shortest
    spacing = sides.max() / (min(MOST_SHEET_POINTS, max(SHEET_POINTS, 1 + round(wanted))) - 1)
    axes = (np.linspace(0, side, 1 + max(1, round(side / spacing))) for side in sides)
    x, y = np.meshgrid(*axes)
    return x.ravel(), y.ravel(), x.shape


def _top(entry):
    """Return the height of a horizon as a function of x and y, m."""
    depth, wave = entry.depth.si, entry.cosine
    if wave is None:
        return lambda x, y=0.0: np.full_like(x, -depth)
    k, a = 2 * np.pi / wave.wavelength.si, wave.amplitude.si
    if not wave.wavelength_y:
        return lambda x, y=0.0: -depth + a * np.cos(k * (x - wave.phase.si))
    across, phase = 2 * np.pi / wave.wavelength_y.si, wave.phase_y.si if wave.phase_y else 0.0
    return lambda x, y: -depth + a * np.cos(k * (x - wave.phase.si)) * np.cos(across * (y - phase))


def _layer_names(layers):
    """Return the names of layers: their own or their rock's, numbered where one comes again."""
    names = [layer.name or layer.rock for layer in layers]
    return tuple(
        f"{name} {names[: i + 1].count(name)}" if names.count(name) > 1 else name
        for i, name in enumerate(names)
    )


def from_file(case, source, tree):
    """Return the shape of a file of polygons or of particles."""
    section = case.section
    settings = (SCALES[section.coordinates], SIGNS[section.vertical])
    if section.particles:
        return _from_cloud(case, cloud.read_cloud(source, section.particles, *settings), tree)
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
    return Shape(found.outline, found.units, rocks, found.unit_at, found.lines, found.notes)


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


def _from_cloud(case, found, tree):
    """Return the shape of a cloud, a tuple of positions, rows and unit names."""
    from scipy.spatial import cKDTree

    x, unit, names = found
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
    return Shape(
        outline,
        names,
        rocks,
        lambda points: unit[nearest.query(points)[1]],
        (),
        ("a cloud of particles brings no horizons; none are followed",),
        Cloud(x, unit),
    )

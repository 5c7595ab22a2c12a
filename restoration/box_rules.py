"""What a box in three dimensions can be asked for so far; the rest is refused by name."""

from restoration.words import listed, quoted

ELEMENTS = ("P2-P1", "P2b-P1dg")
WALLS = ("free-slip", "no-slip")
# What is possible, by entry.
POSSIBLE = (
    (("mesh", "element"), ELEMENTS),
    (("mesh", "interfaces"), ("particles",)),
    (("transfer", "density"), ("projection", "hat", "cell")),
    (("transfer", "viscosity"), ("hat", "cell")),
    (("particles", "velocity"), ("plain",)),
    (("certificate",), ("off", False)),
    (("output", "arrows"), (False,)),
)
# Entries that no box with a length takes yet.
ABSENT = {
    ("section", "file"): "a section from a file",
    ("section", "particles"): "a cloud of particles",
    ("faults",): "a fault",
    ("surface",): "a free surface",
    ("mesh", "refine"): "a mesh that is finer in places",
    ("time", "stop"): "a run that stops by itself",
    ("time", "known_age"): "a known age",
}
# Entries that only a box with a length has a use for.
ONLY = (("boundary", "front"), ("boundary", "back"))


def has_length(tree):
    """Return whether the box of a case has a length, and with it three dimensions."""
    return tree.raw(("section", "box", "length")) is not None


def box_faults(tree):
    """Return the faults of what the dimensions of a case have no use for.

    Args:
        tree: `tree.Tree` of the case file.
    """
    faults = _too_flat(tree) if not has_length(tree) else _too_deep(tree)
    return faults + _wrong_cells(tree)


def _too_flat(tree):
    """Return the faults of entries that need a third dimension."""
    waves = [
        ("section", "layers", i, "top", "cosine", name)
        for i in range(len(_layers(tree)))
        for name in ("wavelength_y", "phase_y")
    ]
    message = "a section has two dimensions; remove it, or give the box a length along y"
    given = [path for path in (*ONLY, *waves) if tree.raw(path) is not None]
    return [tree.fault(path, message, at="key") for path in given]


def _too_deep(tree):
    """Return the faults of entries that have two dimensions only."""
    faults, what = [], "in three dimensions (section.box.length)"
    for path, name in ABSENT.items():
        if tree.raw(path):
            message = f"{name} is not possible {what} yet; remove it, or the length of the box"
            faults.append(tree.fault(path, message, at="key"))
    for path, known in POSSIBLE:
        value = tree.raw(path)
        if value is not None and value not in known:
            message = f"{quoted(value)} is not possible {what} yet; possible: {_told(known)}"
            faults.append(tree.fault(path, message))
    walls = tree.raw(("boundary",))
    for name, kind in walls.items() if isinstance(walls, dict) else ():
        if kind is not None and kind not in WALLS:
            message = f"{quoted(kind)} is not possible {what} yet; possible: {listed(WALLS)}"
            faults.append(tree.fault(("boundary", name), message))
    return faults


def _wrong_cells(tree):
    """Return the fault of a mesh of as many numbers as the case has not dimensions."""
    cells, deep = tree.raw(("mesh", "cells")), has_length(tree)
    if not isinstance(cells, list) or len(cells) != (2 if deep else 3):
        return []
    ask = "write [along x, along y, up]" if deep else "a section has two, [across, up]"
    return [tree.fault(("mesh", "cells"), f"{quoted(cells)}: {ask}, or one for the shortest side")]


def _layers(tree):
    layers = tree.raw(("section", "layers"))
    return layers if isinstance(layers, list) else []


def _told(values):
    return listed([value for value in values if value is not False] or ["false"])

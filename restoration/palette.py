"""Colours of rocks and units: the field's habits first, then a palette, shades within a rock."""

import colorsys
from math import gcd

# A word in the name of a rock, and its colour.
HABITS = {
    "salt": "#d78fb5",
    "halite": "#d78fb5",
    "evaporite": "#c98fc0",
    "gypsum": "#d9a7c7",
    "anhydrite": "#c79ad0",
    "basement": "#8f8f94",
    "granite": "#c97f74",
    "basalt": "#5f6670",
    "mantle": "#7d8f69",
    "lithosphere": "#b59f80",
    "water": "#a9cfe8",
    "air": "#eaf4fb",
    "limestone": "#8fb4cf",
    "carbonate": "#8fb4cf",
    "chalk": "#d5e3ec",
    "sand": "#e6cf7f",
    "shale": "#93a08a",
    "clay": "#a3977f",
    "mud": "#8c8577",
    "marl": "#b7bf9a",
    "fault": "#c0504d",
    "sediment": "#cda764",
    "overburden": "#cda764",
}
OTHERS = ("#b9a26a", "#7fa88f", "#c48a5a", "#93a9c2", "#a89bb8", "#c9bf8f", "#7d9a9e", "#b07f7f")
SPREAD = 0.34  # how far the shades of a rock lie apart, in lightness


def unit_colors(rocks, rock_of_unit, given):
    """Return the colours of rocks and of units, ``#rrggbb``.

    Args:
        rocks: names of the rocks.
        rock_of_unit: row of the rock of every unit.
        given: colour of every rock from the case, None where there is none.

    Returns:
        Two lists, of rocks and of units.
    """
    taken, of_rocks = set(filter(None, given)), []
    for name, color in zip(rocks, given, strict=True):
        color = color or _habit(name)
        if color in taken and color not in given:
            color = None
        color = color or next((c for c in OTHERS if c not in taken), OTHERS[len(of_rocks) % 8])
        taken.add(color)
        of_rocks.append(color)
    of_units = []
    for unit, rock in enumerate(rock_of_unit):
        family = [other for other, r in enumerate(rock_of_unit) if r == rock]
        of_units.append(_shade(of_rocks[rock], SPREAD * _step(family.index(unit), len(family))))
    return of_rocks, of_units


def _step(place, count):
    """Return a lightness from -0.5 to 0.5, each once, far apart for neighbours in the column."""
    if count == 1:
        return 0.0
    stride = next(k for k in range(max(2, round(0.4 * count)), count + 2) if gcd(k, count) == 1)
    return (place * stride % count) / (count - 1) - 0.5


def _habit(name):
    folded = name.casefold()
    return next((color for word, color in HABITS.items() if word in folded), None)


def _shade(color, lighter):
    """Return a colour of the same hue that is lighter by a part of the range."""
    if not lighter:
        return color
    red, green, blue = (int(color[i : i + 2], 16) / 255 for i in (1, 3, 5))
    hue, light, full = colorsys.rgb_to_hls(red, green, blue)
    light = min(0.92, max(0.18, light + lighter))
    return "#" + "".join(f"{round(255 * c):02x}" for c in colorsys.hls_to_rgb(hue, light, full))

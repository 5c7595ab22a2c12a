"""Draws section.geojson: a salt diapir through five layers, after no particular place.

Run from the repository: ``.venv/bin/python cases/salt-diapir/draw.py``.
"""

import json
from pathlib import Path

import numpy as np
import shapely
from scipy.interpolate import PchipInterpolator

WIDTH, DEPTH, GRID = 10_000.0, 6_000.0, 0.1  # m
# Half width of the diapir at heights above the base of the section, m: pedestal, stem, bulb.
HEIGHTS = np.array([0, 700, 850, 1100, 1600, 2400, 3200, 3800, 4300, 4600, 4700])
HALF_WIDTHS = np.array([5000, 5000, 1900, 1000, 650, 560, 700, 900, 800, 420, 0])
AXIS = 4_800.0  # m, off the middle, so that left and right can be told apart
LAYERS = {"A": 900.0, "B": 1900.0, "C": 3000.0, "D": 4100.0, "E": 5200.0}  # m, bases on the flanks
DRAG = 260.0  # m, how far the layers are dragged up along the stem


def salt():
    """Return the salt: a source layer of 700 m and the diapir above it."""
    z = np.linspace(HEIGHTS[1], HEIGHTS[-1], 160)
    half = PchipInterpolator(HEIGHTS[1:], HALF_WIDTHS[1:])(z)
    left, right = np.clip(AXIS - half, 0, WIDTH), np.clip(AXIS + half, 0, WIDTH)
    lean = 150 * np.sin(np.pi * (z - z[0]) / (z[-1] - z[0]))  # the stem is not quite straight
    inner = (left > 0) & (right < WIDTH)
    flank = [np.column_stack([side + lean, z])[inner] for side in (left, right)]
    ring = [[0, 0], [WIDTH, 0], [WIDTH, HEIGHTS[1]], *flank[1], *flank[0][::-1], [0, HEIGHTS[1]]]
    return shapely.Polygon(ring)


def top(base):
    """Return the line at the base of a layer, dragged up towards the diapir."""
    x = np.linspace(0, WIDTH, 201)
    drag = DRAG * np.exp(-(((x - AXIS) / 1600) ** 2)) * (1 - base / 7000)
    return np.column_stack([x, base + drag])


def units():
    """Return (unit, rock, polygon): faces of one arrangement of lines, so that nothing gapes."""
    frame = shapely.box(0, 0, WIDTH, DEPTH)
    body = salt()
    tops = [top(base) for base in list(LAYERS.values())[1:]]
    edges = [frame.exterior, body.exterior, *map(shapely.LineString, tops)]
    faces = shapely.get_parts(shapely.polygonize([shapely.union_all(edges, grid_size=GRID)]))
    named = {}
    for face in faces:
        x, z = shapely.get_coordinates(face.representative_point())[0]
        layer = sum(z > np.interp(x, *line.T) for line in tops)
        in_salt = body.contains(face.representative_point())
        key = ("salt", "salt", 0) if in_salt else (list(LAYERS)[layer], "sediment", int(x > AXIS))
        named.setdefault(key, []).append(face)
    for (unit, kind, _), parts in sorted(named.items()):
        for part in shapely.get_parts(shapely.union_all(parts)):
            yield unit, kind, part


def main():
    """Write the section beside this file."""
    features = [
        {
            "type": "Feature",
            "properties": {"unit": unit, "kind": kind},
            "geometry": {
                "type": "Polygon",
                "coordinates": [
                    [[round(x, 1), round(z - DEPTH, 1)] for x, z in ring.coords]
                    for ring in (part.exterior, *part.interiors)
                ],
            },
        }
        for unit, kind, part in units()
    ]
    text = json.dumps({"type": "FeatureCollection", "crs": None, "features": features})
    Path(__file__).with_name("section.geojson").write_text(text + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()

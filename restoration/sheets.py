"""Horizons in three dimensions: sheets of points, their triangles, and what can be told of them."""

import numpy as np

from restoration.diagnostics import summary


def triangles(shape):
    """Return the triangles of a grid of points, rows of three, shape (m, 3), int32.

    Args:
        shape: rows and columns of the grid.
    """
    number = np.arange(np.prod(shape), dtype=np.int32).reshape(shape)
    a, b, c, d = (
        part.ravel()
        for part in (number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1])
    )
    return np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])


def joined(sheets):
    """Return points, triangles and the number of the sheet of every point, of all sheets.

    Args:
        sheets: `scene.Sheet`s, one at least.
    """
    first = np.cumsum([0, *(len(sheet.points) for sheet in sheets)])
    parts = zip(sheets, first, strict=False)
    of = np.repeat(np.arange(len(sheets), dtype=np.int16), np.diff(first))
    cells = np.concatenate([start + triangles(sheet.shape) for sheet, start in parts])
    return np.concatenate([sheet.points for sheet in sheets]), cells.astype(np.int32), of


def sheet_distances(before, after):
    """Return how far the points of sheets are from where they were, one entry per sheet.

    The points move with the rock, so that this is what the rock of a horizon is off by, sideways
    too; the surface is off by less.

    Args:
        before, after: `scene.Sheet`s in the same order.

    Returns:
        List of ``{name, kind, mean_m, max_m}``.
    """
    rows = []
    for one, two in zip(before, after, strict=True):
        found = summary(np.linalg.norm(two.points - one.points, axis=1))
        entry = {"name": one.name, "kind": one.kind}
        rows.append(entry | {name: found[name] for name in ("mean_m", "max_m")})
    return rows


def flatness(sheets):
    """Return the root mean square of the height of all sheets, each about its mean, m."""
    off = [sheet.points[:, 2] - sheet.points[:, 2].mean() for sheet in sheets]
    return float(np.sqrt(np.mean(np.concatenate(off) ** 2))) if off else None


def crossing(sheet, y):
    """Return where a sheet crosses a vertical plane, segments of shape (n, 2, 2) in x and z, m.

    Args:
        sheet: `scene.Sheet`.
        y: of the plane, m.
    """
    corners = sheet.points[triangles(sheet.shape)]
    before = corners[..., 1] < y
    crosses = before.any(axis=1) & ~before.all(axis=1)
    corners, before = corners[crosses], before[crosses]
    # the corner that is alone on its side of the plane comes first
    alone = np.where(before.sum(axis=1) == 1, before.argmax(axis=1), (~before).argmax(axis=1))
    turn = (alone[:, None] + np.arange(3)) % 3
    corners = np.take_along_axis(corners, turn[..., None], axis=1)
    first, others = corners[:, :1], corners[:, 1:]
    share = (y - first[..., 1:2]) / (others[..., 1:2] - first[..., 1:2])
    return (first + share * (others - first))[..., ::2]

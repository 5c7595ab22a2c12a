"""Numbers that tell how a run went. Nothing here writes a file."""

import numpy as np
import shapely

from restoration.lines import as_drawn, surface_of
from restoration.particles import OUTSIDE
from restoration.transfer import FittedFields

LEAST = 1e-6  # m, shorter distances count as this in the histogram
LOG_BINS = np.arange(-6, 6.5, 0.5)  # log10 of m


def there_and_back(particles):
    """Return how far the particles are from where they started.

    Args:
        particles: `Particles` of a run that has returned to the time it started from.

    Returns:
        Distances, shape (n,), m, NaN for particles that were born later or are lost; and their
        mean, 99th percentile and maximum as a dict of ``mean_m``, ``p99_m``, ``max_m``.
    """
    distance = np.linalg.norm(particles.x - particles.start, axis=1)
    distance[particles.cell == OUTSIDE] = np.nan
    return distance, summary(distance[~np.isnan(distance)])


def summary(distance):
    """Return mean, 99th percentile and maximum of distances, m; None of none."""
    if not len(distance):
        return {"mean_m": None, "p99_m": None, "max_m": None}
    return {
        "mean_m": float(distance.mean()),
        "p99_m": float(np.percentile(distance, 99)),
        "max_m": float(distance.max()),
    }


def relief(lines):
    """Return relief, m, and root mean square of the slope of a free surface, for the run record.

    Args:
        lines: `MovingLine`s; without a surface among them both are None.
    """
    surface = surface_of(lines)
    if surface is None:
        return {"surface_relief_m": None, "surface_rms_slope": None}
    run, rise = np.diff(surface.points, axis=0).T
    slope = np.sqrt(np.sum(rise**2 / run) / np.sum(run))
    return {
        "surface_relief_m": float(np.ptp(surface.points[:, 1])),
        "surface_rms_slope": float(slope),
    }


def line_distances(before, after, kept=None):
    """Return the distances between lines of the same name, one entry per name; no edges of faults.

    Every vertex of one set is measured to the nearest point of the other set, both ways, so that
    neither a spike nor a missing piece goes unseen. Vertices count by the length they stand for.

    Args:
        before, after: `scene.Line`s.
        kept: which vertices of each line count, shape (n,) each, the same ones in both; None of
            all. Of lines that lost or won vertices on the way none can be told from another.

    Returns:
        List of ``{name, kind, mean_m, max_m}`` in the order of ``before``; None where no vertex
        counts.
    """
    rows = []
    if kept is None:
        kept = [np.ones(len(line.points), bool) for line in before]
    edges = [line.kind != "edge" for line in before]
    kept = [rows for rows, edge in zip(kept, edges, strict=True) if edge]
    before, after = ([line for line in lines if line.kind != "edge"] for lines in (before, after))
    for name, kind in dict.fromkeys((line.name, line.kind) for line in before):
        one, two = (
            [line.points for line in lines if line.name == name] for lines in (before, after)
        )
        counts = [rows for line, rows in zip(before, kept, strict=True) if line.name == name]
        distance, length = (
            np.concatenate(pair) for pair in zip(_to_set(one, two), _to_set(two, one), strict=True)
        )
        if not np.all(np.concatenate(counts)):
            counts = np.concatenate([*counts, *counts])
            distance, length = distance[counts], length[counts]
        mean = float(np.average(distance, weights=length)) if length.any() else 0.0
        most = float(distance.max()) if len(distance) else None
        rows.append(
            {"name": name, "kind": kind, "mean_m": None if most is None else mean, "max_m": most}
        )
    return rows


def _to_set(pieces, others):
    """Return distances of all vertices to the other pieces, and the length each stands for."""
    target = shapely.MultiLineString([shapely.LineString(points) for points in others])
    shapely.prepare(target)
    distance = [shapely.distance(shapely.points(points), target) for points in pieces]
    length = []
    for points in pieces:
        half = np.linalg.norm(np.diff(points, axis=0), axis=1) / 2
        length.append(np.r_[half, 0] + np.r_[0, half])
    return np.concatenate(distance), np.concatenate(length)


def volume_by_rock(scene, grid, particles):
    """Return the area each rock fills on the mesh, m^2 (volume per metre of strike), by name.

    In three dimensions the volume, m^3.

    The rock is read as the flow sees it, as its density goes to the mesh, so that clusters of
    particles and empty patches show; in a fitted mesh by the cells.

    Args:
        scene: `scene.Scene`.
        grid: `Grid` that the particles are located in.
        particles: `Particles`.
    """
    rock = np.array([unit.rock for unit in scene.units])
    table = (rock[:, None] == np.arange(len(scene.rocks))).astype(float)
    if isinstance(grid.fields, FittedFields):
        share = table[grid.fields.unit]
    else:
        p, weights = particles, grid.index.locate(particles.x, particles.cell)[1]
        hats = grid.fields.shares(table, p.cell, weights, p.unit, p.area)
        share = hats[grid.spaces.h_nodes].mean(axis=1)
        share[grid.fields.in_air] = 0
    volume = np.einsum("c,cr->r", grid.index.area, share)
    return {rock.name: float(v) for rock, v in zip(scene.rocks, volume, strict=True)}


def relative_change(first, last):
    """Return (last - first) / first of the entries of two dicts that are not zero in the first."""
    return {name: (last[name] - v) / v for name, v in first.items() if v}


def drawn_distances(before, after):
    """Return `line_distances` of moving lines, as drawn.

    Vertices that were added on the way are interpolated, and tell nothing of the rock.
    """
    return line_distances(as_drawn(before), as_drawn(after))


def compared(states, volume, distances=drawn_distances):
    """Return what a run has kept and lost between its marks, as entries of its record.

    Args:
        states: `State` at every mark; where the last is at the time of the first, there and back is
            compared too.
        volume: `volume_by_rock` of every one of them.
        distances: between the lines, or sheets, of two states.
    """
    changes = [relative_change(volume[0], later) for later in volume[1:]]
    found = {
        "area_change": sum(volume[-1].values()) / sum(volume[0].values()) - 1,
        "volume_by_rock_change": changes[-1],
        "volume_by_rock_largest_change": {
            name: max((change[name] for change in changes), key=abs) for name in changes[0]
        },
    }
    first, last = states[0], states[-1]
    if last.time != first.time:
        return found
    distance, stats = there_and_back(last.particles)
    counts, edges = np.histogram(
        np.log10(np.maximum(distance[~np.isnan(distance)], LEAST)), bins=LOG_BINS
    )
    histogram = {"log10_m": edges.tolist(), "count": counts.tolist()}
    return found | {
        "there_and_back": stats | {"histogram": histogram},
        "horizons": distances(first.lines, last.lines),
    }

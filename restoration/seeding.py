"""Where particles are seeded: a lattice that is denser where two rocks meet."""

import numpy as np
from scipy.ndimage import distance_transform_edt

from restoration.bands import areas, distance_to

ACROSS = 2  # particles at least, in a row across the band of a fault
MOST = 1000  # particles in a lattice square for that


def seed_points(scene):
    """Return positions, units and areas of the particles of a scene.

    The lattice follows the columns of the outline. A lattice square within one mesh cell of a
    contact between different rocks holds ``densify`` particles of low discrepancy instead of one
    (paper, sect. 3.4), each standing for its share of the square; where the mesh is finer near
    contacts and in the bands of faults, more in proportion. Squares that a band touches hold so
    many that two lie across the band.

    Args:
        scene: `scene.Scene`.

    Returns:
        Positions (n, 2), m; rows of the unit table (n,); areas (n,), m^2.
    """
    outline, plan = scene.outline, scene.particles
    rng = np.random.default_rng(plan.seed)
    share = _share(scene)
    up, across = share.shape
    share = share.ravel()
    k, i = np.divmod(np.repeat(np.arange(share.size), share), across)
    within = _r2_sequence(share)
    spread = plan.jitter / np.sqrt(share[k * across + i])[:, None]
    within = np.clip(within + spread * (rng.random(within.shape) - 0.5), 0, 1 - 1e-9)
    fraction = (np.column_stack([i, k]) + within) / (across, up)
    x, height = _to_section(outline, fraction)
    area = outline.width / across * height / up / share[k * across + i]
    return x, scene.unit_at(x), area


def count_points(scene):
    """Return how many particles `seed_points` would seed."""
    return int(_share(scene).sum())


def _share(scene):
    """Return the number of particles in every lattice square, shape (up, across)."""
    outline, cells, plan = scene.outline, scene.cells, scene.particles
    count = 4 * cells[0] * cells[1] * plan.per_cell
    across = max(cells[0], round(np.sqrt(count * outline.width / outline.height)))
    up = max(cells[1], round(count / across))
    middle = np.stack(
        np.meshgrid((np.arange(across) + 0.5) / across, (np.arange(up) + 0.5) / up), axis=-1
    )
    x, _ = _to_section(outline, middle.reshape(-1, 2))
    unit = scene.unit_at(x)
    rock = np.array([u.rock for u in scene.units])[unit].reshape(up, across)
    alone = np.ones(rock.shape, bool)  # no other rock in the next square
    for axis in (0, 1):
        differs = np.diff(rock, axis=axis) != 0
        one, two = [slice(None)] * 2, [slice(None)] * 2
        one[axis], two[axis] = slice(None, -1), slice(1, None)
        alone[tuple(one)] &= ~differs
        alone[tuple(two)] &= ~differs
    square = outline.height / up, outline.width / across
    bands = areas(scene.lines)
    off = {  # of the middles of the squares from the edges of the bands
        name: distance_to(area, min(square) / 2)(x).reshape(rock.shape)
        for name, area in bands.items()
    }
    refine = scene.mesh.refine
    levels = refine.levels if refine and "interfaces" in refine.where else 0
    if (alone.all() and not bands) or (plan.densify == 1 and not levels and not bands):
        return np.ones(rock.shape, int)
    reach = max(outline.width / cells[0], outline.height / cells[1])
    finest = reach / 2**levels
    # from the middle of a square to the contact at the edge of the nearest one that touches it
    distance = np.full(rock.shape, np.inf)
    if not alone.all():
        distance = distance_transform_edt(alone, sampling=square) + min(square) / 2
    edge = np.min([np.full(rock.shape, np.inf), *map(np.abs, off.values())], axis=0)
    wanted = np.full(rock.shape, reach)
    if levels:
        wanted = np.minimum(wanted, graded(np.minimum(distance, edge), finest))
    at_bands = finest
    if refine and "faults" in refine.where:
        at_bands = reach / 2**refine.levels
        inside = np.min([np.full(rock.shape, np.inf), *off.values()], axis=0).clip(0)
        wanted = np.minimum(wanted, graded(inside, at_bands))
    dense = (distance < max(finest, min(square))) | (edge < max(at_bands, min(square)))
    share = np.where(dense, plan.densify, 1)
    share = share * np.rint((reach / wanted) ** 2).astype(int)
    for fault in scene.faults:
        least = np.ceil(np.prod(square) * (ACROSS / fault.width) ** 2)
        touched = off[fault.name] < np.hypot(*square) / 2
        share[touched] = np.maximum(share[touched], min(int(least), MOST))
    return share


def graded(distance, finest):
    """Return the wanted size of cells at a distance from a line, m: two of each size, then larger.

    Args:
        distance: shape (n,), m.
        finest: size at the line, m.
    """
    return 1.01 * np.maximum(finest, distance / 2)  # a little more, against rounding


def _to_section(outline, fraction):
    """Return the points at fractions (n, 2) of width and height, and the height there."""
    x = outline.surface[0, 0] + fraction[:, 0] * outline.width
    top = np.interp(x, *outline.surface.T)
    bottom = np.interp(x, *outline.base.T)
    return np.column_stack([x, bottom + fraction[:, 1] * (top - bottom)]), top - bottom


def _r2_sequence(share):
    """Return points of low discrepancy in the unit square, ``share`` of them for every square.

    Each pattern is moved to have its mean in the middle: a pattern that lies low in all squares
    would lift every contact.
    Source: the additive recurrence with the plastic number, the two-dimensional analogue of the
    golden ratio.
    """
    plastic = 1.324717957244746
    patterns = {}
    for count in np.unique(share):
        points = (0.5 + np.arange(1, count + 1)[:, None] / (plastic, plastic**2)) % 1
        points -= points.mean(axis=0)
        patterns[count] = 0.5 + points * min(1.0, 0.499 / max(np.abs(points).max(), 1e-9))
    first = np.r_[0, np.cumsum(share)[:-1]]
    within = np.empty((share.sum(), 2))
    for count, points in patterns.items():
        rows = first[share == count][:, None] + np.arange(count)
        within[rows] = points
    return within

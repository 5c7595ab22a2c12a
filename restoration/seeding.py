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
        Positions (n, dim), m; rows of the unit table (n,); areas (n,), m^2, or volumes, m^3.
    """
    plan, dim = scene.particles, scene.dim
    rng = np.random.default_rng(plan.seed)
    share = _share(scene)
    counts = share.shape[::-1]
    share = share.ravel()
    square = np.repeat(np.arange(share.size), share)
    corner = np.column_stack(np.unravel_index(square, counts[::-1])[::-1])
    within = _low_discrepancy(share, dim)
    spread = plan.jitter / (share[square] ** (1 / dim))[:, None]
    within = np.clip(within + spread * (rng.random(within.shape) - 0.5), 0, 1 - 1e-9)
    x, height = _to_section(scene, (corner + within) / counts)
    area = scene.outline.width / counts[0] * height / counts[-1] / share[square]
    return x, scene.unit_at(x), area if dim == 2 else area * scene.length / counts[1]


def count_points(scene):
    """Return how many particles `seed_points` would seed."""
    return int(_share(scene).sum())


def _share(scene):
    """Return the number of particles in every lattice square or cube, shape (up, .., across)."""
    plan, dim, shape = scene.particles, scene.dim, _lattice(scene)
    middle = np.meshgrid(*((np.arange(n) + 0.5) / n for n in shape), indexing="ij")[::-1]
    x, _ = _to_section(scene, np.stack(middle, axis=-1).reshape(-1, dim))
    unit = scene.unit_at(x)
    rock = np.array([u.rock for u in scene.units])[unit].reshape(shape)
    alone = np.ones(rock.shape, bool)  # no other rock in the next square
    for axis in range(dim):
        differs = np.diff(rock, axis=axis) != 0
        one, two = [slice(None)] * dim, [slice(None)] * dim
        one[axis], two[axis] = slice(None, -1), slice(1, None)
        alone[tuple(one)] &= ~differs
        alone[tuple(two)] &= ~differs
    square = np.divide(scene.extent[::-1], shape)
    bands = areas(scene.lines)
    off = {  # of the middles of the squares from the edges of the bands
        name: distance_to(area, min(square) / 2)(x).reshape(rock.shape)
        for name, area in bands.items()
    }
    refine = scene.mesh.refine
    levels = refine.levels if refine and "interfaces" in refine.where else 0
    if (alone.all() and not bands) or (plan.densify == 1 and not levels and not bands):
        return np.ones(rock.shape, int)
    reach = max(np.divide(scene.extent, scene.cells))
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


def _lattice(scene):
    """Return squares or cubes of the lattice: up, in three dimensions along y, and across."""
    cells, count = scene.cells, scene.particles.per_cell
    width, *_, height = scene.extent
    if scene.dim == 3:
        size = (np.prod(scene.extent) / (12 * np.prod(cells) * count)) ** (1 / 3)
        counts = [max(n, round(side / size)) for n, side in zip(cells, scene.extent, strict=True)]
        return tuple(counts[::-1])
    count *= 4 * cells[0] * cells[1]
    across = max(cells[0], round(np.sqrt(count * width / height)))
    return max(cells[1], round(count / across)), across


def graded(distance, finest):
    """Return the wanted size of cells at a distance from a line, m: two of each size, then larger.

    Args:
        distance: shape (n,), m.
        finest: size at the line, m.
    """
    return 1.01 * np.maximum(finest, distance / 2)  # a little more, against rounding


def _to_section(scene, fraction):
    """Return the points at fractions (n, dim) of the extent, and the height there."""
    outline = scene.outline
    x = outline.surface[0, 0] + fraction[:, 0] * outline.width
    top = np.interp(x, *outline.surface.T)
    bottom = np.interp(x, *outline.base.T)
    along = [] if scene.length is None else [fraction[:, 1] * scene.length]
    z = bottom + fraction[:, -1] * (top - bottom)
    return np.column_stack([x, *along, z]), top - bottom


def _low_discrepancy(share, dim):
    """Return points of low discrepancy in the unit square or cube, ``share`` for every one.

    Each pattern is moved to have its mean in the middle: a pattern that lies low in all squares
    would lift every contact.
    Source: the additive recurrence with the plastic number, the two-dimensional analogue of the
    golden ratio, and with the next of that row in three dimensions: r^(dim + 1) = r + 1.
    """
    ratio = {2: 1.324717957244746, 3: 1.2207440846057596}[dim]
    powers = tuple(ratio**n for n in range(1, dim + 1))
    patterns = {}
    for count in np.unique(share):
        points = (0.5 + np.arange(1, count + 1)[:, None] / powers) % 1
        points -= points.mean(axis=0)
        patterns[count] = 0.5 + points * min(1.0, 0.499 / max(np.abs(points).max(), 1e-9))
    first = np.r_[0, np.cumsum(share)[:-1]]
    within = np.empty((share.sum(), dim))
    for count, points in patterns.items():
        rows = first[share == count][:, None] + np.arange(count)
        within[rows] = points
    return within

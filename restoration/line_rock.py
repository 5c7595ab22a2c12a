"""Rock from the lines between it: exact moments of what a rock has in the cells that lines cross.

A property that is constant between lines jumps across each of them by a known amount, so that its
integrals over a cell are integrals along what the lines have in it, and along the edges of the
cell. Seen from corner 0 of a triangle, with signed triangles (corner, a, b) of pieces a -> b,

    int_c rho hat_i = sum over pieces of (rho_left - rho_right) int_(corner, a, b) hat_i
                    + the same for the edge opposite, with the rock along it,

as the other two edges pass through the corner. No polygons are made. The sum is smooth in the
positions of the lines, also where they run along edges, touch or cross each other a little.

Which rock lies along an edge is told by what crosses it: vertices with no line between them are of
one rock, that of the side of the lines around them. Where an edge disagrees, as around the end of a
line inside the section, its cells are left to the particles.
"""

from functools import lru_cache

import numba
import numpy as np
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components

from restoration.ranks import ALONE

ON_WALL = 1e-9  # slack of the hats of a point on a wall
UNKNOWN = -2  # cell of a point that nobody had to know
SAMPLES = 64  # segments of a drawn line that are asked for the rock beside them
BESIDE = 1e-3  # of a segment's length: how far beside it
NEAR_WALL = 0.25  # cells: an end of a line this near to a wall meets it
BEYOND = 0.5  # cells by which such a line is led on


@lru_cache(maxsize=4)
def sides_of(scene):
    """Return name and units on the left and the right of every horizon of a scene, in order.

    A line is a contact of two units from end to end, and as it moves with the rock stays so.
    """
    found = []
    for line in scene.lines:
        if line.kind != "horizon":
            continue
        step = np.diff(line.points, axis=0)
        rows = np.unique(np.linspace(0, len(step) - 1, SAMPLES).astype(int))
        middle = (line.points[:-1] + line.points[1:])[rows] / 2
        off = BESIDE * step[rows] @ np.array([[0.0, 1.0], [-1.0, 0.0]])
        left, right = (scene.unit_at(middle + way * off) for way in (1, -1))
        found.append((line.name, int(np.bincount(left).argmax()), int(np.bincount(right).argmax())))
    return tuple(found)


class LineRock:
    """Finds the moments of rock between lines on a mesh of triangles, which may move.

    Args:
        scene: `scene.Scene`; its lines in motion keep their order, but some may be gone.
        spaces, index: `Spaces` and `CellIndex` of the mesh.
        rock: which cells are of the section and not of the air, shape (cells,), bool.
        ranks: `ranks.Ranks` that have some of the particles each.
    """

    def __init__(self, scene, spaces, index, rock, ranks=ALONE):
        self._ranks = ranks
        self._sides, self._units = sides_of(scene), len(scene.units)
        self._index, self._rock = index, rock
        self._nodes = np.asarray(spaces.h_nodes, np.int64)
        beyond = index.neighbours >= 0
        beyond &= rock[np.maximum(index.neighbours, 0)]
        self._neighbours = np.where(beyond, index.neighbours, -1).astype(np.int64)
        ends = np.sort(self._nodes[:, [[1, 2], [2, 0], [0, 1]]], axis=2)
        self._ends, edge = np.unique(ends[rock].reshape(-1, 2), axis=0, return_inverse=True)
        self._edge = np.full(self._nodes.shape, -1, np.int64)
        self._edge[rock] = edge.reshape(-1, 3)
        self._walls = np.nonzero((self._neighbours < 0) & rock[:, None])
        self._hash = np.random.default_rng(0).integers(1, 2**40, self._units)

    def moments(self, lines, values, particles):
        """Return the integrals of properties times the hats over every cell, and what is unsure.

        Args:
            lines: moving lines at this moment.
            values: of every unit, shape (units, properties).
            particles: (cell, weights, unit, area) as `RockFields.fill` has them, which tell the
                rock where no line does.

        Returns:
            Moments, shape (cells, 3, properties), and which cells the lines contradict each other
            in, shape (cells,), bool; those of the air count as neither.
        """
        corners, values = self._index.corners, np.ascontiguousarray(values, float)
        points, cells, first, left, right = self._polylines(lines)
        room = 2 * len(points) + 2 * len(corners)
        while True:
            moments = np.zeros((*self._nodes.shape, values.shape[1]))
            mesh = corners, self._neighbours, self._edge, self._nodes
            edge, at, sides = np.empty(room, np.int64), np.empty(room), np.empty((room, 2), int)
            crossed = _follow(
                points, cells, first, left, right, values, *mesh, moments, edge, at, sides
            )
            if crossed < 0:
                cells = np.where(cells == UNKNOWN, self._inside(points), cells)
            elif crossed <= room:
                break
            room = max(room, 2 * crossed)
        order = np.lexsort((at[:crossed], edge[:crossed]))
        edge, at, sides = edge[order], at[order], sides[order]
        begin = np.searchsorted(edge, np.arange(len(self._ends) + 1))
        unit = self._at_vertices(begin, sides, particles)
        _add_edges(begin, at, sides, unit, values, *mesh, self._rock, moments)
        jumps = self._hash[sides[:, 1]] - self._hash[sides[:, 0]]
        total = np.diff(np.r_[0, np.cumsum(jumps)][begin])
        wrong = self._hash[unit[self._ends]] @ [-1, 1] != total
        return moments, wrong[self._edge].any(axis=1) & self._rock

    def _at_vertices(self, begin, sides, particles):
        """Return the unit at every vertex of the rock, shape (vertices,).

        Where a contact has a gap, one part of the mesh is told two units: there every vertex goes
        by the lines beside it, or else by the particles.
        """
        n = int(self._nodes.max()) + 1
        own = np.zeros((n, self._units), np.int64)
        _vote(begin, sides, self._ends, own)
        unit, sure = own.argmax(axis=1), np.count_nonzero(own, axis=1) == 1
        whole = self._ends[np.diff(begin) == 0]
        whole = whole[(unit[whole[:, 0]] == unit[whole[:, 1]]) | ~sure[whole].all(axis=1)]
        graph = coo_matrix((np.ones(len(whole), bool), tuple(whole.T)), (n, n))
        count, part = connected_components(graph, directed=False)
        votes = _sums(part, own, count)
        told, of_part = np.count_nonzero(votes, axis=1)[part], votes.argmax(axis=1)[part]
        if not self._ranks.any((told[self._ends] != 1).any()):
            return of_part
        by_particles = np.zeros((n, self._units))
        _told_by_particles(*particles, self._nodes, by_particles)
        by_particles = self._ranks.sum(by_particles)
        of_silent = _sums(part, by_particles, count).argmax(axis=1)[part]
        of_torn = np.where(by_particles.any(axis=1), by_particles.argmax(axis=1), of_part)
        of_torn = np.where(sure, unit, of_torn)
        return np.select([told == 0, told == 1], [of_silent, of_part], of_torn)

    def _polylines(self, lines):
        """Return the points of all horizons led on at their ends, their cells, and their sides.

        Cells are -1 outside of the rock, UNKNOWN between the ends of lines; ``first`` has the row
        of each line's first point.
        """
        lines = [line for line in lines if line.kind == "horizon"]
        sides = _matched(lines, self._sides)
        chosen = [i for i, (one, other) in enumerate(sides) if one != other]
        parts = [lines[i].points for i in chosen]
        x = np.concatenate([*parts, np.empty((0, 2))])
        last = np.cumsum([len(part) for part in parts], dtype=int)
        ends = np.column_stack([np.r_[0, last[:-1]], last - 1]).ravel() if parts else last
        cell = np.full(len(x), UNKNOWN)
        cell[ends] = self._inside(x[ends])
        on, to = self._led_on(x[ends], cell[ends])
        ends[1::2] += 1
        x, cell = np.insert(x, ends, on, axis=0), np.insert(cell, ends, to)
        left, right = np.array([sides[i] for i in chosen], int).reshape(-1, 2).T
        first = np.r_[0, last + 2 * np.arange(1, len(last) + 1)]
        return x, cell, first, np.ascontiguousarray(left), np.ascontiguousarray(right)

    def _inside(self, x):
        """Return the cells of points, -1 for those outside of the rock."""
        if not len(x):
            return np.empty(0, np.int64)
        cell = self._index.locate(x, self._index.guess(x))[0].astype(np.int64)
        cell[~self._rock[cell]] = -1
        a, b, c = np.moveaxis(self._index.corners[np.maximum(cell, 0)], 1, 0)
        whole = _cross(b - a, c - a)
        hats = np.stack([_cross(c - b, x - b), _cross(a - c, x - c), _cross(b - a, x - a)]) / whole
        return np.where(hats.min(axis=0) < -ON_WALL, -1, cell)

    def _led_on(self, x, cell):
        """Return a point beyond each end of a line and its cell.

        Through the wall that is near; otherwise to the centre of the cell, where all that end in
        one point meet again and cancel.
        """
        if not len(x):
            return x, cell
        corners, (of, k) = self._index.corners, self._walls
        a, b, inner = (corners[of, (k + i) % 3] for i in (1, 2, 0))
        along = b - a
        length = np.linalg.norm(along, axis=1)
        t = np.einsum("nwd,wd->nw", x[:, None] - a, along) / length**2
        foot = a + np.clip(t, 0, 1)[..., None] * along
        gap = np.linalg.norm(x[:, None] - foot, axis=2)
        wall, row = gap.argmin(axis=1), np.arange(len(x))
        size = np.sqrt(self._index.area[of[wall]])
        outward = np.column_stack([along[:, 1], -along[:, 0]]) / length[:, None]
        outward *= -np.sign(np.einsum("wd,wd->w", outward, inner - a))[:, None]
        beyond = foot[row, wall] + BEYOND * size[:, None] * outward[wall]
        out = (gap[row, wall] < NEAR_WALL * size) | (cell < 0)
        centre = corners[np.maximum(cell, 0)].mean(axis=1)
        return np.where(out[:, None], beyond, centre), np.where(out, -1, cell)


def _sums(part, values, count):
    """Return the sums of rows that belong to the same part, shape (count, ...)."""
    rows = np.arange(len(part) + 1)
    return csr_matrix((np.ones(len(part)), part, rows), (len(part), count)).T @ values


def _matched(lines, sides):
    """Return the sides of lines, of which some may be gone: a pair of units for each."""
    found, row = [], 0
    for line in lines:
        names = [name for name, *_ in sides[row:]]
        row += names.index(line.name)
        found.append(sides[row][1:])
        row += 1
    return found


def _cross(a, b):
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


@numba.njit(cache=True)
def _hats(x, corner):
    ax, az = corner[1, 0] - corner[0, 0], corner[1, 1] - corner[0, 1]
    bx, bz = corner[2, 0] - corner[0, 0], corner[2, 1] - corner[0, 1]
    px, pz = x[0] - corner[0, 0], x[1] - corner[0, 1]
    det = ax * bz - az * bx
    w1, w2 = (px * bz - pz * bx) / det, (ax * pz - az * px) / det
    return np.array([1.0 - w1 - w2, w1, w2]), det


@numba.njit(cache=True)
def _follow(
    points, cells, first, left, right, values, corners, neighbours, edges, nodes, moments, edge, at,
    sides,
):  # fmt: skip
    """Add what is beside the pieces of lines to the moments; note where lines cross edges.

    Returns:
        The number of crossings; more than there is room for where some were not noted, -1 where
        cells have to be known.
    """
    n = 0
    for line in range(len(left)):
        one, other = left[line], right[line]
        c = cells[first[line]]
        for i in range(first[line], first[line + 1] - 1):
            a, b = points[i], points[i + 1]
            if c >= 0:
                c, n = _walk(
                    a, b, c, one, other, values, corners, neighbours, edges, nodes, moments, edge,
                    at, sides, n,
                )  # fmt: skip
            if c < 0 and cells[i + 1] == UNKNOWN:
                return -1
            if c < 0 and cells[i + 1] >= 0:  # comes back: from there to where it came through
                c, n = _walk(
                    b, a, cells[i + 1], other, one, values, corners, neighbours, edges, nodes,
                    moments, edge, at, sides, n,
                )  # fmt: skip
                c = cells[i + 1]
    return n


@numba.njit(cache=True)
def _walk(
    a, b, c, one, other, values, corners, neighbours, edges, nodes, moments, edge, at, sides, n
):
    """Follow a segment from cell c; return where it ends, -1 for outside, and the crossings."""
    begin, came = 0.0, -1
    for _ in range(len(corners)):
        wa, det = _hats(a, corners[c])
        wb, _ = _hats(b, corners[c])
        k, end = -1, 1.0
        for m in range(3):
            # a point that `_inside` has on a wall is not beyond it
            least = -ON_WALL if neighbours[c, m] < 0 else 0.0
            if edges[c, m] != came and wb[m] < least:
                t = wa[m] / (wa[m] - wb[m]) if wa[m] > 0.0 else 0.0
                t = max(t, begin)
                if k < 0 or t < end:
                    k, end = m, t
        p, q = wa + begin * (wb - wa), wa + end * (wb - wa)
        area = det / 2 * (p[1] * q[2] - p[2] * q[1])
        for m in range(3):
            share = area * ((1.0 if m == 0 else 0.0) + p[m] + q[m]) / 3
            for j in range(values.shape[1]):
                moments[c, m, j] += share * (values[one, j] - values[other, j])
        if k < 0:
            return c, n
        if n < len(edge):
            r, s = (k + 1) % 3, (k + 2) % 3
            t = q[s] / (q[r] + q[s]) if q[r] + q[s] > 0.0 else 0.5
            t = min(max(t, 0.0), 1.0)
            # Counterclockwise from r to s the edge leads from the right of the line to its left.
            ahead = (nodes[c, r] < nodes[c, s]) == (det > 0.0)
            edge[n] = edges[c, k]
            at[n] = t if nodes[c, r] < nodes[c, s] else 1.0 - t
            sides[n, 0], sides[n, 1] = (other, one) if ahead else (one, other)
        n += 1
        begin, came, c = end, edges[c, k], neighbours[c, k]
        if c < 0:
            return -1, n
    return -1, n


@numba.njit(cache=True)
def _told_by_particles(cell, weights, unit, area, nodes, told):
    """Add the area of each particle to its unit at the vertices of its cell."""
    for i in range(len(cell)):
        if cell[i] >= 0:
            for k in range(3):
                told[nodes[cell[i], k], unit[i]] += weights[i, k] * area[i]


@numba.njit(cache=True)
def _vote(begin, sides, ends, votes):
    """Let every edge that is crossed tell the units of its ends, unless it is in two minds."""
    net = np.zeros(votes.shape[1], np.int64)
    for e in range(len(ends)):
        one, last = begin[e], begin[e + 1]
        if one == last:
            continue
        for i in range(one, last):
            net[sides[i, 0]] += 1
            net[sides[i, 1]] -= 1
        start, stop, sound = -1, -1, True
        for i in range(one, last):
            for u in sides[i]:
                if net[u] == 1 and start in (-1, u):
                    start = u
                elif net[u] == -1 and stop in (-1, u):
                    stop = u
                elif net[u] != 0:
                    sound = False
        if start < 0 and stop < 0:  # it ends where it began
            start = stop = sides[one, 0]
            for i in range(one + 1, last):
                sound = sound and sides[i - 1, 1] == sides[i, 0]
        for i in range(one, last):
            net[sides[i, 0]] = net[sides[i, 1]] = 0
        if sound and start >= 0 and stop >= 0:
            votes[ends[e, 0], start] += 1
            votes[ends[e, 1], stop] += 1


@numba.njit(cache=True)
def _add_edges(begin, at, sides, unit, values, corners, neighbours, edges, nodes, rock, moments):
    """Add the share of the edges opposite of the corners 0."""
    for c in range(len(corners)):
        if not rock[c]:
            continue
        _, det = _hats(corners[c, 0], corners[c])
        area, e = abs(det) / 2, edges[c, 0]
        for j in range(values.shape[1]):
            for m in range(3):
                moments[c, m, j] += values[unit[nodes[c, 1]], j] * area / 3
        ahead = nodes[c, 1] < nodes[c, 2]
        for i in range(begin[e], begin[e + 1]):
            t = at[i] if ahead else 1.0 - at[i]
            before, after = (sides[i, 0], sides[i, 1]) if ahead else (sides[i, 1], sides[i, 0])
            for j in range(values.shape[1]):
                share = (values[after, j] - values[before, j]) * area * (1.0 - t) / 3
                moments[c, 0, j] += share
                moments[c, 1, j] += share * (1.0 - t)
                moments[c, 2, j] += share * (1.0 + t)

"""The nodes of a fitted mesh on the lines of the rock, and all others, which give way to them."""

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import shapely

from meshes.chains import arc_lengths, best_nodes, chains
from restoration.lines import from_memory, memory_of
from restoration.surface import Extension, cell_shapes, standing

CORNER = np.radians(30)  # a line that turns more keeps a node where it does
LOOK = 0.2  # of an edge: how far to both sides of a node it is looked for a corner
OFF_LINE = 1e-5  # of the height: a node farther from its line keeps its distance
# A step begins on a new mesh where a cell has lost more than this part of its shape, or where an
# edge on a line is so many times longer than it was made; stages go on to the last.
BEGINNING_SHAPE, SHORTENED, LENGTHENED, WORST_SHAPE = 0.4, 0.35, 2.2, 0.15
FAR = 0.5  # of an edge: lines whose nodes are farther away than this are others
AXIS = {"left": 0, "right": 0, "base": 1, "surface": 1}  # along which nodes on a level wall stand


@dataclass(frozen=True, eq=False)
class Chain:
    """Nodes in the order of a line that they follow.

    Attributes:
        line: row of it among the lines.
        nodes: shape (n,).
        share: of the way from the first to the last node, at which each was made, shape (n,).
        edges: length of the edges as they were made, shape (n - 1,), m.
        ends: direction along which the first and the last node may slide on a wall, or None.
        surface: whether the line is a free surface: only the ends are carried along it.
        even: whether it ends where rock crosses a wall: its nodes spread out again in every step.
    """

    line: int
    nodes: np.ndarray
    share: np.ndarray
    edges: np.ndarray
    ends: tuple
    surface: bool
    even: bool


class Contacts:
    """Moves a fitted mesh with the lines that it was made for.

    The mesh is a function of the lines alone, as below a `surface.Top`: a node on a line is at a
    place between two vertices, which rock carries, and off it as `meshes.chains.best_nodes` has it,
    so that the areas beside a chain are those beside the line. All other nodes move by the harmonic
    extension of what these are away from where they were made.

    Args:
        section: fitted `meshes.data.SectionMesh`.
        spaces: `Spaces` of it.
        lines: `MovingLine`s that it was made for.
        crossed: names of the walls that rock crosses.
        rough: whether the surface has scarps: its nodes stay on it then.

    Attributes:
        chains: `Chain`s, those of a surface first.
    """

    def __init__(self, section, spaces, lines, crossed=(), rough=False):
        self.section, self._cells, self._rough = section, spaces.h_nodes, rough
        self._geometry = np.empty(int(spaces.h_nodes.max()) + 1, np.int64)
        self._geometry[spaces.h_nodes] = section.corner_vertices
        self._x = self._made = section.mesh.geometry.x[self._geometry, :2].copy()
        self._shape = cell_shapes(self._made[self._cells])
        self._lines = _upright(lines)
        self._walls, edges = self._sides()
        self.chains, self._at, self._off = [], [], np.zeros_like(self._made)
        self._find_chains(edges, crossed)
        # none where one rock fills the section
        nodes = [np.empty(0, np.int64), *(chain.nodes for chain in self.chains)]
        self._nodes = np.unique(np.concatenate(nodes))
        self._extension = Extension(spaces, self._held(), self._nodes)

    def hold(self, lines):
        """Take the places of the nodes on lines that may have other vertices than those before."""
        lines = _upright(lines)
        if len(lines) != len(self._lines) or _same(lines, self._lines):
            return
        places = []
        for chain in self.chains:
            line, x = lines[chain.line].points, self._x[chain.nodes]
            places.append(self._placed(chain, line, x))
            off = np.abs(_on(line, places[-1]) + self._off[chain.nodes] - x).max()
            if off > FAR * (chain.edges.min() if len(chain.edges) else np.inf):
                self._lines = ()  # other lines: no mesh of these follows them
                return
        self._at, self._lines = places, lines

    def carry(self, rows, lines):
        """Take the places of the nodes on lines after a step.

        Args:
            rows: the lines held, moved by the step.
            lines: the same with vertices added, removed or set right.
        """
        counts = [len(line.points) for line in rows]
        if counts == [len(line.points) for line in self._lines] and len(lines) == len(rows):
            self._x = self._material(_upright(rows))
            self.hold(lines)

    def memory(self):
        """Return where the nodes on lines are; see `recall`."""
        return {"x": self._x, "at": list(self._at), "lines": memory_of(self._lines)}

    def recall(self, memory):
        """Go on from what `memory` returned, of contacts made for the same mesh and lines."""
        self._x, self._at = memory["x"], list(memory["at"])
        self._lines = from_memory(memory["lines"])

    def follow(self, lines, rows=None, begins=False):
        """Move the mesh to lines.

        Args:
            lines: as they are.
            rows: the lines held with their vertices moved, where ``lines`` have others; else None.
            begins: whether a step begins, which asks for better cells.

        Returns:
            Whether all cells have kept their shape; if not, the mesh stands where it was.
        """
        held = lines if rows is None else rows
        if [len(line.points) for line in held] != [len(line.points) for line in self._lines]:
            return False
        lines = _upright(lines)
        x = self._material(_upright(held))
        carried = x.copy()
        for chain, at in zip(self.chains, self._at, strict=True):
            line, nodes = lines[chain.line].points, chain.nodes
            if len(nodes) < 2:
                continue
            if rows is not None or chain.surface:
                at = self._placed(chain, line, x[nodes])
            s = np.interp(at, np.arange(len(line)), arc_lengths(line))
            if not (np.diff(s) > 0).all():
                return False
            for end, slides in zip((0, -1), chain.ends, strict=True):
                if slides is not None:  # the line may have been cut there
                    x[nodes[end]] = _on(line, at[[end]])[0]
            if not (chain.surface and self._rough):
                across = (0.0, 1.0) if chain.surface else None
                x[nodes] = best_nodes(x[nodes], line, s, chain.ends, across)
            ratio = np.hypot(*np.diff(x[nodes], axis=0).T) / chain.edges
            if begins and not SHORTENED < ratio.min() <= ratio.max() < LENGTHENED:
                return False
        moved = self._made + self._extension(x[self._nodes] - self._made[self._nodes])
        kept = cell_shapes(moved[self._cells]) / self._shape
        if not kept.min() > (BEGINNING_SHAPE if begins else WORST_SHAPE):
            return False
        self._x = carried
        self.section.mesh.geometry.x[self._geometry, :2] = moved
        return True

    def across(self):
        """Return which cells reach from one line or wall to another, away from where these meet."""
        count = np.zeros(len(self._made), int)
        for chain in self.chains:
            count[chain.nodes] += 1
            if len(chain.nodes) > 1 and chain.nodes[0] == chain.nodes[-1]:
                count[chain.nodes[0]] -= 1
        for nodes in self._walls.values():
            count[nodes] += 1
        return (count[self._cells] == 1).all(axis=1)

    def _material(self, lines):
        """Return all nodes, those on lines where rock has carried them, shape (nodes, 2), m."""
        x = self._made.copy()
        for chain, at in zip(self.chains[::-1], self._at[::-1], strict=True):  # the first counts
            line, nodes = lines[chain.line].points, chain.nodes
            x[nodes] = _on(line, at) + self._off[nodes]
            for name, wall in self._walls.items():
                on = nodes[np.isin(nodes, wall)]
                if name in self.section.flat:
                    x[on, AXIS[name]] = self._made[on, AXIS[name]]
            if chain.surface:
                if (x[nodes[[0, -1]], 0] != self._made[nodes[[0, -1]], 0]).any():
                    x[nodes, 0] = _between(x[nodes, 0], chain.share)
                else:
                    x[nodes, 0] = self._made[nodes, 0]
                x[nodes[1:-1], 1] = np.interp(x[nodes[1:-1], 0], *line.T)
        return x

    def _placed(self, chain, line, x):
        """Return the places of the nodes of a chain on a line: vertices from its first, (n,)."""
        number = np.arange(len(line))
        if chain.surface:
            return np.interp(x[:, 0], line[:, 0], number)
        at = _nearest(line, x)
        if not np.array_equal(line[0], line[-1]):
            for end, slides in zip((0, -1), chain.ends, strict=True):
                if slides is not None:
                    at[end] = 0 if at[end] < number[-1] / 2 else number[-1]
        if chain.even:
            s = arc_lengths(line)
            at = np.interp(_between(np.interp(at, number, s), chain.share), s, number)
        return at

    def _sides(self):
        """Return the nodes on every wall, and the edges on a surface and between regions by kind.

        Both as nodes of `Spaces.H`. A free surface is no wall here.
        """
        section, hats, beside = self.section, self._cells, self.section.neighbours
        facets = section.mesh.topology.connectivity(2, 1).array.reshape(-1, 3)
        tag = np.zeros(facets.max() + 1, np.int32)
        tag[section.facet_tags.indices] = section.facet_tags.values
        free = any(line.kind == "surface" for line in self._lines)
        walls = {name: [] for name in section.wall_tags if not (free and name == "surface")}
        between = {"surface": [], "contacts": []}
        for k, others in enumerate(([1, 2], [0, 2], [0, 1])):
            for name, number in section.wall_tags.items():
                into = walls[name] if name in walls else between["surface"]
                into.append(hats[tag[facets[:, k]] == number][:, others])
            other = beside[:, k]
            parts = (other > np.arange(len(other))) & (section.regions != section.regions[other])
            between["contacts"].append(hats[parts][:, others])
        walls = {name: np.unique(np.concatenate(edges)) for name, edges in walls.items()}
        return walls, {k: np.concatenate(e) for k, e in between.items() if e}

    def _find_chains(self, edges, crossed):
        made, every = self._made, np.concatenate(list(edges.values()))
        degree = np.bincount(every.ravel(), minlength=len(made))
        on_walls = np.concatenate(list(self._walls.values()))
        walls_of = np.bincount(on_walls, minlength=len(made))
        slides, gates = {}, set()
        for name, nodes in self._walls.items():
            if name in self.section.flat:
                way = (0.0, 1.0) if AXIS[name] == 0 else (1.0, 0.0)
                slides |= dict.fromkeys(nodes[(degree[nodes] == 1) & (walls_of[nodes] == 1)], way)
            if name in crossed:
                gates |= set(nodes)
        outcrops = np.intersect1d(edges.get("surface", []), edges["contacts"]).astype(np.int64)
        owned = np.zeros(len(made), bool)
        self._shapes = np.array([shapely.LineString(line.points) for line in self._lines])
        for kind, pairs in edges.items():
            surface = kind == "surface"
            rows = [i for i, x in enumerate(self._lines) if (x.kind == "surface") == surface]
            found = chains(pairs, np.concatenate([on_walls, outcrops]).tolist())
            for row, nodes in (piece for chain in found for piece in self._by_line(chain, rows)):
                x = made[nodes]
                line = self._lines[row].points
                at = _nearest(line, x)
                gap = x - _on(line, at)
                loose = np.hypot(*gap.T) > OFF_LINE * np.ptp(made[:, 1])
                new = nodes[loose & ~owned[nodes]]
                self._off[new] = gap[loose & ~owned[nodes]]
                owned[nodes] = True
                for part in _parts(line, at, x, loose & (not surface)):
                    own, places = nodes[part], at[part]
                    if places[0] > places[-1]:
                        own, places = own[::-1], places[::-1]
                    ends = tuple(slides.get(own[end]) for end in (0, -1))
                    even = any(
                        n in gates and e is not None
                        for n, e in zip(own[[0, -1]], ends, strict=True)
                    )
                    way = made[own, 0] if surface else _lengths_at(line, places)
                    share = (way - way[0]) / ((way[-1] - way[0]) or 1.0)
                    long = np.hypot(*np.diff(made[own], axis=0).T)
                    self.chains.append(Chain(row, own, share, long, ends, surface, even))
                    self._at.append(places)

    def _by_line(self, nodes, rows):
        """Yield the row of a line and the nodes of a chain that are on it, in their order.

        A contact of a rock with layers of another one is a chain along one line after another.
        Lines share the nodes at which they meet.
        """
        points = shapely.points(self._made[nodes])
        shapes = self._shapes[rows]
        near = OFF_LINE * np.ptp(self._made[:, 1])
        at_middle = shapely.distance(shapes, points[len(points) // 2])
        likely = np.flatnonzero(at_middle <= max(near, at_middle.min()))
        far = shapely.distance(shapes[likely, None], points).max(axis=1)
        if len(nodes) < 2 or far.min() <= near:
            yield rows[likely[far.argmin()]], nodes
            return
        far = shapely.distance(shapes[:, None], points)
        edges = np.maximum(far[:, :-1], far[:, 1:]).argmin(axis=0)
        cuts = np.r_[0, np.flatnonzero(np.diff(edges)) + 1, len(edges)]
        for begin, end in pairwise(cuts):
            yield rows[edges[begin]], nodes[begin : end + 1]

    def _held(self):
        """Return, by axis, which nodes stand."""
        held = {axis: np.zeros(len(self._made), bool) for axis in (0, 1)}
        for name, nodes in self._walls.items():
            held[AXIS[name]][nodes] = True
            if name not in self.section.flat:
                held[1 - AXIS[name]][nodes] = True
        return held


def _upright(lines):
    """Return the lines with the surface standing, see `surface.standing`."""
    found = []
    for line in lines:
        if line.kind == "surface":
            points = standing(line.points)[0]
            line = line if points is line.points else replace(line, points=points)
        found.append(line)
    return tuple(found)


def _same(lines, others):
    """Return whether lines have the same vertices."""
    pairs = zip(lines, others, strict=True)
    return all(a.points is b.points or np.array_equal(a.points, b.points) for a, b in pairs)


def _between(x, share):
    """Return values at shares of the way from the first to the last."""
    return x[0] + share * (x[-1] - x[0])


def _on(line, at):
    """Return the points at places on a line, which count its vertices, shape (n, 2), m."""
    return np.column_stack([np.interp(at, np.arange(len(line)), axis) for axis in line.T])


def _lengths_at(line, at):
    """Return the arc lengths at places on a line, m."""
    return np.interp(at, np.arange(len(line)), arc_lengths(line))


def _nearest(line, x):
    """Return the places on a line nearest to points: vertices from its first, shape (n,)."""
    s = shapely.line_locate_point(shapely.LineString(line), shapely.points(x))
    lengths = arc_lengths(line)
    _, first = np.unique(lengths, return_index=True)
    return np.interp(s, lengths[first], np.arange(len(line))[first])


def _parts(line, at, x, loose):
    """Return the rows of nodes that follow a line one way, cut at its corners.

    Args:
        line: shape (m, 2), m.
        at: places of nodes on it, shape (n,).
        x: the nodes, shape (n, 2), m.
        loose: which nodes are off the line: each is a part of its own.
    """
    step = np.diff(at)
    way = 1.0 if (step > 0).sum() >= (step < 0).sum() else -1.0
    joined = (way * step > 0) & ~loose[:-1] & ~loose[1:]
    edge = np.hypot(*np.diff(x, axis=0).T)
    reach = LOOK * np.minimum(np.r_[edge, np.inf], np.r_[np.inf, edge])
    lengths = arc_lengths(line)
    s = np.interp(at, np.arange(len(line)), lengths)
    before, after = (
        np.column_stack([np.interp(s + side * reach, lengths, axis) for axis in line.T])
        for side in (-1, 1)
    )
    here = _on(line, at)
    a, b = here - before, after - here
    turn = np.abs(np.arctan2(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0], (a * b).sum(axis=1)))
    parts, begin = [], 0
    for row in range(1, len(at)):
        if not joined[row - 1]:
            parts.append(np.arange(begin, row))
            begin = row
        elif turn[row] > CORNER and row < len(at) - 1:
            parts.append(np.arange(begin, row + 1))
            begin = row
    return [*parts, np.arange(begin, len(at))]

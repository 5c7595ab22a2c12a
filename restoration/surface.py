"""A free surface: a line of its own that moves with the rock, and a mesh that follows it."""

import numpy as np
import shapely
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from scipy.linalg import solveh_banded
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

from forms.mesh_motion import spread_form
from meshes.box import AIR

GROUND = 9  # tag of the inner facets between rock and air
# A mesh is made anew where a cell has lost more than this part of its shape.
WORST_SHAPE = 0.15
ROUGH = 0.02  # from here on a surface line has scarps, see `Top.roughness`
STEEPEST = 2.0  # slope of a surface that stands; what becomes steeper falls
LEAST_RUN = 1e-6  # of the width, between two points of a line that was made upright
LEAST_FALL, MOST_FALLS = 1e-3, 2000  # of the longest segment; sweeps


def line_area(points):
    """Return the area between a line and z = 0, m^2."""
    return float(np.trapz(points[:, 1], points[:, 0]))


def standing(points, steepest=STEEPEST):
    """Return a surface line without cliffs: what is steeper falls, and what overhangs is upright.

    The ends of a segment that is too steep move towards each other, the area below kept, again and
    again until none is left.

    Args:
        points: of the line, shape (n, 2), m.
        steepest: slope, rise over run, that stands.

    Returns:
        The line, and the area that fell, m^2.
    """
    run, rise = np.diff(points, axis=0).T
    if (run > 0).all() and (np.abs(rise) <= steepest * run).all():
        return points, 0.0
    x, z = points.T.copy()
    if not (np.diff(x) > 0).all():
        low, high = np.minimum.accumulate(x[::-1])[::-1], np.maximum.accumulate(x)
        x = (low + high) / 2
        x += LEAST_RUN * np.ptp(x) * (np.arange(len(x)) - (len(x) - 1) / 2) / len(x)
        x[[0, -1]] = points[[0, -1], 0]
    run = np.diff(x)
    width = (np.r_[run, 0] + np.r_[0, run]) / 2
    for _ in range(MOST_FALLS):
        steep = 0.0
        for first in (0, 1):
            a = np.arange(first, len(run), 2)
            rise = z[a + 1] - z[a]
            excess = np.sign(rise) * np.maximum(np.abs(rise) - steepest * run[a], 0)
            z[a] += excess * width[a + 1] / (width[a] + width[a + 1])
            z[a + 1] -= excess * width[a] / (width[a] + width[a + 1])
            steep = max(steep, np.abs(excess).max(initial=0.0))
        if steep <= LEAST_FALL * steepest * run.max():
            break
    dz = np.abs(np.diff(points[:, 1]))
    aside = np.abs(x - points[:, 0]) @ (np.r_[dz, 0] + np.r_[0, dz]) / 2
    return np.column_stack([x, z]), float(aside + width @ np.abs(z - points[:, 1]) / 2)


def heights_on(points, x):
    """Return the heights at ``x`` of the polyline with the least distance to a surface line.

    It is the projection onto hat functions, so that the area below is that below the line.

    Args:
        points: surface line, shape (n, 2), m, x ascending; beyond its ends it goes on level.
        x: ascending, shape (m,), m.
    """
    at = np.unique(np.concatenate([x, points[(points[:, 0] > x[0]) & (points[:, 0] < x[-1]), 0]]))
    z = np.interp(at, *points.T)
    length = np.diff(at)
    cell = np.searchsorted(x, (at[1:] + at[:-1]) / 2) - 1
    width = np.diff(x)
    load = np.zeros(len(x))
    for end in (0, 1):
        first, last = (
            1 - end - (1 - 2 * end) * (side - x[cell]) / width[cell] for side in (at[:-1], at[1:])
        )
        part = (2 * z[:-1] * first + z[:-1] * last + z[1:] * first + 2 * z[1:] * last) * length / 6
        np.add.at(load, cell + end, part)
    mass = np.zeros((2, len(x)))
    mass[0, 1:] = width / 6
    mass[1, :-1] += width / 3
    mass[1, 1:] += width / 3
    return solveh_banded(mass, load)


class Ground:
    """The surface of the rock, and integrals over it.

    Args:
        section: `meshes.data.SectionMesh`, with regions where there is air.
        spaces: `Spaces` of it.
        air: whether the regions of the mesh tell rock from air.

    Attributes:
        air: as above.
        facets: of the surface that this rank knows.
        n: normal of facets.
        rock: one in the rock, and zero in the air.
    """

    def __init__(self, section, spaces, air=False):
        self.section, self.spaces, self.air = section, spaces, air
        mesh, wall = section.mesh, section.wall_tags["surface"]
        self.facets = _ground(section) if air else section.facet_tags.find(wall)
        self.n = ufl.FacetNormal(mesh)
        if not air:
            self._measure, self.rock = spaces.ds(wall), fem.Constant(mesh, 1.0)
            return
        values = np.full(len(self.facets), GROUND, np.int32)
        tags = dmesh.meshtags(mesh, section.dim - 1, self.facets, values)
        metadata = {"quadrature_degree": spaces.degree}
        self._measure = ufl.Measure("dS", mesh, subdomain_data=tags, metadata=metadata)(GROUND)
        self.rock = fem.Function(spaces.D)
        self.rock.x.array[:] = section.regions != AIR

    def over(self, integrand):
        """Return the integral over the surface, from both sides of it where air is meshed too."""
        if not self.air:
            return integrand * self._measure
        return (integrand("+") + integrand("-")) * self._measure


class Top(Ground):
    """The nodes of a mesh along its free surface, and all nodes that give way to them.

    The mesh is a function of the surface line alone: the nodes of the mesh as it was made, moved
    by the harmonic extension of what the top nodes are away from there. So it forgets no step and
    remembers none, and it is as smooth in time as the line.

    Args:
        section: `meshes.data.SectionMesh`, with regions where there is air.
        spaces: `Spaces` of it.
        index: `CellIndex` of it.
        motion: of the top nodes, ``vertical`` or ``normal``.
        air: whether the regions of the mesh tell rock from air.

    Attributes:
        x: of the top nodes, ascending, shape (m,), m.
        dofs: of `Spaces.H` at the top nodes, shape (m,).
    """

    def __init__(self, section, spaces, index, motion="vertical", air=False):
        super().__init__(section, spaces, air)
        self.index, self.motion = index, motion
        mesh, hats = section.mesh, spaces.H
        self._geometry = np.empty(int(spaces.h_nodes.max()) + 1, np.int64)
        self._geometry[spaces.h_nodes] = section.corner_vertices
        self._made = mesh.geometry.x[self._geometry, :2].copy()
        dofs = fem.locate_dofs_topological(hats, 1, self.facets)
        self.dofs = dofs[np.argsort(self._made[dofs, 0])]
        self._corners = spaces.h_nodes[:, [0, 1, 3, 2] if section.cell == "quadrilateral" else ...]
        self._shape = cell_shapes(self._made[self._corners])
        self._extension = Extension(spaces, self._held(), self.dofs)
        self._u = fem.Function(spaces.V)
        self._flux = fem.form(self.over(self.rock * ufl.dot(self._u, self.n)))

    @property
    def x(self):
        """Positions of the top nodes, ascending, m."""
        return self.section.mesh.geometry.x[self._geometry[self.dofs], 0]

    @property
    def line(self):
        """The top nodes from left to right, shape (m, 2), m."""
        return self.section.mesh.geometry.x[self._geometry[self.dofs], :2].copy()

    def flux(self, flow):
        """Return the area that the section gains through its surface in a time, m^2/s."""
        self._u.x.array[:] = flow.u.ravel()
        return float(fem.assemble_scalar(self._flux))

    def roughness(self, points):
        """Return how far the least-squares line is off a surface line at the nodes.

        In parts of the edges there: it overshoots beside a scarp that the mesh has nodes on.

        Args:
            points: of the line, as in `follow`.
        """
        x = self._made[self.dofs, 0]
        off = np.abs(heights_on(points, x) - np.interp(x, *points.T))
        run = np.diff(x)
        return float((off / np.minimum(np.r_[run, np.inf], np.r_[np.inf, run])).max())

    def follow(self, points):
        """Move the mesh so that it follows a surface line.

        Args:
            points: shape (n, 2), m, x ascending.

        Returns:
            Whether all cells have kept their shape; if not, the mesh must not be solved on.
        """
        made = self._made[self.dofs]
        goal = made.copy()
        if self.motion == "vertical":
            goal[:, 1] = heights_on(points, made[:, 0])
        else:
            line = shapely.LineString(points)
            near = shapely.line_interpolate_point(
                line, shapely.line_locate_point(line, shapely.points(made))
            )
            goal[1:-1] = shapely.get_coordinates(near)[1:-1]
            goal[[0, -1], 1] = np.interp(made[[0, -1], 0], *points.T)
        moved = self._made + self._extension(goal - made)
        kept = cell_shapes(moved[self._corners]) / self._shape
        if not kept.min() > WORST_SHAPE:
            return False
        self.section.mesh.geometry.x[self._geometry, :2] = moved
        self.index.moved(goal)
        return True

    def _held(self):
        """Return, by axis, which nodes stand."""
        walls = {1: ("base", "surface"), 0: ("base", "surface", "left", "right")}
        held = {}
        for axis in (1,) if self.motion == "vertical" else (1, 0):
            held[axis] = np.zeros(len(self._made), bool)
            for name in walls[axis]:
                facets = self.section.facet_tags.find(self.section.wall_tags[name])
                held[axis][fem.locate_dofs_topological(self.spaces.H, 1, facets)] = True
        return held


class Extension:
    """The harmonic extension of what some nodes of a mesh move by, from the mesh as it is now.

    Args:
        spaces: `Spaces`.
        held: which nodes of `Spaces.H` stand, by axis; no node moves along an axis without entry.
        nodes: those that are moved, which count before those that stand.
    """

    def __init__(self, spaces, held, nodes):
        self._nodes, self._axes = nodes, {}
        d, w = ufl.TrialFunction(spaces.H), ufl.TestFunction(spaces.H)
        form = fem.form(spread_form(d, w, spaces.section.mesh, spaces.dx))
        assembled = fem.petsc.assemble_matrix(form)
        assembled.assemble()
        stiffness = csr_matrix(assembled.getValuesCSR()[::-1], shape=assembled.getSize())
        assembled.destroy()
        for axis, standing_nodes in held.items():
            free = ~standing_nodes
            free[nodes] = False
            rows = np.flatnonzero(free)
            factors = splu(stiffness[rows][:, rows].tocsc())
            self._axes[axis] = factors.solve, rows, stiffness[rows].copy()
        self._count = stiffness.shape[0]

    def __call__(self, push):
        """Return what all nodes move by, shape (nodes, 2), m, for what those given do, (m, 2)."""
        moves = np.zeros((self._count, 2))
        for axis, (solve, free, held) in self._axes.items():
            moves[self._nodes, axis] = push[:, axis]
            moves[free, axis] = solve(-held @ moves[:, axis])
        return moves


def _ground(section):
    """Return the facets between rock and air, sorted."""
    topology = section.mesh.topology
    topology.create_connectivity(1, 2)
    cells = topology.connectivity(1, 2)
    pair = cells.array[cells.offsets[:-1]], cells.array[cells.offsets[1:] - 1]
    air = section.regions == AIR
    return np.flatnonzero(air[pair[0]] != air[pair[1]]).astype(np.int32)


def cell_shapes(corners):
    """Return the shape of cells, shape (cells,): signed area over the sum of squared edges.

    Of a quadrilateral the worst of the triangles at its corners counts.
    """
    if corners.shape[1] == 3:
        (ax, az), (bx, bz) = (corners[:, k].T - corners[:, 0].T for k in (1, 2))
        squares = ax**2 + az**2 + bx**2 + bz**2 + (bx - ax) ** 2 + (bz - az) ** 2
        return (ax * bz - az * bx) / squares
    after, before = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    twice = after[..., 0] * before[..., 1] - after[..., 1] * before[..., 0]
    squares = (after**2).sum(axis=(1, 2))
    return twice[np.arange(len(twice)), np.abs(twice).argmin(axis=1)] / squares

"""The mesh of a scene at a moment: it stands, follows the lines of the rock, or is adapted."""

import numpy as np
import ufl
from dolfinx import fem
from mpi4py import MPI
from scipy.spatial import cKDTree
from shapely.errors import ShapelyError

from forms.elements import ELEMENTS
from meshes.box import section_mesh
from meshes.refine import adapted_mesh
from meshes.section import MeshingError, fitted_mesh
from restoration.bands import areas, distance_to, mesh_lines, section_of
from restoration.errors import MeshError
from restoration.lines import spaced, surface_of
from restoration.particles import OUTSIDE
from restoration.ranks import ALONE
from restoration.scene import Outline
from restoration.seeding import graded
from restoration.surface import heights_on, standing

ASIDE = 1e-4  # of the height: where the rocks on both sides of a line are asked for


class Mesher:
    """Makes the meshes of a run.

    Args:
        scene: `scene.Scene`.
        ranks: `ranks.Ranks`; every one gets the whole mesh.

    Attributes:
        coarsest, finest: side of the squares that become cells, at their largest and smallest, m.
    """

    def __init__(self, scene, ranks=ALONE):
        self.scene, self._comm = scene, ranks.comm
        outline, plan = scene.outline, scene.mesh
        self.coarsest = float(np.sqrt(outline.area / np.prod(scene.cells)))
        self.finest = self.coarsest / 2 ** (plan.refine.levels if plan.refine else 0)
        self._widths = {fault.name: fault.width for fault in scene.faults}
        self.contacts = {
            line.name
            for line in scene.lines
            if line.name not in self._widths and _between_rocks(scene, line)
        }
        self._base = None

    def mesh(self, lines, grid=None, flow=None):
        """Return the mesh for the lines where they are, and points in its regions.

        Args:
            lines: horizons and faults at this moment.
            grid, flow: the last `Grid` and `Flow`, which a mesh adapted to the velocity needs.

        Returns:
            (`meshes.data.SectionMesh`, points), points of shape (regions, 2) of a fitted mesh,
            else None.

        Raises:
            MeshError: no mesh follows these lines.
        """
        plan = self.scene.mesh
        if plan.interfaces != "particles":
            return self._fitted(lines)
        base = self._columns(lines)
        if plan.refine is None:
            return base, None
        sizes = [self._towards(lines, name) for name in ("interfaces", "faults")]
        if "velocity-gradient" in plan.refine.where and flow is not None:
            sizes.append(gradient_size(grid, flow, self.finest))
        # `adapted_mesh` measures a triangle by the square of twice its area, half a cell's square.
        return adapted_mesh(
            base,
            lambda x: (
                np.min([np.full(len(x), np.inf), *(size(x) for size in sizes)], axis=0) / np.sqrt(2)
            ),
            plan.refine.levels,
        ), None

    def _columns(self, lines):
        """Return the mesh of columns: one for the run, but below a surface that moves."""
        if self._base is None or self.scene.free:
            cell = ELEMENTS[self.scene.mesh.element].cells[0]
            air, surface = self.scene.air, self._surface(lines)
            if air:
                top = surface[:, 1].max() + air.thickness
                air = top, max(1, round(air.thickness * self.scene.cells[1] / self._height))
            self._base = section_mesh(
                surface, self.scene.outline.base, self.scene.cells, cell, air, MPI.COMM_SELF
            )
        return self._base

    @property
    def _height(self):
        return self.scene.outline.area / self.scene.outline.width

    def _surface(self, lines):
        """Return the top line of the section as the mesh is to have it, m."""
        line = surface_of(lines)
        if line is None:
            return self.scene.outline.surface
        left, right = self.scene.outline.surface[[0, -1], 0]
        x = np.linspace(left, right, self.scene.cells[0] + 1)
        return np.column_stack([x, heights_on(standing(line.points)[0], x)])

    def _fitted(self, lines):
        outline, plan = self.scene.outline, self.scene.mesh.refine
        surface = surface_of(lines)
        if surface is not None:
            outline = Outline(standing(surface.points)[0], outline.base)
        where = plan.where if plan else ()
        follow = [line.points for line in lines if line.name in self.contacts]
        if "faults" in where:
            plain = [line for line in lines if line.kind == "fault"]
            follow += [line.points for line in plain if line.name not in self._widths]
        # the edges of a crossed square are its side and half its diagonal
        share = 0.85
        near = share * (self.finest if where else self.coarsest)
        bands = [(area, self._widths[name]) for name, area in areas(lines).items()]
        try:
            pieces = mesh_lines(follow, bands, section_of(outline), near)
            follow, near = [points for points, _ in pieces], [size for _, size in pieces]
            size = share * self.coarsest
            return fitted_mesh(
                outline.surface, outline.base, follow, size, near, comm=self._comm, whole=True
            )
        except (MeshingError, ShapelyError) as error:
            raise MeshError(
                f"no mesh follows the horizons any more: {error}; let particles carry the rock "
                "(mesh.interfaces: auto does so by itself)"
            ) from error

    def _towards(self, lines, name):
        """Return the wanted size of cells as a function of points, small near some lines."""
        kept, bands = [], []
        if name in self.scene.mesh.refine.where:
            if name == "faults":
                bands = areas(lines).values()
                kept = [x for x in lines if x.kind == "fault" and x.name not in self._widths]
            else:
                kept = [x for x in lines if x.kind == "edge" or x.name in self.contacts]
        distances = [distance_to(area, self.finest / 2) for area in bands]
        if kept:
            tree = cKDTree(np.concatenate([spaced(x.points, self.finest / 2) for x in kept]))
            distances.append(lambda x: tree.query(x)[0])
        if not distances:
            return lambda x: np.full(len(x), np.inf)
        return lambda x: graded(np.min([far(x) for far in distances], axis=0).clip(0), self.finest)


def _between_rocks(scene, line):
    """Return whether a line anywhere parts two rocks."""
    points = spaced(line.points, scene.outline.height / 100)
    step = np.diff(points, axis=0)
    length = np.linalg.norm(step, axis=1)
    keep = length > 0
    normal = np.column_stack([-step[:, 1], step[:, 0]])[keep] / length[keep, None]
    middle = (points[1:] + points[:-1])[keep] / 2
    rock = np.array([unit.rock for unit in scene.units])
    one, two = (
        scene.unit_at(middle + side * ASIDE * scene.outline.height * normal) for side in (-1, 1)
    )
    banded = np.isin([one, two], [fault.unit for fault in scene.faults]).any(axis=0)
    return bool((rock[one] != rock[two])[~banded].any())


def gradient_size(grid, flow, finest):
    """Return the wanted size of cells as a function of points, small where the velocity bends.

    The jump of the velocity gradient across the facets of a cell tells how far the flow is from
    the quadratic that a cell can hold; it falls with the square of the size. Cells are to be so
    small that it is nowhere above its mean over the cells of the last mesh (the equal share of
    the error that Kelly et al. 1983, Int. J. Numer. Methods Eng. 19, ask for).

    Args:
        grid: `Grid` of the flow.
        flow: `Flow`.
        finest: least size that is given, m.
    """
    mesh = grid.section.mesh
    u, test = fem.Function(grid.spaces.V), ufl.TestFunction(grid.spaces.D)
    u.x.array[:] = flow.u.ravel()
    jump = ufl.jump(ufl.grad(u))
    form = fem.form(ufl.inner(jump, jump) * (test("+") + test("-")) * ufl.dS(domain=mesh))
    jumps = fem.petsc.assemble_vector(form)
    squared = jumps.array / np.sqrt(grid.index.area)  # per length of facets
    jumps.destroy()
    strength = np.sqrt(np.maximum(squared, 0))
    bound = strength.mean() or 1.0
    wanted = grid.sizes * np.sqrt(bound / np.maximum(strength, 1e-6 * bound))
    wanted = np.maximum(wanted, finest)

    def size(x):
        cell, _ = grid.index.locate(x, np.full(len(x), OUTSIDE, np.int32))
        return np.where(cell == OUTSIDE, np.inf, wanted[cell])

    return size

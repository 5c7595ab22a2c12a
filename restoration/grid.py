"""One mesh of a section with all that is made for it: spaces, cells of points, rock, the flow."""

from dataclasses import fields
from functools import partial

import numpy as np
import shapely
import ufl
from dolfinx import fem

from forms.elements import ELEMENTS
from meshes.arrays import Arrays
from meshes.box import AIR
from meshes.split import barycentric_mesh
from restoration.conservative import velocity_sampler
from restoration.contacts import Contacts
from restoration.line_rock import LineRock
from restoration.lines import memory_of, surface_of
from restoration.particles import CellIndex, nearest, relocate
from restoration.ranks import ALONE
from restoration.shared_stokes import FirstStokes, SharedStokes
from restoration.snapshot import FieldSnapshot
from restoration.solvers import choose_solver
from restoration.spaces import Spaces
from restoration.stokes import StokesProblem
from restoration.surface import ROUGH, Top, cell_shapes, standing
from restoration.transfer import FittedFields, RockFields

# Shape of an equilateral triangle, a square and a regular tetrahedron.
BEST_SHAPE = {"triangle": 3**0.5 / 6, "quadrilateral": 1 / 4, "tetrahedron": 0.5**0.5}
ARRAYS = tuple(field.name for field in fields(Arrays))


class Grid:
    """A mesh and what is made for it.

    Args:
        scene: `scene.Scene`.
        section: `meshes.data.SectionMesh`; split at the barycentres here where elements ask for it.
        counts: `stokes.Counts` to go on with, or None.
        regions: of a fitted mesh, tells the unit of every region for the section and its
            `CellIndex`, such as `units_of_regions`; None where particles carry the rock.
        lines: `lines.MovingLine`s that the mesh was made for.
        ranks: `ranks.Ranks`, that hold the mesh whole each and solve on it together.

    Attributes:
        section, spaces, index, fields, stokes, sampler: the parts.
        top: `surface.Top` of a free surface, else None.
        contacts: `Contacts` of a fitted mesh, else None.
    """

    def __init__(self, scene, section, counts=None, regions=None, lines=(), ranks=ALONE):
        self._ranks = ranks
        pair = ELEMENTS[scene.mesh.element]
        self._made_for, self._made_from = lines, None
        self._with_regions = section.regions is not None
        if regions is not None or scene.mesh.refine:
            self._made_from = section.made_from
        section = barycentric_mesh(section) if pair.split else section
        air = scene.air
        lowest = min(scene.unit_viscosity.min(), air.viscosity if air else np.inf)
        self.section, self.eta0 = section, float(lowest)
        self.spaces = Spaces(section, scene.mesh.element)
        self.index = CellIndex(section)
        density, viscosity = scene.unit_density, scene.unit_viscosity / self.eta0
        if regions is None:
            self.fields = RockFields(
                self.spaces,
                self.index,
                density,
                viscosity,
                scene.transfer,
                air and (air.density, air.viscosity / self.eta0),
                self._line_rock(scene),
                ranks,
            )
        else:
            self._unit_of_region = regions(section, self.index)
            unit = self._unit_of_region[section.regions]
            self.fields = FittedFields(self.spaces, density, viscosity, unit)
        self.top = None
        if scene.free:
            motion = scene.surface.motion
            self.top = Top(section, self.spaces, self.index, motion, air is not None)
        problem = StokesProblem
        if ranks.several:
            name = choose_solver(scene.solver, section.dim, self.spaces.unknowns)
            alone = name == "direct" and scene.solver.reproducible
            problem = partial(FirstStokes if alone else SharedStokes, ranks)
        self.stokes = problem(
            section,
            self.spaces,
            self.fields.density,
            self.fields.eta,
            self.eta0,
            scene.walls,
            scene.gravity,
            scene.closed,
            scene.one_viscosity and not scene.free and regions is None,
            scene.solver,
            counts=counts,
            top=self.top,
            on_facets=self.fields.on_facets,
            follows=scene.one_viscosity or regions is not None,
        )
        self.sampler = velocity_sampler(self.spaces, scene.particles.velocity)
        self.contacts = None if regions is None else self._contacts(scene, lines)
        self._share = {"triangle": 4, "quadrilateral": 1, "tetrahedron": 12}[section.cell] * (
            3 if pair.split else 1
        )
        self._made = self._shapes()
        self._u = fem.Function(self.spaces.V)
        rock = self.top.rock if self.top else 1
        self._squared = fem.form(rock * ufl.inner(self._u, self._u) * self.spaces.dx)
        self._snapshot = None
        self._analysed = self._factored = None
        self._analyses = 0
        self.stokes.factored = self._note_factors

    def _note_factors(self):
        """Keep what the matrix was made of that has just been factorised."""
        self._factored = self._matrix_of()
        if self._analysed is None or self.stokes.analyses != self._analyses:
            self._analyses, self._analysed = self.stokes.analyses, self._factored

    def _matrix_of(self):
        """Return all that the matrix depends on and that changes with time."""
        return self.fields.values() | {"points": self.points, "lead": self.stokes.lead}

    @property
    def points(self):
        """The nodes of the mesh, shape (nodes, dim), m; a copy."""
        return self.section.mesh.geometry.x[:, : self.section.dim].copy()

    def _set(self, matrix_of, time):
        """Set mesh and fields to where they were, see `_matrix_of`."""
        self.section.mesh.geometry.x[:, : self.section.dim] = matrix_of["points"]
        self.fields.set_values(matrix_of)
        self.stokes.set_time(time)
        if self.top:
            self.stokes.stabilise(matrix_of["lead"])

    def memory(self):
        """Return all that a `Grid` made anew lacks, for a checkpoint; see `recalled`."""
        once = self._analysed is self._factored
        arrays = self._made_from
        return {
            "arrays": arrays and {name: getattr(arrays, name) for name in ARRAYS},
            "flat": sorted(self.section.flat),
            "with_regions": self._with_regions,
            "made_for": memory_of(self._made_for),
            "unit_of_region": None if self.contacts is None else self._unit_of_region,
            "contacts": self.contacts and self.contacts.memory(),
            "lid": self.index.lid,
            "fields": self.fields.memory(),
            "now": self._matrix_of(),
            "analysed": self._analysed,
            "factored": None if once else self._factored,
            "stokes": self.stokes.memory(),
        }

    def recall(self, memory, time):
        """Take the moving parts of what `memory` returned of a grid, made for the same mesh.

        The matrix is factorised as it was, so that old factors go on as they would have.

        Args:
            memory: of `memory`.
            time: model time then, s.
        """
        for name in ("analysed", "factored"):
            if memory[name]:
                self._set(memory[name], time)
                self.stokes.prepare(memory["stokes"], analysed=name == "analysed")
                self._note_factors()
        self._set(memory["now"], time)
        self.fields.recall(memory["fields"])
        self.stokes.recall(memory["stokes"])
        self.index.moved(memory["lid"])
        if self.contacts:
            self.contacts.recall(memory["contacts"])
        self._snapshot = None

    def _line_rock(self, scene):
        """Return the `LineRock` of this mesh, or None where particles alone tell the rock."""
        if "lines" not in (scene.transfer.density, scene.transfer.viscosity):
            return None
        rock = np.ones(len(self.index.area), bool)
        if scene.air:
            rock = self.section.regions != AIR
        return LineRock(scene, self.spaces, self.index, rock, self._ranks)

    @property
    def sizes(self):
        """Side of the square or cube that is split into such cells, shape (cells,), m."""
        return (self._share * self.index.area) ** (1 / self.section.dim)

    def _shapes(self):
        corners = self.section.corners  # as they are, whatever the index was told
        if self.section.dim == 3:
            return tetrahedron_shapes(corners)
        round_it = [0, 1, 3, 2] if self.section.cell == "quadrilateral" else slice(None)
        return cell_shapes(corners[:, round_it])

    @property
    def kept_shape(self):
        """What cells have kept of the shape they were made with, shape (cells,).

        It is negative where a cell has turned over.
        """
        return self._shapes() / self._made

    @property
    def thinnest(self):
        """Least shape of the cells as they were made, over that of the best cell."""
        return float(np.abs(self._made).min() / BEST_SHAPE[self.section.cell])

    def facts(self):
        """Return what a developer asks of mesh, rock and matrix, numbers by name."""
        kept, eta = self.kept_shape, self.fields.viscosity_means() * self.eta0
        worst = self.index.corners[int(np.nan_to_num(kept, nan=-np.inf).argmin())].mean(axis=0)
        return {
            "cells": len(kept),
            "unknowns": self.spaces.unknowns,
            "least_area": float(self.index.area.min()),
            "least_shape_kept": float(kept.min()),
            "least_shape_at_m": worst.tolist(),
            "thinnest_cell": self.thinnest,
            "viscosity_Pa_s": [float(eta.min()), float(eta.max())],
        } | self.stokes.facts()

    def fit(self, lines, rows=None, begins=False):
        """Move a fitted mesh to lines; return whether its cells have kept their shape.

        Args:
            lines, rows, begins: see `Contacts.follow`.
        """
        if not self.contacts.follow(lines, rows, begins):
            return False
        self._snapshot = None
        self.index.moved(self.top.line if self.top else None)
        return True

    def _contacts(self, scene, lines):
        surface = surface_of(lines)
        rough = surface is not None and self.top.roughness(standing(surface.points)[0]) > ROUGH
        crossed = [name for name in ("left", "right") if scene.normal_velocity(name) != 0]
        return Contacts(self.section, self.spaces, lines, crossed, rough)

    def follow(self, points):
        """Move the mesh after a surface line; return whether its cells have kept their shape."""
        self._snapshot = None
        return self.top.follow(points)

    def fill(self, particles, hats, lines):
        """Fill the fields from particles and lines; those of a fitted mesh stand.

        Args:
            particles: located `Particles`.
            hats: of the particles, see `CellIndex`.
            lines: moving lines at the same moment.
        """
        if isinstance(self.fields, RockFields):
            p = particles
            self.fields.fill(p.x, p.cell, hats, p.unit, p.area, lines)

    def speeds(self, flow):
        """Return root mean square and greatest speed of the rock, m/s."""
        self._u.x.array[:] = flow.u.ravel()
        squared = fem.assemble_scalar(self._squared)
        rock = ~self.fields.in_air
        nodes = np.unique(self.spaces.v_nodes[rock])
        greatest = (flow.u[nodes] ** 2).sum(axis=1).max()
        area = self.section.area if rock.all() else self.index.area[rock].sum()
        return float(np.sqrt(squared / area)), float(np.sqrt(greatest))

    def fastest(self, flow):
        """Return the greatest number of cells that the rock crosses in a time, 1/s."""
        speed = np.linalg.norm(flow.u, axis=1)[self.spaces.v_nodes].max(axis=1) / self.sizes
        return float(speed[~self.fields.in_air].max())

    @property
    def snapshot(self):
        """The reader of the fields for files."""
        if self._snapshot is None:
            self._snapshot = FieldSnapshot(self.spaces, self.fields, self.eta0)
        return self._snapshot


def tetrahedron_shapes(corners):
    """Return the shape of tetrahedra: signed volume over that of a cube on their mean edge.

    Args:
        corners: shape (cells, 4, 3), m.
    """
    edges = corners[:, 1:] - corners[:, :1]
    pairs = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)]).T
    squares = ((corners[:, pairs[0]] - corners[:, pairs[1]]) ** 2).sum(axis=2).mean(axis=1)
    return np.einsum("cd,cd->c", edges[:, 0], np.cross(edges[:, 1], edges[:, 2])) / squares**1.5


def units_of_regions(section, index, *, particles, points, bands, scene, ranks):
    """Return the unit of every region of a fitted mesh: that of most of its particles.

    The bands of faults are known by their edges: the few particles in a sliver of one tell less.

    Args:
        section: fitted `meshes.data.SectionMesh`.
        index: `CellIndex` of it.
        particles: `Particles` without cells; None at the start, when the scene tells.
        points: a point in every region, shape (regions, 2), m.
        bands: areas of the faults by name, see `bands.areas`.
        scene: `scene.Scene`.
        ranks: `ranks.Ranks` that have some of the particles each.
    """
    if particles is None:
        return scene.unit_at(points)
    particles = relocate(particles, index)
    inside = particles.inside
    votes = np.zeros((len(points), len(scene.units)))
    at = section.regions[particles.cell[inside]], particles.unit[inside]
    np.add.at(votes, at, particles.area[inside])
    votes = ranks.sum(votes)
    of_faults = [fault.unit for fault in scene.faults]
    votes[:, of_faults] = 0
    unit = votes.argmax(axis=1)
    silent = np.flatnonzero(votes.sum(axis=1) == 0)
    if len(silent):  # thinner than the particles are apart
        telling = np.flatnonzero(~np.isin(particles.unit[inside], of_faults))
        distance, row = nearest(particles.x[inside][telling], points[silent])
        own = particles.unit[inside][telling[row]] if len(telling) else np.zeros(len(silent))
        unit[silent] = ranks.of_least(distance, own)[1]
    for fault in scene.faults:  # where they cross, the later one is on top
        if fault.name in bands:
            unit[shapely.contains_xy(bands[fault.name], *points.T)] = fault.unit
    return unit

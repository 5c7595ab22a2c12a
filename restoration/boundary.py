"""Walls of the scene as conditions and terms of the Stokes problem."""

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.stokes import slip_form, traction_load
from restoration.scene import normal_axis, value_at

TRACTION_DEGREE = 4  # of the polynomials that hold a traction given as a function


def is_inclined_slip(name, wall, section):
    """Return whether a free-slip wall is inclined, so that u.n = 0 is held weakly."""
    return wall.kind == "free-slip" and name not in section.flat


class WallValues:
    """Functions that hold the values of walls; they follow tables in time, and the mesh.

    Attributes:
        held: of (function, value, scale, cells beside the wall).
    """

    def __init__(self):
        self.held = []

    def __bool__(self):
        return bool(self.held)

    def hold(self, space, value, facets, scale=1.0):
        """Return a function on a space with a wall value over ``scale``, right at facets only."""
        topology = space.mesh.topology
        dim = topology.dim
        topology.create_connectivity(dim - 1, dim)
        beside = topology.connectivity(dim - 1, dim)
        cells = np.unique([beside.links(facet)[0] for facet in facets]).astype(np.int32)
        if space.mesh.comm.size > 1:  # a rank may own a corner of a facet that only others know
            cells = np.arange(topology.index_map(dim).size_local, dtype=np.int32)
        self.held.append((fem.Function(space), value, scale, cells))
        self._fill(*self.held[-1], 0.0)
        return self.held[-1][0]

    def update(self, time):
        """Set all functions for a model time, s, on the mesh where its nodes are now."""
        for held in self.held:
            self._fill(*held, time)

    @staticmethod
    def _fill(function, value, scale, cells, time):
        dim = function.function_space.mesh.topology.dim
        function.interpolate(lambda x: value_at(value, x[:dim].T, time) / scale, cells)
        function.x.scatter_forward()


def velocity_conditions(walls, section, spaces, values):
    """Return the strong conditions on the velocity, wall by wall and component by component.

    No-slip walls come last: where two walls meet, the one that holds the rock fast decides.

    Args:
        walls: `scene.Wall` by name.
        section: `meshes.data.SectionMesh`.
        spaces: `Spaces`.
        values: `WallValues`, which takes up what is not a number.
    """
    conditions = []
    for name, wall in sorted(walls.items(), key=lambda item: item[1].kind == "no-slip"):
        if is_inclined_slip(name, wall, section):
            continue
        facets = section.facet_tags.find(section.wall_tags[name])
        for axis, value in enumerate(wall.velocity):
            if value is not None:
                conditions.append(_held(spaces.W.sub(0).sub(axis), facets, value, values))
    return conditions


def _held(component, facets, value, values):
    """Return the condition that holds a velocity component, by a number or a function."""
    dim = component.mesh.topology.dim
    if not callable(value):
        dofs = fem.locate_dofs_topological(component, dim - 1, facets)
        return fem.dirichletbc(PETSc.ScalarType(value), dofs, component)
    alone, _ = component.collapse()
    held = values.hold(alone, value, facets)
    dofs = fem.locate_dofs_topological((component, alone), dim - 1, facets)
    return fem.dirichletbc(held, dofs, component)


def pressure_pin(spaces):
    """Return the condition that fixes the level of the pressure in a closed section.

    The dof is one of the first rank's; the others must hold it where it is a ghost of theirs.
    """
    index_map = spaces.W.dofmap.index_map
    first = index_map.local_to_global(spaces.q_in_w[:1].astype(np.int32))
    chosen = spaces.section.mesh.comm.bcast(first, root=0)
    local = np.arange(index_map.size_local + index_map.num_ghosts, dtype=np.int32)
    dof = local[index_map.local_to_global(local) == chosen]
    return fem.dirichletbc(PETSc.ScalarType(0), dof, spaces.W.sub(1))


def wall_form(trial, test, eta, length, walls, section, spaces):
    """Return the bilinear terms of inclined free-slip walls; None if there are none."""
    terms = [
        slip_form(*trial, *test, eta, length, spaces.ds(section.wall_tags[name]))
        for name, wall in walls.items()
        if is_inclined_slip(name, wall, section)
    ]
    return sum(terms[1:], terms[0]) if terms else None


def wall_load(v, scale, walls, section, spaces, values):
    """Return the load of the tractions divided by ``scale``; None if there are none.

    Args:
        v: test function of the velocity.
        scale: Pa s.
        walls, section, spaces, values: as in `velocity_conditions`.
    """

    def component(value, tag):
        if not callable(value):
            return fem.Constant(section.mesh, PETSc.ScalarType(value / scale))
        space = fem.FunctionSpace(section.mesh, ("Lagrange", TRACTION_DEGREE))
        return values.hold(space, value, section.facet_tags.find(tag), scale)

    terms = []
    for name, wall in walls.items():
        if any(wall.traction):
            tag = section.wall_tags[name]
            push = ufl.as_vector([component(value, tag) for value in wall.traction])
            terms.append(traction_load(v, push, spaces.ds(tag)))
    return sum(terms[1:], terms[0]) if terms else None


def outflow(u, walls, section, spaces):
    """Return the form of the flux that the walls prescribe, u.n integrated, m^dim/s."""
    n = ufl.FacetNormal(section.mesh)
    held = [
        name
        for name, wall in walls.items()
        if wall.velocity[normal_axis(name, section.dim)] is not None
        and not is_inclined_slip(name, wall, section)
    ]
    terms = [ufl.dot(u, n) * spaces.ds(section.wall_tags[name]) for name in held]
    return sum(terms[1:], terms[0])

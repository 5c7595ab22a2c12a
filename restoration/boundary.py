"""Walls of the scene as conditions and terms of the Stokes problem."""

import numpy as np
import ufl
from dolfinx import fem
from petsc4py import PETSc

from forms.stokes import slip_form, traction_load
from restoration.scene import normal_axis

TRACTION_DEGREE = 4  # of the polynomials that hold a traction given as a function


def is_inclined_slip(name, wall, section):
    """Return whether a free-slip wall is inclined, so that u.n = 0 is held weakly."""
    return wall.kind == "free-slip" and name not in section.flat


def velocity_conditions(walls, section, spaces):
    """Return the strong conditions on the velocity, wall by wall and component by component.

    No-slip walls come last: where two walls meet, the one that holds the rock fast decides.

    Args:
        walls: `scene.Wall` by name.
        section: `meshes.data.SectionMesh`.
        spaces: `Spaces`.
    """
    conditions = []
    for name, wall in sorted(walls.items(), key=lambda item: item[1].kind == "no-slip"):
        if is_inclined_slip(name, wall, section):
            continue
        facets = section.facet_tags.find(section.wall_tags[name])
        for axis, value in enumerate(wall.velocity):
            if value is not None:
                conditions.append(_held(spaces.W.sub(0).sub(axis), facets, value))
    return conditions


def _held(component, facets, value):
    """Return the condition that holds a velocity component, by a number or a function of points."""
    dim = component.mesh.topology.dim
    if not callable(value):
        dofs = fem.locate_dofs_topological(component, dim - 1, facets)
        return fem.dirichletbc(PETSc.ScalarType(value), dofs, component)
    alone, _ = component.collapse()
    held = fem.Function(alone)
    held.interpolate(lambda x: value(x[:dim].T))
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


def wall_load(v, scale, walls, section, spaces):
    """Return the load of the tractions divided by ``scale``; None if there are none."""
    terms = [
        traction_load(
            v,
            ufl.as_vector([_traction(t, scale, section.mesh) for t in wall.traction]),
            spaces.ds(section.wall_tags[name]),
        )
        for name, wall in walls.items()
        if any(wall.traction)
    ]
    return sum(terms[1:], terms[0]) if terms else None


def _traction(value, scale, mesh):
    """Return a component of a traction, given by a number or a function of points."""
    if not callable(value):
        return fem.Constant(mesh, PETSc.ScalarType(value / scale))
    given = fem.Function(fem.FunctionSpace(mesh, ("Lagrange", TRACTION_DEGREE)))
    given.interpolate(lambda x: value(x[: mesh.topology.dim].T) / scale)
    return given


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

"""Dynamic topography: how high the rock would stand if a surface that is held flat were free.

The normal stress on the surface is taken from the momentum equation itself: what its weak form is
off by for test functions at the wall is the force that the wall exerts there. That consistent
boundary flux gains one to two orders over stresses computed from the velocity gradient.
Source: Zhong, Gurnis & Hulbert (1993), Phys. Earth Planet. Inter. 78, 91-104.
"""

import numpy as np
import ufl
from dolfinx import fem
from scipy.sparse import csr_matrix
from scipy.sparse.linalg import splu

from forms.stokes import traction_residual


class SurfaceStress:
    """The normal stress that a wall of free slip holds against the rock below the surface.

    Args:
        section: `meshes.data.SectionMesh`.
        spaces: `Spaces` of it.
        rho: density as a UFL expression, kg/m^3.
        eta: viscosity over ``eta0`` as a UFL expression.
        eta0: Pa s.
        gravity: downwards, m/s^2.
        surface_rho: density as integrals over facets can read it; None where that is ``rho``.

    Attributes:
        x: positions along the surface of its velocity nodes, ascending, shape (m,), m.
    """

    def __init__(self, section, spaces, rho, eta, eta0, gravity, surface_rho=None):
        mesh, wall = section.mesh, section.wall_tags["surface"]
        self.spaces, self.gravity = spaces, gravity
        dim, ds = section.dim, spaces.ds(wall)
        self._u, self._p = fem.Function(spaces.V), fem.Function(spaces.Q)
        self._eta0 = fem.Constant(mesh, float(eta0))
        down = np.zeros(dim)
        down[-1] = -gravity
        down = fem.Constant(mesh, down)
        self._test, trial = ufl.TestFunction(spaces.V), ufl.TrialFunction(spaces.V)[dim - 1]
        self._push = fem.form(
            traction_residual(self._u, self._p, self._test, self._eta0 * eta, rho, down, spaces.dx)
        )
        # of a wall without shear the force is along n
        test = self._test[dim - 1] * ufl.FacetNormal(mesh)[dim - 1]
        self._mass = fem.form(trial * test * ds)
        self._weight = fem.form((rho if surface_rho is None else surface_rho) * trial * test * ds)
        self._share = fem.form(test * ds)
        facets = section.facet_tags.find(wall)
        blocks = fem.locate_dofs_topological(spaces.V, dim - 1, facets)
        x = spaces.V.tabulate_dof_coordinates()[blocks, 0]
        order = np.argsort(x)
        self.x, self._dofs = x[order], blocks[order] * dim + dim - 1

    def normal(self, flow):
        """Return the normal stress on the rock at the surface, shape (m,), Pa; positive pulls.

        Args:
            flow: `Flow` of the same fields.
        """
        return splu(self._matrix(self._mass)).solve(self._residual(flow))

    def projected(self, integral):
        """Return a field on the surface by its integral with test functions, shape (m,).

        Args:
            integral: maps a scalar test function to a UFL integral over the surface.
        """
        along = self._test[len(self._test) - 1]
        return splu(self._matrix(self._mass)).solve(self._vector(fem.form(integral(along))))

    def amplitude(self, values, wave):
        """Return how much of a wave there is in values at the surface nodes: least squares."""
        mass = self._matrix(self._mass)
        return float(wave @ mass @ values / (wave @ mass @ wave))

    def heights(self, flow):
        """Return the dynamic topography at the surface nodes, zero on average, shape (m,), m.

        Rock as dense as that at the surface would rise so high that it weighs what the wall holds.

        Args:
            flow: `Flow` of the same fields.
        """
        push, share = self._residual(flow), self._vector(self._share)
        push -= share * push.sum() / share.sum()
        found = splu(self._matrix(self._weight) * -self.gravity).solve(push)
        return found - share @ found / share.sum()

    def _residual(self, flow):
        self._u.x.array[:], self._p.x.array[:] = flow.u.ravel(), flow.p
        return self._vector(self._push)

    def _vector(self, form):
        vector = fem.petsc.assemble_vector(form)
        found = vector.array[self._dofs].copy()
        vector.destroy()
        return found

    def _matrix(self, form):
        assembled = fem.petsc.assemble_matrix(form)
        assembled.assemble()
        values = csr_matrix(assembled.getValuesCSR()[::-1], shape=assembled.getSize())
        assembled.destroy()
        return values[self._dofs][:, self._dofs].tocsc()


def dynamic_topography(scene, grid, flow):
    """Return the dynamic topography of a surface of free slip: its x and heights, (m,) each, m.

    Args:
        scene: `scene.Scene`.
        grid: `Grid` with the fields of the flow.
        flow: `Flow`.

    Returns:
        None where the surface is not of free slip, or where there is no gravity.
    """
    if scene.walls["surface"].kind != "free-slip" or not scene.gravity:
        return None
    fields = grid.fields
    stress = SurfaceStress(
        grid.section,
        grid.spaces,
        fields.density,
        fields.eta,
        grid.eta0,
        scene.gravity,
        fields.on_facets[0],
    )
    return stress.x, stress.heights(flow)

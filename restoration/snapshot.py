"""The fields of one instant as plain arrays, ready for a file."""

import numpy as np
from dolfinx import fem

from forms.stokes import second_invariant
from restoration.spaces import nodes

# dolfinx numbers the edges of a triangle by their opposite corner, those of a square row by row,
# and those of a tetrahedron from the one between the last corners; VTK goes round.
VTK_NODES = {
    "triangle": [0, 1, 2, 5, 3, 4],
    "quadrilateral": [0, 1, 3, 2, 4, 6, 7, 5, 8],
    "tetrahedron": [0, 1, 2, 3, 9, 6, 8, 7, 5, 4],
}
TURNED = [0, 2, 1, 3, 6, 5, 4, 7, 9, 8]  # of a tetrahedron, with its corners 1 and 2 exchanged


class FieldSnapshot:
    """Reads fields at the nodes of quadratic cells, so that quadratic velocities are kept whole.

    What is discontinuous becomes means of the cells.

    Args:
        spaces: `Spaces`.
        fields: `RockFields`, or others with the same attributes.
        eta0: reference viscosity, Pa s.

    Attributes:
        points: nodes, shape (n, dim), m.
        cells: nodes of every cell in VTK's order, shape (m, 6), (m, 9) or (m, 10).
    """

    def __init__(self, spaces, fields, eta0):
        self.fields, self.eta0 = fields, eta0
        section, self._dim = spaces.section, spaces.section.dim
        nodal = fem.FunctionSpace(section.mesh, ("Lagrange", 2))
        self.points = nodal.tabulate_dof_coordinates()[:, : self._dim].copy()
        self.cells = nodes(nodal)[:, VTK_NODES[section.cell]]
        if section.cell == "tetrahedron":  # some are inside out, which their volumes would tell
            a, b, c = np.moveaxis(section.corners[:, 1:] - section.corners[:, :1], 1, 0)
            turned = np.einsum("cd,cd->c", np.cross(a, b), c) < 0
            self.cells[turned] = self.cells[turned][:, TURNED]
        self._vectors = fem.Function(fem.VectorFunctionSpace(section.mesh, ("Lagrange", 2)))
        self._scalars, self._means = fem.Function(nodal), fem.Function(spaces.D)
        self._u, self._p = fem.Function(spaces.V), fem.Function(spaces.Q)
        at, centre = (space.element.interpolation_points() for space in (nodal, spaces.D))
        self._velocity = fem.Expression(self._u, at)
        self._eps = fem.Expression(second_invariant(self._u), centre)
        self._at_nodes, self._in_cells = {}, {}
        if spaces.pair.continuous:
            self._at_nodes["pressure"] = fem.Expression(self._p, at)
        else:
            self._in_cells["pressure"] = fem.Expression(self._p, centre)
        if fields.rho.function_space == spaces.H:
            self._at_nodes["density"] = fem.Expression(fields.rho, at)

    def read(self, flow, names):
        """Return point data and cell data by name, SI.

        Args:
            flow: `Flow` for which the rock fields were filled last.
            names: of velocity, pressure, density, viscosity, strain_rate.
        """
        self._u.x.array[:] = flow.u.ravel()
        self._p.x.array[:] = flow.p
        readers = {
            "velocity": lambda: (True, self._nodal_velocity()),
            "pressure": lambda: self._either("pressure", None),
            "density": lambda: self._either("density", self.fields.density_means),
            "viscosity": lambda: (False, self.fields.viscosity_means() * self.eta0),
            "strain_rate": lambda: (False, self._values(self._means, self._eps)),
        }
        point, cell = {}, {}
        for name in names:
            at_nodes, values = readers[name]()
            (point if at_nodes else cell)[name] = values
        return point, cell

    def _nodal_velocity(self):
        return self._values(self._vectors, self._velocity).reshape(-1, self._dim)

    def _either(self, name, otherwise):
        """Return whether a field is at nodes, and its values."""
        if name in self._at_nodes:
            return True, self._values(self._scalars, self._at_nodes[name])
        if name in self._in_cells:
            return False, self._values(self._means, self._in_cells[name])
        return False, otherwise()

    @staticmethod
    def _values(function, expression):
        function.interpolate(expression)
        return function.x.array.copy()

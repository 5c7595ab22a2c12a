"""The fields of one instant as plain arrays, ready for a file."""

import numpy as np
from dolfinx import fem

from forms.stokes import second_invariant

# dolfinx numbers the edges of a triangle by their opposite corner; VTK goes round.
VTK_NODES = [0, 1, 2, 5, 3, 4]


class FieldSnapshot:
    """Reads the fields of an engine at the nodes of quadratic triangles, so that P2 is kept whole.

    Args:
        spaces: `Spaces`.
        fields: `RockFields`.
        eta0: reference viscosity, Pa s.

    Attributes:
        points: nodes, shape (n, 2), m.
        triangles: nodes of every triangle in VTK's order, shape (m, 6).
    """

    def __init__(self, spaces, fields, eta0):
        self.spaces, self.fields, self.eta0 = spaces, fields, eta0
        self.points = spaces.V.tabulate_dof_coordinates()[:, :2].copy()
        self.triangles = spaces.v_nodes[:, VTK_NODES]
        self._u = fem.Function(spaces.V)
        at_centre = spaces.D.element.interpolation_points()
        self._eps = fem.Expression(second_invariant(self._u), at_centre)
        self._eta = fem.Expression(fields.eta, at_centre)
        self._cells = fem.Function(spaces.D)

    def read(self, flow, names):
        """Return point data and cell data by name, SI.

        Args:
            flow: `Flow` for which the rock fields were filled last.
            names: of velocity, pressure, density, viscosity, strain_rate.
        """
        readers = {
            "velocity": lambda: flow.u,
            "pressure": lambda: self._at_nodes(flow.p),
            "density": self._density,
            "viscosity": self._viscosity,
            "strain_rate": lambda: self._strain_rate(flow),
        }
        point, cell = {}, {}
        for name in names:
            values = readers[name]()
            (point if len(values) == len(self.points) else cell)[name] = values
        return point, cell

    def _at_nodes(self, vertex_values):
        corners = vertex_values[self.spaces.q_nodes]
        out = np.empty(len(self.points))
        out[self.spaces.v_nodes[:, :3]] = corners
        for k in range(3):
            out[self.spaces.v_nodes[:, 3 + k]] = (corners.sum(axis=1) - corners[:, k]) / 2
        return out

    def _density(self):
        values = self.fields.rho.x.array
        kind = self.fields.transfer.density
        if kind == "hat":
            return self._at_nodes(values)
        return values.reshape(len(self.triangles), -1).mean(axis=1)

    def _viscosity(self):
        self._cells.interpolate(self._eta)
        return self._cells.x.array * self.eta0

    def _strain_rate(self, flow):
        self._u.x.array[:] = flow.u.ravel()
        self._cells.interpolate(self._eps)
        return self._cells.x.array.copy()

"""Function spaces and measures of a section, and their degrees of freedom as plain arrays."""

import numpy as np
import ufl
from dolfinx import fem

QUADRATURE_DEGREE = 4


class Spaces:
    """The spaces of one mesh: P2/P1 Taylor-Hood for the flow, P1, DG0 and points for the rock.

    Args:
        section: `meshes.data.SectionMesh`.

    Attributes:
        W: mixed space of velocity and pressure.
        V, Q: velocity and pressure space on their own.
        v_in_w, q_in_w: dofs of W behind the dofs of V and Q.
        v_nodes: velocity nodes of every cell, shape (cells, 6).
        q_nodes: pressure nodes (vertices) of every cell, shape (cells, 3).
        D: cell-wise constants.
        P: values at the quadrature points.
        dx, ds: measures; ``ds`` takes the tag of a wall.
    """

    def __init__(self, section):
        mesh = section.mesh
        cell = mesh.ufl_cell()
        velocity = ufl.VectorElement("Lagrange", cell, 2)
        pressure = ufl.FiniteElement("Lagrange", cell, 1)
        points = ufl.FiniteElement("Quadrature", cell, QUADRATURE_DEGREE, quad_scheme="default")
        self.W = fem.FunctionSpace(mesh, ufl.MixedElement([velocity, pressure]))
        self.V, v_in_w = self.W.sub(0).collapse()
        self.Q, q_in_w = self.W.sub(1).collapse()
        self.v_in_w, self.q_in_w = np.asarray(v_in_w), np.asarray(q_in_w)
        self.D = fem.FunctionSpace(mesh, ("DG", 0))
        self.P = fem.FunctionSpace(mesh, points)
        self.v_nodes = self.V.dofmap.list.array.reshape(-1, 6)
        self.q_nodes = self.Q.dofmap.list.array.reshape(-1, 3)
        degree = {"quadrature_degree": QUADRATURE_DEGREE}
        self.dx = ufl.Measure("dx", mesh, metadata=degree)
        self.ds = ufl.Measure("ds", mesh, subdomain_data=section.facet_tags, metadata=degree)

    @property
    def unknowns(self):
        """Number of velocity and pressure unknowns."""
        return self.W.dofmap.index_map.size_global * self.W.dofmap.index_map_bs

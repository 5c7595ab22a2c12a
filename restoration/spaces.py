"""Function spaces and measures of a section, and their degrees of freedom as plain arrays."""

import numpy as np
import ufl
from dolfinx import fem

from forms.elements import ELEMENTS, vector


class Spaces:
    """The spaces of one mesh: a pair of elements for the flow; P1, DG0 and points for the rock.

    Args:
        section: `meshes.data.SectionMesh`; split at the barycentres where the pair asks for it.
        element: name in `forms.elements.ELEMENTS`.
        degree: of the quadrature; None for the one of the elements.

    Attributes:
        pair: the `ElementPair`.
        W: mixed space of velocity and pressure.
        V, Q: velocity and pressure space on their own.
        v_in_w, q_in_w: dofs of W behind the dofs of V and Q.
        v_nodes: velocity nodes of every cell, shape (cells, nodes).
        H: continuous hat functions of the corners of the cells.
        h_nodes: hats (corners) of every cell, shape (cells, corners).
        D: cell-wise constants.
        P: values at the quadrature points.
        degree: of the quadrature.
        dx, ds: measures; ``ds`` takes the tag of a wall.
    """

    def __init__(self, section, element="P2-P1", degree=None):
        mesh, self.section = section.mesh, section
        self.pair = ELEMENTS[element]
        cell, dim = section.cell, section.dim
        self.degree = degree or self.pair.quadrature(cell)
        velocity = vector(self.pair.velocity(cell), dim)
        pressure = self.pair.pressure(cell)
        points = ufl.FiniteElement("Quadrature", cell, self.degree, quad_scheme="default")
        self.W = fem.FunctionSpace(mesh, ufl.MixedElement([velocity, pressure]))
        self.V, v_in_w = self.W.sub(0).collapse()
        self.Q, q_in_w = self.W.sub(1).collapse()
        self.v_in_w, self.q_in_w = np.asarray(v_in_w), np.asarray(q_in_w)
        self.H = self.Q if self.pair.continuous else fem.FunctionSpace(mesh, ("Lagrange", 1))
        self.D = fem.FunctionSpace(mesh, ("DG", 0))
        self.P = fem.FunctionSpace(mesh, points)
        self.v_nodes, self.h_nodes = nodes(self.V), nodes(self.H)
        degree = {"quadrature_degree": self.degree}
        self.dx = ufl.Measure("dx", mesh, metadata=degree)
        self.ds = ufl.Measure("ds", mesh, subdomain_data=section.facet_tags, metadata=degree)

    @property
    def unknowns(self):
        """Number of velocity and pressure unknowns on all ranks."""
        return self.W.dofmap.index_map.size_global * self.W.dofmap.index_map_bs


def nodes(space):
    """Return the nodes of every cell of a space, shape (cells, nodes), int32."""
    dofmap = space.dofmap.list
    return dofmap.array.reshape(dofmap.num_nodes, -1)

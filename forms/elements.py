"""Pairs of finite elements for velocity and pressure, by name.

All are stable, and of second order or better in the velocity. They differ in what they ask of a
mesh, in how well the pressure follows a jump, and in how exactly the flow keeps its volume:
docs/benchmarks.md has the measurements.
"""

from collections.abc import Callable
from dataclasses import dataclass

import basix
import basix.ufl_wrapper
import numpy as np
import ufl

SIMPLICES = ("triangle", "tetrahedron")
BOXES = ("quadrilateral", "hexahedron")


@dataclass(frozen=True)
class ElementPair:
    """An element for the velocity and one for the pressure.

    Attributes:
        name: in case files.
        cells: names of the cells it lives on.
        velocity: element of one velocity component, a function of the name of the cell.
        pressure: element of the pressure, likewise.
        continuous: whether the pressure is continuous from cell to cell.
        split: whether every cell of the mesh is to be split at its barycentre first.
        bubbles: whether the velocity has bubbles of higher degree.
    """

    name: str
    cells: tuple[str, ...]
    velocity: Callable[[str], object]
    pressure: Callable[[str], object]
    continuous: bool
    split: bool = False
    bubbles: bool = False

    def quadrature(self, cell):
        """Return the degree that integrates the viscous term of affine cells of one viscosity."""
        return 6 if self.bubbles and cell == "tetrahedron" else 4


def lagrange(degree):
    """Return the Lagrange element of a degree, a function of the name of the cell."""
    return lambda cell: ufl.FiniteElement("Lagrange", cell, degree)


def discontinuous(family):
    """Return the discontinuous element of degree one, a function of the name of the cell."""
    return lambda cell: ufl.FiniteElement(family, cell, 1)


def with_bubbles(degree, faces=False):
    """Return Lagrange elements with bubbles, a function of the name of the cell.

    The degrees of freedom are the values at the Lagrange nodes and at the middle of every cell
    and, with ``faces``, of every face of a tetrahedron. Without those the pair of P2 and
    discontinuous P1 is not stable there (Boffi, Brezzi & Fortin 2013, Mixed Finite Element
    Methods, sect. 8.7).
    """

    def element(cell):
        cell_type = getattr(basix.CellType, cell)
        dim = {"triangle": 2, "tetrahedron": 3}[cell]
        highest = dim + 1  # of the bubble of a cell
        points, weights = basix.make_quadrature(cell_type, 2 * highest)
        basis = basix.tabulate_polynomials(
            basix.PolynomialType.legendre, cell_type, highest, points
        )
        hats = np.column_stack([1 - points.sum(axis=1), points])
        bubbles = [hats.prod(axis=1)]
        if faces and dim == 3:
            bubbles += [np.delete(hats, k, axis=1).prod(axis=1) for k in range(4)]
        # The polynomials are orthonormal and ordered by degree: the first ones span P1 or P2.
        lower = {1: dim + 1, 2: (dim + 1) * (dim + 2) // 2}[degree]
        span = np.zeros((lower + len(bubbles), len(basis)))
        span[:lower, :lower] = np.eye(lower)
        for row, bubble in zip(span[lower:], bubbles, strict=True):
            row[:] = (basis * weights) @ bubble
            row /= np.linalg.norm(row)
        has_node = [True, degree == 2, dim == 2 or faces, True]
        geometry, topology = basix.geometry(cell_type), basix.topology(cell_type)
        nodes, functionals = [[] for _ in range(4)], [[] for _ in range(4)]  # by dimension
        for level, entities in enumerate(topology):
            count = int(has_node[level])
            for entity in entities:
                nodes[level].append(np.full((count, dim), geometry[list(entity)].mean(axis=0)))
                functionals[level].append(np.ones((count, 1, count, 1)))
        made = basix.create_custom_element(
            cell_type,
            [],
            span,
            nodes,
            functionals,
            0,
            basix.MapType.identity,
            False,
            degree,
            highest,
        )
        return basix.ufl_wrapper.BasixElement(made)

    return element


ELEMENTS = {
    pair.name: pair
    for pair in (
        ElementPair("P2-P1", SIMPLICES, lagrange(2), lagrange(1), True),
        ElementPair(
            "P2b-P1dg",
            SIMPLICES,
            with_bubbles(2, faces=True),
            discontinuous("DG"),
            False,
            bubbles=True,
        ),
        # In three dimensions the split needs cubic velocities to be stable (Zhang 2005).
        ElementPair("P2-P1dg", ("triangle",), lagrange(2), discontinuous("DG"), False, split=True),
        ElementPair("MINI", SIMPLICES, with_bubbles(1), lagrange(1), True, bubbles=True),
        ElementPair("Q2-Q1", BOXES, lagrange(2), lagrange(1), True),
        ElementPair("Q2-P1dg", BOXES, lagrange(2), discontinuous("DPC"), False),
    )
}


def vector(element, dim):
    """Return the vector element of ``dim`` components of an element."""
    if isinstance(element, basix.ufl_wrapper.BasixElement):
        return basix.ufl_wrapper.VectorElement(element, dim)
    return ufl.VectorElement(element, dim=dim)

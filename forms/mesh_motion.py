"""Weak form of the motion of a mesh: what moves a wall is spread into the cells."""

from ufl import dot, grad
from ufl.geometry import JacobianDeterminant


def spread_form(d, w, domain, dx):
    """Return the Laplace form of a component of the displacement, stiff where cells are small.

    With a stiffness of one over the area, small cells near an interface keep their shape and the
    large ones give way (Masud & Hughes 1997, Comput. Methods Appl. Mech. Eng. 146, 91-126).

    Args:
        d, w: trial and test function.
        domain: the mesh.
        dx: measure.
    """
    return dot(grad(d), grad(w)) / abs(JacobianDeterminant(domain)) * dx

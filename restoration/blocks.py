"""What the field split of `solvers` needs to know of a mixed space: dofs, mass, linear elements."""

from dataclasses import dataclass

import basix
import basix.ufl_wrapper
import numpy as np
from dolfinx import fem
from petsc4py import PETSc


@dataclass(frozen=True, eq=False)
class Blocks:
    """What the field split needs to know of the mixed space.

    Attributes:
        velocity, pressure: owned dofs of the mixed space, in the order of the collapsed spaces.
        schur: matrix of `mass`.
        mass: compiled form of the pressure mass over ``length**2 * eta``, without conditions.
        prolongation: writes linear elements in the velocity space.
        linear: space of linear vector fields; its nodes give the rigid motions.
        held: local rows of ``pressure`` under a strong condition.
    """

    velocity: PETSc.IS
    pressure: PETSc.IS
    schur: PETSc.Mat
    mass: fem.FormMetaClass
    prolongation: PETSc.Mat
    linear: fem.FunctionSpace
    held: np.ndarray

    @classmethod
    def build(cls, W, bcs, mass):
        """Return the blocks of the mixed space ``W`` of velocity and pressure.

        Args:
            W: the mixed space.
            bcs: strong conditions.
            mass: compiled form on the collapsed pressure space, see `mass`.
        """
        (V, v_in_w), (Q, q_in_w) = W.sub(0).collapse(), W.sub(1).collapse()
        held = np.zeros(_size(W), dtype=bool)
        for bc in bcs:
            held[bc.dof_indices()[0]] = True
        v_in_w, q_in_w = np.asarray(v_in_w), np.asarray(q_in_w)
        linear = fem.VectorFunctionSpace(W.mesh, ("Lagrange", 1))
        return cls(
            _index_set(W, V, v_in_w),
            _index_set(W, Q, q_in_w),
            fem.petsc.create_matrix(mass),
            mass,
            _prolongation(linear, V, held[v_in_w]),
            linear,
            np.flatnonzero(held[q_in_w[: _size(Q, ghosts=False)]]),
        )

    def assemble(self):
        """Assemble the Schur mass of the viscosity as it is now."""
        self.schur.zeroEntries()
        fem.petsc.assemble_matrix(self.schur, self.mass)
        self.schur.assemble()


def rigid_motions(linear):
    """Return translations and rotations of the mesh as it is now, as a null space."""
    dim, n = linear.dofmap.index_map_bs, linear.dofmap.index_map.size_local
    x = linear.tabulate_dof_coordinates()[:n, :dim]
    points = PETSc.Vec().createMPI((n * dim, None), bsize=dim, comm=linear.mesh.comm)
    points.array_w[:] = x.ravel()
    return PETSc.NullSpace().createRigidBody(points)


def _size(space, ghosts=True):
    index_map = space.dofmap.index_map
    nodes = index_map.size_local + (index_map.num_ghosts if ghosts else 0)
    return nodes * space.dofmap.index_map_bs


def _index_set(W, space, in_w):
    owned = in_w[: _size(space, ghosts=False)] + W.dofmap.index_map.local_range[0]
    dofs = PETSc.IS().createGeneral(owned.astype(PETSc.IntType), comm=W.mesh.comm)
    dofs.setBlockSize(space.dofmap.index_map_bs)
    return dofs


def _prolongation(coarse, fine, held):
    """Return the matrix that writes linear elements in the fine velocity space.

    A condition leaves only the entry of the vertex itself in its row and in its column, so that
    the Galerkin product has a one on the diagonal there too.
    """
    bs, local = fine.dofmap.index_map_bs, _reference_prolongation(coarse, fine)
    i, j = np.nonzero(local)
    vertex = np.isclose(local[i, j], 1)
    rows, cols = (
        space.dofmap.list.array.reshape(-1, n)[:, k, None] * bs + np.arange(bs)
        for space, n, k in ((fine, local.shape[0], i), (coarse, local.shape[1], j))
    )
    held_coarse = np.zeros(_size(coarse), dtype=bool)
    held_coarse[cols[:, vertex][held[rows[:, vertex]]]] = True
    keep = vertex[:, None] | ~(held[rows] | held_coarse[cols])
    keep &= rows < _size(fine, ghosts=False)
    values = np.broadcast_to(local[i, j][:, None], rows.shape)[keep]
    pair, once = np.unique(rows[keep] * np.int64(_size(coarse)) + cols[keep], return_index=True)
    rows, cols = np.divmod(pair, _size(coarse))
    node = coarse.dofmap.index_map.local_to_global((cols // bs).astype(np.int32))
    indptr = np.searchsorted(rows, np.arange(_size(fine, ghosts=False) + 1))
    cols = node * bs + cols % bs
    csr = (indptr.astype(PETSc.IntType), cols.astype(PETSc.IntType), values[once])
    sizes = [(_size(s, ghosts=False), s.dofmap.index_map.size_global * bs) for s in (fine, coarse)]
    return PETSc.Mat().createAIJ(sizes, bsize=bs, csr=csr, comm=fine.mesh.comm)


def _reference_prolongation(coarse, fine):
    """Return linear elements in the fine basis of one cell, shape (fine nodes, vertices)."""
    fine, coarse = (
        basix.ufl_wrapper.convert_ufl_element(space.ufl_element().sub_elements()[0])
        for space in (fine, coarse)
    )
    points, _ = basix.make_quadrature(coarse.cell_type, 8)
    local = np.linalg.lstsq(fine.tabulate(0, points)[0], coarse.tabulate(0, points)[0], rcond=None)
    return np.where(np.abs(local[0]) < 1e-10, 0, local[0])

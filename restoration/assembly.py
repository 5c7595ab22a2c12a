"""Assembly of a matrix whose pattern stays: compiled cell kernels, and places known beforehand.

The kernels are those that FFCx makes of the UFL forms. What a general assembly spends on finding
the places of the entries in the sparse matrix is spent once: assembling anew then costs what
the kernels cost, a quarter of what the general way does (``docs/measure.py solves``). Cells are
shared out to threads; they are summed up in one order, so that the sum does not depend on how many
there are.
"""

import ctypes

import cffi
import numba
import numpy as np
from dolfinx import fem
from dolfinx.cpp.fem import IntegralType, pack_coefficients, pack_constants
from petsc4py import PETSc

CHUNK = 1024  # cells whose matrices are kept at a time
KERNEL = ctypes.CFUNCTYPE(None, *[ctypes.c_void_p] * 6)


def assembler(form, cells, facets, space, mesh):
    """Return what assembles a bilinear form: by known places where that is possible.

    Args:
        form: compiled form of all integrals.
        cells: the same of its cell integrals alone.
        facets: the same of its other integrals, None where there are none.
        space: function space of its arguments.
        mesh: `dolfinx.mesh.Mesh`, whose nodes may move.
    """
    if CellAssembler.serves(cells, space, mesh):
        return CellAssembler(cells, facets, space, mesh)
    return Assembler(form)


class Assembler:
    """Assembles a bilinear form on any number of ranks.

    Args:
        form: compiled form.

    Attributes:
        A: the matrix.
    """

    def __init__(self, form):
        self._form = form
        self.A = fem.petsc.create_matrix(form)

    def assemble(self, conditions):
        """Assemble with the coefficients and nodes as they are now.

        Args:
            conditions: strong ones, applied symmetrically with a one on the diagonal.
        """
        self.A.zeroEntries()
        fem.petsc.assemble_matrix(self.A, self._form, conditions)
        self.A.assemble()


class CellAssembler:
    """Assembles as `Assembler` does, on one rank, the cell integrals by known places.

    Args:
        cells: compiled form of cell integrals over the whole mesh.
        facets: of all other integrals, or None.
        space: function space of the arguments, whose cells need no turning of their dofs.
        mesh: `dolfinx.mesh.Mesh`, whose nodes may move.

    Attributes:
        A: the matrix. It reads the array that the sums are made in.
    """

    def __init__(self, cells, facets, space, mesh):
        self._form, self._facets, self._mesh = cells, facets, mesh
        pattern = fem.create_sparsity_pattern(cells)
        pattern.assemble()
        rows, columns = pattern.graph.offsets.copy(), pattern.graph.array.copy()
        self._values = np.zeros(len(columns))
        n, csr = len(rows) - 1, (rows, columns, self._values)
        self.A = PETSc.Mat().createAIJWithArrays((n, n), csr, comm=mesh.comm)
        numbers = PETSc.LGMap().create(np.arange(n, dtype=np.int32), comm=mesh.comm)
        self.A.setLGMap(numbers, numbers)
        numbers.destroy()  # the matrix holds it; PETSc would keep for good what Python drops
        self._rows, self._columns = rows, columns
        self._conditions, self._held, self._diagonal = None, None, None
        dofs = space.dofmap.list
        dofs = dofs.array.reshape(dofs.num_nodes, -1)
        self._places = _places(dofs, rows, columns)
        nodes = mesh.geometry.dofmap
        self._nodes = nodes.array.reshape(nodes.num_nodes, -1)
        kernel = cells.ufcx_form.integrals(IntegralType.cell.value)[0]
        address = int(cffi.FFI().cast("uintptr_t", kernel.tabulate_tensor_float64))
        self._kernel = KERNEL(address)

    @staticmethod
    def serves(cells, space, mesh):
        """Return whether cell integrals can be assembled here: on one rank, by one kernel."""
        ufcx = cells.ufcx_form
        return (
            mesh.comm.size == 1
            and not space.element.needs_dof_transformations
            and ufcx.num_integrals(IntegralType.cell.value) == 1
            and ufcx.integral_ids(IntegralType.cell.value)[0] == -1
        )

    def assemble(self, conditions):
        """Assemble, see `Assembler.assemble`."""
        (coefficients,) = pack_coefficients(self._form).values()
        _assemble(
            self._kernel,
            self._values,
            self._places,
            coefficients,
            pack_constants(self._form),
            self._mesh.geometry.x,
            self._nodes,
        )
        if conditions is not self._conditions:
            self._hold(conditions)
        self._values[self._held] = 0.0
        self._values[self._diagonal] = 1.0
        self.A.stateIncrease()
        if self._facets is not None:
            fem.petsc.assemble_matrix(self.A, self._facets, conditions)
            self.A.assemble()

    def _hold(self, conditions):
        """Find the entries in the rows and columns of dofs that are held."""
        dofs = [condition.dof_indices()[0] for condition in conditions]
        held = np.zeros(len(self._rows) - 1, bool)
        held[np.concatenate([np.empty(0, np.int32), *dofs])] = True
        row = np.repeat(np.arange(len(held)), np.diff(self._rows))
        self._held = np.flatnonzero(held[row] | held[self._columns])
        self._diagonal = self._held[row[self._held] == self._columns[self._held]]
        self._conditions = conditions


@numba.njit(cache=True)
def _places(dofs, rows, columns):
    """Return where in the values every entry of the matrix of a cell goes, (cells, n * n)."""
    n = dofs.shape[1]
    places = np.empty((len(dofs), n * n), np.int32)
    for c in range(len(dofs)):
        for i in range(n):
            first = rows[dofs[c, i]]
            row = columns[first : rows[dofs[c, i] + 1]]
            for j in range(n):
                places[c, i * n + j] = first + np.searchsorted(row, dofs[c, j])
    return places


@numba.njit(parallel=True, cache=True)
def _assemble(kernel, values, places, coefficients, constants, x, nodes):
    values[:] = 0.0
    part = np.empty((CHUNK, places.shape[1]))
    at = np.empty((CHUNK, nodes.shape[1], 3))
    for first in range(0, len(places), CHUNK):
        count = min(CHUNK, len(places) - first)
        for k in numba.prange(count):
            c = first + k
            for i in range(nodes.shape[1]):
                at[k, i] = x[nodes[c, i]]
            part[k] = 0.0
            kernel(
                part[k].ctypes,
                coefficients[c].ctypes,
                constants.ctypes,
                at[k].ctypes,
                0,
                0,
            )
        for k in range(count):
            for m in range(places.shape[1]):
                values[places[first + k, m]] += part[k, m]

"""What is asked of a solution of the Stokes equations before anybody may use it.

The residual tells whether the matrix was solved. Whether that was the matrix of the problem, and
whether every rank has the values of its neighbours, it cannot tell: the divergence of what was
found does, and two products of the matrix with known vectors.
"""

import numpy as np
import ufl
from dolfinx import fem
from dolfinx import mesh as dmesh
from mpi4py import MPI
from petsc4py import PETSc

from restoration.errors import SolveError, TooLargeError

# Mean divergence over the speed across the section: rounding makes 1e-3 where viscosities differ by
# 1e12 and 1e-9 where by 1e6 (`docs/measure.py divergence`); ghosts of another flow make 1 and more.
MOST_DIVERGENCE = 1e-2
SAME = 1e-8  # relative, between two sums that are one but for rounding
CONTRAST = "the viscosity contrast may be too high"


def climbed(rungs, doubt):
    """Take one way after another until what it leads to can be trusted.

    Args:
        rungs: (name, task) in order, made as they are asked for; a task may raise SolveError.
        doubt: returns why what a task has led to cannot be trusted, or None.

    Returns:
        Names of the ways taken; the last has led there.

    Raises:
        SolveError: all have failed; it tells what each met, and what to do.
        TooLargeError: at once where one does not fit into memory.
    """
    failures, advice = {}, None
    for name, task in rungs:
        try:
            task()
            why = doubt()
        except TooLargeError:
            raise
        except SolveError as error:
            why, _, told = str(error).partition("; ")
            advice = advice or told
        if why is None:
            return [*failures, name]
        failures[name] = why  # of several refinements the last
    met = ", then ".join(f"{name}: {why}" for name, why in failures.items())
    raise SolveError(f"the Stokes solve failed ({met}); {advice or CONTRAST}")


def add_up(vector):
    """Add what the ranks have of a vector for others where it belongs; collective.

    Args:
        vector: PETSc vector with ghosts.

    Raises:
        SolveError: the sum over all ranks is another afterwards.
    """
    comm = vector.comm.tompi4py()
    with vector.localForm() as local:
        parts = np.array([local.array_r.sum(), np.abs(local.array_r).sum()])
    _send(vector, PETSc.InsertMode.ADD, PETSc.ScatterMode.REVERSE)
    if comm.size == 1:
        return
    total, size = comm.allreduce(parts, op=MPI.SUM)
    if not abs(vector.sum() - total) <= SAME * size:
        raise SolveError("the load is not what the ranks have made of it; check the MPI of dolfinx")


def tell(vector):
    """Let the ranks know what others have of a vector; collective."""
    _send(vector, PETSc.InsertMode.INSERT, PETSc.ScatterMode.FORWARD)


def _send(vector, how, way):
    vector.ghostUpdate(addv=how, mode=way)


class Divergence:
    """Tells how much volume a velocity makes, away from the walls.

    What is looked at is what the elements keep: the mean over cells where the pressure is
    discontinuous, else the means weighted by the hats of the corners.

    Args:
        section: `meshes.data.SectionMesh`.
        spaces: `Spaces` of it.
    """

    def __init__(self, section, spaces):
        self._section, self._comm = section, section.mesh.comm
        space = spaces.H if spaces.pair.continuous else spaces.D
        self._u = fem.Function(spaces.V)
        q = ufl.TestFunction(space)
        self._made = fem.form(q * ufl.div(self._u) * spaces.dx)
        self._weight = fem.form(q * spaces.dx)
        dim, walls = section.dim, _walls(section)
        if spaces.pair.continuous:
            at_wall = fem.locate_dofs_topological(space, dim - 1, walls)
        else:
            cells = section.mesh.topology.connectivity(dim - 1, dim)
            at_wall = [cells.links(facet)[0] for facet in walls]
        self._owned = space.dofmap.index_map.size_local
        self._inside = np.ones(self._owned, bool)
        held = np.asarray(at_wall, np.int64)
        self._inside[held[held < self._owned]] = False
        # of the mesh as it was made, which is near enough to tell what is small
        self._weights = self._assembled(self._weight)
        self._volume = self._comm.allreduce(float(self._weights.sum()), op=MPI.SUM)
        self._length = section.area ** (1 / dim)

    def __call__(self, u, rate=0.0):
        """Return the divergence over the speed across the section; collective.

        Args:
            u: velocity at the nodes of this rank and its ghosts, shape (nodes, dim), m/s.
            rate: divergence that it is to have, 1/s.
        """
        self._u.x.array[:] = u.ravel()
        off = self._assembled(self._made)
        if rate:
            off -= rate * self._assembled(self._weight)
        owned = u[: self._u.function_space.dofmap.index_map.size_local]
        parts = np.array([off @ (off / self._weights), (owned**2).sum(), len(owned)])
        off, squares, count = self._comm.allreduce(parts, op=MPI.SUM)
        if not off or not squares:
            return float(np.sqrt(off))
        return float(self._length * np.sqrt(off / self._volume / (squares / count)))

    def _assembled(self, form):
        """Return a form at the inner rows of this rank."""
        vector = fem.petsc.assemble_vector(form)
        vector.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        values = vector.array_r[: self._owned][self._inside].copy()
        vector.destroy()
        return values


class Probe:
    """Tells whether a matrix can be that of a Stokes problem, by two products with it.

    Against a pressure that grows upwards rock that rises everywhere but at the walls does work,
    which is its volume over the length in the form; both blocks of the pressure must say so, and
    the same. Moving so it deforms, which costs work.

    Args:
        section: `meshes.data.SectionMesh`.
        spaces: `Spaces` of it.
        like: vector of their unknowns.
        viscous: whether the velocity block is that of viscous rock alone.
    """

    def __init__(self, section, spaces, like, viscous=True):
        dim, self._viscous = section.dim, viscous
        owned = like.getLocalSize()
        inside = np.ones((len(spaces.v_in_w) // dim, dim), bool)
        inside[fem.locate_dofs_topological(spaces.V, dim - 1, _walls(section))] = False
        inside[:, :-1] = False
        height = fem.Function(spaces.Q)
        height.interpolate(lambda x: x[dim - 1])
        self._rise, self._pressure, self._force = (like.duplicate() for _ in range(3))
        rows = spaces.v_in_w[inside.ravel()]
        self._rise.array_w[rows[rows < owned]] = 1.0
        own = spaces.q_in_w < owned
        self._pressure.array_w[spaces.q_in_w[own]] = height.x.array[own]

    def __call__(self, A):
        """Return what is wrong with a matrix, or None; collective.

        Args:
            A: of the problem, its strong conditions applied symmetrically.
        """
        A.mult(self._pressure, self._force)
        lifted = self._rise.dot(self._force)
        A.mult(self._rise, self._force)
        given, spent = self._pressure.dot(self._force), self._rise.dot(self._force)
        if not (lifted > 0 and abs(lifted - given) <= SAME * lifted):
            return (
                f"the blocks of the pressure are not those of a flow ({lifted:.2e} and "
                f"{given:.2e} instead of two of the same above zero)"
            )
        if self._viscous and not spent > 0:
            return f"rock that rises gains energy by its viscosity ({spent:.2e})"
        return None

    def release(self):
        """Give the memory back."""
        for held in (self._rise, self._pressure, self._force):
            held.destroy()


def _walls(section):
    """Return the facets on walls."""
    topology = section.mesh.topology
    topology.create_connectivity(section.dim - 1, section.dim)
    return dmesh.exterior_facet_indices(topology)

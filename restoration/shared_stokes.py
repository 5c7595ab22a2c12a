"""The Stokes problem of a mesh that every rank holds whole, solved by one of them or by all.

For all of them the mesh is dealt out with ghosts, the fields are copied there from the whole ones,
and velocity and pressure are gathered again, so that around the solve nothing knows of ranks.
"""

from dataclasses import asdict, replace
from functools import partial

import numpy as np
from dolfinx import fem
from ufl import replace as replaced
from ufl.algorithms import extract_coefficients
from ufl.core.expr import Expr

from meshes.dealt import dealt
from meshes.noding import MeshingError
from restoration.errors import MeshError
from restoration.spaces import Spaces, nodes
from restoration.stokes import Counts, StokesProblem
from restoration.surface import Ground


class FirstStokes:
    """Solves as a `StokesProblem` does: on the first of several ranks, which tells the others.

    The same run on the same ranks then gives the same bits.

    Args:
        ranks: `ranks.Ranks`, that hold the mesh and the fields whole each.
        *arguments, **options: of a `StokesProblem`.

    Attributes:
        leak, factored, analyses, lead: see `StokesProblem`.
    """

    def __init__(self, ranks, *arguments, counts, **options):
        self._ranks, self._counts, self.factored = ranks, counts or Counts(), lambda: None
        self.lead = 0.0
        self._made = ranks.alone(partial(StokesProblem, *arguments, counts=self._counts, **options))
        self._tell()

    def _tell(self, *found):
        """Return what the first rank has found, and take over what it counts."""
        made, counts = self._made, asdict(self._counts)
        told = self._ranks.same((found, made and (made.leak, made.analyses), counts))
        for name, value in told[2].items():
            setattr(self._counts, name, value)
        self.leak, self.analyses = told[1]
        return told[0]

    def _alone(self, name, *arguments):
        return self._ranks.alone(lambda: getattr(self._made, name)(*arguments))

    def set_time(self, time):
        """See `StokesProblem.set_time`."""
        self._alone("set_time", time)

    def stabilise(self, lead, before=None):
        """See `StokesProblem.stabilise`."""
        self.lead = lead
        self._alone("stabilise", lead, before)

    def assemble(self):
        """See `StokesProblem.assemble`."""
        self._alone("assemble")

    def solve(self):
        """See `StokesProblem.solve`; on all ranks."""
        return self._found("solve")

    def response(self, column):
        """See `StokesProblem.response`; on all ranks."""
        return self._found("response", column)

    def _found(self, name, *arguments):
        before = self._counts.factorisations
        (found,) = self._tell(self._alone(name, *arguments))
        if self._counts.factorisations > before:
            self.factored()
        return found

    def memory(self):
        """See `StokesProblem.memory`."""
        return self._ranks.same(self._alone("memory"))

    def prepare(self, memory, analysed):
        """See `StokesProblem.prepare`."""
        self._alone("prepare", memory, analysed)
        self._tell()

    def recall(self, memory):
        """See `StokesProblem.recall`."""
        self._alone("recall", memory)
        self._tell()

    def facts(self):
        """See `StokesProblem.facts`; on all ranks."""
        return self._ranks.same(self._alone("facts"))

    def release(self):
        """Give the memory of matrix and factors back."""
        self._alone("release")


class SharedStokes:
    """Solves as a `StokesProblem` does, on several ranks.

    Args:
        ranks: `ranks.Ranks`.
        section, spaces: the whole mesh, the same on all ranks, and its `Spaces`.
        rho, eta: UFL expressions of functions on the whole mesh.
        *others: further arguments of `StokesProblem`.
        top: `surface.Ground` of the whole mesh, or None.
        on_facets: as ``rho`` and ``eta``, or None.
        **options: further arguments of `StokesProblem` by name.

    Raises:
        MeshError: there are more ranks than cells.

    Attributes:
        leak: see `StokesProblem`.
    """

    def __init__(self, ranks, section, spaces, rho, eta, *others, top, on_facets, **options):
        self._ranks, self._whole = ranks, section
        try:
            self._part = dealt(section, ranks.comm)
        except MeshingError as error:
            raise MeshError(str(error)) from None
        self.spaces = spaces
        own = self._own = Spaces(self._part.section, spaces.pair.name, spaces.degree)
        self._mirrors = {}
        rho, eta, *facets = (self._mirrored(field) for field in (rho, eta, *(on_facets or ())))
        ground = top and Ground(self._part.section, own, top.air)
        self._problem = StokesProblem(
            self._part.section,
            own,
            rho,
            eta,
            *others,
            top=ground,
            on_facets=tuple(facets) or None,
            **options,
        )
        self._hats = self._nodes_of(own.H, spaces.H)
        self._nodes = [self._nodes_of(own.V, spaces.V), self._nodes_of(own.Q, spaces.Q)]
        self._gathered = [
            _Gathering(ranks, space, at)
            for space, at in zip((own.V, own.Q), self._nodes, strict=True)
        ]

    @property
    def leak(self):
        """Flux out of the walls that the section makes up for by swelling, m^dim/s."""
        return self._problem.leak

    def _nodes_of(self, own, whole):
        """Return the node of the whole mesh of every node of this rank."""
        found = np.empty(int(nodes(own).max()) + 1, np.int64)
        found[nodes(own)] = nodes(whole)[self._part.cells]
        return found

    def _mirrored(self, field):
        """Return an expression with its functions replaced by those of the mesh dealt out."""
        if not isinstance(field, Expr):
            return field
        of = {}
        for function in extract_coefficients(field):
            if function not in self._mirrors:
                space = function.function_space
                own = fem.FunctionSpace(self._part.section.mesh, space.ufl_element())
                self._mirrors[function] = fem.Function(own), self._nodes_of(own, space)
            of[function] = self._mirrors[function][0]
        return replaced(field, of)

    def set_time(self, time):
        """Set what the walls prescribe for a model time, s, and for the mesh as it stands now."""
        self._part.section.mesh.geometry.x[:] = self._whole.mesh.geometry.x[self._part.nodes]
        self._problem.set_time(time)

    def stabilise(self, lead, before=None):
        """Let the weight of the moved surface count, see `StokesProblem.stabilise`."""
        self._problem.stabilise(lead, before)

    def assemble(self):
        """Assemble for the fields as they are now, see `StokesProblem.assemble`."""
        self._mirror()
        self._problem.assemble()

    def _mirror(self):
        """Take the values of the functions on the whole mesh."""
        for function, (own, at) in self._mirrors.items():
            own.x.array[:] = function.x.array[at]

    def solve(self):
        """Return the `Flow` on the whole mesh of what was assembled last.

        Raises:
            SolveError: as `StokesProblem.solve`, on all ranks.
        """
        flow, (velocity, pressure) = self._problem.solve(), self._gathered
        return replace(flow, u=velocity(flow.u), p=pressure(flow.p))

    def response(self, column):
        """Return the velocity that a column of rock on the surface adds, (nodes, 2), m/s.

        Args:
            column: its height at the dofs of `Spaces.H` of the whole mesh, m.
        """
        return self._gathered[0](self._problem.response(column[self._hats]))

    @property
    def factored(self):
        """See `StokesProblem`."""
        return self._problem.factored

    @factored.setter
    def factored(self, note):
        self._problem.factored = note

    @property
    def lead(self):
        """See `StokesProblem.lead`."""
        return self._problem.lead

    @property
    def analyses(self):
        """See `StokesProblem.analyses`."""
        return self._problem.analyses

    def memory(self):
        """Return what `StokesProblem.memory` does, on the whole mesh."""
        found, (velocity, pressure) = self._problem.memory(), self._gathered
        past = [x | {"u": velocity(x["u"]), "p": pressure(x["p"])} for x in found["past"]]
        return found | {"past": past}

    def prepare(self, memory, analysed):
        """See `StokesProblem.prepare`."""
        self._mirror()
        self._problem.prepare(memory, analysed)

    def recall(self, memory):
        """See `StokesProblem.recall`; of any number of ranks."""
        self._mirror()
        velocity, pressure = self._nodes
        past = [x | {"u": x["u"][velocity], "p": x["p"][pressure]} for x in memory["past"]]
        self._problem.recall(memory | {"past": past})

    def facts(self):
        """Return what `StokesProblem.facts` does."""
        return self._problem.facts()

    def release(self):
        """Give the memory of matrix and factors back."""
        self._problem.release()


class _Gathering:
    """Puts the values of all ranks together in the order of the whole mesh.

    Args:
        ranks: `ranks.Ranks`.
        space: of this rank.
        nodes: node of the whole mesh of every node of this rank, ghosts last.
    """

    def __init__(self, ranks, space, nodes):
        self._ranks, self._owned = ranks, space.dofmap.index_map.size_local
        self._order = ranks.rows(nodes[: self._owned])

    def __call__(self, values):
        parts = self._ranks.rows(values[: self._owned])
        whole = np.empty_like(parts)
        whole[self._order] = parts
        return whole

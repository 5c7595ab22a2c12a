"""The Stokes engine of a box in three dimensions: a mesh that stands, particles, and sheets."""

from dataclasses import replace

import numpy as np
from mpi4py import MPI

from meshes.body_centred import body_centred_mesh
from restoration.engine import StokesEngine
from restoration.lines import points_of, with_points
from restoration.particles import relocate
from restoration.state import State


class BoxMesher:
    """Makes the one mesh of a box, in the place of a `Mesher`.

    Args:
        scene: `scene.Scene` of three dimensions.
        _ranks: of whom every one gets the whole mesh.

    Attributes:
        coarsest, finest: side of the cubes that become cells, m.
    """

    def __init__(self, scene, _ranks=None):
        width, length, height = scene.extent
        self.coarsest = self.finest = float(np.cbrt(width * length * height / np.prod(scene.cells)))
        corners = (0, 0, -height), (width, length, 0)
        self._section = body_centred_mesh(*corners, scene.cells, MPI.COMM_SELF)

    def mesh(self, *_):
        """Return the mesh, and None for points in its regions, of which there are none."""
        return self._section, None


class BoxEngine(StokesEngine):
    """Moves a box by Stokes flow; its states have sheets in the place of lines.

    Args:
        scene: `scene.Scene` of three dimensions: closed, without a free surface.
        ranks: as of a `StokesEngine`.
    """

    make_mesher = BoxMesher

    def within(self, x):
        """Return the points with those beyond the box set onto it."""
        width, length, height = self.scene.extent
        return np.clip(x, (0.0, 0.0, -height), (width, length, 0.0))

    def _first_lines(self):
        return self.scene.sheets

    def _take(self, section, lines, regions=None):
        super()._take(section, (), regions)  # no mesh is made for sheets

    _memory_of_lines = staticmethod(points_of)

    def _lines_of_memory(self, points):
        return with_points(self.scene.sheets, points)

    def _on_walls(self, x, particles):
        inside = self.within(x)
        moved = (inside != x).any(axis=1)
        own = np.array(np.count_nonzero(moved[:particles]))
        self.held_on_wall += int(self.ranks.sum(own)) + np.count_nonzero(moved[particles:])
        return inside

    def _moved(self, state, until, scheme, slaving=True):
        move, x, until = self._controlled(state, until, scheme, slaving)
        with self.timed("advect"):
            moved = move.parts(self._on_walls(x, move.particles))
            lines = self.ranks.same(with_points(state.lines, moved["lines"]))
            particles = replace(state.particles, x=moved["particles"])
            return State(until, relocate(particles, self.grid.index), lines)

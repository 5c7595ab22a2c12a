"""What an engine remembers, for a checkpoint or a trial, and how it goes on from there.

The factors of a matrix are not remembered but what they were made of, so that they are made again.
"""

from dataclasses import asdict, replace

from mpi4py import MPI

from meshes.arrays import Arrays, assembled
from meshes.box import PLANE_WALLS, WALL_TAGS
from restoration.lines import from_memory, memory_of
from restoration.state import State
from restoration.stokes import Flow

# What is counted and remembered from step to step beside the state.
NUMBERS = (
    "meshes",
    "fitted",
    "start_area",
    "surface_shift",
    "horizon_shift",
    "fallen",
    "rejected",
    "retried",
    "longest",
    "born",
    "empty_cells",
    "held_on_wall",
    "_steps",
    "_next",
)


class Remembering:
    """The memory of `engine.StokesEngine`, whose attributes it reads and sets."""

    _memory_of_lines = staticmethod(memory_of)
    _lines_of_memory = staticmethod(from_memory)

    def memory(self, state, gather=True):
        """Return all that the run depends on from a state on, for a checkpoint or another trial.

        What is rebuilt from it by `recalled` goes on bit for bit as this engine does. The arrays
        are not to be changed.

        Args:
            state: with its flow, the one solved for last.
            gather: whether the particles of all ranks are gathered, as a file asks for; else every
                rank holds its own, and `gathered` makes up for it.

        Returns:
            A dict of dicts, lists, numbers, texts and arrays; the same on all ranks.
        """
        if gather:  # for a file, and counted with that
            return self._memory(state, gather)
        with self.timed("guards"):
            return self._memory(state, gather)

    def _memory(self, state, gather):
        flow = state.flow
        return self.memory_of_rock(state, gather) | {
            "flow": {"u": flow.u, "p": flow.p, "residual": flow.residual},
            "grid": self.grid.memory(),
            "surface": self.surface and self.surface.memory(),
            "rock_areas": self._guard.areas,
            "guards": self._guards.memory(),
            "counts": asdict(self.counts),
            "numbers": {name: getattr(self, name) for name in NUMBERS},
            "left": dict(self.left),
            "entered": dict(self.entered),
            "folded": sorted(self._folded),
            "notes": list(self.notes),
            "seconds": dict(self.seconds),
        }

    def recalled(self, memory):
        """Go back to where `memory` was asked for, and return the state.

        Args:
            memory: of an engine of the same scene, on any number of ranks.
        """
        self._let_follow(memory["numbers"]["fitted"])
        flow = memory["flow"]
        flow = Flow(flow["u"], flow["p"], flow["residual"])
        with self.timed("setup"):
            self.grid.stokes.release()
            self.grid = self._recalled_grid(memory["grid"])
            self.grid.recall(memory["grid"], memory["time"])
            if self.surface:
                self.surface.recall(memory["surface"], self.grid)
        self._guard.areas = memory["rock_areas"]
        self._guards.recall(memory["guards"])
        for name, value in memory["counts"].items():
            setattr(self.counts, name, value)
        for name, value in memory["numbers"].items():
            setattr(self, name, value)
        self.left, self.entered = dict(memory["left"]), dict(memory["entered"])
        self._folded, self.notes = set(memory["folded"]), list(memory["notes"])
        self.seconds, self._last_flow = dict(memory["seconds"]), flow
        state = self.rock_of(memory)
        particles = self.sharing.dealt(state.particles, self.grid.index)
        return replace(state, particles=particles, flow=flow, grid=self.grid)

    def gathered(self, memory):
        """Return a memory with the particles of all ranks."""
        particles = memory["particles"]["held"]
        return memory | {"particles": self.sharing.memory(particles)}

    def memory_of_rock(self, state, gather=True):
        """Return where the rock is in a state, as `memory` does; see `rock_of`."""
        particles = self.sharing.memory if gather else self.sharing.held
        return {
            "time": state.time,
            "particles": particles(state.particles),
            "lines": self._memory_of_lines(state.lines),
        }

    def rock_of(self, memory):
        """Return the state, without flow and mesh, that `memory_of_rock` was asked of.

        It can be taken over; on another number of ranks all have all particles.
        """
        lines = self._lines_of_memory(memory["lines"])
        return State(memory["time"], self.sharing.recalled(memory["particles"]), lines)

    def _recalled_grid(self, memory):
        """Return a grid as it was made, of the mesh that a memory tells of."""
        lines, arrays = from_memory(memory["made_for"]), memory["arrays"]
        if arrays is None:
            return self._grid_of(self.mesher.mesh(lines)[0], lines, None)
        section = assembled(
            Arrays(**arrays),
            {name: WALL_TAGS[name] for name in PLANE_WALLS},
            frozenset(memory["flat"]),
            MPI.COMM_SELF,
            memory["with_regions"],
        )
        unit = memory["unit_of_region"]
        return self._grid_of(section, lines, None if unit is None else lambda *_: unit)

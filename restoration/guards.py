"""What must hold after every step, and what a fitted mesh cannot follow.

A state that breaks one of these is not gone on from and not written: the step is taken anew, with
half its length, and if that does not help the run ends with the place and the number.
"""

import numpy as np

from restoration.errors import MeshError, ParticleError, SolveError
from restoration.spaces import nodes
from restoration.surface import STEEPEST, WORST_SHAPE
from restoration.units import show

MOST_AREA_DRIFT = 1e-6  # of the section in a step, where no rock crosses a wall
MOST_AREA_CHANGE = 1e-4  # the same from where the run began: that of hundreds of steps
# Slope between two nodes of a mesh on its surface. What is steeper than `surface.STEEPEST` falls
# from the line; the nodes follow that by least squares, and overshoot a little beside a scarp.
STEEPEST_CELL = 2 * STEEPEST
THINNEST = 1e-5  # shape of a cell over that of the best one: about its height over its length

ROCK_JUMP = 0.02  # of the section, that no rock wins or loses from one fitted mesh to the next
SAMPLES = 300  # along each side of the section, of what is drawn
WELD = 0.02  # of a cell: a layer that is thinner is left to particles


class StepGuards:
    """Looks at the state after every step, before it is gone on from.

    Args:
        scene: `scene.Scene`.
        ranks: `ranks.Ranks`; all of them look, and raise together.
        closed: whether no rock crosses a wall.
    """

    def __init__(self, scene, ranks, closed):
        self._scene, self._ranks, self._closed = scene, ranks, closed
        self._area = self._begun = self._expected = None

    def watch(self, state, arrived=0):
        """Take from a state what those after it are compared with; arguments as of `look`."""
        self._area = self._begun = self._area_of(state.grid)
        self._expected = int(self._ranks.sum(np.array(len(state.particles.x)))) - arrived

    @staticmethod
    def _area_of(grid):
        return float(grid.index.area[~grid.fields.in_air].sum())

    def memory(self):
        """Return what the next looks compare with."""
        return {"area": self._area, "begun": self._begun, "particles": self._expected}

    def recall(self, memory):
        """Go on comparing with what `memory` has returned."""
        self._area, self._begun = memory["area"], memory["begun"]
        self._expected = memory["particles"]

    def look(self, state, arrived=0):
        """Raise where a state cannot be gone on from.

        Args:
            state: `State` with its flow, after a step.
            arrived: particles that were born or have come through walls so far, less those that
                have left.

        Raises:
            SolveError: the flow is not finite.
            MeshError: a cell has turned over or lost its shape, the section has won or lost area,
                the surface is too steep, or a line is not finite.
            ParticleError: a particle is lost or nowhere, or a part of the section has none.
        """
        self._look_at_numbers(state)
        self._look_at_particles(state, arrived)
        self._look_at_cells(state.grid)

    def _look_at_numbers(self, state):
        u, p = state.flow.u, state.flow.p
        if not (np.isfinite(u.sum()) and np.isfinite(p.sum())):
            wrong = int((~np.isfinite(u)).any(axis=1).sum()), int((~np.isfinite(p)).sum())
            raise SolveError(
                f"the flow is not finite: the velocity at {wrong[0]} of {len(u)} nodes, the "
                f"pressure at {wrong[1]} of {len(p)}"
            )
        for line in state.lines:
            if not np.isfinite(line.points.sum()):
                count = int((~np.isfinite(line.points)).any(axis=1).sum())
                raise MeshError(
                    f"{line.kind} {line.name}: {count} of {len(line.points)} points are not finite"
                )

    def _look_at_particles(self, state, arrived):
        particles, ranks = state.particles, self._ranks
        finite = bool(np.isfinite(particles.x.sum()))
        count, lost, wrong = ranks.sum(
            np.array([len(particles.x), particles.lost, 0 if finite else 1])
        ).tolist()
        if wrong:
            wrong = ~np.isfinite(particles.x).all(axis=1)
            raise ParticleError(
                f"{int(ranks.sum(np.array(wrong.sum())))} of {count} particles are nowhere: their "
                "positions are not finite"
            )
        if lost:
            where = ranks.rows(particles.x[~particles.inside][:1])[0]
            raise ParticleError(
                f"{lost} of {count} particles have left the section where nothing may, the first "
                f"near {place(where)}; shorter steps (time.courant) or finer cells may help"
            )
        missing = self._expected + arrived - count
        if missing:
            raise ParticleError(
                f"{abs(missing)} of {count} particles {'are missing' if missing > 0 else 'are new'}"
                ", and none of them came or went through a wall"
            )
        bare = state.grid.fields.bare
        if len(bare):
            where = state.grid.index.corners[bare[0]].mean(axis=0)
            raise ParticleError(
                f"no particle is within two cells of {len(bare)} cells, the first near "
                f"{place(where)}; raise particles.per_cell"
            )

    def _look_at_cells(self, grid):
        kept, index = grid.kept_shape, grid.index
        least = int(kept.argmin())
        if not kept[least] > 0:
            raise MeshError(
                f"{np.count_nonzero(~(kept > 0))} of {len(kept)} cells have turned over, the worst "
                f"near {place(index.corners[least].mean(axis=0))}"
            )
        if not kept[least] > 0.99 * WORST_SHAPE:
            raise MeshError(
                f"a cell near {place(index.corners[least].mean(axis=0))} has kept "
                f"{100 * kept[least]:.2g} % of its shape, at least {100 * WORST_SHAPE:.0f} % are "
                "needed"
            )
        if grid.thinnest < THINNEST:
            raise MeshError(
                f"a cell is {1 / grid.thinnest:.1g} times as long as it is high, at most "
                f"{1 / THINNEST:.0g} are possible; change mesh.cells or simplify the section"
            )
        area = self._area_of(grid)
        for before, since, most in (
            (self._area, "in this step", MOST_AREA_DRIFT),
            (self._begun, "since the run began", MOST_AREA_CHANGE),
        ):
            drift = area / before - 1
            if self._closed and not abs(drift) <= most:
                raise MeshError(
                    f"the section has {'won' if drift > 0 else 'lost'} {abs(drift):.1e} of its "
                    f"area {since}, at most {most:.0e} are possible where no rock crosses a wall"
                )
        self._area = area
        if grid.top is not None:
            self._look_at_surface(grid.top.line)

    @staticmethod
    def _look_at_surface(line):
        run, rise = np.diff(line, axis=0).T
        steep = np.abs(rise) - STEEPEST_CELL * run
        if not np.isfinite(steep.sum()):
            raise MeshError("the surface is nowhere: its heights are not finite")
        if (steep > 0).any():
            worst = int(steep.argmax())
            rise, run = (show(abs(float(part[worst])), "length") for part in (rise, run))
            raise MeshError(
                f"the surface is too steep near {place(line[worst])}: {rise} over {run}; it stands "
                f"up to a slope of {STEEPEST_CELL:.0f}"
            )


def place(x):
    """Return coordinates as text, m; the last axis is z."""
    names = "xz" if len(x) == 2 else "xyz"
    told = [show(float(v), "length") if np.isfinite(v) else "nowhere" for v in x]
    return " and ".join(f"{n} = {text}" for n, text in zip(names, told, strict=True))


def look_at_fields(grid):
    """Raise where the rock on a mesh is not what its units can make.

    Args:
        grid: `Grid`, its fields filled.

    Raises:
        SolveError: density or viscosity are not finite, or the viscosity is beyond its units.
    """
    for what, function, low, high in grid.fields.ranges():
        values = function.x.array
        if np.isfinite(values.sum()) and values.min() >= low and values.max() <= high:
            continue
        wrong = np.flatnonzero(~((values >= low) & (values <= high)))
        at = nodes(function.function_space)
        cell = np.flatnonzero(np.isin(at, wrong).any(axis=1))[0]
        raise SolveError(
            f"the {what} is not that of any rock at {len(wrong)} of {len(values)} places, the "
            f"first near {place(grid.index.corners[cell].mean(axis=0))} "
            f"({float(values[wrong[0]]):.2e}); check rocks and transfer"
        )


class FittedGuard:
    """Looks at fitted meshes, one after another.

    Args:
        scene: `scene.Scene`.
        cell: side of the squares that become cells, m.

    Attributes:
        areas: of every rock on the last mesh, m^2; None before the first.
    """

    def __init__(self, scene, cell):
        self.scene, self._thinnest = scene, WELD * cell
        self.areas = None

    def begin(self, grid):
        """Raise where the regions of the first mesh are not the rocks as drawn.

        A line that ends before a wall, as the columns of the mesh have it, closes no region.

        Args:
            grid: `Grid` of the lines as given.

        Raises:
            MeshError: a rock has another area.
        """
        found = self._shares(grid)
        off = np.abs(found - drawn_shares(self.scene))
        if off.max() > ROCK_JUMP:
            raise MeshError(
                f"{self.scene.rocks[off.argmax()].name} has {found[off.argmax()]:.1%} of the "
                f"section on the mesh, and {off.max():.1%} more or less as drawn: a horizon ends "
                "before a wall as the cells have it; let particles carry the rock "
                "(mesh.interfaces: auto does so by itself), or raise mesh.cells"
            )

    def _shares(self, grid):
        rock = np.array([unit.rock for unit in self.scene.units])[grid.fields.unit]
        areas = np.bincount(rock, grid.index.area, len(self.scene.rocks))
        return areas / areas.sum()

    def look(self, grid):
        """Raise where lines no longer part the rocks, or a weld is better left to particles.

        Args:
            grid: `Grid` of a mesh that follows the lines.

        Raises:
            MeshError: a rock has lost or won a part of the section at once; or, where particles
                may take over, a layer is thinner than a small part of a cell.
        """
        areas = self._shares(grid) * grid.index.area.sum()
        jump = np.abs(areas - (areas if self.areas is None else self.areas))
        if jump.max() > ROCK_JUMP * areas.sum():
            name = self.scene.rocks[jump.argmax()].name
            raise MeshError(
                f"{name} changed its area by {jump.max() / 1e6:.3g} km^2 at once: a horizon no "
                "longer parts the rocks; let particles carry them (mesh.interfaces: auto does so "
                "by itself)"
            )
        self.areas = areas
        if self.scene.mesh.interfaces == "auto":
            self._refuse_welds(grid)

    def _refuse_welds(self, grid):
        bands = [fault.unit for fault in self.scene.faults]
        across = grid.contacts.across() & ~np.isin(grid.fields.unit, bands)
        if not across.any():
            return
        corners = grid.index.corners[across]
        longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1)
        thickness = 2 * grid.index.area[across] / longest
        if thickness.min() < self._thinnest:
            row = thickness.argmin()
            where = corners[row].mean(axis=0)
            name = self.scene.rocks[self.scene.units[grid.fields.unit[across][row]].rock].name
            thick = show(float(thickness[row]), "length")
            raise MeshError(f"{name} is a weld near {place(where)}, {thick} thick")


def drawn_shares(scene, samples=SAMPLES):
    """Return the share of the section that every rock has as drawn, shape (rocks,).

    Args:
        scene: `scene.Scene` of two dimensions.
        samples: along each side of the section.
    """
    rock = np.array([unit.rock for unit in scene.units])
    share = (np.arange(samples) + 0.5) / samples
    x = scene.outline.surface[0, 0] + share * scene.outline.width
    low, high = (np.interp(x, *line.T) for line in (scene.outline.base, scene.outline.surface))
    z = low + share[:, None] * (high - low)
    points = np.stack([np.broadcast_to(x, z.shape), z], axis=-1).reshape(-1, 2)
    weight = np.broadcast_to(high - low, z.shape).ravel()
    found = np.bincount(rock[scene.unit_at(points)], weight, len(scene.rocks))
    return found / weight.sum()

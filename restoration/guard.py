"""What a fitted mesh cannot follow, and is better left to particles."""

import numpy as np

from restoration.errors import MeshError
from restoration.units import show

ROCK_JUMP = 0.02  # of the section, that no rock wins or loses from one fitted mesh to the next
SAMPLES = 300  # along each side of the section, of what is drawn
WELD = 0.02  # of a cell: a layer that is thinner is left to particles


class Guard:
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
            at = " and ".join(
                f"{n} = {show(float(v), 'length')}" for n, v in zip("xz", where, strict=True)
            )
            raise MeshError(
                f"{name} is a weld near {at}, {show(float(thickness[row]), 'length')} thick"
            )


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

"""Which rank has which particles: those in cells of its own, about as many as the others have.

The cells are cut into parts by recursive bisection, across the longer side, so that every part
holds as many particles as the others; after a step particles go to the rank of their new cell. A
rank keeps its particles in the order that they have in the whole cloud.
"""

from dataclasses import replace

import numpy as np

from restoration.particles import OUTSIDE, Particles, joined, subset

MOST_LOAD = 1.1  # of the mean load, above which cells are dealt out anew
DEALT = "_owner", "_next_number", "load"
CLOUD = tuple(name for name in Particles.__dataclass_fields__ if name != "number")


class Sharing:
    """Deals the particles of a run out to its ranks.

    Args:
        ranks: `ranks.Ranks`.

    Attributes:
        load: particles of the rank that has most over the mean of all, after the last step.
    """

    def __init__(self, ranks):
        self._ranks = ranks
        self._owner, self._next_number = None, 0
        self.load = 1.0

    def dealt(self, particles, index):
        """Return those of a whole cloud that this rank has; of a cloud dealt out all of them.

        Args:
            particles: located `Particles`, the same on all ranks.
            index: `CellIndex` that they are located in.
        """
        if not self._ranks.several or particles.number is not None:
            return particles
        self._next_number = n = len(particles.x)
        self._deal(np.bincount(particles.cell[particles.inside], minlength=len(index.area)), index)
        whole = replace(particles, number=np.arange(n))
        return subset(whole, np.flatnonzero(self._rank_of(particles.cell, whole.number)))

    def memory(self, particles):
        """Return the whole cloud and who has what of it, for a checkpoint; see `recalled`.

        Args:
            particles: `Particles` of this rank.
        """
        ranks, own, whole = self._ranks, particles.number, self.whole(particles)
        memory = {name: getattr(whole, name) for name in CLOUD}
        if own is None:
            return memory
        numbers = ranks.rows(own)
        order = np.argsort(numbers)
        held_by = ranks.rows(np.full(len(own), ranks.rank, np.int32))
        return memory | {
            "ranks": ranks.size,
            "number": numbers[order],
            "held_by": held_by[order],
            "owner": self._owner,
            "next_number": self._next_number,
            "load": self.load,
        }

    def held(self, particles):
        """Return what `memory` does, but the particles of this rank as they are, not gathered."""
        dealt = {name: getattr(self, name) for name in DEALT}
        return {"held": particles, "dealt": dealt}

    def recalled(self, memory):
        """Return the particles that `memory` returned.

        On as many ranks as then every one gets what it had, else all get the whole cloud.

        Args:
            memory: of `memory`, the same on all ranks, or of `held`.
        """
        if "held" in memory:
            for name, value in memory["dealt"].items():
                setattr(self, name, value)
            return memory["held"]
        particles = Particles(**{name: memory[name] for name in CLOUD})
        if not self._ranks.several or memory.get("ranks") != self._ranks.size:
            return particles
        self._owner, self._next_number = memory["owner"], memory["next_number"]
        self.load = memory["load"]
        particles = replace(particles, number=memory["number"])
        return subset(particles, np.flatnonzero(memory["held_by"] == self._ranks.rank))

    def migrated(self, particles, index):
        """Return the particles of this rank's cells, after they have moved or the mesh has.

        Args:
            particles: located `Particles` of this rank.
            index: `CellIndex` that they are located in.
        """
        if not self._ranks.several:
            return particles
        inside = particles.cell[particles.inside]
        counts = self._ranks.sum(np.bincount(inside, minlength=len(index.area)))
        if self._owner is None or len(counts) != len(self._owner):
            self._deal(counts, index)
        elif self._load(counts) > MOST_LOAD:
            self._deal_better(counts, index)
        self.load = self._load(counts)
        goes_to = np.where(particles.inside, self._owner[particles.cell], self._ranks.rank)
        leaves = np.flatnonzero(goes_to != self._ranks.rank)
        parcels = [
            subset(particles, leaves[goes_to[leaves] == rank]) for rank in range(self._ranks.size)
        ]
        arrived = [part for part in self._ranks.comm.alltoall(parcels) if len(part.x)]
        if not len(leaves) and not arrived:
            return particles
        stays = subset(particles, np.flatnonzero(goes_to == self._ranks.rank))
        particles = joined(stays, *arrived)
        return subset(particles, np.argsort(particles.number, kind="stable"))

    def whole(self, particles):
        """Return the whole cloud in its order, on all ranks."""
        if particles.number is None:
            return particles
        names = (name for name in particles.__dataclass_fields__ if name != "number")
        order = np.argsort(self._ranks.rows(particles.number))
        columns = {name: self._ranks.rows(getattr(particles, name))[order] for name in names}
        return type(particles)(**columns)

    def with_newborn(self, particles, born):
        """Return the particles with new ones, that the first rank takes until they migrate.

        Args:
            particles: `Particles` of this rank.
            born: the new ones, the same on all ranks.
        """
        if particles.number is None:
            return joined(particles, born)
        number = np.arange(self._next_number, self._next_number + len(born.x))
        self._next_number += len(born.x)
        return joined(particles, replace(born, number=number)) if self._ranks.first else particles

    def _rank_of(self, cell, number):
        """Return which particles of a whole cloud are this rank's; those in no cell are dealt."""
        rank = np.where(cell == OUTSIDE, number % self._ranks.size, self._owner[cell])
        return rank == self._ranks.rank

    def _load(self, counts):
        """Return the particles of the rank that would have most, over the mean."""
        held = np.bincount(self._owner, counts, self._ranks.size)
        return float(held.max() / max(held.mean(), 1e-300))

    def _deal(self, counts, index):
        """Find the rank of every cell anew, for so many particles in each."""
        centres = index.corners.mean(axis=1)
        self._owner = bisected(centres, counts + 1e-3 * max(counts.mean(), 1.0), self._ranks.size)

    def _deal_better(self, counts, index):
        """Find the rank of every cell anew, and keep that where it is the better one."""
        before, load = self._owner, self._load(counts)
        self._deal(counts, index)
        if self._load(counts) >= load:
            self._owner = before


def bisected(centres, weights, parts):
    """Return the part of every cell, shape (cells,): about the same weight in all.

    Args:
        centres: of the cells, shape (cells, dim), m.
        weights: of the cells, shape (cells,), positive.
        parts: number of parts.
    """
    part = np.zeros(len(centres), np.int32)
    pieces = [(np.arange(len(centres)), 0, parts)]
    while pieces:
        cells, first, count = pieces.pop()
        if count == 1 or not len(cells):
            part[cells] = first
            continue
        axis = np.ptp(centres[cells], axis=0).argmax()
        cells = cells[np.argsort(centres[cells, axis], kind="stable")]
        below = np.cumsum(weights[cells])
        share = below[-1] * (count // 2) / count
        cut = np.searchsorted(below, share * (1 + 1e-12), side="right")
        pieces.append((cells[:cut], first, count // 2))
        pieces.append((cells[cut:], first + count // 2, count - count // 2))
    return part

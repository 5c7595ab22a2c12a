"""The processes that share a run: what all of them know, and what one of them does for all.

Every rank holds the mesh, the lines and the fields whole, and goes through the same steps. What is
dealt out is what costs: particles, and the Stokes problem. So every call here is made by all ranks.
"""

import pickle
from functools import cache

import numpy as np
from mpi4py import MPI

MOST_AT_ONCE = 2**27  # values in a message, below what its count of bytes can tell


class Ranks:
    """The ranks of a communicator.

    Args:
        comm: MPI communicator; one of its own is made, so that messages do not get mixed up.

    Attributes:
        comm: the communicator.
        size, rank: how many there are, and which one this is.
    """

    def __init__(self, comm=MPI.COMM_WORLD):
        self.size, self.rank = comm.size, comm.rank
        self.comm = comm.Dup() if self.size > 1 else MPI.COMM_SELF

    @property
    def first(self):
        """Whether this is the rank that writes."""
        return self.rank == 0

    @property
    def several(self):
        """Whether there is more than one."""
        return self.size > 1

    def sum(self, values):
        """Return the sum of an array over the ranks, same shape, the same bits on all."""
        return self._reduced(values, MPI.SUM)

    def least(self, values):
        """Return the least of every entry of an array over the ranks."""
        return self._reduced(values, MPI.MIN)

    def most(self, values):
        """Return the greatest of every entry of an array over the ranks."""
        return self._reduced(values, MPI.MAX)

    def _reduced(self, values, operation):
        if not self.several:
            return values
        found = np.array(values, copy=True, order="C")
        rows = found.reshape(-1)
        for begin in range(0, len(rows), MOST_AT_ONCE):
            self.comm.Allreduce(MPI.IN_PLACE, rows[begin : begin + MOST_AT_ONCE], op=operation)
        # The order of a sum may differ from rank to rank; what follows must not.
        self.comm.Bcast(found, root=0)
        return found if found.ndim else found[()]

    def rows(self, values):
        """Return the rows of an array of all ranks, those of the first rank first."""
        if not self.several:
            return values
        values = np.ascontiguousarray(values)
        counts = np.array(self.comm.allgather(len(values)))
        found = np.empty((counts.sum(), *values.shape[1:]), values.dtype)
        ends = np.cumsum(counts)
        for rank, (begin, end) in enumerate(zip(ends - counts, ends, strict=True)):
            part = found[begin:end]
            if rank == self.rank:
                part[:] = values
            flat = part.reshape(-1).view(np.uint8)
            for at in range(0, len(flat), 8 * MOST_AT_ONCE):
                self.comm.Bcast(flat[at : at + 8 * MOST_AT_ONCE], root=rank)
        return found

    def of_least(self, distance, *values):
        """Return the values of the rank with the least distance, entry by entry.

        Args:
            distance: shape (n,); infinite where a rank has none.
            values: arrays of n rows.

        Returns:
            The least distances, and the values that go with them.
        """
        if not self.several:
            return (distance, *values)
        all_distances = np.array(self.comm.allgather(distance))
        best = all_distances.argmin(axis=0)
        found = [
            np.array(self.comm.allgather(value))[best, np.arange(len(best))] for value in values
        ]
        return (all_distances.min(axis=0), *found)

    def same(self, value):
        """Return what the first rank has, on all ranks."""
        return self.comm.bcast(value, root=0) if self.several else value

    def any(self, flag):
        """Return whether a flag is up on any rank."""
        return self.comm.allreduce(bool(flag), op=MPI.LOR) if self.several else bool(flag)

    def alone(self, task, *arguments, **options):
        """Let the first rank alone do something, and tell all others if it fails.

        Returns:
            What the task returns; None on the other ranks.

        Raises:
            Exception: what the task raises, on all ranks.
        """
        if not self.several:
            return task(*arguments, **options)
        found = error = None
        if self.first:
            try:
                found = task(*arguments, **options)
            except Exception as fault:
                error = fault
        told = self.comm.bcast(_sendable(error), root=0)
        if error is not None:
            raise error
        if told is not None:
            raise told
        return found


ALONE = Ranks(MPI.COMM_SELF)


@cache
def world():
    """Return the ranks that this program was started on."""
    return Ranks()


def _sendable(error):
    """Return an error that can be sent to another rank, with the same text."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(str(error))
    return error

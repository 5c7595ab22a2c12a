"""The errors a user can meet, each with the exit code of the command line.

A message is one line per fault and says where, what was found, what is possible and what to do.
Everything else that escapes is a bug and keeps its traceback.
"""

import errno
from dataclasses import dataclass

from restoration.words import printable

# How libraries tell that they were refused memory, where their errors have no number for it.
MEMORY_WORDS = (
    "bad_alloc",
    "cannot allocate memory",
    "failed to map segment",
    "can't start new thread",
    "unable to allocate",
    "out of memory",
)
PETSC_MEMORY = 55  # error of PETSc


class RestorationError(Exception):
    """Base of every error that is reported without a traceback.

    Attributes:
        memory: of the state before the step that has failed for good, see `StokesEngine.memory`;
            None where it was no such step.
        facts: what a developer asks of mesh, rock and matrix, numbers and texts by name.
    """

    exit_code = 1
    memory = facts = None


@dataclass(frozen=True)
class Fault:
    """One fault of an input file.

    Attributes:
        file: name of the file as the user gave it.
        line: line in the file, from 1; None where there is none.
        column: column in the line, from 1; None where there is none.
        entry: dotted path of the entry, such as ``rocks.salt.viscosity``; may be empty.
        message: what was found and what is possible.
    """

    file: str
    line: int | None
    column: int | None
    entry: str
    message: str

    def __str__(self):
        place = [self.file, self.line, self.column]
        parts = [":".join(str(part) for part in place if part is not None), self.entry]
        return printable(
            ": ".join([part for part in parts if part] + [" ".join(self.message.split())])
        )


class CaseError(RestorationError):
    """The case, or a file it names, is faulty.

    Args:
        faults: a list of `Fault`, or one message.
    """

    exit_code = 2

    def __init__(self, faults):
        self.faults = faults if isinstance(faults, list) else [Fault("", None, None, "", faults)]
        super().__init__("\n".join(str(fault) for fault in self.faults))


class EnvironmentFault(RestorationError):
    """The machine lacks something, or has it in a version that cannot work."""

    exit_code = 2


class RankFault(RestorationError):
    """One rank may have failed alone: nothing may be made of it but an end for all."""

    exit_code = 3


class SolveError(RestorationError):
    """A solver failed, or its answer cannot be trusted."""

    exit_code = 3


class TooLargeError(SolveError):
    """A problem does not fit into memory."""

    exit_code = 6


TOO_LARGE = (
    "out of memory; lower mesh.cells or particles.per_cell, or ask for more (ulimit -v, or the "
    "memory of the job)"
)


def out_of_memory(error):
    """Return whether an error, or one that it came from, tells that memory has run out."""
    seen = set()
    while error is not None and id(error) not in seen:
        seen.add(id(error))
        if isinstance(error, (MemoryError, TooLargeError)):
            return True
        if getattr(error, "errno", None) == errno.ENOMEM:
            return True
        if getattr(error, "ierr", None) == PETSC_MEMORY:
            return True
        if any(words in str(error).lower() for words in MEMORY_WORDS):
            return True
        error = error.__cause__ or error.__context__
    return False


class MeshError(RestorationError):
    """A mesh could not be made, or is too distorted to go on."""

    exit_code = 4


class ParticleError(MeshError):
    """The particles no longer cover the mesh."""


class OutputError(RestorationError):
    """A result could not be written."""

    exit_code = 5


class CheckpointError(OutputError):
    """A checkpoint cannot be read, or is of another run."""


class StoppedError(RestorationError):
    """The run was stopped on request."""

    exit_code = 75

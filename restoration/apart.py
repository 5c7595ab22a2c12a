"""Reading that may crash or never end, done by a process of its own with little to spend."""

import os
import resource
import subprocess
import sys
from pathlib import Path

from restoration.errors import CaseError
from restoration.words import printable

REFUSED = 2  # exit code of a process that has told why
GB = 2**30
HOME = str(Path(__file__).parents[1])
# Of launchers, which would make the process one of their ranks.
LAUNCHER_PREFIXES = ("OMPI_", "PMI", "PMIX_", "SLURM_", "HYDRA_", "MPI")


def read_apart(module, arguments, shown, seconds, memory):
    """Return a file in memory, open, that another process has filled.

    Args:
        module: name of the module to run; it calls `answer`.
        arguments: texts for it.
        shown: name of what is read, for messages.
        seconds: of computing, after which it is ended; it may wait ten times as long.
        memory: most that it may take, bytes of address space.

    Raises:
        CaseError: it could not be read: the process said why, crashed, or took too much.
    """
    kept = {name: os.environ[name] for name in os.environ if not name.startswith(LAUNCHER_PREFIXES)}
    kept["PYTHONPATH"] = os.pathsep.join([HOME, *filter(None, [os.getenv("PYTHONPATH")])])
    kept |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}  # whose stacks count as memory
    kept["HDF5_PLUGIN_PRELOAD"] = "::"  # no filter is loaded from anywhere
    filled = os.fdopen(os.memfd_create("restoration"), "w+b")
    limits = [str(filled.fileno()), str(seconds), str(memory)]
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-m", module, *limits, *arguments],
            env=kept,
            pass_fds=[filled.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            timeout=10 * seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        filled.close()
        raise CaseError(f"{shown}: reading it took too long; the file is damaged") from None
    if done.returncode == 0:
        filled.seek(0)
        return filled
    filled.close()
    told = done.stderr.decode(errors="replace").strip()
    if done.returncode == REFUSED:
        raise CaseError(f"{shown}: {printable(' '.join(told.split()))}")
    if done.returncode < 0:
        raise CaseError(
            f"{shown}: reading it was ended by signal {-done.returncode}; the file is damaged"
        )
    raise RuntimeError(f"{module} failed: {told}")


def answer(read, arguments=None):
    """Fill the file of `read_apart` and return the exit code; the other end of it.

    Args:
        read: called with the open file and the arguments; its CaseError is handed on.
        arguments: of the process; None for its own.
    """
    number, seconds, memory, *arguments = sys.argv[1:] if arguments is None else arguments
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (int(seconds), int(seconds)))
    resource.setrlimit(resource.RLIMIT_AS, (int(memory), int(memory)))
    try:
        with os.fdopen(int(number), "w+b") as filled:
            read(filled, *arguments)
    except CaseError as error:
        print(error, file=sys.stderr)
        return REFUSED
    except MemoryError:
        print("takes too much memory to be read; the file is damaged", file=sys.stderr)
        return REFUSED
    return 0

"""Ranks: how they are started, and how they end together. Loads no MPI."""

import ctypes
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

from restoration.errors import CaseError, EnvironmentFault, StoppedError

# What launchers tell their processes: their number, and how many there are.
LAUNCHERS = (
    ("OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"),
    ("PMI_RANK", "PMI_SIZE"),
    ("SLURM_PROCID", "SLURM_STEP_NUM_TASKS"),
)
MOST_RANKS = 10_000
EVERY = 0.5  # s, between two looks at ranks
PR_SET_PDEATHSIG = 1  # of Linux
PATIENCE = 20.0  # s, that a rank which failed waits for the others to have failed too
# One thread for every rank; what the user has set stays.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")


def rank_and_size():
    """Return the number of this process and how many a launcher has started; (0, 1) alone."""
    for rank, size in LAUNCHERS:
        if rank in os.environ and os.environ.get(size, "").isdecimal():
            return int(os.environ[rank]), int(os.environ[size])
    return 0, 1


def cores():
    """Return the number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def begin_together():
    """Prepare one of several ranks: one thread each unless told otherwise, and no end by SIGUSR1.

    To be called before numba is loaded.
    """
    for name in THREADS:
        os.environ.setdefault(name, "1")
    signal.signal(signal.SIGUSR1, signal.SIG_IGN)  # a wish to stop, outside of a run: too late


def run_on_ranks(count, arguments):
    """Run ``restore`` on several ranks of this machine, and return its exit code.

    Ctrl-C, SIGTERM and SIGHUP are handed on as SIGUSR1, which every rank takes as a wish to stop
    after the step, again and again until they have ended: a rank may not listen yet. The second
    Ctrl-C or SIGTERM ends at once.

    Args:
        count: of ranks.
        arguments: of the command line, without ``--ranks``.

    Raises:
        CaseError: so many ranks cannot be.
        EnvironmentFault: there is nothing to start them with.
    """
    if not 1 <= count <= MOST_RANKS:
        raise CaseError(f"--ranks: {count} is not possible; 1 to {MOST_RANKS} are")
    if rank_and_size()[1] > 1:
        raise CaseError("--ranks: this program is one of several ranks already; leave it out")
    mpirun = shutil.which("mpirun")
    if mpirun is None:
        raise EnvironmentFault("not found: mpirun; run 'make setup' or apt install openmpi-bin")
    if count > cores():
        print(
            f"warning: {count} ranks on {cores()} cores are slower than {cores()}", file=sys.stderr
        )
    environment = child_environment()
    if os.getuid() == 0:  # in a container there may be nobody else; OpenMPI asks twice
        environment |= {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    # Bound to cores, the ranks of two runs would share the first ones and leave the others idle.
    command = [mpirun, "--quiet", "--oversubscribe", "--bind-to", "none", "-n", str(count)]
    # -P: what lies beside the case is no module of ours
    command += [sys.executable, "-P", "-m", "restoration.cli", *arguments]
    asked = []
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGUSR1):
        signal.signal(number, lambda number, _frame: asked.append(number))
    with subprocess.Popen(
        command,
        env=environment,
        stdin=subprocess.DEVNULL,
        start_new_session=True,
        preexec_fn=end_with_parent,
    ) as ranks:
        code = None
        while code is None:
            try:
                code = ranks.wait(EVERY)
            except subprocess.TimeoutExpired:
                if asked:
                    # mpirun ends its ranks on SIGTERM, at once
                    ranks.send_signal(signal.SIGTERM if _at_once(asked) else signal.SIGUSR1)
    return _code(code, asked)


def child_environment(one_thread=False):
    """Return the environment of a child that is to find this very package.

    Args:
        one_thread: whether the child is one thread, as one of several that share the machine.
    """
    home = str(Path(__file__).parents[1])
    paths = os.pathsep.join([home, *filter(None, [os.getenv("PYTHONPATH")])])
    threads = dict.fromkeys(THREADS, "1") if one_thread else {}
    return os.environ | {"PYTHONPATH": paths} | threads


def end_with_parent():
    """Have this process, a child before it begins, asked to end where the one above it dies."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGTERM)


def _at_once(asked):
    """Return whether the signals that came are those of a user who does not want to wait."""
    return max(asked.count(signal.SIGINT), asked.count(signal.SIGTERM)) > 1


def _code(code, asked):
    """Return the exit code of ranks that have ended, and tell of those that were ended."""
    if code in (0, StoppedError.exit_code):
        return code
    if _at_once(asked):
        print("stopped at once", file=sys.stderr)
        return 130
    ended_by = code - 128 if code > 128 else -code
    if asked and ended_by == signal.SIGUSR1:  # before it listened
        print("stopped on request before the first step", file=sys.stderr)
        return StoppedError.exit_code
    if 0 < ended_by < 64 and (code > 128 or code < 0):
        print(
            f"a rank was ended by signal {ended_by} (9: perhaps out of memory); the run folder "
            "holds what was reached",
            file=sys.stderr,
        )
    return code


def as_many_as_told(size):
    """Raise where MPI knows another number of ranks than the launcher has started.

    Raises:
        EnvironmentFault: the launcher is not that of this MPI.
    """
    told = rank_and_size()[1]
    if told != size:
        raise EnvironmentFault(
            f"the launcher has started {told} processes, and MPI knows {size}: take the mpirun of "
            "the MPI that dolfinx was built with, or srun --mpi=pmix"
        )


def end_together(code, error):
    """End all ranks where this one has failed, also those that wait for it.

    Where all have failed of the same the first one has told. A rank that is alone with its error
    tells it after a while, and ends the others.

    Args:
        code: exit code.
        error: what to tell, None where it was told.
    """
    if "mpi4py.MPI" not in sys.modules:  # no rank can wait for this one
        return
    from mpi4py import MPI

    met, begin = MPI.COMM_WORLD.Ibarrier(), time.monotonic()
    try:
        while not met.Test():
            if time.monotonic() - begin > PATIENCE:
                break
            time.sleep(0.01)
        else:
            return
    except MPI.Exception:  # the others are in the middle of something else
        pass
    if error:
        print(f"rank {MPI.COMM_WORLD.rank}: {error}", file=sys.stderr, flush=True)
    MPI.COMM_WORLD.Abort(code)

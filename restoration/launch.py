"""Ranks: how they are started, and how they end together. Loads no MPI."""

import os
import shutil
import signal
import subprocess
import sys
import time

from restoration.errors import CaseError, EnvironmentFault

# What launchers tell their processes: their number, and how many there are.
LAUNCHERS = (
    ("OMPI_COMM_WORLD_RANK", "OMPI_COMM_WORLD_SIZE"),
    ("PMI_RANK", "PMI_SIZE"),
    ("SLURM_PROCID", "SLURM_STEP_NUM_TASKS"),
)
MOST_RANKS = 10_000
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


def run_on_ranks(count, arguments):
    """Run ``restore`` on several ranks of this machine, and return its exit code.

    Ctrl-C and SIGTERM are handed on as SIGUSR1, which every rank takes as a wish to stop after the
    step; the second Ctrl-C ends at once.

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
    environment = dict.fromkeys(THREADS, "1") | os.environ
    if os.getuid() == 0:  # in a container there may be nobody else; OpenMPI asks twice
        environment |= {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    command = [mpirun, "--quiet", "--oversubscribe", "-n", str(count), sys.executable]
    command += ["-m", "restoration.cli", *arguments]
    with subprocess.Popen(command, env=environment, start_new_session=True) as ranks:
        asked = []

        def hand_on(number, _frame):
            asked.append(number)
            # mpirun ends its ranks on SIGTERM, at once
            ranks.send_signal(signal.SIGUSR1 if asked.count(signal.SIGINT) < 2 else signal.SIGTERM)

        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1):
            signal.signal(number, hand_on)
        code = ranks.wait()
    return 130 if asked.count(signal.SIGINT) > 1 else code


def end_together(code, error):
    """End all ranks where this one has failed, also those that wait for it.

    Where all have failed of the same the first one tells. A rank that is alone with its error tells
    it after a while, and ends the others.

    Args:
        code: exit code.
        error: what to tell.
    """
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
    print(f"rank {MPI.COMM_WORLD.rank}: {error}", file=sys.stderr, flush=True)
    MPI.COMM_WORLD.Abort(code)

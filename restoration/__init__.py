"""Restoration of geological sections by reverse-time Stokes flow."""

import os

__version__ = "0.1.0"

# Before anything imports numba. Of its ways to share out work this one alone leaves the cores to
# others while it has nothing to do: `omp` spins, and `tbb`, where a system has it, can take
# minutes to end beside MPI.
os.environ.setdefault("NUMBA_THREADING_LAYER", "workqueue")

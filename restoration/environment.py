"""The machine: what must be there, what is in use, and where compiled code is kept.

`check_environment` loads no library, so that a wrong one is named in a line before it crashes.
"""

import atexit
import contextlib
import ctypes
import fcntl
import hashlib
import logging
import os
import re
import sys
import tempfile
import time
from importlib.machinery import PathFinder
from pathlib import Path

from restoration.errors import EnvironmentFault
from restoration.writing import write_text

SYSTEM_SITE = Path("/usr/lib/python3/dist-packages")
LIBRARIES = Path("/usr/lib") / sys.implementation._multiarch
DEBIAN_MODULES = {
    "dolfinx": "python3-dolfinx",
    "petsc4py": "python3-petsc4py",
    "mpi4py": "python3-mpi4py",
    "h5py": "python3-h5py",
    "scipy": "python3-scipy",
}
VENV_MODULES = ("matplotlib", "numba", "pydantic", "ruamel", "shapely")
# What libraries read from the working folder by themselves: settings that can start programs, load
# libraries and write files. Nobody asks whether that is the folder of a stranger.
SETTINGS = {
    ".petscrc": "PETSc",
    "petscrc": "PETSc",
    ".numba_config.yaml": "Numba",
    "matplotlibrc": "Matplotlib",
    "dolfinx_jit_parameters.json": "DOLFINx",
    "ffcx_parameters.json": "FFCx",
}
LONGEST_BUILD = 600.0  # s, of a form, on the busiest machine
STALE = 60.0  # s, age of a half-built form that no living process can still be building


def check_environment(path=None, system=SYSTEM_SITE, libraries=LIBRARIES, here=Path()):
    """Return what slows the work or spoils pictures, one line each; loads no library.

    Args:
        path: folders that modules are imported from; None for ``sys.path``.
        system: folder of Debian's Python modules.
        libraries: folder of Debian's shared libraries.
        here: the working folder.

    Raises:
        EnvironmentFault: numpy is not the one dolfinx was built for, a package is missing, or the
            working folder holds settings that libraries would follow.
    """
    faults = _missing_modules(path) + _wrong_numpy(path, system) + _settings(here)
    if faults:
        raise EnvironmentFault("\n".join(faults))
    warnings = []
    if blas(libraries, maps=None) == "reference":
        warnings.append(
            "the slow reference BLAS is in use, and solves take about four times as long; "
            "install Debian's libopenblas0-serial"
        )
    if not list(libraries.glob("libOSMesa.so.*")):
        warnings.append("no libOSMesa, so VTK cannot draw off-screen; install Debian's libosmesa6")
    return warnings


def _missing_modules(path):
    debian = [
        package for name, package in DEBIAN_MODULES.items() if not PathFinder.find_spec(name, path)
    ]
    venv = [name for name in VENV_MODULES if not PathFinder.find_spec(name, path)]
    faults = []
    if debian:
        faults.append(
            f"not found: Debian's {', '.join(debian)}; run 'make setup' or apt install them"
        )
        if "PETSC_DIR" in os.environ:
            faults[-1] += ", and unset PETSC_DIR, which hides Debian's PETSc"
    if venv:
        faults.append(f"not found: Python's {', '.join(venv)}; run 'make setup'")
    return faults


def _wrong_numpy(path, system):
    spec = PathFinder.find_spec("numpy", path)
    if not spec:
        return ["not found: numpy; run 'make setup' or apt install python3-numpy"]
    site = Path(spec.origin).parent.parent
    found, built_for = _numpy_version(site), _numpy_version(system)
    if found == built_for:
        return []
    if site.is_relative_to(sys.prefix):
        advice = f"run 'make setup', or pip install numpy=={built_for} there"
    else:
        advice = "take that folder off PYTHONPATH, or set PYTHONNOUSERSITE=1"
    return [f"numpy {found} in {site} hides {built_for}, which dolfinx was built for; {advice}"]


def _settings(here):
    return [
        f"the working folder holds {name}, and {library} would do what that says, to the starting "
        "of programs; remove it, or work in another folder"
        for name, library in SETTINGS.items()
        if os.path.lexists(here / name)
    ]


def _numpy_version(site):
    """Return the version by the metadata beside the package; None where there is none."""
    for entry in site.glob("numpy-*-info"):
        if found := re.fullmatch(r"numpy-(.+)\.(dist|egg)-info", entry.name):
            return found[1]
    return None


def blas(libraries=LIBRARIES, maps="/proc/self/maps"):
    """Return the BLAS that Debian's libraries call, such as ``openblas-serial 0.3.21``.

    Args:
        libraries: folder of Debian's shared libraries.
        maps: list of the files this process has loaded, asked first; None to leave it out.

    Returns:
        The name with the version where known, ``reference``, or None where there is no BLAS.
    """
    library = libraries / "libblas.so.3"
    loaded = re.search(r"/\S+/libblas\.so\S*", Path(maps).read_text()) if maps else None
    if not loaded and not library.exists():
        return None
    folder = Path(loaded[0] if loaded else library.resolve()).parent
    if folder.name == "blas":
        return "reference"
    versions = [re.search(r"-r([\d.]+)\.so$", entry.name) for entry in folder.glob("*.so")]
    return " ".join([folder.name, *(version[1] for version in versions if version)])


def give_memory_back():
    """Give the system back what was freed and the C library keeps, in pieces too small to reuse."""
    with contextlib.suppress(AttributeError):  # of GNU's alone
        ctypes.CDLL(None).malloc_trim(0)


def versions():
    """Return the versions of what computes, for the run record."""
    import dolfinx
    import numpy
    from petsc4py import PETSc

    return {
        "dolfinx": dolfinx.__version__,
        "petsc": ".".join(str(part) for part in PETSc.Sys.getVersion()),
        "numpy": numpy.__version__,
        "blas": blas(),
    }


def jit_cache(name="fenics"):
    """Return a folder of our own for compiled code; made if need be.

    In the .venv, so that it goes with the versions it was compiled for; else in the user's cache;
    else in a temporary folder.
    """
    key = hashlib.sha256(f"{sys.prefix} {sys.implementation.cache_tag}".encode()).hexdigest()[:8]
    places = [
        _home("XDG_CACHE_HOME", ".cache") / f"restoration-{key}",
        Path(tempfile.gettempdir()) / f"restoration-{os.getuid()}-{key}",
    ]
    if sys.prefix != sys.base_prefix:
        places.insert(0, Path(sys.prefix) / "cache")
    for place in places:
        folder = place / name
        try:
            place.mkdir(mode=0o700, parents=True, exist_ok=True)
            folder.mkdir(exist_ok=True)
            # What lies here is run, so nobody else may own it.
            owners = {place.stat().st_uid, folder.stat().st_uid}
            if owners == {os.getuid()} and os.access(folder, os.W_OK):
                return folder
        except OSError:
            continue
    return Path(tempfile.mkdtemp(prefix="restoration-"))


def _home(variable, name):
    """Return a folder of the user: what a variable says, or one in the home."""
    given = os.environ.get(variable)
    try:
        return Path(given) if given else Path.home() / name
    except RuntimeError:  # a user without a home
        return Path(os.devnull) / name


def use_jit_cache():
    """Keep compiled forms in `jit_cache`, mended where that is damaged, and compile without a word.

    Returns:
        The folder.
    """
    import dolfinx.jit
    import ffcx.codegeneration.jit as compiler

    if not hasattr(compiler.get_cached_module, "remembered"):
        builds = Builds()
        compiler.get_cached_module = _remembering(builds.finding(compiler.get_cached_module))
        compiler._compile_objects = builds.compiling(compiler._compile_objects)
    folder = jit_cache()
    _join(folder)
    parameters = dolfinx.jit.DOLFINX_DEFAULT_JIT_PARAMETERS
    parameters["cache_dir"] = (folder, parameters["cache_dir"][1])
    parameters["timeout"] = (int(STALE), parameters["timeout"][1])
    for handler in logging.getLogger().handlers:
        if type(handler) is logging.StreamHandler:  # FFCx's, not one of a log file
            handler.setLevel(logging.WARNING)  # setuptools tells every compiler call as INFO
    _mend_numba()
    return folder


def _remembering(find):
    """Return FFCx's `get_cached_module` with what this process has loaded kept in memory.

    It lists the whole folder for every form, and a run makes forms anew for every mesh.
    """
    remembered = {}

    def found(module_name, object_names, cache_dir, timeout):
        key = module_name, tuple(object_names), str(cache_dir)
        if key not in remembered:
            objects, module = find(module_name, object_names, cache_dir, timeout)
            if objects is None:  # to be compiled
                return objects, module
            remembered[key] = objects, module
        return remembered[key]

    found.remembered = remembered
    return found


class Builds:
    """What this process builds in a cache of FFCx, one process at a time for each module.

    FFCx takes ``x.c`` for its lock, which outlives a killed process, and loads whatever library
    lies there, which ends a process where it was cut off. Here a lock of the system ends with its
    process, and a library is loaded only where it is as long and as it was when it was built
    (``x.sum``); else it is built again.
    """

    def __init__(self):
        self._locks = {}  # of modules that are being built, by name

    def finding(self, find):
        """Return FFCx's `get_cached_module`, which finds what is sound, and waits for others."""

        def found(module_name, object_names, cache_dir, timeout):
            stem = Path(cache_dir) / module_name
            with contextlib.ExitStack() as stack:
                lock, ours = _lock_of(stem)
                stack.callback(lock.close)
                if not _sound(stem) and (ours or _file(stem, ".c.cached").exists()):
                    _remove_build(stem)
                try:
                    objects, module = find(module_name, object_names, cache_dir, timeout)
                except (TimeoutError, ImportError, AttributeError):
                    # left by a process that knew no lock, or not what it is called
                    _remove_build(stem)
                    objects, module = find(module_name, object_names, cache_dir, timeout)
                if objects is None:  # to be compiled; until then nobody else may
                    self._locks[module_name] = stack.pop_all()
            return objects, module

        return found

    def compiling(self, build):
        """Return FFCx's `_compile_objects`, which notes what it has built and lets others in."""

        def built(decl, ufl_objects, object_names, module_name, parameters, cache_dir, *more):
            with self._locks.pop(module_name, contextlib.nullcontext()):
                content = build(
                    decl, ufl_objects, object_names, module_name, parameters, cache_dir, *more
                )
                stem = Path(cache_dir) / module_name
                write_text(_file(stem, ".sum"), _sum_of(stem))
            return content

        return built


def _file(stem, suffix):
    return stem.with_name(stem.name + suffix)


def _lock_of(stem):
    """Wait for the lock of a module.

    Returns:
        The lock, an open file; and whether a build that is there was begun under it.

    Raises:
        EnvironmentFault: another process does not give it back.
    """
    path = _file(stem, ".lock")
    path.parent.mkdir(exist_ok=True, parents=True)
    ours, limit = path.exists(), time.monotonic() + LONGEST_BUILD
    lock = path.open("w")
    while True:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return lock, ours
        except BlockingIOError:
            ours = True  # whoever holds it has made it
            if time.monotonic() > limit:
                lock.close()
                raise EnvironmentFault(
                    f"{path}: another process has been compiling for {LONGEST_BUILD:.0f} s; end it"
                ) from None
            time.sleep(0.05)
        except OSError:  # a file system without locks: what is half-built goes by its age
            return lock, False


def _sound(stem):
    """Return whether a module is built, and its library as it was then."""
    try:
        kept = _file(stem, ".sum").read_text()
        whole = all(_file(stem, suffix).exists() for suffix in (".c", ".c.cached"))
        return whole and kept == _sum_of(stem)
    except (OSError, UnicodeDecodeError):
        return False


def _sum_of(stem):
    """Return length and hash of the library of a module."""
    content = b"".join(path.read_bytes() for path in _libraries(stem))
    return f"{len(content)} {hashlib.sha256(content).hexdigest()}\n"


def _remove_build(stem):
    """Remove all of a module but its lock, that which says it is built first."""
    for suffix in (".c.cached", ".sum", ".o", ".c"):
        _file(stem, suffix).unlink(missing_ok=True)
    for library in _libraries(stem):
        library.unlink(missing_ok=True)


def _libraries(stem):
    """Return the library of a module in a list, empty where there is none."""
    return sorted(stem.parent.glob(f"{stem.name}.*.so"))


def _mend_numba():
    """Have numba compile again what it cannot read from its cache; it ends with a traceback."""
    from numba.core.caching import IndexDataCacheFile as Cache

    for name, nothing in (("_load_index", dict), ("load", lambda: None)):
        read = getattr(Cache, name)
        if not hasattr(read, "unmended"):
            setattr(Cache, name, _or_nothing(read, nothing))


def _or_nothing(read, nothing):
    """Return a method that returns nothing where its file is damaged."""

    def mended(*arguments):
        try:
            return read(*arguments)
        except Exception:  # unpickling what is damaged raises anything
            return nothing()

    mended.unmended = read
    return mended


def use_numba_cache():
    """Keep compiled kernels in `jit_cache` where they cannot lie beside their source.

    To be called before numba is imported.
    """
    if not os.access(Path(__file__).parent, os.W_OK):
        os.environ.setdefault("NUMBA_CACHE_DIR", str(jit_cache("numba")))


# Bytes that OpenBLAS asks for at once and for each thread, and more; side of a matrix that is large
# enough for all threads to take part.
BLAS_BUFFER, BLAS_BLOCK = 140_000_000, 512
LEAST_MEMORY = 450_000_000  # bytes that the smallest run needs beside these, from its start on


def take_early():
    """Take what libraries wait for without end, or give up without a word, were it refused later.

    That is memory for the buffers of OpenBLAS, and the threads of numba and of MPI. Nothing can be
    told any more once one of these is refused, so the least that a run needs is asked for here.

    Raises:
        MemoryError: there is less.
        RuntimeError: a thread cannot be started.
    """
    import threading

    import numba
    import numpy as np

    np.empty(LEAST_MEMORY + BLAS_BUFFER * numba.config.NUMBA_NUM_THREADS, np.uint8)
    square = np.ones((BLAS_BLOCK, BLAS_BLOCK))
    square @ square
    together = threading.Event()
    try:
        for _ in range(numba.config.NUMBA_NUM_THREADS):
            threading.Thread(target=together.wait, daemon=True).start()
    finally:
        together.set()
    numba.get_num_threads()
    import mpi4py.MPI  # noqa: F401


def use_matplotlib_cache():
    """Keep what matplotlib notes of fonts in `jit_cache` where the user's home cannot hold it.

    It would warn, and look for all fonts again in every process. To be called before it is
    imported.
    """
    try:
        for variable, name in (("XDG_CONFIG_HOME", ".config"), ("XDG_CACHE_HOME", ".cache")):
            (_home(variable, name) / "matplotlib").mkdir(parents=True, exist_ok=True)
    except OSError:
        os.environ.setdefault("MPLCONFIGDIR", str(jit_cache("matplotlib")))


_locks = {}


def _join(folder):
    """Take part in a cache until this process ends, and clean it.

    Every process in a cache shares a lock. Whoever has it alone knows that no one else is building
    and that all half-built forms were left by the killed; others go by their age.
    """
    if folder in _locks:
        return
    lock = _locks[folder] = (folder / "lock").open("w")
    atexit.register(lock.close)
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        alone = True
    except OSError:
        alone = False
    remove_half_built(folder, age=0 if alone else STALE)
    with contextlib.suppress(OSError):  # a file system without locks: age has to do
        fcntl.flock(lock, fcntl.LOCK_SH)


def remove_half_built(folder, age=STALE):
    """Remove forms older than ``age``, s, whose compilation was never finished.

    FFCx makes ``x.c`` first, as its lock, and ``x.c.cached`` last; who finds only the first waits
    for the second and gives up.
    """
    for source in folder.glob("libffcx_*.c"):
        with contextlib.suppress(FileNotFoundError):  # another process does the same
            half_built = not source.with_suffix(".c.cached").exists()
            if half_built and time.time() - source.stat().st_mtime >= age:
                _remove_build(source.with_suffix(""))


def warm():
    """Compile a first form, which proves that dolfinx, PETSc and the compiler work together."""
    use_jit_cache()
    import ufl
    from dolfinx import fem, mesh
    from mpi4py import MPI

    square = mesh.create_unit_square(MPI.COMM_SELF, 1, 1)
    area = fem.assemble_scalar(fem.form(fem.Constant(square, 1.0) * ufl.dx))
    if abs(area - 1) > 1e-12:
        raise EnvironmentFault(f"dolfinx finds {area} for the area of the unit square")


def main(arguments=None):
    """Check the machine, and with ``--warm`` compile a first form; return the exit code."""
    try:
        for warning in check_environment():
            print(f"warning: {warning}", file=sys.stderr)
        if "--warm" in (sys.argv[1:] if arguments is None else arguments):
            warm()
    except EnvironmentFault as fault:
        print(fault, file=sys.stderr)
        return fault.exit_code
    return 0


if __name__ == "__main__":
    sys.exit(main())

"""Compiled forms: processes that begin at once with an empty cache, and caches that are damaged."""

import fcntl
import os
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from restoration.environment import Builds
from tests.torture import tries

ROOT = Path(__file__).parents[1]
# The forms of a whole Stokes flow, and what comes of them; the cache lies in a folder of the test.
FLOW = """
import sys
sys.prefix = sys.argv[1]
from restoration.environment import use_jit_cache
from tests.restoration.conftest import diapir_scene
use_jit_cache()
from restoration.engine import StokesEngine
engine = StokesEngine(diapir_scene(cells=(4, 4)))
state = engine.with_flow(engine.start())
print(f"{engine.grid.fastest(state.flow):.12e} {engine.grid.spaces.unknowns}")
"""
# One form, which is quicker to build.
FORM = """
import sys
sys.prefix = sys.argv[1]
import restoration.environment as e
e.warm()
print("sound")
"""


def begun(code, home):
    return subprocess.Popen(
        [sys.executable, "-c", code, str(home)],
        cwd=ROOT,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def answers(processes, timeout=300):
    """Return what all processes have said; each must have ended well and without a word beside."""
    found = [process.communicate(timeout=timeout) for process in processes]
    assert [process.returncode for process in processes] == [0] * len(processes), found
    assert all(said == "" for _, said in found), found
    return [out for out, _ in found]


def cache_of(home):
    return home / "cache" / "fenics"


def built(home):
    """Return the stems of all modules of a cache."""
    return sorted({p.name.split(".")[0] for p in cache_of(home).glob("libffcx_*")})


@pytest.mark.slow
@pytest.mark.torture
def test_processes_that_begin_at_once_build_every_form_once(tmp_path):
    for number in range(tries(1, 10)):
        home = tmp_path / str(number)
        home.mkdir()
        (answer,) = set(answers([begun(FLOW, home) for _ in range(tries(6, 8))]))
        assert int(answer.split()[1]) > 100
        assert len(built(home)) > 5
        files = list(cache_of(home).glob("libffcx_*"))
        for suffix in (".so", ".c.cached", ".sum"):
            assert sum(path.name.endswith(suffix) for path in files) == len(built(home))
        moments = {path: path.stat().st_mtime_ns for path in files if path.suffix == ".so"}
        assert set(answers([begun(FLOW, home)])) == {answer}  # from the cache
        assert {path: path.stat().st_mtime_ns for path in moments} == moments


def only(folder, suffix):
    (path,) = (p for p in folder.glob("libffcx_*") if p.name.endswith(suffix))
    return path


def cut(share):
    def damage(folder):
        path = only(folder, ".so")
        os.truncate(path, int(share * path.stat().st_size))

    return damage


def flipped(folder):
    path = only(folder, ".so")
    content = bytearray(path.read_bytes())
    for at in range(0x200, len(content), 97):
        content[at] ^= 0x55
    path.write_bytes(content)


def unfinished(folder):
    """As a kill in the middle of a compilation leaves it."""
    for suffix in (".c.cached", ".sum", ".so"):
        only(folder, suffix).unlink()


def of_old(folder):
    """As a program that knew no locks left it, half-built, long ago."""
    unfinished(folder)
    only(folder, ".lock").unlink()
    os.utime(only(folder, ".c"), (time.time() - 3600,) * 2)


def unnoted(folder):
    """As a kill after the compilation leaves it, with a library that was not written to the end."""
    only(folder, ".sum").unlink()
    cut(0.5)(folder)


def removed(suffix):
    return lambda folder: only(folder, suffix).unlink()


def foreign(folder):
    """Another library under the name of ours."""
    path = only(folder, ".so")
    path.write_bytes(Path("/usr/lib/x86_64-linux-gnu/libm.so.6").read_bytes())


DAMAGES = {
    "half a library": cut(0.5),
    "no library": removed(".so"),
    "flipped bytes": flipped,
    "empty library": cut(0),
    "unfinished": unfinished,
    "unnoted": unnoted,
    "of old": of_old,
    "most of a library": cut(0.9),
    "a header": cut(0.01),
    "no sign of the end": removed(".c.cached"),
    "empty sum": lambda folder: only(folder, ".sum").write_text(""),
    "binary sum": lambda folder: only(folder, ".sum").write_bytes(bytes(range(200, 250))),
    "no source": removed(".c"),
}
if Path("/usr/lib/x86_64-linux-gnu/libm.so.6").exists():
    DAMAGES["foreign library"] = foreign


@pytest.fixture(scope="module")
def form(tmp_path_factory):
    """A cache with one form."""
    home = tmp_path_factory.mktemp("form")
    assert answers([begun(FORM, home)]) == ["sound\n"]
    return home


@pytest.mark.slow
@pytest.mark.torture
@pytest.mark.parametrize("name", list(DAMAGES)[: tries(7, 100)])
def test_a_damaged_cache_is_mended(form, tmp_path, name):
    """Also while others are at work in it, so that the cleaning at start does nothing."""
    home = shutil.copytree(form, tmp_path / "home")
    with open(cache_of(home) / "lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_SH)
        DAMAGES[name](cache_of(home))
        begin = time.monotonic()
        assert answers([begun(FORM, home)]) == ["sound\n"]
        assert time.monotonic() - begin < 40  # not the minute that FFCx waits
    files = [path.name for path in cache_of(home).glob("libffcx_*")]
    assert sum(name.endswith(".so") for name in files) == 1
    assert sum(name.endswith(".sum") for name in files) == 1


@pytest.mark.slow
@pytest.mark.torture
@pytest.mark.parametrize("seed", range(tries(1, 60)))
def test_killed_builders_leave_nothing_that_harms(tmp_path, seed):
    """Of processes that build the same forms some are killed; the others are not the worse."""
    rng = random.Random(seed)
    processes = [begun(FLOW, tmp_path) for _ in range(3)]
    limit = time.monotonic() + 60
    while not list(cache_of(tmp_path).glob("libffcx_*.c")):
        assert time.monotonic() < limit
        time.sleep(0.02)
    time.sleep(rng.uniform(0, 3))
    os.killpg(processes[0].pid, signal.SIGKILL)
    processes[0].communicate()
    first, second = answers(processes[1:])
    assert first == second
    assert answers([begun(FLOW, tmp_path)]) == [first]


NUMBA = """
import sys
import restoration.environment as e
e._mend_numba()
import kernels
print(kernels.double(21))
"""


def test_a_damaged_cache_of_kernels_is_mended(tmp_path):
    (tmp_path / "kernels.py").write_text(
        "from numba import njit\n@njit(cache=True)\ndef double(x):\n    return 2 * x\n"
    )

    def answer():
        return subprocess.run(
            [sys.executable, "-c", NUMBA],
            env=os.environ | {"PYTHONPATH": f"{ROOT}{os.pathsep}{tmp_path}"},
            capture_output=True,
            text=True,
            check=False,
        )

    assert answer().stdout == "42\n"
    cache = tmp_path / "__pycache__"
    for suffix in (".nbi", ".nbc"):
        for share in (0, 0.5):
            (path,) = cache.glob(f"*{suffix}")
            os.truncate(path, int(share * path.stat().st_size))
            done = answer()
            assert (done.stdout, done.returncode) == ("42\n", 0), done.stderr
            assert answer().stdout == "42\n"


@pytest.mark.parametrize("error", [TimeoutError, ImportError, AttributeError])
def test_what_cannot_be_loaded_is_removed_and_looked_for_once_more(tmp_path, error):
    """A build that was begun by a program without locks, and is not ours to remove at first."""
    source, asked = tmp_path / "libffcx_x.c", []
    source.touch()

    def find(name, objects, folder, timeout):
        asked.append(source.exists())
        if len(asked) < 2:
            raise error("it cannot be loaded")
        return None, None

    builds = Builds()
    assert builds.finding(find)("libffcx_x", ["f"], tmp_path, 1) == (None, None)
    assert asked == [True, False]

    def build(*arguments):
        for suffix in (".c", ".c.cached", ".so"):
            (tmp_path / f"libffcx_x{suffix}").write_text("built")
        return "content"

    arguments = ("decl", [], ["f"], "libffcx_x", {}, tmp_path, None, False, None, None)
    assert builds.compiling(build)(*arguments) == "content"
    with open(tmp_path / "libffcx_x.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)  # given back

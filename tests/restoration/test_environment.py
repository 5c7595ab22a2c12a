import os
import subprocess
import sys
import time
from pathlib import Path

import pytest

from restoration import environment
from restoration.environment import DEBIAN_MODULES, VENV_MODULES
from restoration.errors import EnvironmentFault

OLD = 1000.0  # s


def make_site(folder, numpy="1.24.2", without=()):
    """Make a folder of importable but empty packages, and numpy with its metadata."""
    for name in {*DEBIAN_MODULES, *VENV_MODULES, "numpy"} - set(without):
        (folder / name).mkdir(parents=True)
        (folder / name / "__init__.py").touch()
    (folder / f"numpy-{numpy}.dist-info").mkdir()
    return folder


def make_libraries(folder, blas="openblas-serial", gl="libOSMesa.so.8"):
    """Make a folder of libraries as Debian's alternatives lay it out."""
    (folder / blas).mkdir(parents=True)
    (folder / blas / "libblas.so.3").touch()
    (folder / blas / "libopenblas-r0.3.21.so").touch()
    (folder / "libblas.so.3").symlink_to(folder / blas / "libblas.so.3")
    if gl:
        (folder / gl).touch()
    return folder


@pytest.fixture
def system(tmp_path):
    return make_site(tmp_path / "system")


@pytest.fixture
def libraries(tmp_path):
    return make_libraries(tmp_path / "lib")


def test_a_sound_machine_is_passed_over(system, libraries):
    assert environment.check_environment([str(system)], system, libraries) == []


def test_a_wrong_numpy_is_named_with_its_cure(system, libraries, tmp_path, monkeypatch):
    venv = make_site(tmp_path / "venv", numpy="2.3.1")
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    with pytest.raises(EnvironmentFault, match=r"numpy 2.3.1 in .*venv hides 1.24.2") as caught:
        environment.check_environment([str(venv), str(system)], system, libraries)
    assert "pip install numpy==1.24.2 there" in str(caught.value)
    assert "\n" not in str(caught.value)
    assert caught.value.exit_code == 2


def test_a_wrong_numpy_outside_the_venv_is_not_pips_to_cure(system, libraries, tmp_path):
    user = make_site(tmp_path / "user", numpy="2.3.1")
    with pytest.raises(EnvironmentFault, match="PYTHONNOUSERSITE=1"):
        environment.check_environment([str(user), str(system)], system, libraries)


def test_the_same_numpy_in_the_venv_will_do(system, libraries, tmp_path):
    venv = make_site(tmp_path / "venv", numpy="1.24.2")
    assert environment.check_environment([str(venv), str(system)], system, libraries) == []


@pytest.mark.parametrize("command", [["environment"], ["cli", "check", "case.yaml"]])
def test_numpy_2_stops_this_very_python_in_a_line(tmp_path, command):
    """The whole guard, on this machine, with a numpy that would crash dolfinx put before."""
    fake = tmp_path / "numpy"
    fake.mkdir()
    (fake / "__init__.py").write_text("raise SystemExit('numpy was loaded')")
    (tmp_path / "numpy-2.3.1.dist-info").mkdir()
    done = subprocess.run(
        [sys.executable, "-m", f"restoration.{command[0]}", *command[1:]],
        env={**os.environ, "PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert done.stderr.startswith(f"numpy 2.3.1 in {tmp_path} hides ")
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize(
    ("module", "advice"),
    [
        ("dolfinx", "Debian's python3-dolfinx;"),
        ("numpy", "python3-numpy"),
        ("numba", "Python's numba; run 'make setup'"),
    ],
)
def test_a_missing_package_is_named(tmp_path, libraries, monkeypatch, module, advice):
    monkeypatch.delenv("PETSC_DIR", raising=False)
    system = make_site(tmp_path / "system", without=[module])
    with pytest.raises(EnvironmentFault) as caught:
        environment.check_environment([str(system)], system, libraries)
    assert advice in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_foreign_petsc_is_suspected(tmp_path, libraries, monkeypatch):
    monkeypatch.setenv("PETSC_DIR", "/opt/petsc")
    system = make_site(tmp_path / "system", without=["dolfinx", "petsc4py"])
    with pytest.raises(EnvironmentFault, match=r"python3-petsc4py; .* unset PETSC_DIR"):
        environment.check_environment([str(system)], system, libraries)


def test_a_missing_gl_is_a_warning(system, tmp_path):
    libraries = make_libraries(tmp_path / "bare", gl=None)
    (warning,) = environment.check_environment([str(system)], system, libraries)
    assert "libosmesa6" in warning


def test_the_reference_blas_is_a_warning(system, tmp_path):
    libraries = make_libraries(tmp_path / "bare", blas="blas")
    (warning,) = environment.check_environment([str(system)], system, libraries)
    assert "libopenblas0-serial" in warning


def test_blas_follows_the_alternatives(tmp_path, libraries):
    assert environment.blas(libraries, maps=None) == "openblas-serial 0.3.21"
    assert environment.blas(make_libraries(tmp_path / "2", blas="blas"), None) == "reference"
    assert environment.blas(tmp_path / "none", maps=None) is None


def test_blas_believes_what_is_loaded(tmp_path, libraries):
    """A BLAS bundled with a wheel is not the one that PETSc calls."""
    maps = tmp_path / "maps"
    wheel = "7f00-7f01 r-xp 00000000 00:2a 13   /site/numpy.libs/libopenblas64_p-r0.3.23.so\n"
    maps.write_text(wheel)
    assert environment.blas(libraries, maps) == "openblas-serial 0.3.21"
    maps.write_text(wheel + "7f02-7f03 r-xp 0 00:2a 12  /usr/lib/x/blas/libblas.so.3.11.0\n")
    assert environment.blas(libraries, maps) == "reference"


def test_the_guard_loads_nothing_and_is_quick():
    code = (
        "import sys, time; start = time.process_time(); import restoration.environment as e;"
        "e.check_environment(); print(time.process_time() - start);"
        "print([name for name in ('numpy', 'dolfinx', 'vtk', 'gmsh') if name in sys.modules])"
    )
    runs = [subprocess.check_output([sys.executable, "-c", code], text=True) for _ in range(3)]
    assert all(run.split("\n")[1] == "[]" for run in runs)
    assert min(float(run.split("\n")[0]) for run in runs) < 0.1


def test_versions_for_the_record():
    found = environment.versions()
    assert list(found) == ["dolfinx", "petsc", "numpy", "blas"]
    assert all(found.values())
    assert found["petsc"].count(".") == 2


@pytest.fixture
def places(tmp_path, monkeypatch):
    """The three places of a cache, in a folder of the test."""
    monkeypatch.setattr(sys, "prefix", str(tmp_path / "venv"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "tmp"))
    for name in ("venv", "home", "tmp"):
        (tmp_path / name).mkdir()
    return tmp_path


def block(folder):
    """Make a folder impossible to make anything in, for root too."""
    folder.rmdir()
    folder.touch()


def test_the_cache_lies_in_the_venv(places):
    assert environment.jit_cache() == places / "venv/cache/fenics"
    assert environment.jit_cache().is_dir()


def test_the_cache_falls_back_to_the_user_and_to_tmp(places):
    block(places / "venv")
    assert environment.jit_cache().is_relative_to(places / "home")
    assert environment.jit_cache() == environment.jit_cache()
    for folder in (places / "home").iterdir():
        (folder / "fenics").rmdir()
        folder.rmdir()
    block(places / "home")
    assert environment.jit_cache().is_relative_to(places / "tmp")


def test_each_venv_has_a_cache_of_its_own(places, monkeypatch):
    block(places / "venv")
    first = environment.jit_cache()
    monkeypatch.setattr(sys, "prefix", str(places / "venv2/x"))
    (places / "venv2").touch()
    assert environment.jit_cache() != first


@pytest.mark.skipif(os.getuid() != 0, reason="only root can give a folder away")
def test_a_folder_of_somebody_else_is_not_trusted(places):
    block(places / "venv")
    block(places / "home")
    ours = environment.jit_cache()
    os.chown(ours.parent, 12345, -1)
    assert environment.jit_cache().parent != ours.parent


def make_form(folder, name, age, done):
    for suffix in [".c", ".o", *([".c.cached"] if done else [])]:
        path = folder / f"libffcx_forms_{name}{suffix}"
        path.touch()
        os.utime(path, (time.time() - age,) * 2)


def remaining(folder):
    return sorted(
        {path.name.split(".")[0].removeprefix("libffcx_forms_") for path in folder.glob("lib*")}
    )


def test_only_old_half_built_forms_are_removed(tmp_path):
    make_form(tmp_path, "done", OLD, done=True)
    make_form(tmp_path, "poison", OLD, done=False)
    make_form(tmp_path, "building", 0, done=False)
    environment.remove_half_built(tmp_path)
    assert remaining(tmp_path) == ["building", "done"]


BUILD = """
import sys, time, restoration.environment as e
from pathlib import Path
e._join(Path(sys.argv[1]))
print("in", flush=True)
time.sleep(60)
"""


def test_a_half_built_form_of_a_living_process_stays_and_of_a_killed_one_goes(tmp_path):
    """No age is asked where the lock says that nobody is left."""
    other = subprocess.Popen([sys.executable, "-c", BUILD, tmp_path], stdout=subprocess.PIPE)
    with other:
        assert other.stdout.readline() == b"in\n"
        make_form(tmp_path, "half", 1, done=False)
        join(tmp_path)
        assert remaining(tmp_path) == ["half"]
        other.kill()
    join(tmp_path)
    assert remaining(tmp_path) == []


def join(folder):
    code = "import sys, restoration.environment as e, pathlib; e._join(pathlib.Path(sys.argv[1]))"
    subprocess.run([sys.executable, "-c", code, folder], check=True)


COMPILE = """
import restoration.environment as e
folder = e.use_jit_cache()
e.warm()
print(folder)
"""


def compile_form(home):
    """Compile the first form in a fresh cache, and return the folder and what was said."""
    done = subprocess.run(
        [sys.executable, "-c", f"import sys; sys.prefix = {str(home)!r}\n{COMPILE}"],
        capture_output=True,
        text=True,
        check=True,
        timeout=50,  # s; under the time that FFCx waits for another process
    )
    return Path(done.stdout.strip()), done.stderr


def test_a_killed_compilation_does_not_poison_the_next_run(tmp_path):
    folder, said = compile_form(tmp_path)
    assert folder == tmp_path / "cache/fenics"
    assert said == ""  # no INFO lines of the compiler
    (done,) = folder.glob("*.c.cached")
    done.unlink()  # as a SIGKILL during the compilation leaves it
    compile_form(tmp_path)
    assert done.exists()


def test_compiled_forms_are_looked_for_on_disk_once():
    asked = []

    def find(name, objects, folder, timeout):
        asked.append(name)
        return (None, None) if len(asked) == 1 else ([name], "module")

    found = environment._remembering(find)
    assert found("a", ["f"], "folder", 10) == (None, None)  # it is compiled now
    for _ in range(3):
        assert found("a", ["f"], "folder", 10) == (["a"], "module")
    assert asked == ["a", "a"]
    found("b", ["f"], "folder", 10)
    assert asked == ["a", "a", "b"]


def test_numba_caches_beside_the_source_or_in_our_folder(places, monkeypatch):
    monkeypatch.setenv("NUMBA_CACHE_DIR", "kept")
    monkeypatch.delenv("NUMBA_CACHE_DIR")
    environment.use_numba_cache()
    assert "NUMBA_CACHE_DIR" not in os.environ
    monkeypatch.setattr(environment.os, "access", lambda path, mode: "venv" in str(path))
    environment.use_numba_cache()
    assert os.environ["NUMBA_CACHE_DIR"] == str(places / "venv/cache/numba")


def test_matplotlib_keeps_its_notes_in_our_folder_where_the_home_holds_nothing(places, monkeypatch):
    monkeypatch.setenv("MPLCONFIGDIR", "kept")
    monkeypatch.delenv("MPLCONFIGDIR")
    monkeypatch.setenv("XDG_CONFIG_HOME", str(places / "home"))
    environment.use_matplotlib_cache()
    assert "MPLCONFIGDIR" not in os.environ
    monkeypatch.setenv("XDG_CONFIG_HOME", "/proc")
    environment.use_matplotlib_cache()
    assert os.environ["MPLCONFIGDIR"] == str(places / "venv/cache/matplotlib")


def test_a_user_without_a_home(places, monkeypatch):
    def none():
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", none)
    block(places / "venv")
    assert environment.jit_cache().is_relative_to(places / "tmp")


def test_the_command_says_what_is_wrong(monkeypatch, capsys):
    monkeypatch.setattr(environment, "check_environment", lambda: ["slow"])
    assert environment.main([]) == 0
    assert capsys.readouterr().err == "warning: slow\n"

    def refuse():
        raise EnvironmentFault("numpy 2")

    monkeypatch.setattr(environment, "check_environment", refuse)
    assert environment.main(["--warm"]) == 2
    assert capsys.readouterr().err == "numpy 2\n"

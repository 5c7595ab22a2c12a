"""Imports run one way: every module imports only modules above it in its list."""

import ast
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

ORDER = {
    "forms": ["elements", "rheology", "stokes", "surface", "mesh_motion"],
    "meshes": [
        "data",
        "box",
        "body_centred",
        "arrays",
        "split",
        "refine",
        "noding",
        "dealt",
        "curves",
        "chains",
        "section",
    ],
    "restoration": [
        "words",
        "errors",
        "units",
        "writing",
        "apart",
        "files",
        "series_reader",
        "checkpoint",
        "saved",
        "tree",
        "kinds",
        "fault_entries",
        "entries",
        "box_rules",
        "case",
        "scene",
        "geojson",
        "frame",
        "arrangement",
        "section",
        "starter",
        "lines",
        "bands",
        "enclosed",
        "cloud",
        "palette",
        "shapes",
        "faults",
        "walls",
        "retry",
        "stopping",
        "resolve",
        "environment",
        "launch",
        "advection",
        "plan",
        "seeding",
        "layered",
        "ranks",
        "spaces",
        "tetra",
        "particles",
        "sharing",
        "inflow",
        "line_rock",
        "transfer",
        "sampling",
        "conservative",
        "boundary",
        "acceptance",
        "assembly",
        "blocks",
        "solvers",
        "stokes",
        "snapshot",
        "surface",
        "shared_stokes",
        "contacts",
        "grid",
        "guards",
        "mesher",
        "topography",
        "surface_modes",
        "free_surface",
        "state",
        "diagnostics",
        "sheets",
        "welds",
        "displacement",
        "companions",
        "certificate",
        "step",
        "remembering",
        "engine",
        "box_engine",
        "xdmf",
        "output",
        "page",
        "canvas",
        "figures",
        "box_figures",
        "certificate_figure",
        "progress",
        "recorder",
        "box_recorder",
        "run_folder",
        "stop_request",
        "keeper",
        "run",
        "forecast",
        "measured",
        "check",
        "sweep",
        "bench",
        "trade",
        "cli",
    ],
    "restoration/bench": [
        "rows",
        "exact",
        "two_interface",
        "reference",
        "boxes",
        "scenes",
        "solutions",
        "gravity",
        "advection",
        "van_keken",
        "rest",
        "solving",
        "surfaces",
        "reliefs",
        "reverse_surface",
        "graben",
        "certificate",
        "paper",
        "peers",
        "contrasts",
        "extremes",
        "shapes",
        "pictures",
        "suite",
    ],
    "restoration/sweep": ["ranges", "file", "runs", "children", "table", "command"],
    "restoration/trade": [
        "trials",
        "choices",
        "questions",
        "worker",
        "search",
        "report",
        "picture",
        "command",
    ],
}
# What a package may import besides itself and the standard library; None for anything.
OUTSIDE = {
    "forms": {"ufl", "basix", "numpy"},
    "meshes": {"numpy", "scipy", "shapely", "gmsh", "dolfinx", "mpi4py", "petsc4py"},
    "restoration": None,
}
ABOVE = {"forms": set(), "meshes": set(), "restoration": {"forms", "meshes"}}

PLANTED = [
    ("forms/stokes.py", "import scipy", "scipy"),
    ("forms/stokes.py", "from petsc4py import PETSc", "petsc4py"),
    ("forms/rheology.py", "from forms.stokes import strain_rate", "forms.stokes"),
    ("forms/rheology.py", "from .stokes import strain_rate", "forms.stokes"),
    ("meshes/box.py", "def f():\n    import numba", "numba"),
    ("meshes/box.py", "from restoration.errors import MeshError", "restoration"),
    ("restoration/units.py", "from restoration import run", "restoration.run"),
    ("restoration/units.py", "from restoration import run as march", "restoration.run"),
    ("restoration/units.py", "import restoration.run", "restoration.run"),
    ("restoration/units.py", "from . import run", "restoration.run"),
    ("restoration/units.py", "if True:\n    from restoration.run import run", "restoration.run"),
    ("restoration/units.py", "import restoration.units", "restoration.units"),
    ("restoration/__init__.py", "from restoration.errors import CaseError", "restoration.errors"),
    ("restoration/check.py", "def f():\n    from restoration.cli import main", "restoration.cli"),
    ("restoration/run.py", "from tests.conftest import box", "tests"),
    ("restoration/run.py", "from importlib import import_module as load", "importlib"),
    ("restoration/run.py", "__import__('restoration.cli')", "__import__"),
    ("restoration/novel.py", "import ufl", "ORDER"),
    ("restoration/bench/novel.py", "import ufl", "ORDER"),
    ("restoration/bench/rows.py", "from restoration.bench.suite import keep", "bench.suite"),
    ("restoration/bench/rows.py", "from restoration.cli import main", "restoration.cli"),
    ("restoration/run.py", "from restoration.bench.rows import Row", "restoration.bench"),
]
SOUND = [
    ("forms/stokes.py", "from dataclasses import dataclass\nfrom ufl import inner"),
    ("forms/stokes.py", "from forms.rheology import newtonian"),
    ("meshes/box.py", "import numpy as np\nimport gmsh\nfrom meshes.data import SectionMesh"),
    ("restoration/units.py", "from restoration.errors import CaseError"),
    ("restoration/units.py", "from restoration import __version__, errors"),
    ("restoration/bench/suite.py", "from restoration.bench import rows\nimport restoration.run"),
    ("restoration/run.py", "from forms.stokes import strain_rate\nimport meshes.box\nimport numba"),
    (
        "restoration/cli.py",
        "from importlib.resources import files\nfrom restoration.run import run",
    ),
]


def modules(package):
    """Return the names of all modules of a package; those of one inside it count by its name."""
    paths = (path.relative_to(ROOT / package) for path in (ROOT / package).rglob("*.py"))
    return sorted({path.parts[0].removesuffix(".py") for path in paths})


def imported(tree, package):
    """Yield the full dotted name of everything that a module imports, in functions too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = ".".join([package] * bool(node.level) + [node.module] * bool(node.module))
            yield from (f"{base}.{alias.name}" for alias in node.names)
        elif isinstance(node, ast.Name) and node.id == "__import__":
            yield "__import__"


def wrong_imports(name, text):
    """Return what the module file ``name``, such as ``forms/stokes.py``, may not import."""
    package, module, *inner = name.removesuffix(".py").split("/")
    order = ORDER[package]
    beside = ORDER.get(f"{package}/{module}", ())  # of a package inside the package
    if inner and inner[0] != "__init__" and inner[0] not in beside:
        return [f"{package}.{module}.{inner[0]} has no place in ORDER"]
    before = beside[: beside.index(inner[0])] if inner and inner[0] in beside else ()
    if module != "__init__" and module not in order:
        return [f"{package}.{module} has no place in ORDER"]
    above = [] if module == "__init__" else order[: order.index(module)]
    wrong = []
    for target in imported(ast.parse(text), package):
        first, second, third, *_ = [*target.split("."), "", ""]
        if first == package and second == module and inner:
            if third in beside and third not in before:
                wrong.append(target)
        elif first == package:
            if second in order and second not in above:
                wrong.append(f"{first}.{second}")
        elif first in {*ORDER, "tests"}:
            if first not in ABOVE[package]:
                wrong.append(first)
        elif target in {"__import__", "importlib", "importlib.import_module"}:
            wrong.append(target)  # would hide from this test
        elif first not in sys.stdlib_module_names and OUTSIDE[package] is not None:
            if first not in OUTSIDE[package]:
                wrong.append(first)
    return wrong


PACKAGES = [name for name in ORDER if "/" not in name]


@pytest.mark.parametrize("package", PACKAGES)
def test_every_module_imports_only_modules_above_it(package):
    paths = sorted((ROOT / package).rglob("*.py"))
    names = [path.relative_to(ROOT).as_posix() for path in paths]
    wrong = {name: wrong_imports(name, (ROOT / name).read_text()) for name in names}
    assert names
    assert {name: imports for name, imports in wrong.items() if imports} == {}


@pytest.mark.parametrize("package", ORDER)
def test_every_name_in_the_order_is_a_module(package):
    assert set(ORDER[package]) == set(modules(package)) - {"__init__"}


@pytest.mark.parametrize(("name", "text", "culprit"), PLANTED)
def test_a_wrong_import_is_named(name, text, culprit):
    assert culprit in " ".join(wrong_imports(name, text))


@pytest.mark.parametrize(("name", "text"), SOUND)
def test_a_sound_import_passes(name, text):
    assert wrong_imports(name, text) == []

"""`restore check`: what would be solved, told truly, quickly, and without the heavy libraries."""

import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from restoration.check import describe, describe_text
from restoration.entries import ELEMENTS
from restoration.plan import unknowns
from restoration.resolve import load
from restoration.units import YEAR

ROOT = Path(__file__).parents[2]
DEMO = ROOT / "cases" / "diapir-isoviscous" / "case.yaml"
DIAPIR = ROOT / "cases" / "salt-diapir" / "exp1.yaml"
HEAVY = ("dolfinx", "gmsh", "petsc4py", "matplotlib", "vtk", "pyvista", "numba", "h5py")


def words_of(path, *overrides):
    return describe_text(load(path, overrides))


def test_unknowns_of_one_square():
    """One square: 4 triangles, 5 vertices, 8 edges."""
    assert unknowns((1, 1)) == (4, 2 * (5 + 8) + 5)


@pytest.mark.parametrize("element", ELEMENTS)
def test_unknowns_are_those_of_the_solver(element):
    from restoration.engine import StokesEngine

    scene = load(DEMO, ["mesh.cells=[5, 3]", f"mesh.element={element}"]).scene
    spaces = StokesEngine(scene).grid.spaces
    cells, count = unknowns(scene.cells, element)
    assert cells == spaces.section.cell_count
    assert count == spaces.unknowns
    size = sum(s.dofmap.index_map.size_global * s.dofmap.index_map_bs for s in (spaces.V, spaces.Q))
    assert count == size


def test_the_demo():
    about = describe(load(DEMO))
    assert about["width_m"] == 9142
    assert about["area_m2"] == pytest.approx(91.42e6)
    assert [rock["name"] for rock in about["rocks"]] == ["salt", "sediment"]
    assert [line["name"] for line in about["lines"]] == ["salt / sediment"]
    assert 9142 < about["lines"][0]["length_m"] < 9200
    assert about["steps_at_least"] == 20 * (len(about["marks_s"]) - 1)
    assert about["stokes_solves_at_least"] == 4 * about["steps_at_least"] + 1
    assert about["viscosity_contrast"] == 1
    assert max(about["marks_s"]) == pytest.approx(6e6 * YEAR)
    json.dumps(about, allow_nan=False)


def test_particles_are_counted_as_seeded():
    loaded = load(DEMO, ["mesh.cells=8"])
    assert describe(loaded)["particles"] > 4 * 4 * 8 * 8
    about = describe(loaded)["particles"]
    from restoration.seeding import seed_points

    assert len(seed_points(loaded.scene)[0]) == about


def test_without_a_rehearsal_no_time_is_told():
    assert describe(load(DEMO))["time_forecast_s"] is None
    assert "restore check --forecast" in words_of(DEMO)


def test_marches_say_their_way():
    text = words_of(DEMO, "time.marks=[0 Myr, 6 Myr, 0 Myr]")
    assert "march      from 0 Myr to 6 Myr, forward" in text
    assert "march      from 6 Myr to 0 Myr, restoring" in text
    assert "march      from 0 Ma to 2 Ma, restoring" in words_of(DEMO, "time.marks=[0 Ma, 2 Ma]")


@pytest.mark.parametrize(
    ("override", "said"),
    [
        ("mesh.cells=45", "one factorisation for the whole run"),
        ("rocks.salt.viscosity=1e17 Pa s", "a factorisation for every new moment"),
        ("mesh.interfaces=fitted", "the last factorisation as preconditioner"),
        ("mesh.cells=45", "the level of the pressure is set at the surface"),
        ("boundary.surface={traction: [0 MPa, 0 MPa]}", "comes from the wall that is left"),
        ("time.scheme=paper", "steps by paper, one flow for each step"),
        ("gravity=0 m/s^2", "no gravity"),
        ("section.layers.0.rock=sediment", "one rock: only the walls can move it"),
        ("transfer.mean=geometric", "(geometric mean)"),
        ("boundary.surface=free", "a mesh that moves with the surface; particles carry the rock"),
        ("boundary.surface=free", "the last factorisation as preconditioner"),
    ],
)
def test_what_is_active_and_why(override, said):
    active = [row for row in words_of(DEMO, override).splitlines() if row.startswith("active")]
    assert any(said in row for row in active)


def test_walls_in_the_units_of_people():
    free = "boundary.surface={traction: [0 MPa, -2 MPa]}"
    text = words_of(DEMO, "boundary.left={velocity: [1 cm/yr, free]}", free)
    assert "left       velocity [10 mm/yr, free]" in text
    assert "surface    traction [0 MPa, -2 MPa]" in text


def test_a_section_file_names_units_and_contacts():
    text = words_of(DIAPIR)
    assert "rock       sediment: 2600 kg/m^3, 1e19 Pa s; units A, B, C, D, E" in text
    assert "horizon    salt / A" in text


def test_the_text_ends_with_a_case(tmp_path):
    text = words_of(DEMO)
    path = tmp_path / "case.yaml"
    path.write_text(text[text.index("# the case with every default") :], encoding="utf-8")
    assert describe(load(path)) == describe(load(DEMO))


@pytest.mark.parametrize("path", [DEMO, DIAPIR], ids=["layers", "file"])
def test_heavy_libraries_stay_out(path):
    program = (
        "import sys; from restoration.resolve import load; from restoration.check import "
        f"describe_text; describe_text(load({str(path)!r})); "
        f"print([name for name in {HEAVY!r} if name in sys.modules])"
    )
    begin = time.perf_counter()
    done = subprocess.run(
        [sys.executable, "-c", program], cwd=ROOT, capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "[]"
    assert time.perf_counter() - begin < 3


def test_the_largest_case_is_answered_too():
    begin = time.perf_counter()
    about = describe(load(DEMO, ["mesh.cells=[500, 500]", "particles.densify=1000"]))
    assert time.perf_counter() - begin < 3
    assert about["cells"] == 1_000_000
    assert np.isfinite(about["memory_mb_about"])

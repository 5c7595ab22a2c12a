"""What a scene may expect from the presets, by what was measured of cases of its kind."""

import json
from pathlib import Path

import pytest

from restoration.check import describe, describe_text
from restoration.measured import expected, kind_of
from restoration.resolve import load

ROOT = Path(__file__).parents[2]
DEMO = ROOT / "cases" / "diapir-isoviscous" / "case.yaml"
WEAK = ROOT / "cases" / "diapir-two-viscosities" / "case.yaml"
GRABEN = ROOT / "cases" / "graben" / "case.yaml"


@pytest.fixture
def kept(tmp_path):
    """A folder with what was measured of two cases, and of a benchmark, which says nothing."""

    def keep(name, about, **errors):
        trials = [
            {"label": label.replace("_", " "), "error": error} for label, error in errors.items()
        ]
        found = {"name": name, "command": f"restore trade {name}", "about": about}
        found |= {"truth_good_to": 0.5, "trials": trials}
        (tmp_path / f"{name}.json").write_text(json.dumps(found))

    keep("one", kind_of(load(DEMO).scene), preset_draft=8.0, preset_balanced=2.0)
    keep("two", kind_of(load(WEAK).scene), preset_draft=90.0, preset_fine=None)
    keep("pulled", kind_of(load(GRABEN).scene), preset_draft=0.2)
    keep("box", {}, preset_draft=0.01)
    return tmp_path


def test_the_case_of_the_kind_is_taken_and_scaled_by_height(kept):
    told = expected(load(DEMO).scene, kept)
    assert (told.case, told.like) == ("one", True)
    assert told.carried == {"draft": 8.0, "balanced": 2.0}
    low = load(DEMO, ["section.box.height=9 km"]).scene
    assert expected(low, kept).carried["draft"] == pytest.approx(0.9 * 8.0)
    assert expected(load(WEAK).scene, kept).case == "two"
    assert expected(load(WEAK).scene, kept).carried == {"draft": 90.0}


def test_fitted_scenes_expect_what_fitted_cases_gave(kept):
    told = expected(load(GRABEN).scene, kept)
    assert (told.case, told.carried, told.fitted) == ("pulled", {"draft": 0.5}, {})  # as the truth
    other = expected(load(DEMO, ["boundary.surface=free"]).scene, kept)
    assert (other.case, other.like) == ("one", False)


def test_nothing_measured_is_nothing_told(tmp_path):
    assert expected(load(DEMO).scene, tmp_path) is None


def test_check_tells_what_the_presets_gave():
    loaded = load(DEMO)
    told = describe(loaded)["expected"]
    assert told["case"] == "diapir-isoviscous"
    assert set(told["carried"]) <= {"draft", "balanced", "fine"}
    text = describe_text(loaded)
    assert "presets    give horizons off by" in text
    assert "a guess" in text

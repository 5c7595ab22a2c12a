"""The examples of the pages are cases that load, and what they link to is there."""

import re
import shutil
from pathlib import Path

import pytest

from restoration import cloud, files, geojson, kinds, saved, series_reader, tree, units, words
from restoration.resolve import load

ROOT = Path(__file__).parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("cases/*/*.md")])


def blocks(page):
    return re.findall(r"```yaml\n(.*?)```", (ROOT / page).read_text(encoding="utf-8"), re.S)


@pytest.mark.parametrize("page", ["README.md", "docs/design.md"])
def test_the_case_of_a_page_loads(page, tmp_path):
    shutil.copy(ROOT / "cases/salt-diapir/section.geojson", tmp_path)
    (tmp_path / "case.yaml").write_text(blocks(page)[0], encoding="utf-8")
    scene = load(tmp_path / "case.yaml").scene
    assert {rock.name for rock in scene.rocks} == {"salt", "sediment"}


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_links_lead_somewhere(page):
    links = re.findall(r"\]\(([^)#]+)", page.read_text(encoding="utf-8"))
    for link in links:
        assert "://" in link or (page.parent / link).exists(), link


def test_the_limits_of_the_page_are_those_of_the_program():
    page = (ROOT / "docs/input.md").read_text(encoding="utf-8")
    limits = dict(re.findall(r"^\| (a [^|]+?) \| ([^|]+?) \|$", page, re.M))
    assert limits["a case file"].startswith(
        f"{files.MB / 1e6:g} MB, {tree.MOST_LINES} lines of {tree.LONGEST_LINE} characters, "
        f"{tree.MOST_NODES} entries, {tree.DEEPEST} levels"
    )
    longest = f"{words.LONGEST_NAME}; {kinds.LONGEST_PATH} characters"
    assert limits["a name; the path of a file"] == longest
    assert limits["a GeoJSON section"] == (
        f"{geojson.LARGEST / 1e6:g} MB, {geojson.MOST_FEATURES} features, "
        f"{geojson.MOST_VERTICES} vertices"
    )
    assert limits["a table of particles"] == (
        f"{cloud.LARGEST / 1e6:g} MB, {cloud.LONGEST_LINE} characters a line, "
        f"{cloud.MOST_UNITS} units"
    )
    assert limits["a particle series (HDF5)"] == (
        f"{saved.LARGEST / 1e6:g} MB a file, {series_reader.MOST_DATA} values a particle"
    )
    assert limits["a number with a unit"] == f"{units.LONGEST} characters"

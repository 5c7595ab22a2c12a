"""The examples of the pages are cases that load, and what they link to is there."""

import re
import shutil
from pathlib import Path

import pytest

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

"""What pages say of the project is there: the files they link to, and the house as it is."""

import re
from pathlib import Path

import pytest

from tests.test_layers import LAYERS

ROOT = Path(__file__).parent.parent
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/*.md"), *ROOT.glob("schemas/*.md")])
LINK = re.compile(r"\]\((?!https?://|#)([^)#]+)(#[^)]*)?\)")


def test_there_are_pages() -> None:
    names = {page.name for page in PAGES}
    assert {"README.md", "CONTRIBUTING.md", "CHANGELOG.md", "architecture.md"} <= names


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_to_a_file(page: Path) -> None:
    links = [match[1] for match in LINK.finditer(page.read_text())]
    assert [link for link in links if not (page.parent / link).exists()] == []


def test_the_house_is_drawn_as_it_is() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text()
    table = page[page.index("| floor |") : page.index("A folder has one job")]
    rows = [re.findall(r"`(\w+)`", row.split("|")[1]) for row in table.splitlines()[2:] if row]
    assert rows == [row for row in LAYERS if row != ["__main__"]]


def test_the_way_through_convert_is_at_most_eight_files() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text()
    way = page[page.index("## What happens in convert") : page.index("`append` takes")]
    assert len(re.findall(r"^\d\. \[", way, re.M)) == 8

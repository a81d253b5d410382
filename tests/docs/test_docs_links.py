"""Links of the README and of every page of the documentation lead somewhere, to headings too."""

import re
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[2]
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
LINK = re.compile(r"(?<!`)\]\(([^)\s]+)\)")


def text_of(page: Path) -> str:
    """A page without its blocks of code."""
    return re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.S | re.M)


def anchors(page: Path) -> set[str]:
    """What its headings are called in links."""
    titles = re.findall(r"^#+ (.+)$", text_of(page), re.M)
    return {re.sub(r"[^\w\- ]", "", title).strip().lower().replace(" ", "-") for title in titles}


def broken(page: Path) -> list[str]:
    found = []
    for link in LINK.findall(text_of(page)):
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        if link.startswith("http"):
            continue
        if not target.exists() or (anchor and anchor not in anchors(target)):
            found.append(link)
    return found


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    assert broken(page) == []


def test_a_broken_link_is_found(tmp_path: Path) -> None:
    (tmp_path / "a.md").write_text("# A b: `c/<d>`\n[1](a.md#a-b-cd) [2](b.md) [3](#nothing) ![4](no.png)\n")
    assert broken(tmp_path / "a.md") == ["b.md", "#nothing", "no.png"]


def test_every_page_is_in_the_site() -> None:
    listed = re.findall(r"^ +- .+: (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(), re.M)
    assert sorted(listed) == sorted(
        str(path.relative_to(ROOT / "docs")) for path in (ROOT / "docs").rglob("*.md")
    )
    assert yaml.safe_load((ROOT / "mkdocs.yml").read_text())["strict"] is True


def test_pictures_stay_small_and_are_all_shown() -> None:
    pictures = list((ROOT / "docs" / "pictures").iterdir())
    text = "".join(page.read_text() for page in PAGES)
    assert [path.name for path in pictures if f"pictures/{path.name}" not in text] == []
    assert sum(path.stat().st_size for path in pictures) < 2_000_000

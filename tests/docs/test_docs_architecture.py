"""docs/architecture.md is the code's: rooms, imports, calls, files, paths; so are paths in other pages."""

import re
from collections.abc import Iterator
from pathlib import Path

import docs_architecture as drawn
import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "architecture.md").read_text()
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
PATH = re.compile(r"(?:kinectbench|tests|scripts|benchmarks|docs|examples)/[\w./-]+")
AGAIN = "run `make docs-architecture` and look at the picture"


def rows(heading: str) -> Iterator[list[str]]:
    """The cells of the first table below a heading, without its head."""
    text = PAGE.split(f"## {heading}\n")[1].split("\n## ")[0]
    lines = [line for line in text.splitlines() if line.startswith("|")]
    return ([cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:])


def test_the_table_of_rooms_is_the_code() -> None:
    found = {room.strip("`"): set(re.findall(r"`(\w+)`", imports)) for room, _, imports in rows("Rooms")}
    imported = drawn.imports()
    assert list(found) == drawn.rooms()
    assert found == {room: {below for above, below in imported if above == room} for room in drawn.rooms()}


def test_the_picture_has_these_rooms_and_arrows() -> None:
    picture = drawn.PICTURE.read_text()
    assert re.findall(r'id="room-(\w+)"', picture) == drawn.rooms(), AGAIN
    arrows = {(above, below) for above, below in re.findall(r'id="arrow-(\w+)-(\w+)"', picture)}
    assert arrows == set(drawn.imports()), AGAIN


def test_the_picture_is_drawn_the_same_twice() -> None:
    sizes = {("cli", "core"): 3, ("cli", "stages"): 12}
    one, two = (drawn.picture(["cli", "stages", "core"], sizes) for _ in range(2))
    assert one == two and one.count("arrow-") == 2 and ">12<" in one


def test_every_call_on_the_way_of_a_frame_is_there() -> None:
    calls = [(call.strip("`"), file.strip("`")) for call, file, _ in rows("The way of a depth frame")]
    assert len(calls) > 20
    for call, file in calls:
        text = (ROOT / "kinectbench" / file).read_text()
        assert re.search(rf"^def {call}\(", text, re.M), f"{file} has no function {call}"


def test_every_stored_file_has_its_owner() -> None:
    found = drawn.files_list()
    named = re.compile(r"`(\S+)`\s+\(`(\w+)`\)")
    assert len(named.findall(found)) > 10
    assert set(named.findall(drawn.with_list(PAGE, ""))) == set()
    assert sorted(named.findall(PAGE)) == sorted(named.findall(found)), AGAIN


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_paths_that_a_page_names_are_there(page: Path) -> None:
    """In code and in commands; a path with a placeholder is none."""
    quoted = re.findall(r"`([^`\n]+)`", page.read_text(encoding="utf-8"))
    paths = [word for text in quoted for word in text.split() if PATH.fullmatch(word)]
    assert [path for path in paths if not (ROOT / path).exists()] == []

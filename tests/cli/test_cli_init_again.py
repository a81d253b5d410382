"""`init --force` adds recordings; what a person wrote in benchmark.yaml stays."""

import os
from collections.abc import Callable
from pathlib import Path

import pytest
from small_benchmark import Run, copied

from kinectbench.settings.file import load_benchmark

Command = Callable[..., Run]

HEAD = "name: mine\n# my own words\n"
CHAIR = """\
  - id: my_chair
    path: ./recordings/chair/
    category: chair  # from the attic
    underside: closed
    pick: {frame: 3, pixel: [80, 60]}
    # the left leg is loose
"""
TAIL = "\n# of all\nviews: {count: 3}\n"
OTHERS = {
    "a list at the margin": ("recordings:\n" + CHAIR.replace("\n  ", "\n").removeprefix("  "), TAIL),
    "at the end": ("views: {count: 3}\nrecordings:\n" + CHAIR, ""),
    "without a last line feed": ("recordings:\n" + CHAIR.removesuffix("\n"), ""),
    "lines of another system": (("recordings:\n" + CHAIR).replace("\n", "\r\n"), TAIL),
    "in one line": ("recordings:\n  - {id: my_chair, path: recordings/chair, category: chair}\n", TAIL),
    "included": ("include: [more.yaml]\n", TAIL),
}


@pytest.fixture
def root(small: Path, tmp_path: Path) -> Path:
    """Two recordings, chair and table, without a benchmark.yaml."""
    made = copied(small, tmp_path / "b", "recordings/chair", "recordings/table")
    (made / "more.yaml").write_text("recordings:\n" + CHAIR)
    return made


def test_what_a_person_wrote_stays(command: Command, root: Path) -> None:
    config = root / "benchmark.yaml"
    (root / "recordings/table/pick.json").write_text('{"frame": 1, "pixel": [4, 5]}')
    gone = "  - {id: gone, path: recordings/gone, category: table}\n"
    before, after = HEAD + "recordings:\n" + gone + CHAIR, TAIL
    config.write_text(before + after)
    run = command(root, "init", ".", "--force")
    text = config.read_text()
    assert run.status == 0 and text.startswith(before) and text.endswith(after)
    assert "added 1 recording of 2" in run.out and "not found here: gone" in run.err
    settings = load_benchmark(config)
    assert [each.id for each in settings.recordings] == ["gone", "my_chair", "table"]
    assert [each.pick.frame for each in settings.recordings if each.pick] == [3, 1]
    again = command(root, "init", ".", "--force")
    assert config.read_text() == text and "added 0 recordings" in again.out
    assert list(root.glob("benchmark.yaml.*")) == []


@pytest.mark.parametrize("how", OTHERS)
def test_forms_of_the_file(command: Command, root: Path, how: str) -> None:
    before, after = OTHERS[how]
    config = root / "benchmark.yaml"
    config.write_bytes((HEAD + before + after).encode())
    assert command(root, "init", ".", "--force").status == 0
    text = config.read_bytes().decode()
    assert text.startswith(HEAD + before) and text.count("of all") == after.count("of all")
    assert {each.id: each.path for each in load_benchmark(config).recordings} == {
        "my_chair": "recordings/chair" if "one line" in how else "./recordings/chair/",
        "table": "recordings/table",
    }
    assert list(root.glob("benchmark.yaml.*")) == []


def test_the_id_of_an_added_recording_is_its_own(command: Command, root: Path) -> None:
    config = root / "benchmark.yaml"
    config.write_text("name: a\nrecordings:\n  - {id: table, path: recordings/chair, category: chair}\n")
    assert command(root, "init", ".", "--force").status == 0
    assert [each.id for each in load_benchmark(config).recordings] == ["table", "recordings_table"]


@pytest.mark.parametrize(
    "content",
    [
        b"name: [\n",
        b"\xff\xfe\x00",
        b"",
        b"- a list\n",
        b"name: a\nrecordings: [{id: chair, path: recordings/chair, category: chair}]\n",
        b"name: a\nrecordings: &r\n  - {id: chair, path: recordings/chair, category: chair}\n",
        b"name: a\nrecordings: {a: b}\n",
        b"name: a\nrecordings: 3\n",
        b"name: a\nrecordings: [ # none\n]\n",
        b"name: a\nrecordings:\n  - {id: chair, paht: recordings/chair, category: chair}\n",
        b"nam: a\nrecordings: []\n",
        b"name: a\ninclude: [nothing.yaml]\n",
    ],
)
def test_what_has_an_error_stays_as_it_is(command: Command, root: Path, content: bytes) -> None:
    config = root / "benchmark.yaml"
    config.write_bytes(content)
    run = command(root, "init", ".", "--force")
    (line,) = run.err.splitlines()
    assert run.status == 2 and line.startswith("error: ") and "benchmark.yaml" in line
    assert line.endswith("nothing is written: mend it, or move it away and run `kinectbench init`")
    assert config.read_bytes() == content and list(root.glob("benchmark.yaml*")) == [config]


@pytest.mark.parametrize("empty", ["", " []", " ~", " null  # none yet", "  # none yet\n  # - id: one"])
@pytest.mark.parametrize("after", ["", "\n", TAIL])
def test_an_empty_list_is_filled_where_it_is(command: Command, root: Path, empty: str, after: str) -> None:
    config = root / "benchmark.yaml"
    config.write_text(f"name: mine\nrecordings:{empty}{after}")
    assert command(root, "init", ".", "--force").status == 0
    text = config.read_text()
    assert text.startswith("name: mine\nrecordings:") and after.strip() in text
    assert text.count("none yet") == empty.count("none yet")
    assert [each.id for each in load_benchmark(config).recordings] == ["chair", "table"]


def test_a_path_through_a_link_is_the_same_recording(command: Command, root: Path) -> None:
    (root / "recordings").rename(root / "data")
    (root / "recordings").symlink_to("data")
    config = root / "benchmark.yaml"
    config.write_text("name: a\nrecordings:\n  - {id: c, path: recordings/chair, category: chair}\n")
    run = command(root, "init", ".", "--force")
    assert run.status == 0 and "not found" not in run.err
    assert [each.path for each in load_benchmark(config).recordings] == ["recordings/chair", "data/table"]


def test_what_is_no_readable_file_is_refused(command: Command, root: Path) -> None:
    config = root / "benchmark.yaml"
    config.mkdir()
    assert_refused(command(root, "init", ".", "--force"))
    config.rmdir()
    os.mkfifo(config)
    assert_refused(command(root, "init", ".", "--force"))
    config.unlink()
    config.symlink_to("/proc/self/mem")  # may not be read, whoever asks
    assert_refused(command(root, "init", ".", "--force"))
    assert config.is_symlink() and list(root.glob("benchmark.yaml.*")) == []


def assert_refused(run: Run) -> None:
    (line,) = run.err.splitlines()
    assert run.status == 2 and line.startswith("error: ") and "benchmark.yaml: " in line

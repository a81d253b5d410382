"""Files of strangers: plain ones within bounds, names that stay in their folder, texts that only print."""

import errno
import os
import resource
import socket
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest
from bounds import within
from raising import raises

from kinectbench.core.errors import StorageError
from kinectbench.core.storage import append_plain, name_problem, replaced_file, storage_errors
from kinectbench.core.untrusted import (
    below,
    cell,
    listed_below,
    listed_paths,
    open_plain,
    printable,
    quoted,
    read_head,
    read_plain,
    read_plain_text,
    scanned,
)


@pytest.fixture
def odd(tmp_path: Path) -> Path:
    """A pipe, a socket, links to devices, a folder, and a link that goes round."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "zero").symlink_to("/dev/zero")
    (tmp_path / "linked_pipe").symlink_to("pipe")
    (tmp_path / "folder").mkdir()
    with socket.socket(socket.AF_UNIX) as bound:
        bound.bind(os.path.relpath(tmp_path / "socket"))  # such names are short
    return tmp_path


@pytest.mark.parametrize(
    ("sign", "count", "taken"),
    [("a", 99, True), ("é", 49, True), ("€", 16, True), ("€", 40, False), ("😀", 26, False)],
)
def test_a_text_is_bounded_by_what_it_takes_in_memory(
    tmp_path: Path, sign: str, count: int, taken: bool
) -> None:
    path = tmp_path / "a.txt"
    path.write_text(sign * count, encoding="utf-8")
    if taken:
        assert read_plain_text(path, 100) == sign * count
        return
    with pytest.raises(OSError, match=r"takes more than 100 bytes as a text|larger than the 100"):
        read_plain_text(path, 100)


@pytest.mark.parametrize("name", ["pipe", "zero", "linked_pipe", "folder", "socket"])
@pytest.mark.parametrize("read", [open_plain, read_head, read_plain_text, lambda path: read_plain(path, 9)])
def test_what_is_no_plain_file_is_refused_at_once(
    odd: Path, name: str, read: Callable[[Path], object]
) -> None:
    with within(1):
        with pytest.raises(OSError, match="not a plain file but a") as refused:
            read(odd / name)
        assert refused.value.errno == errno.EINVAL
        assert refused.value.filename == str(odd / name)


def test_a_link_to_a_plain_file_is_followed(tmp_path: Path) -> None:
    (tmp_path / "file").write_bytes(b"12345")
    (tmp_path / "link").symlink_to("file")
    assert read_plain(tmp_path / "link", 5) == b"12345"
    assert read_head(tmp_path / "link", 2) == b"12"
    with pytest.raises(FileNotFoundError):
        open_plain(tmp_path / "missing")


def test_a_file_larger_than_its_bound_is_refused_unread(tmp_path: Path) -> None:
    with (tmp_path / "hole").open("wb") as file:
        file.truncate(1 << 40)  # takes no room on the disk
    with pytest.raises(OSError, match="larger than the 5 bytes") as refused:
        read_plain(tmp_path / "hole", 5)
    assert refused.value.errno == errno.EFBIG


def test_a_file_that_claims_no_size_is_bounded_too() -> None:
    """/proc's files are plain and claim 0 bytes."""
    with pytest.raises(OSError, match="larger than the 5 bytes"):
        read_plain(Path("/proc/self/status"), 5)


def test_text_is_utf_8_whatever_the_locale(tmp_path: Path) -> None:
    (tmp_path / "text").write_bytes("\ufeffσ".encode())
    assert read_plain_text(tmp_path / "text") == "σ"
    (tmp_path / "text").write_bytes(b"\xff")
    with pytest.raises(UnicodeDecodeError):
        read_plain_text(tmp_path / "text")


@pytest.mark.parametrize("name", ["/etc/passwd", "../a", "a/../../b", "a/..", "", "a\0b", "..a", "a/.b/c"])
def test_a_name_stays_in_its_folder(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match=r"leads out of the folder|is no name|is hidden"):
        below(tmp_path, name)


@pytest.mark.parametrize("name", ["\ud800", "a/\udfff.png", "x" * 256, "é" * 128, "a/" * 512 + "b"])
def test_a_name_that_no_file_can_have_is_none(tmp_path: Path, name: str) -> None:
    with pytest.raises(ValueError, match="is no name of a file"):
        below(tmp_path, name)


@pytest.mark.parametrize(
    "name", ["a", "depth/1.png", "a b", "./a", "a..b/c", "x" * 255, "é" * 127, "a/" * 511 + "b"]
)
def test_other_names_are_taken(tmp_path: Path, name: str) -> None:
    assert below(tmp_path, name) == tmp_path / name


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("a\x1b]0;x\x07\x1b[2Jb", "a?]0;x??[2Jb"),
        ("one\ntwo\r\u2028three\u202e\u200b", "one?two??three??"),
        ("größe σ 椅子", "größe σ 椅子"),
        ("x" * 200, "x" * 39 + "…" + "x" * 40),
        ("\ud800", "?"),
    ],
)
def test_what_is_quoted_only_prints(text: str, shown: str) -> None:
    assert printable(text) == shown


@pytest.mark.parametrize(
    "value", ["x" * 1000, [["\x1b"] * 1000] * 1000, {"a": {"b": {"c": [1]}}}, 10**4000, None, 1e300, "\ud800"]
)
def test_values_are_quoted_in_short(value: object) -> None:
    assert quoted(value).isprintable() and len(quoted(value)) <= 80


@pytest.mark.parametrize("walk", [scanned, listed_paths, listed_below])
def test_a_folder_is_listed_as_far_as_a_bound(
    tmp_path: Path, walk: Callable[[Path, int], Iterable[object]]
) -> None:
    for number in range(5):
        (tmp_path / f"{number}").mkdir()
    (tmp_path / "0/below").touch()
    (tmp_path / "1/up").symlink_to(tmp_path)  # is listed, and not followed
    count = 5 if walk is not listed_below else 7
    # Of what lies below a folder only the files and links are given; all is counted.
    assert len(list(walk(tmp_path, count))) == (5 if walk is not listed_below else 2)
    with pytest.raises(OSError, match=r"holds more than . files and folders") as told:
        list(walk(tmp_path, count - 1))
    assert told.value.errno == errno.EFBIG
    # The first is given before the rest is counted.
    assert next(iter(walk(tmp_path / "0" if walk is listed_below else tmp_path, 1))) is not None


GROWN = "files may not grow so large here"


def test_a_file_that_may_not_grow_so_large_is_told_as_a_full_disk_is(tmp_path: Path) -> None:
    """And what is too large to be read is not taken for it."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))
    try:
        with pytest.raises(StorageError, match=GROWN), replaced_file(tmp_path / "a") as temporary:
            temporary.write_bytes(bytes(5000))
        with pytest.raises(StorageError, match=GROWN), replaced_file(tmp_path / "a") as temporary:
            raise OSError(errno.EFBIG, "File too large", "from", None, "to")  # as shutil says it of a copy
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "b").write_bytes(bytes(9))
    with pytest.raises(OSError, match="larger than the 8 bytes"), storage_errors(tmp_path / "c"):
        read_plain(tmp_path / "b", 8)


@pytest.mark.parametrize(
    "text", ["=1+1", "+cmd", "-a", "@x", "\tx", "\rx", "-1-1", "--1", "=", "-", "1-1\n=2"]
)
def test_cells_that_a_spreadsheet_would_compute_are_quoted(text: str) -> None:
    shown = cell(text)
    assert shown[0] not in "=+-@\t\r" and shown.endswith(text)


@pytest.mark.parametrize("value", ["a", "-1", "+1.5e-3", "", "3D-RecGAN++", -1.0, None, 3, "1=1"])
def test_plain_texts_and_numbers_stay_as_they_are(value: str | float | None) -> None:
    assert cell(value) == value


@pytest.mark.parametrize("name", ["a", "0", "chair.01", "a-b_c", "x" * 80, "json", "a.json.b", "build"])
def test_names(name: str) -> None:
    assert name_problem(name) is None


@pytest.mark.parametrize(
    "name", ["", ".a", "-a", "a/b", "a b", "a\n", "é", "x" * 81, "a+", "x.JSON", "Baselines"]
)
def test_names_that_are_refused_everywhere(name: str) -> None:
    assert name_problem(name)
    assert name_problem("a++", also="+") is None and name_problem("+a", also="+")


def test_a_name_that_the_disk_does_not_take_is_one_line(tmp_path: Path) -> None:
    """Its temporary neighbour has a longer name than itself."""
    with (
        raises(StorageError, "storage.not-writable"),
        replaced_file(tmp_path / ("x" * 250)),
    ):
        pass


@pytest.mark.parametrize("kind", ["a pipe", "a link", "a folder"])
def test_what_is_added_to_is_a_plain_file(tmp_path: Path, kind: str) -> None:
    path, outside = tmp_path / "lock", tmp_path / "outside"
    outside.write_text("mine")
    {"a pipe": os.mkfifo, "a link": lambda to: to.symlink_to(outside), "a folder": Path.mkdir}[kind](path)
    with raises(StorageError, "storage.no-plain-file"):
        append_plain(path, "theirs")
    assert outside.read_text() == "mine"
    append_plain(tmp_path / "new" / "lock", "é")
    append_plain(tmp_path / "new" / "lock", "t")
    assert (tmp_path / "new" / "lock").read_text(encoding="utf-8") == "ét"

"""Zip files of strangers: each bound, one below and one above, and every form that the end of a zip has."""

import io
import struct
import zipfile

import pytest

from kinectbench.core import zip_files
from kinectbench.core.zip_files import DAMAGED_ZIP, MOST_COMMENT_BYTES, ROW_BYTES, SLACK_BYTES, open_zip

END, END_BYTES = b"PK\5\6", 22


def zipped(count: int, comment: bytes = b"", name_length: int = 10) -> bytes:
    """A zip of so many members of ten bytes each."""
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for number in range(count):
            with archive.open(f"{number:0{name_length}d}", "w", force_zip64=True) as member:
                member.write(b"0123456789")
        archive.comment = comment
    return content.getvalue()


def with_large_end(content: bytes, count: int | None = None, directory: int | None = None) -> bytes:
    """The same zip with the end record of large files (zip64), which may say something else."""
    body, end = content[:-END_BYTES], content[-END_BYTES:]
    files, size, start = struct.unpack_from("<HII", end, 10)
    files, size = files if count is None else count, size if directory is None else directory
    large = struct.pack("<4sQHHIIQQQQ", b"PK\6\6", 44, 45, 45, 0, 0, files, files, size, start)
    locator = struct.pack("<4sIQI", b"PK\6\7", 0, len(body), 1)
    full = struct.pack("<4sHHHHIIH", END, 0, 0, 0xFFFF, 0xFFFF, 0xFFFFFFFF, 0xFFFFFFFF, 0)
    return body + large + locator + full


def names(content: bytes, most_files: int = 100, **bounds: int) -> list[str]:
    return open_zip(io.BytesIO(content), most_files, **bounds).namelist()


@pytest.mark.parametrize("form", ["plain", "comment", "longest comment", "large"])
def test_as_many_files_as_are_accepted_and_one_more(form: str) -> None:
    comments = {"comment": b"of a stranger", "longest comment": b"c" * MOST_COMMENT_BYTES}
    content = zipped(3, comments.get(form, b""))
    content = with_large_end(content) if form == "large" else content
    assert len(names(content, 3)) == 3
    with pytest.raises(ValueError, match=r"^3 files in it; 2 is the most accepted$"):
        names(content, 2)


def test_the_end_record_in_a_comment_is_the_one_that_zipfile_finds() -> None:
    fake = struct.pack("<4sHHHHIIH", END, 0, 0, 1, 1, 46, 0, 0)
    content = zipped(3, b"before" + fake + b"after")
    with pytest.raises(zipfile.BadZipFile):
        names(content, 3)


def test_what_a_large_end_says_counts() -> None:
    with pytest.raises(ValueError, match=r"^4294967296 files in it"):
        names(with_large_end(zipped(3), count=1 << 32))
    with pytest.raises(ValueError, match=r"^a directory of 1099511627776 bytes, too large for 100 files$"):
        names(with_large_end(zipped(3), directory=1 << 40))


def test_a_count_that_is_not_the_directorys_is_damage() -> None:
    for content in (with_large_end(zipped(3), count=2), with_large_end(zipped(3), count=4)):
        with pytest.raises(zipfile.BadZipFile, match=r"its end says \d files, its directory 3"):
            names(content)


def test_a_large_end_that_is_not_there_is_damage() -> None:
    content = with_large_end(zipped(3))
    with pytest.raises(zipfile.BadZipFile, match="its end record for large files is damaged"):
        names(content.replace(b"PK\6\6", b"PK\0\0"))


def test_a_directory_as_large_as_is_accepted_and_one_byte_more(monkeypatch: pytest.MonkeyPatch) -> None:
    content = zipped(2)
    (size,) = struct.unpack_from("<I", content, len(content) - END_BYTES + 12)
    monkeypatch.setattr(zip_files, "SLACK_BYTES", size - 2 * 5)
    assert len(names(content, 2, row_bytes=5)) == 2
    monkeypatch.setattr(zip_files, "SLACK_BYTES", size - 2 * 5 - 1)
    with pytest.raises(ValueError, match=f"^a directory of {size} bytes, too large for 2 files$"):
        names(content, 2, row_bytes=5)


def test_long_names_are_no_part_of_a_small_zip() -> None:
    length = 60_000
    count = (SLACK_BYTES + 2 * ROW_BYTES) // length + 1
    with pytest.raises(ValueError, match=r"^a directory of"):
        names(zipped(count, name_length=length), 2)


def test_as_many_bytes_as_are_accepted_and_one_more() -> None:
    assert len(names(zipped(2), most_bytes=20)) == 2
    with pytest.raises(ValueError, match=r"^claims to unpack to 20 bytes; 19 is the most accepted$"):
        names(zipped(2), most_bytes=19)


def test_every_cut_of_a_zip_is_refused_as_damaged() -> None:
    for content in (zipped(2), with_large_end(zipped(2))):
        for length in range(len(content)):
            with pytest.raises(DAMAGED_ZIP):
                names(content[:length])


def test_every_byte_of_the_end_may_be_wrong() -> None:
    for content in (zipped(2), with_large_end(zipped(2))):
        for at in range(len(content) - 98, len(content)):
            for value in (0, 1, 0x7F, 0xFF):
                wrong = content[:at] + bytes([value]) + content[at + 1 :]
                try:
                    assert len(names(wrong, 2)) == 2
                except DAMAGED_ZIP:
                    continue

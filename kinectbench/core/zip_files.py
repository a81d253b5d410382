"""Untrusted zip files: the end record bounds the content before the directory is read."""

import os
import struct
import zipfile
import zlib
from typing import IO

# The end record, the locator of the one for large files (zip64), and that: see APPNOTE, 4.3.14 to 16.
_END, _LOCATOR, _END_64 = b"PK\5\6", b"PK\6\7", b"PK\6\6"
_END_BYTES, _LOCATOR_BYTES, _END_64_BYTES = 22, 20, 56
# The format counts its bytes in 16 bits.
MOST_COMMENT_BYTES = 0xFFFF
# A file's row in the directory: 46 bytes, its name and times (chosen here; ours have no long names).
ROW_BYTES = 1 << 10
# By how much the directory of a few files may be larger.
SLACK_BYTES = 64 << 10
# What zipfile raises of a damaged zip. NotImplementedError: an unknown compression; RuntimeError: encrypted;
# ValueError and OverflowError: sizes and places that no file has. Of a file there are OSErrors besides.
DAMAGED_ZIP = (
    zipfile.BadZipFile,
    zlib.error,
    struct.error,
    EOFError,
    NotImplementedError,
    RuntimeError,
    ValueError,
    OverflowError,
)


def open_zip(
    file: IO[bytes], most_files: int, most_bytes: int | None = None, row_bytes: int = ROW_BYTES
) -> zipfile.ZipFile:
    """Open a zip after checking its directory; the entries are not checked.

    Args:
        file: open to read; it stays open.
        most_files: a zip of more is refused before its directory is read.
        most_bytes: a zip whose files claim more together, unpacked, is refused; None: who reads
            them bounds them.
        row_bytes: of the directory, for each file that it may hold.

    Raises:
        ValueError: it holds more; the message says what.
        zipfile.BadZipFile: it is not a zip, or its directory is damaged.
    """
    count, directory_bytes = _listed(file)
    if count > most_files:
        raise ValueError(f"{count} files in it; {most_files} is the most accepted")
    if directory_bytes > most_files * row_bytes + SLACK_BYTES:
        raise ValueError(f"a directory of {directory_bytes} bytes, too large for {most_files} files")
    try:
        archive = zipfile.ZipFile(file)
    except (struct.error, OverflowError) as error:
        raise zipfile.BadZipFile(str(error)) from error
    files = archive.infolist()
    if len(files) != count:
        raise zipfile.BadZipFile(f"its end says {count} files, its directory {len(files)}")
    claimed = sum(entry.file_size for entry in files)
    if most_bytes is not None and claimed > most_bytes:
        raise ValueError(f"claims to unpack to {claimed} bytes; {most_bytes} is the most accepted")
    return archive


def _listed(file: IO[bytes]) -> tuple[int, int]:
    """The number of files and size of the directory, from the zip's end record.

    It is found as zipfile does, where the record for large files lies right before its locator.
    """
    size = file.seek(0, os.SEEK_END)
    file.seek(max(0, size - _END_BYTES - MOST_COMMENT_BYTES - 1))
    tail = file.read(_END_BYTES + MOST_COMMENT_BYTES + 1)
    bare = len(tail) - _END_BYTES
    at = bare if bare >= 0 and tail[bare:].startswith(_END) and tail.endswith(b"\0\0") else tail.rfind(_END)
    if at < 0 or len(tail) < at + _END_BYTES:
        raise zipfile.BadZipFile("not a zip file, or cut short")
    count, directory_bytes = struct.unpack_from("<HI", tail, at + 10)
    locator = at - _LOCATOR_BYTES
    if locator < 0 or tail[locator : locator + 4] != _LOCATOR:
        return count, directory_bytes
    record = locator - _END_64_BYTES
    if record < 0 or tail[record : record + 4] != _END_64:
        raise zipfile.BadZipFile("its end record for large files is damaged")
    return struct.unpack_from("<QQ", tail, record + 32)

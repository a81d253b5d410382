"""Open untrusted zip files: the end record limits the content before the directory is read."""

import os
import struct
import zipfile
import zlib
from typing import IO

# The end record, the locator of the zip64 end record, and that record: see APPNOTE, 4.3.14 to 16.
_END, _LOCATOR, _END_64 = b"PK\5\6", b"PK\6\7", b"PK\6\6"
_END_BYTES, _LOCATOR_BYTES, _END_64_BYTES = 22, 20, 56
# The format stores the length of a comment in 16 bits.
MOST_COMMENT_BYTES = 0xFFFF
# Largest row of the directory: 46 bytes, the file's name and times (chosen here; our names are short).
ROW_BYTES = 1 << 10
# Bytes that the directory may have in addition, for zips of few files.
SLACK_BYTES = 64 << 10
# Errors of zipfile on a damaged zip. NotImplementedError: unknown compression; RuntimeError: encrypted;
# ValueError and OverflowError: impossible sizes and offsets. Reading may raise OSErrors as well.
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
    """Open a zip file after checking its directory; the entries are not checked.

    Args:
        file: open for reading; it stays open.
        most_files: a zip of more files is refused before its directory is read.
        most_bytes: a zip with a larger unpacked total, as it states, is refused; None: the caller limits what
            it reads.
        row_bytes: limit of the directory's size per file, bytes.

    Raises:
        ValueError: the zip exceeds a limit; the message says which.
        zipfile.BadZipFile: the file is not a zip, or its directory is damaged.
        NotImplementedError: an entry needs a newer version of the format.
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
    """Return the number of files and the size of the directory in bytes, from the end record.

    Like zipfile, it expects the zip64 record right before its locator.
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

"""The only module that opens untrusted files: plain files only, with bounded cost.

A recording, a release, a prediction or a table may come from anybody. Reading a named pipe or a device may
never end, a file may be larger than memory, a name may lead out of its folder, and a text may control the
terminal that it is printed to. A refused file raises an `OSError` with a one-line reason, like errors of the
system, so that callers report both in the same way.
"""

import codecs
import errno
import os
import re
import reprlib
import stat
import unicodedata
from collections.abc import Callable, Iterator
from io import BufferedReader
from pathlib import Path, PurePosixPath
from typing import IO, TypeVar

_Value = TypeVar("_Value")

# The first 64 KB identify every format.
HEAD_BYTES = 64 << 10
# Default limit of a text: a JSON file of this package, as a million lines of a hundred characters (chosen
# here).
TEXT_BYTES = 100 << 20
# Characters of an untrusted text that a message quotes.
QUOTED = 80
# Largest number of pixels of a side and of an image: the largest side that `camera:` in benchmark.yaml
# allows, and twice the pixels of a 4K camera (chosen here). Checking depth or colour takes 14 bytes a pixel:
# 360 MB for the largest.
MOST_SIDE_PX, MOST_PIXELS = 8192, 1 << 24
# Largest encoded image: four bytes for each pixel of the largest image.
IMAGE_BYTES = 4 * MOST_PIXELS
# Largest unpacked message, chunk or frame: the largest image has 64 MB at four bytes a pixel; a reader holds
# up to four copies.
UNPACKED_BYTES = 80 << 20
# Largest ratio of a whole file's unpacked to its packed size, and bytes that are always allowed: bags and
# releases shrink to a third or a tenth, rendered depth to a thirtieth.
MOST_RATIO, ALWAYS_BYTES = 100, 64 << 20
# Largest number of characters of a path that an index names, and of bytes of a name in it: Linux's limits.
MOST_NAME, MOST_PART_BYTES = 1024, 255
# Largest number of files and folders in a folder: four for each frame of the longest recording.
MOST_LISTED = 1_000_000
# Bytes per read and write: so many that the cost of a call does not matter.
COPIED_BYTES = 1 << 20


def open_plain(path: Path) -> BufferedReader:
    """Open a regular file for reading, following links, without blocking.

    Raises:
        OSError: the file is missing or cannot be read; EINVAL: it is a folder, a pipe, a socket or a device.
    """
    # Checked before opening, because opening a device may have effects; and after, as the file may have
    # changed.
    if not stat.S_ISREG(path.stat().st_mode):
        raise _refused(path)
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise _refused(path)
    return os.fdopen(handle, "rb")


def size_of(file: IO[bytes]) -> int:
    """Return the size of an open file in bytes, even if its path now leads to another file."""
    return os.fstat(file.fileno()).st_size


def scanned(folder: Path, most: int = MOST_LISTED) -> Iterator["os.DirEntry[str]"]:
    """Yield the entries of a folder one at a time, unordered, so that many names cannot fill the memory.

    Raises:
        OSError: the folder cannot be read; EFBIG: it holds more than `most`.
    """
    with os.scandir(folder) as entries:
        for count, entry in enumerate(entries):
            if count == most:
                raise OSError(errno.EFBIG, f"holds more than {most} files and folders", str(folder))
            yield entry


def listed_paths(
    folder: Path, most: int = MOST_LISTED, wanted: Callable[[str], object] | None = None
) -> Iterator[Path]:
    """Yield the paths of a folder's entries whose names are `wanted`; see `scanned`.

    Filtering before paths are made takes a third of the time.
    """
    names = (entry.name for entry in scanned(folder, most))
    return (folder / name for name in names if wanted is None or wanted(name))


def listed_below(folder: Path, most: int = MOST_LISTED, *, with_empty: bool = False) -> Iterator[Path]:
    """Yield every file and link below a folder, unordered; links are not followed.

    With `with_empty`, empty folders are yielded, too.

    Raises:
        OSError: a folder cannot be read; EFBIG: there is more than `most`.
    """
    waiting, left = [folder], most
    while waiting:
        here, before = waiting.pop(), left
        for entry in scanned(here, left):
            left -= 1
            if entry.is_dir(follow_symlinks=False):
                waiting.append(Path(entry.path))
            else:
                yield Path(entry.path)
        if with_empty and left == before and here != folder:
            yield here


def read_plain(path: Path, most_bytes: int) -> bytes:
    """Read the bytes of a regular file; a file larger than `most_bytes` is refused before it is read.

    Raises:
        OSError: as `open_plain`; EFBIG: the file is larger.
    """
    with open_plain(path) as file:
        size = size_of(file)
        # The loop also reads appended data, and files of the kernel, whose stated size is 0.
        content = file.read(size + 1) if size <= most_bytes else b""
        while size < len(content) <= most_bytes and (more := file.read(COPIED_BYTES)):
            content += more
    if size > most_bytes or len(content) > most_bytes:
        raise OSError(errno.EFBIG, f"larger than the {most_bytes} bytes that such a file may have", str(path))
    return content


def read_head(path: Path, count: int = HEAD_BYTES) -> bytes:
    """Read the first bytes of a regular file; fewer if the file is shorter.

    Raises:
        OSError: as `open_plain`.
    """
    with open_plain(path) as file:
        return file.read(count) or b""  # None: a file of the kernel that has no data yet


def is_too_large(width: float, height: float) -> bool:
    """Whether an image has too many pixels to be read."""
    return max(width, height) > MOST_SIDE_PX or width * height > MOST_PIXELS


def copy_bounded(source: IO[bytes], target: IO[bytes], most_bytes: int) -> None:
    """Copy a stream, such as a decompressor's output, but no more than `most_bytes`.

    Raises:
        OSError: EFBIG: the stream is longer than that.
    """
    copied = 0
    while part := source.read(COPIED_BYTES):
        copied += len(part)
        if copied > most_bytes:
            raise OSError(errno.EFBIG, f"unpacks to more than {most_bytes} bytes")
        target.write(part)


def unpacked_bound(packed_bytes: int) -> int:
    """Largest accepted size, bytes, after unpacking a file of `packed_bytes`."""
    return ALWAYS_BYTES + MOST_RATIO * packed_bytes


def read_plain_text(path: Path, most_bytes: int = TEXT_BYTES) -> str:
    """Read a UTF-8 text, with or without a byte order mark, whatever the locale.

    Raises:
        OSError: as `read_plain`; EFBIG: the text takes more memory than `most_bytes`.
        UnicodeDecodeError: the file is not UTF-8.
    """
    return decoded(read_plain(path, most_bytes).removeprefix(codecs.BOM_UTF8), most_bytes, str(path))


def decoded(content: bytes, most_bytes: int, where: str) -> str:
    """Decode UTF-8 bytes, unless the text would take more than `most_bytes` of memory.

    One character that takes two or four bytes makes every character of a text that wide (PEP 393).

    Raises:
        OSError: EFBIG: the text takes more memory.
        UnicodeDecodeError: the bytes are not UTF-8.
    """
    if 4 * len(content) > most_bytes and not content.isascii():
        width = next((width for width, sign in _WIDTHS if sign.search(content)), 1)
        if width * len(content) > most_bytes:
            raise OSError(errno.EFBIG, f"takes more than {most_bytes} bytes as a text", where)
    return content.decode()


# First byte, in UTF-8, of a character that takes this many bytes in memory (PEP 393).
_WIDTHS = ((4, re.compile(rb"[\xf0-\xff]")), (2, re.compile(rb"[\xc4-\xff]")))


def below(folder: Path, name: str) -> Path:
    """Join an untrusted name, such as one from an index file, to a folder; refuse a name that leads outside.

    The name is relative to the folder, with "/" between folders.

    Raises:
        ValueError: the name is absolute, leads upwards, is hidden, or is no name; the message says which.
    """
    way = PurePosixPath(name)
    if not name or "\0" in name or not _can_be(way):
        raise ValueError("is no name of a file")
    if way.is_absolute() or ".." in way.parts:
        raise ValueError(
            f"'{printable(name)}' leads out of the folder; names must be relative to it, without '..'"
        )
    if any(part.startswith(".") for part in way.parts):
        raise ValueError(f"'{printable(name)}' is hidden; a name must not begin with '.'")
    return folder / way


def lies_below(path: Path, root: Path) -> bool:
    """Whether a path, with links resolved, lies below a folder that is already resolved."""
    try:
        return path.resolve().is_relative_to(root)
    except (OSError, RuntimeError):  # links that lead to each other
        return False


def followed(path: Path) -> Path:
    """Resolve the links of a path; return it unchanged, impossible to open, if the links form a cycle."""
    try:
        return path.resolve()
    except (OSError, RuntimeError):
        return path.absolute()


def _can_be(way: PurePosixPath) -> bool:
    """Whether a file can have this path: no part is too long, and all characters are valid."""
    try:
        return len(str(way)) <= MOST_NAME and all(len(part.encode()) <= MOST_PART_BYTES for part in way.parts)
    except UnicodeEncodeError:  # a lone surrogate, which JSON may hold
        return False


def quoted(value: object) -> str:
    """Return a parsed value as text for messages: its shortened `repr`."""
    return printable(reprlib.repr(value))


# Control characters except tab and line feed, line separators, and marks of writing direction.
STEERING = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def printable(text: str, most: int = QUOTED) -> str:
    """Make a text from a file safe for messages: short, without control characters.

    Characters that move the cursor, change the writing direction or cannot be printed (Unicode's categories C
    and line separators) become `?`; texts longer than `most` characters are cut in the middle.
    """
    half = most // 2
    short = text if len(text) <= most else f"{text[: half - 1]}…{text[-half:]}"
    if short.isprintable():  # false for a text with any such character
        return short
    return "".join("?" if unicodedata.category(c)[0] == "C" or c in "\u2028\u2029" else c for c in short)


def cell(value: _Value) -> _Value | str:
    """Quote text of a table cell that a spreadsheet would take for a formula; return other values unchanged.

    Numbers, also in texts, stay as they are. The signs of a formula are those in OWASP's "CSV Injection".
    """
    if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")) and not _NUMBER(value):
        return f"'{value}"
    return value


_NUMBER = re.compile(r"[+-]?[0-9]+(\.[0-9]+)?([eE][+-]?[0-9]+)?").fullmatch


def _refused(path: Path) -> OSError:
    kind = "a folder" if path.is_dir() else "a pipe, a socket or a device"
    return OSError(errno.EINVAL, f"not a plain file but {kind}", str(path))

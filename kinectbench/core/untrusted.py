"""The one place that opens untrusted files: plain files only, with a bound on their cost.

A recording, a release, a prediction or a table may come from anybody. A named pipe or a device in it would
be waited for or read for ever, a file may be larger than memory, a name may lead out of its folder, and a
text may steer the terminal that it is printed to. What is refused is an `OSError` with one line for a
reason, as if the system had refused it: who reports files that cannot be read reports these, too.
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

# The first 64 KB tell every format apart.
HEAD_BYTES = 64 << 10
# A text whose reader says nothing else: a JSON file of ours, as a million lines of a hundred characters
# (chosen here).
TEXT_BYTES = 100 << 20
# Characters of an untrusted text that a message quotes.
QUOTED = 80
# Of an image, pixels: what `camera:` in benchmark.yaml may say of a side, and twice a 4K camera's in all
# (chosen here). Depth or colour takes 14 bytes a pixel to check: 360 MB for the largest, with the libraries.
MOST_SIDE_PX, MOST_PIXELS = 8192, 1 << 24
# An image as it is encoded: four bytes for each pixel of the largest.
IMAGE_BYTES = 4 * MOST_PIXELS
# What one message, chunk or frame may unpack to: the largest image has 64 MB at four bytes a pixel; a reader
# holds up to four copies of it.
UNPACKED_BYTES = 80 << 20
# What a whole file may unpack to, as a multiple of itself: bags and releases shrink to a third or a tenth,
# rendered depth to a thirtieth; and by how much a small file may exceed it.
MOST_RATIO, ALWAYS_BYTES = 100, 64 << 20
# Of a path that an index names, characters; and of a name in it, bytes: what Linux takes.
MOST_NAME, MOST_PART_BYTES = 1024, 255
# Files and folders in one: four for each frame of the longest recording.
MOST_LISTED = 1_000_000
# Read and written at a time: enough that a call costs nothing beside it.
COPIED_BYTES = 1 << 20


def open_plain(path: Path) -> BufferedReader:
    """Open a regular file to read, following links, without blocking.

    Raises:
        OSError: it is missing or cannot be read; EINVAL: it is a folder, a pipe, a socket or a device.
    """
    # Looked at before it is opened: to open a device may do something. And once more, as it may have changed.
    if not stat.S_ISREG(path.stat().st_mode):
        raise _refused(path)
    handle = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise _refused(path)
    return os.fdopen(handle, "rb")


def size_of(file: IO[bytes]) -> int:
    """The size of an open file, whatever its path leads to now."""
    return os.fstat(file.fileno()).st_size


def scanned(folder: Path, most: int = MOST_LISTED) -> Iterator["os.DirEntry[str]"]:
    """The entries of a folder, unordered, one at a time, so that many names cannot fill the memory.

    Args:
        folder: a folder.
        most: files and folders in it.

    Raises:
        OSError: it cannot be read; EFBIG: it holds more.
    """
    with os.scandir(folder) as entries:
        for count, entry in enumerate(entries):
            if count == most:
                raise OSError(errno.EFBIG, f"holds more than {most} files and folders", str(folder))
            yield entry


def listed_paths(
    folder: Path, most: int = MOST_LISTED, wanted: Callable[[str], object] | None = None
) -> Iterator[Path]:
    """The paths of `scanned`.

    Args:
        folder: a folder.
        most: files and folders in it.
        wanted: whether a name is asked for; to make a path of each other one takes three times as long.
    """
    names = (entry.name for entry in scanned(folder, most))
    return (folder / name for name in names if wanted is None or wanted(name))


def listed_below(folder: Path, most: int = MOST_LISTED) -> Iterator[Path]:
    """Every file and link in a folder and below, links not followed, in no order.

    Args:
        folder: a folder.
        most: files and folders in it and below.

    Raises:
        OSError: a folder cannot be read; EFBIG: there is more than `most`.
    """
    waiting, left = [folder], most
    while waiting:
        for entry in scanned(waiting.pop(), left):
            left -= 1
            if entry.is_dir(follow_symlinks=False):
                waiting.append(Path(entry.path))
            else:
                yield Path(entry.path)


def read_plain(path: Path, most_bytes: int) -> bytes:
    """The bytes of a regular file.

    Args:
        path: the file.
        most_bytes: a larger file is refused before it is read.

    Raises:
        OSError: as `open_plain`; EFBIG: it is larger.
    """
    with open_plain(path) as file:
        size = size_of(file)
        # The loop also reads appended data, and the kernel's files, whose stated size is 0.
        content = file.read(size + 1) if size <= most_bytes else b""
        while size < len(content) <= most_bytes and (more := file.read(COPIED_BYTES)):
            content += more
    if size > most_bytes or len(content) > most_bytes:
        raise OSError(errno.EFBIG, f"larger than the {most_bytes} bytes that such a file may have", str(path))
    return content


def read_head(path: Path, count: int = HEAD_BYTES) -> bytes:
    """The first bytes of a regular file, fewer if it is shorter.

    Raises:
        OSError: as `open_plain`.
    """
    with open_plain(path) as file:
        return file.read(count) or b""  # nothing yet: some of the kernel's own files are waited for


def is_too_large(width: float, height: float) -> bool:
    """Whether an image has too many pixels to be read."""
    return max(width, height) > MOST_SIDE_PX or width * height > MOST_PIXELS


def copy_bounded(source: IO[bytes], target: IO[bytes], most_bytes: int) -> None:
    """Copy a decompressed stream up to a bound.

    Raises:
        OSError: EFBIG: there is more of it.
    """
    copied = 0
    while part := source.read(COPIED_BYTES):
        copied += len(part)
        if copied > most_bytes:
            raise OSError(errno.EFBIG, f"unpacks to more than {most_bytes} bytes")
        target.write(part)


def unpacked_bound(packed_bytes: int) -> int:
    """Maximum unpacked size of a file of this size, bytes."""
    return ALWAYS_BYTES + MOST_RATIO * packed_bytes


def read_plain_text(path: Path, most_bytes: int = TEXT_BYTES) -> str:
    """A UTF-8 text, with or without a byte order mark, whatever the locale.

    Raises:
        OSError: as `read_plain`; EFBIG: it takes more in memory.
        UnicodeDecodeError: it is not UTF-8.
    """
    return decoded(read_plain(path, most_bytes).removeprefix(codecs.BOM_UTF8), most_bytes, str(path))


def decoded(content: bytes, most_bytes: int, where: str) -> str:
    """UTF-8 bytes as a text.

    One character that takes two or four bytes in memory makes all others of a text as wide.

    Args:
        content: in UTF-8.
        most_bytes: that the text may take in memory.
        where: the file in the error.

    Raises:
        OSError: EFBIG: it takes more.
        UnicodeDecodeError: it is not UTF-8.
    """
    if 4 * len(content) > most_bytes and not content.isascii():
        width = next((width for width, sign in _WIDTHS if sign.search(content)), 1)
        if width * len(content) > most_bytes:
            raise OSError(errno.EFBIG, f"takes more than {most_bytes} bytes as a text", where)
    return content.decode()


# The first byte, in UTF-8, of a character that takes so many bytes in memory (PEP 393).
_WIDTHS = ((4, re.compile(rb"[\xf0-\xff]")), (2, re.compile(rb"[\xc4-\xff]")))


def below(folder: Path, name: str) -> Path:
    """The path of a file that an untrusted index names.

    Args:
        folder: of the index; names are relative to it.
        name: with "/" between folders.

    Raises:
        ValueError: the name is absolute, leads upwards, is hidden, or is none; the message says which.
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
    """Whether a path, with its links resolved, lies below a folder that is already resolved."""
    try:
        return path.resolve().is_relative_to(root)
    except (OSError, RuntimeError):  # links that lead to each other
        return False


def followed(path: Path) -> Path:
    """A path with its links resolved; a cycle of links is returned as it is, and cannot be opened."""
    try:
        return path.resolve()
    except (OSError, RuntimeError):
        return path.absolute()


def _can_be(way: PurePosixPath) -> bool:
    """Whether a path is valid for a file."""
    try:
        return len(str(way)) <= MOST_NAME and all(len(part.encode()) <= MOST_PART_BYTES for part in way.parts)
    except UnicodeEncodeError:  # half of a pair of surrogates, as JSON may hold
        return False


def quoted(value: object) -> str:
    """A parsed value for messages: its short `repr`."""
    return printable(reprlib.repr(value))


# Control characters except tab and line feed, line separators, and marks of the writing direction.
STEERING = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u200e\u200f\u2028-\u202e\u2066-\u2069]")


def printable(text: str, most: int = QUOTED) -> str:
    """A text from a file for messages: short, without control characters.

    Characters that move the cursor, change the direction of writing or cannot be printed (Unicode's
    categories C and line separators) become `?`; texts longer than `most` characters are cut in the middle.
    """
    half = most // 2
    short = text if len(text) <= most else f"{text[: half - 1]}…{text[-half:]}"
    if short.isprintable():  # which none of them is
        return short
    return "".join("?" if unicodedata.category(c)[0] == "C" or c in "\u2028\u2029" else c for c in short)


def cell(value: _Value) -> _Value | str:
    """A table cell; text that a spreadsheet would take for a formula is quoted.

    Numbers stay as they are, also those in a text. The signs are those of OWASP's "CSV Injection".
    """
    if isinstance(value, str) and value.startswith(("=", "+", "-", "@", "\t", "\r")) and not _NUMBER(value):
        return f"'{value}"
    return value


_NUMBER = re.compile(r"[+-]?[0-9]+(\.[0-9]+)?([eE][+-]?[0-9]+)?").fullmatch


def _refused(path: Path) -> OSError:
    kind = "a folder" if path.is_dir() else "a pipe, a socket or a device"
    return OSError(errno.EINVAL, f"not a plain file but {kind}", str(path))

"""Read an untrusted npy stream: its header is checked before memory is allocated.

Written against NumPy's format page (NEP 1). NumPy's own reader would accept object arrays, structured types
and any shape, allocates what a header claims, and raises half a dozen kinds of error.
"""

import ast
import io
import math
import re
import struct
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import IO, cast

import numpy as np
from numpy.typing import NDArray

MAGIC = b"\x93NUMPY"
# numpy's own bound of a header (np.lib.format); of types only numbers, bools and short texts.
MAX_HEADER_BYTES = 10_000
PLAIN_TYPE = re.compile(r"[<>|=]?(?:[?bBiufcO][0-9]{0,2}|U[1-9][0-9]{0,5})")
CHUNK_BYTES = 1 << 20
# Unicode's last code point, and the first of the 2048 that stand for halves of UTF-16 only.
LAST_CHARACTER, SURROGATES = 0x10FFFF, 0xD800


class NpyError(ValueError):
    """An npy stream is unreadable; the message gives the reason without the file's name."""


@dataclass(frozen=True)
class NpyHeader:
    """The header of an npy file.

    Attributes:
        dtype: a plain dtype without objects or fields; byte order as in the file.
        shape: shape that the file claims.
        fortran_order: whether the first index runs fastest.
        data_offset: number of bytes before the data.
    """

    dtype: np.dtype[np.generic]
    shape: tuple[int, ...]
    fortran_order: bool
    data_offset: int

    @property
    def data_bytes(self) -> int:
        """Number of bytes of data that `shape` and `dtype` claim."""
        return math.prod(self.shape) * self.dtype.itemsize


def read_npy(
    file: IO[bytes], size: int, check: Callable[[NpyHeader], None] | None = None
) -> NDArray[np.generic]:
    """Read an npy stream whose length must match its header.

    Args:
        file: the stream, at its start; a zip's entry, for example.
        size: number of bytes in the stream, header included; the header must claim as many.
        check: checks the header before allocation; its exceptions pass through.

    Returns:
        An array in the shape, byte order and dtype of the header: a new one, or, for an `io.BytesIO`, a
        writable view of its memory.

    Raises:
        NpyError: not an npy stream, pickled objects, cut short, longer than it claims, or texts with
            invalid characters; other ValueErrors: an empty array of more or larger axes than numpy can have.
        OSError, EOFError, zlib.error, zipfile.BadZipFile: from the stream's own reader.
    """
    header = read_npy_header(file)
    if check is not None:
        check(header)
    claimed = header.data_offset + header.data_bytes
    if size != claimed:
        what = "cut short" if size < claimed else "longer than it claims"
        raise NpyError(f"{what}: {size} bytes where its header claims {claimed}")
    data = _in_place(file, header) if isinstance(file, io.BytesIO) else _copied(file, header)
    if file.read(1):  # reaching the end also checks an archive's checksum
        raise NpyError("longer than it claims")
    _check_texts(data)
    return data.reshape(header.shape, order="F" if header.fortran_order else "C")


def _copied(file: IO[bytes], header: NpyHeader) -> NDArray[np.generic]:
    """Copy a stream's data into a new flat array."""
    data = np.empty(math.prod(header.shape), header.dtype)
    if data.nbytes:
        raw, done = data.view(np.uint8).data, 0
        read_into = cast(io.BufferedIOBase, file).readinto  # what is typed IO[bytes] has it
        while done < len(raw):
            count = read_into(raw[done : done + CHUNK_BYTES])
            if not count:
                raise NpyError(f"cut short: {done} bytes of data, {len(raw)} are claimed")
            done += count
    return data


def _in_place(file: io.BytesIO, header: NpyHeader) -> NDArray[np.generic]:
    """Return a flat view of the data, which is in memory already.

    Copying the grids of a pair would take as long as inflating them: 3 ms, most of it for fresh pages.
    """
    view = file.getbuffer()[file.tell() :]
    if len(view) < header.data_bytes:
        raise NpyError(f"cut short: {len(view)} bytes of data, {header.data_bytes} are claimed")
    file.seek(header.data_bytes, io.SEEK_CUR)
    # Unlike np.ndarray's, this holds the buffer: the stream can be neither closed nor made longer meanwhile.
    data: NDArray[np.generic] = np.frombuffer(view, header.dtype, math.prod(header.shape))
    return data if data.flags.aligned else data.copy()


def _check_texts(data: NDArray[np.generic]) -> None:
    """Refuse invalid Unicode code points, which Python's str cannot hold."""
    if data.dtype.kind == "U" and data.size:
        points = data.view(np.dtype(np.uint32).newbyteorder(data.dtype.byteorder))
        if (points > LAST_CHARACTER).any() or (points >> 11 == SURROGATES >> 11).any():
            raise NpyError("a text of what are no characters")


def read_npy_header(file: IO[bytes]) -> NpyHeader:
    """Read a header; the stream is then at the first byte of data.

    Raises:
        NpyError: not an npy stream, cut short, pickled objects, or a malformed header.
    """
    start = file.read(8)
    if not start:
        raise NpyError("the file is empty")
    if start[:6] != MAGIC:
        raise NpyError(
            "it is a pickle, which is never loaded" if start[:1] == b"\x80" else "not an npy array"
        )
    width = {1: "<H", 2: "<I", 3: "<I"}.get(start[6] if len(start) == 8 else 0)
    if width is None:
        raise NpyError("an unknown version of the npy format")
    length_bytes = file.read(struct.calcsize(width))
    if len(length_bytes) < struct.calcsize(width):
        raise NpyError("cut short in its header")
    (length,) = struct.unpack(width, length_bytes)
    if length > MAX_HEADER_BYTES:
        raise NpyError(f"a header of {length} bytes: no plain array needs that")
    text = file.read(length)
    if len(text) < length:
        raise NpyError("cut short in its header")
    return _parse(text, 8 + len(length_bytes) + length)


# Python 3.11 counts the depth of a syntax tree for all threads together: two that parse at once may end in a
# SystemError ("AST constructor recursion depth mismatch"; CPython gh-106905), seen once while training.
_one_at_a_time = threading.Lock()


def _parse(text: bytes, data_offset: int) -> NpyHeader:
    """Parse the header's text, a Python dictionary; `data_offset` is the number of bytes before the data."""
    malformed = NpyError("a malformed npy header")
    try:
        with _one_at_a_time:
            claims = ast.literal_eval(text.decode("latin-1").strip())
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
        raise malformed from None
    if not isinstance(claims, dict) or set(claims) != {"descr", "fortran_order", "shape"}:
        raise malformed
    descr, fortran_order, shape = claims["descr"], claims["fortran_order"], claims["shape"]
    if not isinstance(fortran_order, bool) or not isinstance(shape, tuple):
        raise malformed
    if not all(type(n) is int and n >= 0 for n in shape):
        raise malformed
    return NpyHeader(_dtype(descr), shape, fortran_order, data_offset)


def _dtype(descr: object) -> np.dtype[np.generic]:
    """Return the dtype that the header's `descr` names, such as "<f4"; refuse objects and fields."""
    if not isinstance(descr, str):
        raise NpyError("a structured array, not a plain one")
    if not PLAIN_TYPE.fullmatch(descr):
        raise NpyError(f"dtype {descr[:40]!r} is not accepted")
    try:
        dtype: np.dtype[np.generic] = np.dtype(descr)
    except TypeError:
        raise NpyError(f"dtype {descr!r} is not known") from None
    if dtype.hasobject:
        raise NpyError("pickled Python objects, which are never loaded")
    return dtype

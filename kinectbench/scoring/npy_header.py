"""Read the header of an untrusted npy stream without allocating what it claims.

Written against NumPy's format page (NEP 1). NumPy's own reader would accept object arrays, structured types
and any shape, and raises half a dozen kinds of error.
"""

import ast
import re
import struct
from dataclasses import dataclass
from io import BufferedIOBase

import numpy as np

from kinectbench.core.errors import PredictionError

MAGIC = b"\x93NUMPY"
MAX_HEADER_BYTES = 10_000
PLAIN_TYPE = re.compile(r"[<>|=]?[?bBiufcO][0-9]{0,2}")


@dataclass(frozen=True)
class NpyHeader:
    """What an npy file claims to hold.

    Attributes:
        dtype: a plain dtype without objects or fields; byte order as in the file.
        shape: as claimed.
        fortran_order: the first index runs fastest.
        data_offset: bytes before the data.
    """

    dtype: np.dtype[np.generic]
    shape: tuple[int, ...]
    fortran_order: bool
    data_offset: int


def read_npy_header(file: BufferedIOBase) -> NpyHeader:
    """Read a header and leave the stream at the first byte of data.

    Raises:
        PredictionError: not an npy stream, cut short, pickled objects, or a malformed header; without the
            file's name.
    """
    start = file.read(8)
    if not start:
        raise PredictionError("the file is empty")
    if start[:6] != MAGIC:
        hint = "it is a pickle, which is never loaded" if start[:1] == b"\x80" else "it is not an npy array"
        raise PredictionError(f"{hint}; write it with np.save or np.savez")
    width = {1: "<H", 2: "<I", 3: "<I"}.get(start[6] if len(start) == 8 else 0)
    if width is None:
        raise PredictionError("an unknown version of the npy format; write it with np.save")
    length_bytes = file.read(struct.calcsize(width))
    if len(length_bytes) < struct.calcsize(width):
        raise PredictionError("cut short in its header; write it again")
    (length,) = struct.unpack(width, length_bytes)
    if length > MAX_HEADER_BYTES:
        raise PredictionError(f"a header of {length} bytes: no plain array needs that; write it with np.save")
    text = file.read(length)
    if len(text) < length:
        raise PredictionError("cut short in its header; write it again")
    return _parse(text, 8 + len(length_bytes) + length)


def _parse(text: bytes, data_offset: int) -> NpyHeader:
    """Parse the header's dictionary."""
    malformed = PredictionError("a malformed npy header; write it with np.save")
    try:
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
    """The dtype of a plain type string."""
    if not isinstance(descr, str):
        raise PredictionError("a structured array; save one plain array of numbers")
    if not PLAIN_TYPE.fullmatch(descr):
        raise PredictionError(f"dtype {descr[:40]!r} is not accepted; save float16, float32, bool or uint8")
    try:
        dtype: np.dtype[np.generic] = np.dtype(descr)
    except TypeError:
        raise PredictionError(f"dtype {descr!r} is not known; save float16, float32, bool or uint8") from None
    if dtype.hasobject:
        raise PredictionError("pickled Python objects, which are never loaded; save a plain array of numbers")
    return dtype

"""RVL, the lossless code of compressedDepth (Wilson, "Fast Lossless Depth Image Compression", 2017)."""

import struct

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.stages.ingest.images import DamagedImageError

HEADER = struct.Struct("<II")
# A few bytes can code an image of zeros, so the allocated memory depends on the header alone: it is limited.
MAX_PIXELS = 1 << 24


def decode_rvl(data: bytes, name: str) -> NDArray[np.uint16]:
    """Decode RVL as compressed_depth_image_transport stores it: `uint32 columns, rows`, then nibbles.

    Runs of zeros and of other values alternate. The length of a run, and the difference of each value to the
    previous one (zigzag), are written in nibbles with three bits each, least significant first; the fourth
    bit says that more follow. Nibbles fill little-endian 32-bit words from the top (paper, section 3).

    Returns:
        (rows, columns) uint16.

    Raises:
        DamagedImageError: the header is impossible or the code is cut off.
    """
    if len(data) < HEADER.size:
        raise DamagedImageError(f"{name}: the RVL image is cut off after {len(data)} bytes")
    columns, rows = HEADER.unpack_from(data)
    if not 0 < columns * rows <= MAX_PIXELS:
        raise DamagedImageError(f"{name}: the RVL image says it has {columns}x{rows} pixels")
    code = data[HEADER.size :]
    words = np.frombuffer(code[: len(code) // 4 * 4], "<u4")
    depth = np.zeros(columns * rows, np.uint16)
    if not _decode(words, depth):
        raise DamagedImageError(f"{name}: the RVL image is cut off or damaged")
    return depth.reshape(rows, columns)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _number(words: NDArray[np.uint32], nibble: int) -> tuple[int, int]:
    """Read the number that starts at a nibble; return it (-1: cut off or too long) and the next position."""
    value, shift = 0, 0
    while nibble < 8 * len(words) and shift < 30:
        bits = (int(words[nibble >> 3]) >> (28 - 4 * (nibble & 7))) & 15
        nibble += 1
        value |= (bits & 7) << shift
        shift += 3
        if bits < 8:
            return value, nibble
    return -1, nibble


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _decode(words: NDArray[np.uint32], depth: NDArray[np.uint16]) -> bool:
    position, nibble, previous = 0, 0, 0
    while position < len(depth):
        zeros, nibble = _number(words, nibble)
        values, nibble = _number(words, nibble)
        # The encoder may stop before the last zeros.
        if zeros < 0 or position + zeros > len(depth):
            return False
        position += zeros
        if values < 0 or position + values > len(depth) or zeros + values == 0:
            return bool(position == len(depth))
        for _ in range(values):
            code, nibble = _number(words, nibble)
            if code < 0:
                return False
            previous += (code >> 1) ^ -(code & 1)
            depth[position] = previous & 0xFFFF
            position += 1
    return True

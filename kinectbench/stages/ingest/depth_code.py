"""A lossless code for depth in the sequence folder: smaller than PNG, and several times as fast to read.

A file contains `KBD1`, uint16 width and height, a byte for the layout, and a zstd frame. In layout 1 each
pixel is a 16-bit code: 0 if it has no depth, else 1 + zigzag(difference). The difference is to the last depth
above the pixel in its column (0 at first), modulo 65536. The low bytes of all codes come first, then the high
bytes. Columns are independent, so a whole row is decoded at once. Layout 0 has plain little-endian pixels; it
is used for images with the difference -32768, which layout 1 cannot code.
"""

import struct

import numba
import numpy as np
from numpy.typing import NDArray

MAGIC = b"KBD1"
HEAD = struct.Struct("<4sHHB")
# Layouts: the last byte of the header.
PLAIN, DIFFERENCES = 0, 1
# Higher levels save a tenth and take five times as long.
LEVEL = 3


def encode_depth(depth: NDArray[np.uint16]) -> bytes:
    """Encode depth (height, width) uint16, sides below 65536; equal pixels give equal bytes."""
    import zstandard

    height, width = depth.shape
    planes = np.empty((2, height, width), np.uint8)
    fits = _to_planes(np.ascontiguousarray(depth), planes[0], planes[1])
    data = planes.tobytes() if fits else depth.astype("<u2").tobytes()
    head = HEAD.pack(MAGIC, width, height, DIFFERENCES if fits else PLAIN)
    return head + zstandard.ZstdCompressor(level=LEVEL).compress(data)


def decode_depth(data: bytes) -> NDArray[np.uint16]:
    """Decode the result of `encode_depth`: (height, width) uint16.

    Raises:
        ValueError: the data is damaged or truncated.
    """
    import zstandard

    if len(data) < HEAD.size:
        raise ValueError("is cut off")
    magic, width, height, layout = HEAD.unpack_from(data)
    if magic != MAGIC or layout not in (PLAIN, DIFFERENCES):
        raise ValueError("is no depth image of this format")
    size = 2 * width * height
    try:
        if zstandard.frame_content_size(data[HEAD.size :]) != size:
            raise ValueError("is damaged")
        unpacked = zstandard.ZstdDecompressor().decompress(data[HEAD.size :], max_output_size=size)
    except zstandard.ZstdError as error:
        raise ValueError(f"is damaged ({error})") from error
    if layout == PLAIN:
        return np.frombuffer(unpacked, "<u2").reshape(height, width).astype(np.uint16)
    planes = np.frombuffer(unpacked, np.uint8).reshape(2, height, width)
    depth = np.empty((height, width), np.uint16)
    _from_planes(planes[0], planes[1], depth)
    return depth


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _to_planes(depth: NDArray[np.uint16], low: NDArray[np.uint8], high: NDArray[np.uint8]) -> bool:
    """Fill the low and high bytes of layout 1's codes; return False if a difference has no code."""
    height, width = depth.shape
    last = np.zeros(width, np.int64)
    for row in range(height):
        for column in range(width):
            value = int(depth[row, column])
            code = 0
            if value:
                difference = ((value - last[column] + 32768) & 0xFFFF) - 32768
                if difference == -32768:
                    return False
                code = 1 + ((difference << 1) ^ (difference >> 63))
                last[column] = value
            low[row, column] = code & 0xFF
            high[row, column] = code >> 8
    return True


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _from_planes(low: NDArray[np.uint8], high: NDArray[np.uint8], depth: NDArray[np.uint16]) -> None:
    last = np.zeros(depth.shape[1], np.uint16)
    for row in range(depth.shape[0]):
        _next_row(low[row], high[row], last, depth[row])


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _next_row(
    low: NDArray[np.uint8], high: NDArray[np.uint8], last: NDArray[np.uint16], depth: NDArray[np.uint16]
) -> None:
    for column in range(len(depth)):
        code = np.uint16(np.uint16(low[column]) | np.uint16(np.uint16(high[column]) << np.uint16(8)))
        known = np.uint16(code != 0)
        zigzag = np.uint16(code - known)
        step = np.uint16(np.uint16(zigzag >> np.uint16(1)) ^ np.uint16(-np.uint16(zigzag & np.uint16(1))))
        last[column] = np.uint16(last[column] + step)
        depth[column] = np.uint16(last[column] * known)

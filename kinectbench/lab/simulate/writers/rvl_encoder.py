"""Encode RVL, the lossless code of compressedDepth, as `decode_rvl` reads it."""

import struct

import numba
import numpy as np
from numpy.typing import NDArray


def encode_rvl(depth: NDArray[np.uint16]) -> bytes:
    """Encode depth (rows, columns) uint16 as RVL with its header."""
    flat = np.ascontiguousarray(depth).reshape(-1)
    nibbles = np.empty(8 * flat.size + 64, np.uint8)
    count = _encode(flat, nibbles)
    nibbles[count:] = 0
    packed = nibbles[: -(-count // 8) * 8].reshape(-1, 8).astype(np.uint32)
    words = np.zeros(len(packed), np.uint32)
    for place in range(8):
        np.bitwise_or(words, packed[:, place] << np.uint32(28 - 4 * place), out=words)
    return struct.pack("<II", depth.shape[1], depth.shape[0]) + words.astype("<u4").tobytes()


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _put(nibbles: NDArray[np.uint8], count: int, value: int) -> int:
    while True:
        bits = value & 7
        value >>= 3
        nibbles[count] = bits | 8 if value else bits
        count += 1
        if not value:
            return count


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _encode(depth: NDArray[np.uint16], nibbles: NDArray[np.uint8]) -> int:
    position, count, previous = 0, 0, 0
    while position < len(depth):
        start = position
        while position < len(depth) and depth[position] == 0:
            position += 1
        count = _put(nibbles, count, position - start)
        end = position
        while end < len(depth) and depth[end] != 0:
            end += 1
        count = _put(nibbles, count, end - position)
        for index in range(position, end):
            difference = int(depth[index]) - previous
            count = _put(nibbles, count, (difference << 1) ^ (difference >> 63))
            previous = int(depth[index])
        position = end
    return count

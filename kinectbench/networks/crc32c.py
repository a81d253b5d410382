"""Compute CRC-32C as in TensorFlow's checkpoints. Import late: numba is slow to load."""

from functools import cache

import numpy as np
from numba import njit
from numpy.typing import NDArray

# Castagnoli's polynomial with its bits reversed (RFC 3720, appendix B.4); and the constant that TensorFlow
# adds to a rotated checksum (tensorflow/core/lib/hash/crc32c.h).
POLYNOMIAL = 0x82F63B78
MASK = 0xA282EAD8


@cache
def _table() -> NDArray[np.uint32]:
    """Return the CRC remainder of each byte value: (256,)."""
    values = np.arange(256, dtype=np.uint32)
    for _ in range(8):
        values = np.where(values & 1, (values >> 1) ^ np.uint32(POLYNOMIAL), values >> 1).astype(np.uint32)
    return values


@njit(cache=True, nogil=True)
def _remainder(data: NDArray[np.uint8], table: NDArray[np.uint32]) -> np.uint32:
    """Return the plain CRC of some bytes (n,)."""
    crc = np.uint32(0xFFFFFFFF)
    for byte in data:
        crc = table[(crc ^ byte) & np.uint32(0xFF)] ^ (crc >> np.uint32(8))
    return crc ^ np.uint32(0xFFFFFFFF)


def masked_crc32c(data: bytes | NDArray[np.uint8]) -> int:
    """Return the CRC-32C as TensorFlow stores it: rotated by 15 bits, plus a constant.

    Source: TensorFlow's lib/hash/crc32c.h.
    """
    values = np.frombuffer(data, np.uint8)
    crc = int(_remainder(values, _table()))
    return (((crc >> 15) | (crc << 17)) + MASK) & 0xFFFFFFFF

"""Numba kernels that count a prediction against the truth in one pass. Import late: numba is slow to load.

Every voxel has a code 0 to 7: 1 if it is occupied in the truth, + 2 if the truth is known there, + 4 if the
input view saw it. Voxels are counted separately by code, so that one pass serves every protocol.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinectbench.core.types import Float64, Int64

Packed = NDArray[np.uint8]
Words = NDArray[np.uint64]

CODES = 8
HALF_PATTERNS = 0x3C01  # bit patterns of the float16 values 0 to 1

_BITS = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1)
# Spreads bit i of a byte to byte i of a word, so that two shifts and two ors make eight codes.
_SPREAD = (_BITS.astype(np.uint64) << (np.arange(8, dtype=np.uint64) * np.uint64(8))).sum(
    axis=1, dtype=np.uint64
)
_FLUSH = 1e-200
_ROW = 1024
_CELLS = np.uint32(21 * CODES)


@njit(cache=True, error_model="numpy", nogil=True)
def count_halves(bits: NDArray[np.uint16], full: Packed, known: Packed, seen: Packed) -> Int64:
    """Count the voxels of a float16 prediction by predicted value and code (0 to 7).

    Args:
        bits: (v,) bit patterns of values in [0, 1]; -0 is allowed.
        full: (v / 8,) packed truth.
        known: (v / 8,) packed: where the truth is known.
        seen: (v / 8,) packed: where the input view saw the voxel.

    Returns:
        (0x3C01, 8), the number of voxels with each bit pattern and code (1 occupied + 2 known + 4 seen).
    """
    # Use two tables in turn, because successive increments of the same cell would wait for each other.
    even = np.zeros(HALF_PATTERNS * CODES, np.uint32)
    odd = np.zeros(HALF_PATTERNS * CODES, np.uint32)
    for byte in range(len(full)):
        codes = (
            _SPREAD[full[byte]] | _SPREAD[known[byte]] << np.uint64(1) | _SPREAD[seen[byte]] << np.uint64(2)
        )
        for i in range(0, 8, 2):
            first = np.uint64(bits[8 * byte + i] & 0x7FFF) << np.uint64(3)
            even[first | (codes >> np.uint64(8 * i)) & np.uint64(7)] += np.uint32(1)
            second = np.uint64(bits[8 * byte + i + 1] & 0x7FFF) << np.uint64(3)
            odd[second | (codes >> np.uint64(8 * i + 8)) & np.uint64(7)] += np.uint32(1)
    counts = even.astype(np.int64) + odd
    return counts.reshape(HALF_PATTERNS, CODES)


@njit(cache=True, error_model="numpy", nogil=True)
def _ones(word: np.uint64) -> np.uint64:
    """Return the number of set bits, by sideways addition, which LLVM vectorises."""
    word -= (word >> np.uint64(1)) & np.uint64(0x5555555555555555)
    word = (word & np.uint64(0x3333333333333333)) + ((word >> np.uint64(2)) & np.uint64(0x3333333333333333))
    word = (word + (word >> np.uint64(4))) & np.uint64(0x0F0F0F0F0F0F0F0F)
    return (word * np.uint64(0x0101010101010101)) >> np.uint64(56)


@njit(cache=True, error_model="numpy", nogil=True)
def count_bits(occupied: Words, full: Words, known: Words, seen: Words) -> Int64:
    """Count the voxels of a packed boolean prediction by predicted value (0, 1) and code (0 to 7): (2, 8).

    A code is 1 if the truth is occupied, + 2 if the truth is known, + 4 if the input view saw the voxel.

    Args:
        occupied: (v / 64,) uint64, packed prediction.
        full: (v / 64,) uint64, packed truth.
        known: (v / 64,) uint64, packed.
        seen: (v / 64,) uint64, packed.
    """
    counts = np.zeros((2, CODES), np.int64)
    for code in range(CODES):
        flip_full = np.uint64(0) if code & 1 else ~np.uint64(0)
        flip_known = np.uint64(0) if code & 2 else ~np.uint64(0)
        flip_seen = np.uint64(0) if code & 4 else ~np.uint64(0)
        voxels = above = np.uint64(0)
        for word in range(len(full)):
            bits = (full[word] ^ flip_full) & (known[word] ^ flip_known) & (seen[word] ^ flip_seen)
            voxels += _ones(bits)
            above += _ones(bits & occupied[word])
        counts[0, code], counts[1, code] = voxels - above, above
    return counts


@njit(cache=True, error_model="numpy", nogil=True)
def count_reals(
    values: NDArray[np.floating],
    full: Packed,
    known: Packed,
    seen: Packed,
    steps: int,
    clip: float,
    bins: Int64,
    ce_sum: Float64,
) -> None:
    """Count a float32 or float64 prediction, or a part of one; the counts are added to `bins` and `ce_sum`.

    Args:
        values: (v,) in [0, 1], v a multiple of 8; each value is converted to float64.
        full: (v / 8,) packed truth.
        known: (v / 8,) packed: where the truth is known.
        seen: (v / 8,) packed: where the input view saw the voxel.
        steps: 20; thresholds are k / steps.
        clip: cross-entropy clips values to [clip, 1 - clip].
        bins: (21, 8) int64; row k counts values above k / 20 and up to (k + 1) / 20; row 0 also counts the
            value 0. A column is a code: 1 occupied + 2 known + 4 seen.
        ce_sum: (8,) for each code, the sum of -log(y), if it is occupied, or else of -log(1 - y), over its
            values y.
    """
    # A sum of logarithms is the logarithm of a product: one logarithm suffices for some thirty voxels. Eight
    # tables are used in turn, as above. Unsigned indices need no test for negative values.
    tables, product = np.zeros(8 * _CELLS, np.int64), np.ones(CODES)
    rows, factors = np.zeros(_ROW, np.uint8), np.empty(8)
    for start in range(0, len(values), _ROW):
        part = values[start : start + _ROW]
        _bins_of(part, steps, rows)
        for byte in range(len(part) // 8):
            at, voxel = np.uint64(start // 8 + byte), np.uint32(8 * byte)
            f, k, s = full[at], known[at], seen[at]
            if (f == 0 or f == 255) and (k == 0 or k == 255) and (s == 0 or s == 255):
                # Most bytes hold eight voxels of one code.
                code = np.uint32(f & 1 | k & 2 | s & 4)
                for j in range(8):
                    tables[_CELLS * np.uint32(j) + np.uint32(rows[voxel + np.uint32(j)]) + code] += 1
                for j in range(8):
                    factors[j] = min(max(np.float64(part[voxel + np.uint32(j)]), clip), 1.0 - clip)
                if code & 1 == 0:
                    for j in range(8):
                        factors[j] = 1.0 - factors[j]
                left = (factors[0] * factors[4]) * (factors[1] * factors[5])
                grown = product[code] * (left * ((factors[2] * factors[6]) * (factors[3] * factors[7])))
                if grown < _FLUSH:
                    ce_sum[code] -= np.log(grown)
                    grown = 1.0
                product[code] = grown
                continue
            codes = _SPREAD[f] | _SPREAD[k] << np.uint64(1) | _SPREAD[s] << np.uint64(2)
            for j in range(8):
                code = np.uint32(codes >> np.uint64(8 * j)) & np.uint32(7)
                tables[_CELLS * np.uint32(j) + np.uint32(rows[voxel + np.uint32(j)]) + code] += 1
                y = min(max(np.float64(part[voxel + np.uint32(j)]), clip), 1.0 - clip)
                grown = product[code] * (y if code & np.uint32(1) else 1.0 - y)
                if grown < _FLUSH:
                    ce_sum[code] -= np.log(grown)
                    grown = 1.0
                product[code] = grown
    for j in range(8):
        bins += tables[j * _CELLS : (j + 1) * _CELLS].reshape(len(bins), CODES)
    ce_sum -= np.log(product)


@njit(cache=True, error_model="numpy", nogil=True)
def _bins_of(values: NDArray[np.floating], steps: int, rows: NDArray[np.uint8]) -> None:
    """Write 8 times the index of each value's row in `bins` (see `count_reals`) into `rows` (v,)."""
    for i in range(len(values)):
        y = np.float64(values[i])
        k = np.int32(np.ceil(y * steps)) - np.int32(
            1
        )  # exact if y was a float32, whose product needs 29 bits
        if values.itemsize > 4:
            k += np.int32(y > np.float64(k + 1) / steps) - np.int32(y <= np.float64(k) / steps)
        rows[i] = np.uint8(max(k, np.int32(0)) << 3)

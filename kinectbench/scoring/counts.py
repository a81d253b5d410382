"""What one pass over a prediction and its truth counts: enough for every metric, threshold and protocol."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.scoring.truth import Truth
from kinectbench.voxels.pair_file import FULL_CELLS, Packed
from kinectbench.voxels.resample import HALF_PIXEL, upsampled_planes

Int64 = NDArray[np.int64]
Float64 = NDArray[np.float64]
Prediction = NDArray[np.bool_] | NDArray[np.float16] | NDArray[np.float32]

STEPS = 20
THRESHOLD_STEPS = tuple(range(2, 19))
THRESHOLDS = tuple(k / STEPS for k in THRESHOLD_STEPS)
CE_CLIP = 1e-7

# The codes (see kernels.py) that a protocol counts.
PROTOCOLS = {
    "paper": tuple(range(8)),
    "known": tuple(code for code in range(8) if code & 2),
    "occluded": tuple(code for code in range(8) if code & 2 and not code & 4),
}
PRIMARY = "known"


@dataclass(frozen=True)
class Tally:
    """Voxels of one pair by code: 1 if occupied, + 2 if known, + 4 if seen by the input view.

    Attributes:
        voxels: (8,) int64, how many there are.
        above: (17, 8) int64, how many are predicted above each threshold k / 20, k = 2 to 18.
        ce_sum: (8,) float64, sum of the cross-entropy in nats.
    """

    voxels: Int64
    above: Int64
    ce_sum: Float64


@dataclass(frozen=True)
class ProtocolCounts:
    """The counts of one pair under one protocol.

    Attributes:
        voxels: number of voxels counted.
        occupied: number of them that are occupied in the truth.
        predicted: (17,) int64, number predicted occupied at each threshold.
        hit: (17,) int64, number of those that are occupied.
        ce_sum: sum of the cross-entropy in nats.
    """

    voxels: int
    occupied: int
    predicted: Int64
    hit: Int64
    ce_sum: float


def tally(prediction: Prediction, truth: Truth, upsampling: str = HALF_PIXEL) -> Tally:
    """Count a prediction against the truth in one pass.

    Args:
        prediction: (n, n, n), C order, values in [0, 1]; a cube that is not 256 a side is upsampled.
        truth: the packed grids.
        upsampling: see `upsampled_planes`.
    """
    if len(prediction) != FULL_CELLS:
        planes = upsampled_planes(prediction, convention=upsampling)
        return _tally_parts(planes, (truth.full, truth.known, truth.seen))  # memory stays at one plane
    from kinectbench.scoring.kernels import count_bits, count_halves

    grids = truth.flat()
    if prediction.dtype == np.bool_:
        words = [grid.view(np.uint64) for grid in (np.packbits(prediction.view(np.bool_)), *grids)]
        return _from_histogram(np.array([0.0, 1.0]), count_bits(*words))
    if prediction.dtype == np.float16:
        counts = count_halves(prediction.view(np.uint16).ravel(), *grids)
        values = np.arange(len(counts), dtype=np.uint16).view(np.float16).astype(np.float64)
        return _from_histogram(values, counts)
    return _tally_parts([prediction.view(np.float32)], ([grid] for grid in grids))


def _from_histogram(values: Float64, counts: Int64) -> Tally:
    """Tally of a histogram: `values` (m,) ascending, `counts` (m, 8)."""
    not_above = np.searchsorted(values, THRESHOLDS, side="right")
    tail = np.vstack([counts[::-1].cumsum(axis=0)[::-1], np.zeros((1, 8), np.int64)])
    clipped = np.clip(values, CE_CLIP, 1 - CE_CLIP)
    loss = np.where(np.arange(8) & 1, -np.log(clipped)[:, None], -np.log(1 - clipped)[:, None])
    return Tally(counts.sum(axis=0), tail[not_above], (counts * loss).sum(axis=0))


def _tally_parts(parts: Iterable[NDArray[np.floating]], grids: Iterable[Iterable[Packed]]) -> Tally:
    """Tally voxel by voxel in float64, part by part; `grids` are full, known and seen in the same parts."""
    from kinectbench.scoring.kernels import count_reals

    bins, ce_sum = np.zeros((STEPS + 1, 8), np.int64), np.zeros(8)
    for part, full, known, seen in zip(parts, *grids, strict=True):
        flat = (part.ravel(), full.ravel(), known.ravel(), seen.ravel())
        count_reals(*flat, STEPS, CE_CLIP, bins, ce_sum)
    above = bins[::-1].cumsum(axis=0)[::-1]
    return Tally(above[0], above[list(THRESHOLD_STEPS)], ce_sum)


def protocol_counts(tally: Tally, protocol: str) -> ProtocolCounts:
    """Sum a tally over the voxels that a protocol counts."""
    codes = list(PROTOCOLS[protocol])
    occupied = [code for code in codes if code & 1]
    return ProtocolCounts(
        voxels=int(tally.voxels[codes].sum()),
        occupied=int(tally.voxels[occupied].sum()),
        predicted=tally.above[:, codes].sum(axis=1),
        hit=tally.above[:, occupied].sum(axis=1),
        ce_sum=float(tally.ce_sum[codes].sum()),
    )

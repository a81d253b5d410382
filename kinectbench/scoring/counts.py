"""Count a prediction against its truth in one pass, for all metrics, thresholds and protocols.

Also binarise predictions, reduce the truth to a coarser grid, and compute the paper's metrics. Ratios have no
unit; cross-entropy is in nats per voxel. The paper does not define its metrics if a prediction or a truth is
empty; each function states its value for these cases.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.counted import Tally
from kinectbench.core.artefacts.provenance import STEPS, THRESHOLD_STEPS
from kinectbench.core.artefacts.score_figures import VoxelMetrics
from kinectbench.core.types import Float32, Float64, Int64
from kinectbench.core.voxels.pair_file import FULL_CELLS, Packed, unpack
from kinectbench.core.voxels.resample import HALF_PIXEL, upsampled_planes
from kinectbench.scoring.protocols import PROTOCOLS, SOLID
from kinectbench.scoring.truth import PackedTruth

Prediction = NDArray[np.bool_] | NDArray[np.float16] | NDArray[np.float32]

THRESHOLDS = tuple(k / STEPS for k in THRESHOLD_STEPS)
CE_CLIP = 1e-7


@dataclass(frozen=True)
class ProtocolCounts:
    """The counts of one pair under one protocol.

    Attributes:
        voxels: number of counted voxels.
        occupied: number of counted voxels that are occupied in the truth.
        predicted: (17,) int64, number of counted voxels that are predicted occupied at thresholds k / 20, k =
            2 to 18.
        hit: (17,) int64, number of those that are also occupied in the truth.
        ce_sum: sum of the cross-entropy over the counted voxels, in nats.
    """

    voxels: int
    occupied: int
    predicted: Int64
    hit: Int64
    ce_sum: float


def tally(prediction: Prediction, truth: PackedTruth, upsampling: str = HALF_PIXEL) -> Tally:
    """Count the voxels of a prediction by predicted value and by state of the truth, in one pass.

    Args:
        prediction: (n, n, n), C order, values in [0, 1]; it is upsampled if n is not 256.
        truth: the packed grids of the truth.
        upsampling: "half-pixel" or "corner-aligned" (see `upsampled_planes`).
    """
    if len(prediction) != FULL_CELLS:
        planes = upsampled_planes(prediction, convention=upsampling)
        return _tally_parts(planes, (truth.full, truth.known, truth.seen))  # one plane is in memory at a time
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


def tallies(
    prediction: Prediction, truth: PackedTruth, protocols: Sequence[str], upsampling: str = HALF_PIXEL
) -> tuple[Tally, dict[str, Tally]]:
    """Return a prediction's tally, and {protocol: tally} for the protocols whose truth is another grid."""
    truths = {name: truth.under(PROTOCOLS[name]) for name in protocols}
    others = {name: tally(prediction, of, upsampling) for name, of in truths.items() if of is not truth}
    return tally(prediction, truth, upsampling), others


def _from_histogram(values: Float64, counts: Int64) -> Tally:
    """Return the tally of a histogram: `counts` (m, 8) are voxels by value (`values`, ascending) and code."""
    not_above = np.searchsorted(values, THRESHOLDS, side="right")
    tail = np.vstack([counts[::-1].cumsum(axis=0)[::-1], np.zeros((1, 8), np.int64)])
    clipped = np.clip(values, CE_CLIP, 1 - CE_CLIP)
    loss = np.where(np.arange(8) & 1, -np.log(clipped)[:, None], -np.log(1 - clipped)[:, None])
    return Tally(counts.sum(axis=0), tail[not_above], (counts * loss).sum(axis=0))


def _tally_parts(parts: Iterable[NDArray[np.floating]], grids: Iterable[Iterable[Packed]]) -> Tally:
    """Tally a prediction in float64, part by part; `grids`: full, known, seen, cut into the same parts."""
    from kinectbench.scoring.kernels import count_reals

    bins, ce_sum = np.zeros((STEPS + 1, 8), np.int64), np.zeros(8)
    for part, full, known, seen in zip(parts, *grids, strict=True):
        flat = (part.ravel(), full.ravel(), known.ravel(), seen.ravel())
        count_reals(*flat, STEPS, CE_CLIP, bins, ce_sum)
    above = bins[::-1].cumsum(axis=0)[::-1]
    return Tally(above[0], above[list(THRESHOLD_STEPS)], ce_sum)


def protocol_counts(tally: Tally, protocol: str) -> ProtocolCounts:
    """Return the counts over the voxels of one protocol, from the tally of all voxels."""
    codes = list(PROTOCOLS[protocol].codes)
    occupied = [code for code in codes if code & 1]
    return ProtocolCounts(
        voxels=int(tally.voxels[codes].sum()),
        occupied=int(tally.voxels[occupied].sum()),
        predicted=tally.above[:, codes].sum(axis=1),
        hit=tally.above[:, occupied].sum(axis=1),
        ce_sum=float(tally.ce_sum[codes].sum()),
    )


def tally_unknown_share(tally: Tally) -> float:
    """Return the share of the truth's occupied voxels outside the `known` mask; 0 if none is occupied."""
    shape = int(tally.voxels[1::2].sum())
    return int(tally.voxels[1::2][[0, 2]].sum()) / shape if shape else 0.0


def is_all_unknown(tally: Tally, protocol: str) -> bool:
    """Return whether a pair's truth is too unknown to judge predictions under a protocol; means omit it.

    There are two cases. If the protocol counts no voxel, every prediction has an IoU of 1. If the part of the
    shape in the protocol's region is all unknown, the IoU is 1 for a prediction that is empty in the known
    voxels, and 0 for others. Neither case occurs under `paper`, which counts every voxel.
    """
    voxels: list[int] = tally.voxels.tolist()
    of = PROTOCOLS[protocol]
    shape, known_shape = (sum(voxels[c] for c in codes if c & 1) for codes in (of.looked_at, of.codes))
    return not any(voxels[code] for code in of.codes) or (shape > 0 and known_shape == 0)


def occupied(prediction: Prediction, threshold: float, upsampling: str = HALF_PIXEL) -> Packed:
    """Return the cells with a value > threshold, packed: (256, 256, 32) uint8, most significant bit first.

    Args:
        prediction: (n, n, n), C order, values in [0, 1]; it is upsampled if n is not 256.
        threshold: in [0, 1).
        upsampling: see `upsampled_planes`.
    """
    if len(prediction) != FULL_CELLS:
        planes = upsampled_planes(prediction, convention=upsampling)
        return np.stack([np.packbits(plane > threshold, axis=-1) for plane in planes])
    if prediction.dtype == np.bool_:
        return np.packbits(prediction.view(np.bool_), axis=-1)
    # The largest value of the prediction's dtype that is not above the threshold. Comparing with it gives the
    # same result as a comparison in float64, without conversion.
    cut = prediction.dtype.type(threshold)
    if float(cut) > threshold:
        cut = np.nextafter(cut, prediction.dtype.type(0))
    if prediction.dtype == np.float16:  # bit patterns of numbers in [0, 1] have the same order
        return np.packbits(prediction.view(np.int16) > cut.view(np.int16), axis=-1)
    return np.packbits(prediction > cut, axis=-1)


def ceiling_tallies(
    truth: PackedTruth, side: int, protocols: Sequence[str], upsampling: str
) -> tuple[Tally, Mapping[str, Tally]]:
    """Return the tallies of the truth itself, reduced to `side`^3 cells and taken as a prediction.

    The value of a cell is its occupied share. The best IoU of these tallies is about the highest that a
    method of this resolution can reach; values optimised for the upsampling may reach a little more. The side
    is below 256.

    Returns:
        The tally against the solid truth, and {protocol: tally} for the protocols that compare with another
        truth.
    """
    others = {}
    for name in protocols:
        if PROTOCOLS[name].truth != SOLID:
            of = truth.under(PROTOCOLS[name])
            others[name] = tally(reduced(unpack(of.full), side), of, upsampling)
    solid = [name for name in protocols if name not in others]
    best, less = tallies(reduced(unpack(truth.full), side), truth, solid, upsampling)
    return best, {**less, **others}


def reduced(full: NDArray[np.bool_], side: int) -> Float32:
    """Return the occupied share of each cell of a coarser grid, same box: (side, side, side) float32."""
    if len(full) % side == 0:
        return _block_shares(full, side)
    weights = _overlaps(len(full), side)
    shares = np.tensordot(weights, full.astype(np.float32), axes=(1, 0))
    shares = np.einsum("ab,xbz->xaz", weights, shares, optimize=True)
    shares = np.einsum("ab,xyb->xya", weights, shares, optimize=True)
    return np.ascontiguousarray(np.clip(shares, 0, 1), dtype=np.float32)


def _block_shares(full: NDArray[np.bool_], side: int) -> Float32:
    """Do the same as `reduced`, but faster; each coarse cell must consist of whole fine cells."""
    step = len(full) // side
    counts: NDArray[np.generic] = np.ascontiguousarray(full).view(np.uint8)
    for axes_done, axis in enumerate((2, 1, 0), start=1):
        counts = counts.astype(np.min_scalar_type(step**axes_done), copy=False)
        blocks = counts.reshape(*counts.shape[:axis], side, step, *counts.shape[axis + 1 :])
        counts = reduce(np.add, np.moveaxis(blocks, axis + 1, 0))
    return counts.astype(np.float32) / np.float32(step**3)


def _overlaps(cells: int, side: int) -> Float32:
    """Return which fraction of each coarse cell each fine cell covers, along one axis: (side, cells)."""
    fine, coarse = np.arange(cells), np.arange(side)[:, None] * (cells / side)
    covered = np.minimum(fine + 1, coarse + cells / side) - np.maximum(fine, coarse)
    return np.asarray(np.clip(covered, 0, None) * (side / cells), dtype=np.float32)


def metrics(counts: ProtocolCounts, step: int) -> VoxelMetrics:
    """Return all metrics at the threshold (step + 2) / 20; `step` is 0 to 16."""
    predicted, hit = int(counts.predicted[step]), int(counts.hit[step])
    return VoxelMetrics(
        iou=iou(predicted, counts.occupied, hit),
        ce=cross_entropy(counts),
        precision=_share(hit, predicted, other=counts.occupied),
        recall=_share(hit, counts.occupied, other=predicted),
        f1=f1(predicted, counts.occupied, hit),
    )


def iou(predicted: int, occupied: int, hit: int) -> float:
    """Return intersection over union: `hit / (predicted + occupied - hit)`; 1 if the union is empty."""
    union = predicted + occupied - hit
    return hit / union if union else 1.0


def ious(counts: ProtocolCounts) -> Float64:
    """Return the IoU at each threshold k / 20, k = 2 to 18: (17,) float64."""
    return np.array(
        [iou(int(p), counts.occupied, int(h)) for p, h in zip(counts.predicted, counts.hit, strict=True)]
    )


def f1(predicted: int, occupied: int, hit: int) -> float:
    """Return F1 of precision and recall, `2 hit / (predicted + occupied)`; 1 if both counts are 0."""
    return 2 * hit / (predicted + occupied) if predicted + occupied else 1.0


def cross_entropy(counts: ProtocolCounts) -> float:
    """Return the mean binary cross-entropy of the clipped prediction, nats per voxel; 0 without voxels."""
    return counts.ce_sum / counts.voxels if counts.voxels else 0.0


def constant_cross_entropy(occupied: int, voxels: int, constant: float) -> float:
    """Return the mean cross-entropy of predicting `constant` everywhere, nats per voxel; 0 without voxels.

    Args:
        occupied: number of counted voxels that are occupied in the truth.
        voxels: number of counted voxels.
        constant: in [0, 1]; clipped as a prediction is.
    """
    y = min(max(constant, CE_CLIP), 1 - CE_CLIP)
    loss = -occupied * np.log(y) - (voxels - occupied) * np.log(1 - y)
    return float(loss) / voxels if voxels else 0.0


def _share(hit: int, total: int, *, other: int) -> float:
    """Return `hit / total`; if `total` is 0, return 1 if `other` is 0 too, else 0."""
    if total:
        return hit / total
    return 0.0 if other else 1.0

"""The IoU that a resolution can reach: the truth itself, reduced to it and brought back to 256."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.scoring.counts import Tally, tally
from kinectbench.scoring.truth import Truth
from kinectbench.voxels.pair_file import unpack

Float32 = NDArray[np.float32]


def ceiling(truth: Truth, side: int, upsampling: str) -> Tally:
    """Count the truth, each cell of `side`^3 the occupied share of its volume, as if it were a prediction.

    The best IoU among the thresholds is what a method of that resolution reaches that knows the truth and
    reduces it as usual. One that chooses its values with the upsampling in mind may reach a little more.

    Args:
        truth: the packed truth.
        side: below 256.
        upsampling: see `upsampled_planes`.
    """
    return tally(reduced(unpack(truth.full), side), truth, upsampling)


def reduced(full: NDArray[np.bool_], side: int) -> Float32:
    """The occupied share of each cell of a coarser grid over the same box: (side, side, side) float32."""
    weights = _overlaps(len(full), side)
    shares = np.tensordot(weights, full.astype(np.float32), axes=(1, 0))
    shares = np.einsum("ab,xbz->xaz", weights, shares, optimize=True)
    shares = np.einsum("ab,xyb->xya", weights, shares, optimize=True)
    return np.ascontiguousarray(np.clip(shares, 0, 1), dtype=np.float32)


def _overlaps(cells: int, side: int) -> Float32:
    """(side, cells): which share of each coarse cell each fine cell covers along one axis."""
    fine, coarse = np.arange(cells), np.arange(side)[:, None] * (cells / side)
    covered = np.minimum(fine + 1, coarse + cells / side) - np.maximum(fine, coarse)
    return np.asarray(np.clip(covered, 0, None) * (side / cells), dtype=np.float32)

"""The paper's metrics, as pure functions of counts. Ratios have no unit; cross-entropy is in nats a voxel.

Source: the paper's definitions. The paper leaves empty predictions and empty truths open; each function here
says what it returns for them.
"""

import numpy as np

from kinectbench.core.artefacts.score_figures import VoxelMetrics
from kinectbench.core.types import Float64
from kinectbench.scoring.counts import CE_CLIP, ProtocolCounts


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
    """Return intersection over union, `hit / (predicted + occupied - hit)`; 1 if the union is empty."""
    union = predicted + occupied - hit
    return hit / union if union else 1.0


def ious(counts: ProtocolCounts) -> Float64:
    """Return the IoU at each threshold k / 20, k = 2 to 18: (17,) float64."""
    return np.array(
        [iou(int(p), counts.occupied, int(h)) for p, h in zip(counts.predicted, counts.hit, strict=True)]
    )


def f1(predicted: int, occupied: int, hit: int) -> float:
    """Return the harmonic mean of precision and recall, `2 hit / (predicted + occupied)`; 1 if both are 0."""
    return 2 * hit / (predicted + occupied) if predicted + occupied else 1.0


def cross_entropy(counts: ProtocolCounts) -> float:
    """Return the mean binary cross-entropy of the clipped prediction, nats a voxel; 0 without voxels."""
    return counts.ce_sum / counts.voxels if counts.voxels else 0.0


def constant_cross_entropy(occupied: int, voxels: int, constant: float) -> float:
    """Return the mean cross-entropy, nats a voxel, of predicting `constant` everywhere; 0 without voxels.

    Args:
        occupied: number of voxels occupied in the truth.
        voxels: number of counted voxels.
        constant: in [0, 1]; clipped as a prediction is.
    """
    y = min(max(constant, CE_CLIP), 1 - CE_CLIP)
    loss = -occupied * np.log(y) - (voxels - occupied) * np.log(1 - y)
    return float(loss) / voxels if voxels else 0.0


def _share(hit: int, total: int, *, other: int) -> float:
    """Return `hit / total`; for an empty total, 1 if the other set is empty too, else 0."""
    if total:
        return hit / total
    return 0.0 if other else 1.0

"""IoU against the threshold: how much a method's score hangs on the threshold that was chosen."""

from collections.abc import Mapping, Sequence

import numpy as np

from kinectbench.release.release import Target
from kinectbench.scoring.counts import THRESHOLDS, protocol_counts
from kinectbench.scoring.metrics import ious
from kinectbench.scoring.pair_result import PairResult


def iou_by_threshold(
    results: Mapping[Target, PairResult], protocols: Sequence[str]
) -> dict[str, dict[str, list[float]]]:
    """{protocol: {category: mean IoU at each of the thresholds k / 20, k = 2 to 18}} of the test pairs.

    Averaged as the scores are (see `averages.py`): pair, object, category; `paper` weighs every pair alike.

    Args:
        results: of every pair that was counted; those of other splits are left out.
        protocols: some of "paper", "known", "occluded".
    """
    test = sorted(target for target in results if target.split == "test")
    return {
        protocol: {
            category: _mean_curve([t for t in test if t.category == category], results, protocol)
            for category in sorted({target.category for target in test})
        }
        for protocol in protocols
    }


def _mean_curve(
    targets: Sequence[Target], results: Mapping[Target, PairResult], protocol: str
) -> list[float]:
    """The mean of one category."""
    by_object: dict[str, list[Target]] = {}
    for target in targets:
        by_object.setdefault("" if protocol == "paper" else target.object, []).append(target)
    objects = [
        np.mean([ious(protocol_counts(results[t].tally, protocol)) for t in group], axis=0)
        for group in by_object.values()
    ]
    curve: list[float] = np.mean(objects, axis=0).tolist()
    assert len(curve) == len(THRESHOLDS)
    return curve

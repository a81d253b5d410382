"""IoU against the threshold: by hand, and the same as the score at the threshold that was chosen."""

from pathlib import Path

import numpy as np
import pytest

from kinectbench.core.artefacts.counted import PairResult, Tally
from kinectbench.core.artefacts.scores import BaseRate
from kinectbench.core.voxels.pair_file import read_pair, unpack
from kinectbench.release.release import Release, Target
from kinectbench.scoring.assemble import rows_of
from kinectbench.scoring.averages import curves as curves_of
from kinectbench.scoring.counts import THRESHOLDS
from kinectbench.scoring.score import score
from kinectbench.scoring.thresholds import Thresholds


def result(occupied: int, predicted: int, hit: int) -> PairResult:
    """`predicted` voxels at y = 0.5, of which `hit` are in the truth; all known and seen."""
    voxels, above = np.zeros(8, np.int64), np.zeros((17, 8), np.int64)
    voxels[[6, 7]] = 1000 - occupied, occupied
    below = np.array(THRESHOLDS) < 0.5
    above[below, 6], above[below, 7] = predicted - hit, hit
    ceilings = dict.fromkeys(("known", "paper", "occluded"), 1.0)
    return PairResult(Tally(voxels, above, np.zeros(8)), 256, ceilings, {}, None)


def target(name: str, thing: str, view: str, split: str = "test") -> Target:
    return Target(name, thing, view, "chair", split, "", "")


def test_means_by_hand() -> None:
    results = {
        target("a", "red", "000"): result(10, 10, 10),  # 1
        target("a", "red", "001"): result(10, 10, 5),  # 1/3
        target("b", "blue", "000"): result(10, 0, 0),  # 0
        target("c", "old", "000", "validation"): result(10, 10, 10),
    }
    protocols = ("known", "paper", "occluded")
    thresholds = Thresholds({"chair": 0.5}, "fixed")
    curves = curves_of(
        rows_of(results, protocols, thresholds, {"chair": BaseRate(value=0.1, source="train")}), protocols
    )
    assert curves is not None
    below = [p < 0.5 for p in THRESHOLDS]
    assert curves["known"]["chair"] == pytest.approx([(2 / 3 + 0) / 2 if low else 0 for low in below])
    assert curves["paper"]["chair"] == pytest.approx([(1 + 1 / 3 + 0) / 3 if low else 0 for low in below])
    # Nothing is occluded: no voxel is counted, and IoU would be 1 for everyone.
    assert curves["occluded"] == {}


def test_the_score_is_a_point_of_the_curve(release: Release, tmp_path: Path) -> None:
    for each in release.targets:
        full = unpack(read_pair(release.pair_path(each)).full)
        path = tmp_path / each.recording / f"{each.view}.npy"
        path.parent.mkdir(exist_ok=True)
        np.save(path, np.roll(full, 4, axis=1).reshape(64, 4, 64, 4, 64, 4).mean(axis=(1, 3, 5)).astype("f4"))
    table = score(release, tmp_path, method="rolled", surface=False)
    assert table.iou_by_threshold is not None and table.by_category is not None
    for protocol, categories in table.iou_by_threshold.items():
        for category, curve in categories.items():
            chosen = THRESHOLDS.index(table.thresholds[category])
            assert curve[chosen] == pytest.approx(table.by_category[protocol][category]["iou"], abs=1e-12)
            assert len(set(curve)) > 10

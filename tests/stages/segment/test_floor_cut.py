"""What the floor cut takes from a flat part of an object is said, and lowers the estimate."""

from types import SimpleNamespace

import numpy as np
import pytest
from analytic_scenes import Surface, box
from bad_scenes import FINE, FLOOR, recorded
from pydantic import ValidationError

from kinectbench.core.artefacts.object import FLOOR_CUT, QualityFile
from kinectbench.settings.models import FusionSettings, SegmentationSettings
from kinectbench.stages.segment.find.floor import Floor
from kinectbench.stages.segment.judge.estimate import (
    LEAST_CUT_SHARE,
    LEAST_LOW_M,
    FloorCut,
    IouEstimate,
    taken_by_floor_cut,
)
from kinectbench.stages.segment.segment import segment
from kinectbench.stages.segment.solid.evidence import FloorLayers

VOXELS = FusionSettings(voxel_size_m=0.005, max_depth_m=2.2)
BLOCK = box((-0.15, -0.12, 0), (0.15, 0.12, 0.15))
ESTIMATE = IouEstimate(0.9, 0.8, 1.0, 0.85, 0.92, 0.82, 1.0, ())


def quality_of(*things: Surface) -> QualityFile:
    return recorded([FLOOR, *things], **FINE).model(fusion=VOXELS).quality


def test_a_plate_below_the_cut_is_reported_and_lowers_the_estimate() -> None:
    alone = quality_of(BLOCK)
    plate = quality_of(BLOCK, box((-0.2, -0.17, 0), (0.2, 0.17, 0.009)))
    assert not any(line.startswith(FLOOR_CUT) for line in alone.warnings)
    (line,) = (line for line in plate.warnings if line.startswith(FLOOR_CUT))
    # 0.064 square metres in two layers of 5 mm, of the block's 10.8 litres.
    assert "lower than 10 mm" in line and line.endswith(
        "set `segmentation.low_cut_m: 0.005` (for all recordings)"
    )
    assert plate.estimated_iou and alone.estimated_iou and plate.estimated_iou < alone.estimated_iou - 0.015
    assert any("the floor cut" in reason for reason in plate.estimated_iou_reasons)


def test_a_plate_above_the_cut_is_the_objects() -> None:
    high = quality_of(BLOCK, box((-0.2, -0.17, 0), (0.2, 0.17, 0.03)))
    assert not any(line.startswith(FLOOR_CUT) for line in high.warnings)


@pytest.mark.parametrize(("share", "said"), [(LEAST_CUT_SHARE, 1), (LEAST_CUT_SHARE - 0.001, 0)])
def test_half_of_it_is_expected_and_all_of_it_possible(share: float, said: int) -> None:
    cut = FloorCut(share, True, 0.015, 0.01, 0.002)
    lowered = cut.applied(ESTIMATE)
    assert len(cut.warnings()) == said == len(lowered.reasons)
    assert (lowered.high, lowered.known_high) == (1.0, 1.0)
    assert lowered.known == pytest.approx(0.92 / (1 + said * share / 2))
    assert lowered.low == pytest.approx(0.8 / (1 + said * share))


def test_the_least_setting_is_one() -> None:
    assert SegmentationSettings(low_cut_m=LEAST_LOW_M)
    with pytest.raises(ValidationError):
        SegmentationSettings(low_cut_m=0.99 * LEAST_LOW_M)


def test_a_foot_below_an_overhang_is_reported() -> None:
    """The base of a pedestal, below its top."""
    top = [box((-0.2, -0.2, 0.37), (0.2, 0.2, 0.4)), box((-0.05, -0.05, 0), (0.05, 0.05, 0.4))]
    for things, said in (([], 0), ([box((-0.18, -0.18, 0), (0.18, 0.18, 0.009))], 1)):
        quality = quality_of(*top, *things)
        assert sum(line.startswith(FLOOR_CUT) for line in quality.warnings) == said


def test_a_rug_is_reported_and_lowers_no_estimate() -> None:
    """It goes on beyond the object's grid."""
    rug = quality_of(BLOCK, box((-0.4, -0.4, 0), (0.4, 0.4, 0.009)))
    (line,) = (line for line in rug.warnings if line.startswith(FLOOR_CUT))
    assert "at least" in line
    assert not any("the floor cut" in reason for reason in rug.estimated_iou_reasons)


def test_nothing_is_said_where_one_layer_is_floor() -> None:
    made = recorded([FLOOR, BLOCK, box((-0.2, -0.17, 0), (0.2, 0.17, 0.004))], **FINE)
    settings = SegmentationSettings(low_cut_m=0.005)
    quality = segment(made.sequence, made.trajectory, made.scene, settings, VOXELS).quality
    assert not any(line.startswith(FLOOR_CUT) for line in quality.warnings)


@pytest.mark.parametrize(
    ("noise_m", "scale", "advised"),
    [
        (0.0004, 1.0, "`segmentation.low_cut_m: 0.01` (for"),
        (0.0004, 0.5, "0.02` (for"),
        (0.003, 1.0, "3.0 mm"),
    ],
)
def test_the_setting_that_lowers_the_cut(noise_m: float, scale: float, advised: str) -> None:
    solid, observed = np.zeros((2, 20, 20, 20), bool)
    solid[5:15, 5:15, 2:15] = observed[3:17, 3:17, 2:15] = True
    classes = SimpleNamespace(observed=observed, free=np.zeros_like(solid))
    layers, floor = FloorLayers(1, 3, 1), Floor(np.eye(4)[2], np.eye(4), noise_m, 0.5, scale=scale)
    cut = taken_by_floor_cut(classes, solid, np.zeros_like(solid), layers, 0.005, floor)  # type: ignore[arg-type]
    (line,) = cut.warnings()
    assert cut.is_whole and advised in line


def test_no_setting_is_advised_that_takes_the_floors_noise() -> None:
    (line,) = FloorCut(0.1, True, 0.015, None, 0.0042).warnings()
    assert "_cut_m:" not in line and "scatters by 4.2 mm: record from nearer" in line

"""What the floor cut takes from a flat part of an object is said, and lowers the estimate."""

import pytest
from analytic_scenes import Surface, box
from bad_scenes import FINE, FLOOR, recorded
from pydantic import ValidationError

from kinectbench.core.artefacts.object import FLOOR_CUT, QualityFile
from kinectbench.settings.models import FusionSettings, SegmentationSettings
from kinectbench.stages.segment.judge.estimate import IouEstimate
from kinectbench.stages.segment.judge.floor_cut import LEAST_CUT_SHARE, LEAST_SETTING_M, FloorCut

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
    assert "lower than 10 mm" in line and line.endswith("set `segmentation.floor_cut_m: 0.005`")
    assert plate.estimated_iou and alone.estimated_iou and plate.estimated_iou < alone.estimated_iou - 0.015
    assert any("the floor cut" in reason for reason in plate.estimated_iou_reasons)


def test_a_plate_above_the_cut_is_the_objects() -> None:
    high = quality_of(BLOCK, box((-0.2, -0.17, 0), (0.2, 0.17, 0.03)))
    assert not any(line.startswith(FLOOR_CUT) for line in high.warnings)


@pytest.mark.parametrize(("share", "said"), [(LEAST_CUT_SHARE, 1), (LEAST_CUT_SHARE - 0.001, 0)])
def test_half_of_it_is_expected_and_all_of_it_possible(share: float, said: int) -> None:
    cut = FloorCut(share, 0.015, 0.01, 0.002)
    lowered = cut.applied(ESTIMATE)
    assert len(cut.warnings()) == said == len(lowered.reasons)
    assert (lowered.high, lowered.known_high) == (1.0, 1.0)
    assert lowered.known == pytest.approx(0.92 / (1 + said * share / 2))
    assert lowered.low == pytest.approx(0.8 / (1 + said * share))


def test_the_least_setting_is_one() -> None:
    assert SegmentationSettings(floor_cut_m=LEAST_SETTING_M)
    with pytest.raises(ValidationError):
        SegmentationSettings(floor_cut_m=0.99 * LEAST_SETTING_M)


def test_no_setting_is_advised_that_takes_the_floors_noise() -> None:
    (line,) = FloorCut(0.1, 0.015, None, 0.0042).warnings()
    assert "floor_cut_m" not in line and "scatters by 4.2 mm: record from nearer" in line

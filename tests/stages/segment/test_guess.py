"""How probable inside is, by what the frames say of a voxel."""

import numpy as np
import pytest
from evidence_by_hand import evidence_of

from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.types import Underside
from kinectbench.stages.segment.solid.evidence import FloorLayers, Rules
from kinectbench.stages.segment.solid.guess import (
    ENCLOSED,
    OPEN_SHARE,
    RIM_SHARE,
    ROOFED_SHARE,
    SIGNED_INSIDE_SHARE,
    SIGNED_VOXELS,
    SKY_SHARE,
    UNDERSIDE_SHARE,
    inside_probability,
    measured_probability,
)

RULES = Rules(FloorLayers(0, 0))
VOXEL_M = 0.005
SHAPE = (9, 9, 9)


def cells(*boxes: tuple[slice | int, ...]) -> np.ndarray:
    found = np.zeros(SHAPE, bool)
    for box in boxes:
        found[box] = True
    return found


def test_what_was_counted_is_a_probability_and_rises_with_enclosure() -> None:
    for shares in (ROOFED_SHARE, SKY_SHARE, RIM_SHARE, SIGNED_INSIDE_SHARE):
        assert shares.min() >= 0 and shares.max() <= 1
    assert (np.diff(ENCLOSED) > 0).all() and (ENCLOSED[0], ENCLOSED[-1]) == (0, 1)
    assert (np.diff(ROOFED_SHARE) >= 0).all() and (np.diff(SKY_SHARE) >= 0).all()
    assert len(RIM_SHARE) == 9 and (np.diff(RIM_SHARE) <= 0).all()
    assert OPEN_SHARE < 0.5 < UNDERSIDE_SHARE


@pytest.mark.parametrize(("told_above", "enclosing"), [(True, 9), (False, 0)])
def test_by_the_share_of_directions_that_meet_the_object(told_above: bool, enclosing: int) -> None:
    """A voxel in free space, far below a plate that all nine ways up meet, or below nothing."""
    unknown = cells((4, 4, 2))
    plate = cells(np.s_[:, :, 6:]) if told_above else cells()
    evidence = evidence_of(SHAPE, unseen=unknown, near_surface=plate, free=~unknown & ~plate)
    # Ways end in the free space right beside it.
    assert inside_probability(evidence, RULES, VOXEL_M)[4, 4, 2] == pytest.approx(SKY_SHARE[0])
    column = cells(np.s_[:, :, 2:6])
    evidence = evidence_of(SHAPE, unseen=column, near_surface=plate, free=~column & ~plate)
    expected = np.interp(enclosing / 26, ENCLOSED, ROOFED_SHARE if told_above else SKY_SHARE)
    assert inside_probability(evidence, RULES, VOXEL_M)[4, 4, 2] == pytest.approx(expected)


@pytest.mark.parametrize("open_side", [True, False])
def test_right_under_the_object_by_the_level_ways_out(open_side: bool) -> None:
    """What a line of half the width reaches beside its middle: 7.5 mm, two voxels."""
    plate, under = cells(np.s_[:, :, 6:]), cells(np.s_[1:8, 1:8, 2:6])
    around = ~plate & ~under
    evidence = evidence_of(
        SHAPE, unseen=under, near_surface=plate | (around & (not open_side)), free=around & open_side
    )
    probability = inside_probability(evidence, RULES, VOXEL_M)
    assert probability[4, 4, 5] == probability[4, 4, 4] == pytest.approx(RIM_SHARE[8 if open_side else 0])
    assert probability[4, 4, 3] != probability[4, 4, 4]
    # As many voxels as a wider line reaches.
    wide = Rules(FloorLayers(0, 0), limits=SensorLimits(line_width_m=0.06))
    assert inside_probability(evidence, wide, VOXEL_M)[4, 4, 3] == probability[4, 4, 4]


@pytest.mark.parametrize(
    ("word", "share"), [("unseen", UNDERSIDE_SHARE), ("open", OPEN_SHARE), ("closed", 1.0)]
)
def test_an_underside_by_what_a_person_says(word: Underside, share: float) -> None:
    under = cells(np.s_[1:8, 1:8, 2:6])
    closed = under if word == "closed" else cells()
    evidence = evidence_of(SHAPE, unseen=under, underside=under, closed=closed, free=~under)
    rules = Rules(FloorLayers(0, 0), underside=word)
    assert inside_probability(evidence, rules, VOXEL_M)[4, 4, 4] == pytest.approx(share)


def test_next_to_a_measured_surface() -> None:
    found = measured_probability(SIGNED_VOXELS * VOXEL_M, VOXEL_M)
    np.testing.assert_allclose(found, SIGNED_INSIDE_SHARE, atol=1e-6)
    assert found.dtype == np.float32

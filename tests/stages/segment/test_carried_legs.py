"""Legs whose upper end no camera saw are carried up to the object."""

import numpy as np

from kinectbench.stages.segment.solid.solid import carried_up

VOXEL_M = 0.005
SEAT = np.s_[5:35, 5:35, 60:70]
LEG = np.s_[10:14, 10:14, :50]
GAP = np.s_[10:14, 10:14, 50:60]


def stool(leg: tuple[slice, ...] = LEG, seat: tuple[slice, ...] = SEAT) -> np.ndarray:
    solid = np.zeros((40, 40, 80), dtype=bool)
    solid[seat] = solid[leg] = True
    return solid


def carried(solid: np.ndarray, seen_empty: np.ndarray | None = None) -> np.ndarray:
    return carried_up(solid, np.zeros_like(solid) if seen_empty is None else seen_empty, 2, VOXEL_M)


def test_a_leg_is_carried_up_to_the_seat_and_nothing_else_is_filled() -> None:
    expected = stool()
    expected[GAP] = True
    np.testing.assert_array_equal(carried(stool()), expected)


def test_where_cameras_saw_through_the_gap_it_stays_open() -> None:
    seen_empty = np.zeros((40, 40, 80), dtype=bool)
    seen_empty[:, :, 55] = True
    np.testing.assert_array_equal(carried(stool(), seen_empty), stool())


def test_columns_that_were_seen_through_are_left_out() -> None:
    seen_empty = np.zeros((40, 40, 80), dtype=bool)
    seen_empty[10, :, 55] = True
    expected = stool()
    expected[11:14, 10:14, 50:60] = True
    np.testing.assert_array_equal(carried(stool(), seen_empty), expected)


def test_a_stick_beside_the_seat_a_speck_and_something_far_below_stay_as_they_are() -> None:
    beside = np.s_[36:39, 10:14, :50]
    speck = np.s_[10:14, 10:14, :8]
    far_below = np.s_[10:14, 10:14, :30]
    for leg in (beside, speck, far_below):
        np.testing.assert_array_equal(carried(stool(leg)), stool(leg))


def test_what_hangs_is_no_leg() -> None:
    hanging = np.s_[10:14, 10:14, 30:50]
    np.testing.assert_array_equal(carried(stool(hanging)), stool(hanging))


def test_one_piece_stays_as_it_is() -> None:
    whole = stool(np.s_[10:14, 10:14, :60])
    assert carried(whole) is whole


def test_a_leg_of_two_layers_is_carried_up() -> None:
    solid = np.zeros((10, 10, 8), dtype=bool)
    solid[1:9, 1:9, 4:6] = solid[3:5, 3:5, :2] = True
    filled = carried_up(solid, np.zeros_like(solid), 0, 0.025)
    assert filled[3:5, 3:5].all(axis=(0, 1)).tolist() == [True] * 6 + [False] * 2

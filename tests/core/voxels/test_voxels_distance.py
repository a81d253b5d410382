"""Distances against scipy's, which have no limit."""

import numpy as np
import pytest
from scipy import ndimage

from kinectbench.core.voxels.morphology import distance_within_m

VOXEL_M = 0.005


@pytest.mark.parametrize(("shape", "share"), [((30, 25, 40), 0.01), ((7, 60, 5), 0.02), ((12, 9, 8), 0.7)])
@pytest.mark.parametrize("within_m", [0.0, 0.004, 0.005, 0.03, 0.0755, 1.0])
def test_as_without_a_limit_up_to_it(shape: tuple[int, int, int], share: float, within_m: float) -> None:
    of = np.random.default_rng(0).random(shape) < share
    expected = ndimage.distance_transform_edt(~of, sampling=VOXEL_M)
    expected[expected > within_m + 1e-9] = np.inf
    np.testing.assert_allclose(distance_within_m(of, VOXEL_M, within_m), expected, rtol=2e-7)


def test_limits_whose_squares_take_more_than_sixteen_bits() -> None:
    of = np.zeros((300, 260, 2), bool)
    of[20, 30, 1] = True
    expected = ndimage.distance_transform_edt(~of, sampling=VOXEL_M)
    expected[expected > 1] = np.inf  # 200 voxels
    assert np.isinf(expected).any()
    np.testing.assert_allclose(distance_within_m(of, VOXEL_M, 1.0), expected, rtol=2e-7)


def test_from_corner_to_corner() -> None:
    of = np.zeros((5, 6, 7), bool)
    of[0, 0, 0] = True
    found = distance_within_m(of, VOXEL_M, 1.0)
    assert found[4, 5, 6] == pytest.approx(VOXEL_M * np.sqrt(4**2 + 5**2 + 6**2))


def test_nothing_is_near_where_nothing_is_set() -> None:
    assert np.isinf(distance_within_m(np.zeros((4, 5, 6), bool), VOXEL_M, 0.1)).all()
    assert (distance_within_m(np.ones((4, 5, 6), bool), VOXEL_M, 0.1) == 0).all()
    turned = np.zeros((6, 5, 4), bool).transpose(2, 1, 0)
    turned[1, 2, 3] = True
    assert distance_within_m(turned, VOXEL_M, 0.1)[3, 2, 3] == pytest.approx(0.01)

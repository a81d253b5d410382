"""The surface of a packed solid, the same as that of the unpacked one; and what the outside reaches."""

import numpy as np
import pytest
from references import shell_of
from scipy import ndimage

from kinectbench.core.voxels.morphology import from_beyond
from kinectbench.core.voxels.pair_file import pack
from kinectbench.core.voxels.solid import packed_shell


@pytest.mark.parametrize("share", [0.02, 0.5, 0.98, 1.0])
def test_random_solids(share: float) -> None:
    solid = np.random.default_rng(0).random((18, 13, 24)) < share
    np.testing.assert_array_equal(packed_shell(pack(solid)), shell_of(solid))


def test_a_box_by_hand() -> None:
    solid = np.zeros((8, 8, 16), bool)
    solid[2:6, 1:8, 5:12] = True
    expected = solid.copy()
    expected[3:5, 2:7, 6:11] = False
    np.testing.assert_array_equal(packed_shell(pack(solid)), pack(expected))


@pytest.mark.parametrize("share", [0.0, 0.4, 0.7, 1.0])
def test_what_the_outside_does_not_reach_are_holes(share: float) -> None:
    solid = np.random.default_rng(1).random((17, 14, 11)) < share
    np.testing.assert_array_equal(~from_beyond(~solid), ndimage.binary_fill_holes(solid))

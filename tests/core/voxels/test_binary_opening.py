"""Binary opening by a box, against SciPy's."""

import numpy as np
import pytest
from scipy import ndimage

from kinectbench.core.voxels.morphology import opened


@pytest.mark.parametrize("size", [(3, 3, 7), (3, 3, 3), (1, 2, 4), (1, 1, 1), (12, 11, 10)])
@pytest.mark.parametrize("seed", range(3))
def test_as_scipys(size: tuple[int, int, int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    mask = ndimage.binary_dilation(rng.random((12, 11, 14)) < 0.02, iterations=2 + seed)
    expected = ndimage.binary_opening(mask, np.ones(size))
    np.testing.assert_array_equal(opened(mask, size), expected)
    if size == (3, 3, 3):
        assert expected.any() and not mask.all()


def test_a_box_larger_than_the_grid_fits_nowhere() -> None:
    assert not opened(np.ones((5, 5, 5), dtype=bool), (3, 3, 6)).any()

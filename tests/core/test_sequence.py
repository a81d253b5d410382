"""Depth in native units becomes metres in one place."""

import numpy as np
import pytest

from kinectbench.core.sequence import depth_in_metres


@pytest.mark.parametrize("depth_scale", [1000.0, 5000.0, 999.5])
def test_depth_in_metres_is_the_nearest_float_of_the_quotient(depth_scale: float) -> None:
    native = np.array([[0, 1, 1500], [4999, 5000, 65535]], np.uint16)
    depth_m = depth_in_metres(native, depth_scale)
    assert depth_m.dtype == np.float32 and depth_m[0, 0] == 0
    np.testing.assert_allclose(depth_m, native / depth_scale, rtol=1.2e-7)

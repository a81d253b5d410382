"""The window of `export --layout rgbd` around an object: no row or column of the object is cut off."""

from typing import Any

import numpy as np

from kinectbench.release.exchange.rgbd import RgbdView, framed


def test_an_object_that_fills_the_window_is_whole() -> None:
    rng = np.random.default_rng(0)
    unused: Any = None
    for _ in range(1000):
        height, width = rng.integers(20, 90, 2)
        mask = np.zeros((height, width), bool)
        (top, bottom), (left, right) = (np.sort(rng.integers(0, n, 2)) for n in (height, width))
        mask[top : bottom + 1, left : right + 1] = True
        depth = np.full(mask.shape, 1000, np.uint16)
        shown = framed(RgbdView(unused, depth, mask, None, "", np.eye(3), np.eye(4)), 24, 18)
        step = max(-(-(right - left + 1) // 24), -(-(bottom - top + 1) // 18))
        assert shown.mask.sum() == mask[::step, ::step].sum()

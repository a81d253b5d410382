"""Resampling against scipy and against blocks counted by hand."""

import numpy as np
import pytest
from raising import raises
from references import upsample
from scipy import ndimage

from kinectbench.core.errors import PairError, PredictionError
from kinectbench.core.voxels.resample import reduce_blocks

RNG = np.random.default_rng(0)


@pytest.mark.parametrize("n", [1, 2, 5, 16, 24, 37])
def test_same_as_scipy(n: int) -> None:
    values = RNG.random((n, n, n))
    side = 37
    expected = ndimage.zoom(values, side / n, order=1, grid_mode=True, mode="nearest")
    np.testing.assert_allclose(upsample(values, side), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("n", [32, 40])
def test_same_as_scipy_at_256(n: int) -> None:
    values = RNG.random((n, n, n)).astype(np.float32)
    expected = ndimage.zoom(values.astype(np.float64), 256 / n, order=1, grid_mode=True, mode="nearest")
    np.testing.assert_allclose(upsample(values), expected, rtol=0, atol=1e-12)


def test_hand_computed() -> None:
    values = np.zeros((2, 2, 2))
    values[1, 0, 0] = 1.0
    # output centres lie at -0.25 (clamped to 0), 0.25, 0.75 and 1.25 (clamped to 1) of the input's axis
    line = upsample(values, 4)[:, 0, 0]
    np.testing.assert_array_equal(line, [0.0, 0.25, 0.75, 1.0])
    assert upsample(values, 4)[3, 1, 2] == 0.75 * 0.25


def test_same_size_is_identity() -> None:
    values = RNG.random((9, 9, 9))
    np.testing.assert_array_equal(upsample(values, 9), values)


def test_larger_cubes_are_sampled_by_the_same_formula() -> None:
    values = RNG.random((18, 18, 18))
    means = values.reshape(9, 2, 9, 2, 9, 2).mean(axis=(1, 3, 5))  # half-pixel centres at twice the side
    np.testing.assert_allclose(upsample(values, 9), means, rtol=0, atol=1e-12)


def test_booleans_are_exact() -> None:
    values = RNG.random((4, 4, 4)) < 0.5
    result = upsample(values, 32)
    np.testing.assert_array_equal(result * 4096, np.rint(result * 4096))


@pytest.mark.parametrize("shape", [(2, 2, 3), (4, 4), (0, 0, 0), (513, 513, 513)])
def test_other_shapes_are_refused(shape: tuple[int, ...]) -> None:
    with raises(PredictionError, "prediction.malformed", match="cube"):
        upsample(np.broadcast_to(np.float16(0), shape))


def test_reduce_blocks() -> None:
    occupancy = np.zeros((8, 8, 8), bool)
    occupancy[0, 0, 0] = True
    occupancy[4:8, 0:4, 0:2] = True  # 32 of 64: not more than half
    occupancy[0:4, 4:8, 0:2] = True
    occupancy[0, 4, 2] = True  # 33 of 64
    expected = np.zeros((2, 2, 2), bool)
    expected[0, 1, 0] = True
    np.testing.assert_array_equal(reduce_blocks(occupancy, "majority"), expected)
    expected[0, 0, 0] = expected[1, 0, 0] = True
    np.testing.assert_array_equal(reduce_blocks(occupancy, "any"), expected)


def test_reduce_blocks_at_full_size() -> None:
    occupancy = RNG.random((256, 256, 256)) < 0.5
    counts = occupancy.reshape(64, 4, 64, 4, 64, 4).sum(axis=(1, 3, 5))
    np.testing.assert_array_equal(reduce_blocks(occupancy, "majority"), counts > 32)
    full = reduce_blocks(np.ones((256, 256, 256), bool), "majority")
    assert full.all()


def test_unknown_rule() -> None:
    with raises(PairError, "pair.malformed"):
        reduce_blocks(np.zeros((8, 8, 8), bool), "most")

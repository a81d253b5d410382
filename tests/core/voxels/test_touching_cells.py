"""Pieces of cells, by a plain labelling of a dense grid, and far beyond what a dense grid can hold."""

import numpy as np
import pytest
from scipy import ndimage

from kinectbench.core.voxels.point_cells import connected, far_apart

CELL_M = 0.03


@pytest.mark.parametrize("through_faces", [False, True])
def test_labels_are_those_of_a_dense_grid(through_faces: bool) -> None:
    """In the same order, too; also of flat clouds, whose rows lie next to each other."""
    random = np.random.default_rng(0)
    for _ in range(60):
        size_m = random.choice([0.1, 0.3, 1.0, 3.0]) * random.choice([0.05, 1.0], 3)
        points = (random.random((random.integers(1, 400), 3)) - 0.5) * size_m
        cells = np.floor(points / CELL_M).astype(int)
        cells -= cells.min(axis=0)
        occupied = np.zeros(cells.max(axis=0) + 1, bool)
        occupied[tuple(cells.T)] = True
        labels, _ = ndimage.label(occupied, None if through_faces else np.ones((3, 3, 3)))
        found = connected(points, CELL_M, through_faces)
        assert found.dtype == np.int32
        np.testing.assert_array_equal(found, labels[tuple(cells.T)])


def test_a_patch_a_kilometre_off_costs_no_memory() -> None:
    patch = np.random.default_rng(0).random((3000, 3)) * [0.4, 0.4, 0.02]
    one = connected(patch, CELL_M)
    both = connected(np.concatenate([patch, patch + np.array([900.0, 700.0, 300.0])]), CELL_M)
    assert one.max() == 1 and both.max() == 2
    np.testing.assert_array_equal(both, np.repeat([1, 2], 3000))


def test_the_largest_group_is_not_far_apart() -> None:
    along = np.concatenate([np.arange(0, 60, 0.5), [130, 131], np.arange(400, 420, 0.5)])
    points = np.stack([along, np.zeros_like(along), np.zeros_like(along)], axis=-1)
    np.testing.assert_array_equal(far_apart(points, 16.0), along > 100)
    assert not far_apart(points[:120], 16.0).any()

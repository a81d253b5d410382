"""Known cells block by block, against one cell at a time."""

import numpy as np
import pytest
from scipy import ndimage

from kinectbench.core.geometry import Grid, rigid, rotation_from_quaternion_xyzw, transform_points
from kinectbench.core.voxels.known_cells import known_grid, known_in
from kinectbench.core.voxels.pair_file import unpack

TURNED = rotation_from_quaternion_xyzw([0.3, -0.2, 0.1, 0.8])


def patches(shape: tuple[int, int, int], seed: int) -> np.ndarray:
    patches: np.ndarray = ndimage.gaussian_filter(np.random.default_rng(seed).random(shape), 3) > 0.5
    return patches


def at(grid: Grid, known: np.ndarray, points: np.ndarray) -> np.ndarray:
    """1, 0, or -1 beyond the grid; -2 where rounding decides."""
    cells = transform_points(grid.T_grid_world, points) / grid.voxel_size_m
    tie = (np.abs(cells - np.rint(cells)) < 1e-9).any(axis=1)
    index = np.floor(cells).astype(int)
    inside = np.all((index >= 0) & (index < grid.shape), axis=1)
    values = np.full(len(points), -1)
    values[inside] = known[tuple(index[inside].T)]
    return np.where(tie, -2, values)


@pytest.mark.parametrize(("voxel_m", "shift"), [(0.3, 3.0), (0.9, -14.0), (2.5, -30.0), (2.5, 3.0)])
def test_one_cell_at_a_time(voxel_m: float, shift: float) -> None:
    fine, coarse = (
        Grid((37, 30, 41), 1.0, np.eye(4)),
        Grid((20, 21, 22), 3.0, rigid(np.eye(3), [-15, -16, -9])),
    )
    known, around = patches(fine.shape, 0), patches(coarse.shape, 1)
    grid = Grid((32, 40, 48), voxel_m, rigid(TURNED, [shift, 2.0, 1.0]))
    cells = np.moveaxis(np.indices(grid.shape), 0, -1).reshape(-1, 3)
    points = transform_points(grid.T_world_grid, (cells + 0.5) * voxel_m)
    expected, beyond = at(fine, known, points), at(coarse, around, points)
    expected = np.where(expected == -1, beyond, expected)
    found = unpack(known_in(known_grid(fine, known), known_grid(coarse, around), grid)).reshape(-1)
    sure = expected != -2
    np.testing.assert_array_equal(found[sure], (expected == 1)[sure])
    assert 0 < found.sum() < found.size


def test_uniform_blocks_are_not_mistaken() -> None:
    """All known but one voxel, which a block's corner alone lies in."""
    known = np.ones((32, 32, 32), bool)
    known[16, 16, 16] = False
    grid = Grid((32, 32, 32), 1.0, np.eye(4))
    nothing = known_grid(Grid((4, 4, 4), 1.0, rigid(np.eye(3), [99, 0, 0])), np.zeros((4, 4, 4), bool))
    np.testing.assert_array_equal(unpack(known_in(known_grid(grid, known), nothing, grid)), known)

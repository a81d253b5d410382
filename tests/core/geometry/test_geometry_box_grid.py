import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from kinectbench.core.geometry import Grid, OrientedBox, rigid, transform_points


def test_a_turned_box_by_hand() -> None:
    box = OrientedBox(center_m=(1.0, 0.0, 0.5), size_m=(2.0, 1.0, 1.0), yaw_rad=np.pi / 2)
    points_floor = np.array([[1.0, 0.9, 0.5], [1.9, 0.0, 0.5], [1.0, 0.0, 0.0], [1.0, 0.0, 1.01]])
    assert box.contains(points_floor).tolist() == [True, False, True, False]
    np.testing.assert_allclose(box.corners_floor().min(axis=0), [0.5, -1.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(box.corners_floor().max(axis=0), [1.5, 1.0, 1.0], atol=1e-12)


@given(st.floats(-7, 7), st.floats(-3, 3), st.floats(0.1, 3), st.integers(0, 1000))
@settings(deadline=None)
def test_a_box_holds_just_what_its_own_frame_says(
    yaw_rad: float, x_m: float, length_m: float, seed: int
) -> None:
    box = OrientedBox((x_m, 0.2, 0.5), (length_m, 0.5, 1.0), yaw_rad)
    unit = np.random.default_rng(seed).uniform(-1, 1, (50, 3))
    points_floor = transform_points(box.T_floor_box, unit * np.array(box.size_m))
    np.testing.assert_array_equal(box.contains(points_floor), (np.abs(unit) <= 0.5).all(axis=1))


def test_corners_lie_on_the_box_and_shapes_carry_over() -> None:
    box = OrientedBox((0.0, 0.0, 0.0), (1.0, 2.0, 4.0))
    assert len(np.unique(box.corners_floor(), axis=0)) == 8
    assert box.contains(box.corners_floor()).all()
    assert box.contains(np.zeros((2, 3, 3))).shape == (2, 3)


def test_a_grid_in_the_world() -> None:
    T_world_grid = rigid([[0, -1, 0], [1, 0, 0], [0, 0, 1]], [1, 2, 3])
    grid = Grid((256, 128, 64), 0.01, T_world_grid)
    np.testing.assert_allclose(grid.size_m, [2.56, 1.28, 0.64])
    np.testing.assert_allclose(grid.T_grid_world @ T_world_grid, np.eye(4), atol=1e-15)


def test_a_coarser_grid_covers_the_same_box() -> None:
    grid = Grid((256, 128, 64), 0.01, np.eye(4))
    coarse = grid.coarser(4)
    assert coarse.shape == (64, 32, 16)
    assert coarse.voxel_size_m == pytest.approx(0.04)
    np.testing.assert_allclose(coarse.size_m, grid.size_m)
    assert coarse.T_world_grid is grid.T_world_grid

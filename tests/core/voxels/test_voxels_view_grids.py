"""What a view says about cells, straight from the definitions; framing; boundaries; containment."""

import numpy as np
import pytest
from references import occupy
from scipy import ndimage

from kinectbench.core.geometry import Camera, Grid, rigid, rotation_from_quaternion_xyzw, transform_points
from kinectbench.core.geometry.depth import depth_sigma_m
from kinectbench.core.voxels.pair_file import pack, unpack
from kinectbench.core.voxels.seen_cells import seen_cells
from kinectbench.core.voxels.solid import packed_shell
from kinectbench.core.voxels.view_grids import (
    blocks_touched,
    containment,
    containment_of_cells,
    depth_cells,
    object_cube,
    view_cube,
)

CAMERA = Camera(60, 44, 50.0, 52.0, 30.3, 20.9)
T_WORLD_CAMERA = rigid(rotation_from_quaternion_xyzw([0.3, -0.2, 0.1, 0.8]), [0.5, 1.0, -0.4])


def view_grid(
    corner_camera: tuple[float, float, float],
    voxel_m: float = 0.04,
    shape: tuple[int, int, int] = (32, 24, 40),
) -> Grid:
    corner_world = transform_points(T_WORLD_CAMERA, np.array(corner_camera))
    return Grid(shape, voxel_m, rigid(T_WORLD_CAMERA[:3, :3], corner_world))


def random_depth(seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    depth_m = rng.uniform(0.5, 1.8, (44, 60)).astype(np.float32)
    depth_m[rng.random(depth_m.shape) < 0.2] = 0
    return depth_m


@pytest.mark.parametrize("corner", [(-0.6, -0.5, 0.4), (-0.6, -0.5, -0.3), (0.1, 0.0, 0.9)])
def test_seen_by_its_definition(corner: tuple[float, float, float]) -> None:
    """In the frustum with a valid depth d and z <= d + 2 sigma(d) + one voxel; one cell at a time."""
    grid, depth_m = view_grid(corner), random_depth()
    seen = unpack(seen_cells(depth_m, CAMERA, T_WORLD_CAMERA, grid))
    disputed = 0
    for cell in np.ndindex(*grid.shape):
        world = transform_points(grid.T_world_grid, (np.array(cell, float) + 0.5) * grid.voxel_size_m)
        x, y, z = transform_points(np.asarray(np.linalg.inv(T_WORLD_CAMERA)), world)
        expected = tie = False
        if z > 0:
            u, v = CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy
            tie = min(abs(u % 1 - 0.5), abs(v % 1 - 0.5)) < 1e-9
            column, row = round(u), round(v)
            if 0 <= column < CAMERA.width and 0 <= row < CAMERA.height:
                d = float(depth_m[row, column])
                limit = d + 2 * float(depth_sigma_m(d)) + grid.voxel_size_m
                expected = d > 0 and z <= limit
                tie |= abs(z - limit) < 1e-6
        disputed += bool(seen[cell]) != expected and not tie
    assert disputed == 0
    assert 0.02 < seen.mean() < 0.98


def test_a_pixel_without_depth_sees_nothing() -> None:
    grid = view_grid((-0.6, -0.5, 0.4))
    assert not seen_cells(np.zeros((44, 60), np.float32), CAMERA, T_WORLD_CAMERA, grid).any()


def test_partial_cells_by_their_definition() -> None:
    grid = view_grid((-0.3, -0.3, 0.6), shape=(16, 16, 16))
    depth_m, mask = random_depth(1), np.random.default_rng(2).random((44, 60)) < 0.6
    cells = depth_cells(depth_m, mask, CAMERA, T_WORLD_CAMERA, grid)
    expected = []
    for v, u in np.argwhere(mask & (depth_m > 0)):
        d = float(depth_m[v, u])
        point = np.array([(u - CAMERA.cx) / CAMERA.fx * d, (v - CAMERA.cy) / CAMERA.fy * d, d])
        T_grid_world = np.asarray(np.linalg.inv(grid.T_world_grid))
        at = transform_points(T_grid_world, transform_points(T_WORLD_CAMERA, point))
        expected.append(np.floor(at / grid.voxel_size_m))
    np.testing.assert_array_equal(cells, expected)
    occupied = occupy(cells, grid.shape)
    within = [tuple(c) for c in cells.tolist() if min(c) >= 0 and max(c) < 16]
    assert occupied.sum() == len(set(within)) and all(occupied[c] for c in within)
    assert 0 < len(within) < len(cells)


def test_partial_lies_in_what_was_seen() -> None:
    grid, depth_m = view_grid((-0.6, -0.5, 0.4)), random_depth(3)
    partial = occupy(depth_cells(depth_m, depth_m > 0, CAMERA, T_WORLD_CAMERA, grid), grid.shape)
    seen = unpack(seen_cells(depth_m, CAMERA, T_WORLD_CAMERA, grid))
    # A cell's centre may project to another pixel than the point in it does.
    assert (partial & ~seen).sum() < 0.5 * partial.sum()
    smooth = np.full((44, 60), 1.1, np.float32)
    partial = occupy(depth_cells(smooth, smooth > 0, CAMERA, T_WORLD_CAMERA, grid), grid.shape)
    seen = unpack(seen_cells(smooth, CAMERA, T_WORLD_CAMERA, grid))
    inner = partial[4:-4, 4:-4] & ~seen[4:-4, 4:-4]
    assert not inner[:, :, :].any()


# --- boundaries and blocks


def test_shell_against_scipy() -> None:
    solid = ndimage.gaussian_filter(np.random.default_rng(0).random((24, 20, 32)), 1.5) > 0.5
    eroded = ndimage.binary_erosion(solid, ndimage.generate_binary_structure(3, 1), border_value=0)
    np.testing.assert_array_equal(unpack(packed_shell(pack(solid))), solid & ~eroded)
    whole = np.ones((8, 8, 8), bool)
    assert unpack(packed_shell(pack(whole))).sum() == 8**3 - 6**3


def test_blocks_touched_against_scipy() -> None:
    occupied = np.random.default_rng(1).random((16, 16, 16)) < 0.01
    dilated = ndimage.binary_dilation(occupied, np.ones((3, 3, 3)))
    expected = dilated.reshape(4, 4, 4, 4, 4, 4).any(axis=(1, 3, 5))
    packed = pack(occupied)
    np.testing.assert_array_equal(blocks_touched(packed), expected)
    np.testing.assert_array_equal(packed, pack(occupied))


def test_containment_by_hand() -> None:
    full = np.zeros((16, 16, 16), bool)
    full[4:8, 4:8, 4:8] = True  # exactly one coarse cell; dilated once it touches all 26 around it
    coarse = [[1, 1, 1], [0, 0, 0], [2, 2, 2], [3, 1, 1]]
    assert containment_of_cells(np.array(coarse), pack(full)) == 0.75
    repeated = np.array([*coarse, [1, 1, 1], [1, 1, 1], [-1, 0, 0], [4, 0, 0]])
    assert (
        containment_of_cells(repeated, pack(full)) == 0.5
    )  # each cell counts once; out of bounds is outside
    assert containment_of_cells(np.zeros((0, 3), np.int64), pack(full)) == 1.0
    full[7, 7, 7] = full[4, 4, 4] = False
    full[4:8, 4:8, 7] = False  # the far layer gone: the coarse cells beyond it are not touched
    assert containment_of_cells(np.array([[1, 1, 2]]), pack(full)) == 0.0


def test_containment_of_grids_against_scipy() -> None:
    rng = np.random.default_rng(4)
    full = ndimage.gaussian_filter(rng.random((32, 32, 32)), 3) > 0.505
    partial = rng.random((8, 8, 8)) < 0.2
    dilated = ndimage.binary_dilation(full, np.ones((3, 3, 3)))
    inside = dilated.reshape(8, 4, 8, 4, 8, 4).any(axis=(1, 3, 5))
    share = containment(pack(partial), pack(full))
    assert share == (partial & inside).sum() / partial.sum()
    assert 0.1 < share < 0.999
    assert containment(pack(np.zeros_like(partial)), pack(full)) == 1.0


# --- framing


def test_object_cube_by_its_formula() -> None:
    vertices = np.random.default_rng(0).uniform([-0.3, -0.1, 0.0], [0.3, 0.1, 0.9], (500, 3))
    grid = object_cube(vertices, T_WORLD_CAMERA)
    rotation = T_WORLD_CAMERA[:3, :3]
    np.testing.assert_allclose(grid.T_world_grid[:3, :3], rotation)
    turned = vertices @ rotation  # in the view's axes
    extent = np.ptp(turned, axis=0)
    assert grid.shape == (256, 256, 256)
    assert grid.voxel_size_m * 256 == pytest.approx(extent.max() * 256 / 252)
    cells = transform_points(grid.T_grid_world, vertices) / grid.voxel_size_m
    np.testing.assert_allclose((cells.min(axis=0) + cells.max(axis=0)) / 2, 128, atol=1e-9)
    assert cells.min() == pytest.approx(2) and cells.max() == pytest.approx(254)
    # The cube depends on the camera's orientation only.
    other = object_cube(vertices, rigid(rotation, [9.0, 9.0, 9.0]))
    np.testing.assert_allclose(other.T_world_grid, grid.T_world_grid)


def test_view_cube_by_its_formula() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform([-0.2, -0.35, 1.1], [0.3, 0.25, 1.4], (20_000, 3))
    grid = view_cube(points, T_WORLD_CAMERA)
    low, high = np.quantile(points, 0.005, axis=0), np.quantile(points, 0.995, axis=0)
    side = 1.4 * (high - low).max()
    assert grid.voxel_size_m * 256 == pytest.approx(side)
    np.testing.assert_allclose(grid.T_world_grid[:3, :3], T_WORLD_CAMERA[:3, :3])
    corner = transform_points(np.asarray(np.linalg.inv(T_WORLD_CAMERA)), grid.T_world_grid[:3, 3])
    np.testing.assert_allclose(corner[:2], ((low + high) / 2 - side / 2)[:2], atol=1e-9)
    assert corner[2] == pytest.approx(low[2] - 0.1 * side)
    # One wild pixel in a thousand moves nothing much.
    wild = np.concatenate([points, np.full((20, 3), 3.0)])
    assert view_cube(wild, T_WORLD_CAMERA).voxel_size_m == pytest.approx(grid.voxel_size_m, rel=0.01)

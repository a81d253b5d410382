"""Which blocks a frame says anything about."""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.fusion.blocks import BLOCK_VOXELS, CUBE_VOXELS, BlockVolume, unique_blocks
from kinectbench.geometry import Camera

TILE_PX = 4
SAMPLE_PX = 4
# Nearer corners are not projected: their block counts as visible.
NEAREST_M = 0.05


def cubes_near_surface(
    depth_m: NDArray[np.float32],
    camera: Camera,
    T_world_camera: NDArray[np.float64],
    margin_m: float,
    voxel_size_m: float,
) -> NDArray[np.int32]:
    """Cubes of 16^3 voxels, world-aligned, within `margin_m` of a frame's depth, along the viewing rays.

    Every fourth pixel is looked at: at 4 m these are 30 mm apart, less than half a cube of 5 mm voxels.

    Returns:
        (n, 3) int32, unique, sorted; cube c covers voxels `16 c ... 16 c + 15`.
    """
    cube_m = CUBE_VOXELS * voxel_size_m
    offsets_m = np.linspace(-margin_m, margin_m, max(2, int(np.ceil(4 * margin_m / cube_m)) + 1))
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    return unique_blocks(_cubes_on_rays(depth_m, intrinsics, T_world_camera[:3] / cube_m, offsets_m))


@numba.njit(cache=True, error_model="numpy")
def _cubes_on_rays(depth, intrinsics, T, offsets):  # type: ignore[no-untyped-def]
    """The cubes that sampled pixels lie in, without those that repeat the one before: (n, 3) int64."""
    fx, fy, cx, cy = intrinsics
    height, width = depth.shape
    samples = ((height - 1) // SAMPLE_PX + 1) * ((width - 1) // SAMPLE_PX + 1)
    found, count = np.empty((samples * len(offsets), 3), np.int64), 0
    for offset in offsets:
        for v in range(0, height, SAMPLE_PX):
            for u in range(0, width, SAMPLE_PX):
                if depth[v, u] > 0:
                    z = depth[v, u] + offset
                    x, y = (u - cx) / fx * z, (v - cy) / fy * z
                    i = np.int64(np.floor(T[0, 0] * x + T[0, 1] * y + T[0, 2] * z + T[0, 3]))
                    j = np.int64(np.floor(T[1, 0] * x + T[1, 1] * y + T[1, 2] * z + T[1, 3]))
                    k = np.int64(np.floor(T[2, 0] * x + T[2, 1] * y + T[2, 2] * z + T[2, 3]))
                    before = found[max(count, 1) - 1]
                    if count == 0 or i != before[0] or j != before[1] or k != before[2]:
                        found[count, 0], found[count, 1], found[count, 2] = i, j, k
                        count += 1
    return found[:count]


def visible_blocks(
    volume: BlockVolume,
    depth_m: NDArray[np.float32],
    camera: Camera,
    T_camera_grid: NDArray[np.float64],
    truncation_m: float,
) -> NDArray[np.int64]:
    """Indices of the blocks that a frame may say something about, ascending.

    Left out are blocks that project beside the image, or lie behind all that was measured where they project.
    """
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    block_m = BLOCK_VOXELS * volume.voxel_size_m
    seen = _visible(volume.blocks, block_m, _farthest(depth_m), T_camera_grid, intrinsics, camera.width,
                    camera.height, truncation_m)  # fmt: skip
    return np.flatnonzero(seen)


@numba.njit(cache=True, error_model="numpy")
def _farthest(depth):  # type: ignore[no-untyped-def]
    """The greatest depth in each tile of pixels; 0 where nothing was measured."""
    height, width = depth.shape
    tiles = np.zeros(((height - 1) // TILE_PX + 1, (width - 1) // TILE_PX + 1), np.float32)
    for v in range(height):
        for u in range(width):
            tile = v // TILE_PX, u // TILE_PX
            tiles[tile] = max(tiles[tile], depth[v, u])
    return tiles


@numba.njit(cache=True, error_model="numpy")
def _visible(  # type: ignore[no-untyped-def]
    blocks, block_m, farthest, T, intrinsics, width, height, truncation_m
):
    """For each block whether it is in view and not wholly behind: by the box around it in camera axes."""
    seen = np.zeros(len(blocks), np.bool_)
    fx, fy, cx, cy = intrinsics
    half = np.empty(3)
    for axis in range(3):
        half[axis] = block_m / 2 * (abs(T[axis, 0]) + abs(T[axis, 1]) + abs(T[axis, 2]))
    for b in range(len(blocks)):
        gx, gy, gz = (
            (blocks[b, 0] + 0.5) * block_m,
            (blocks[b, 1] + 0.5) * block_m,
            (blocks[b, 2] + 0.5) * block_m,
        )
        x = T[0, 0] * gx + T[0, 1] * gy + T[0, 2] * gz + T[0, 3]
        y = T[1, 0] * gx + T[1, 1] * gy + T[1, 2] * gz + T[1, 3]
        z = T[2, 0] * gx + T[2, 1] * gy + T[2, 2] * gz + T[2, 3]
        near, far = z - half[2], z + half[2]
        if near < NEAREST_M:
            seen[b] = far > 0
        else:
            # The tiles of the pixels that voxels in the box round to.
            left, right = _span(fx, x - half[0], x + half[0], near, far, cx, width)
            top, bottom = _span(fy, y - half[1], y + half[1], near, far, cy, height)
            seen[b] = _any_beyond(farthest, left, right, top, bottom, near - truncation_m)
    return seen


@numba.njit(cache=True, error_model="numpy", inline="always")
def _span(focal, low, high, near, far, middle, count):  # type: ignore[no-untyped-def]
    """First and last tile that coordinates from low to high at depths from near to far project to."""
    first = focal * min(low / near, low / far) + middle - 0.5
    last = focal * max(high / near, high / far) + middle + 1
    return int(max(first, 0.0)) // TILE_PX, int(np.floor(min(last, count - 1.0) / TILE_PX))


@numba.njit(cache=True, error_model="numpy", inline="always")
def _any_beyond(farthest, left, right, top, bottom, depth_m):  # type: ignore[no-untyped-def]
    """Whether something was measured at this depth or beyond in these tiles."""
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            if farthest[row, column] > 0 and farthest[row, column] >= depth_m:
                return True
    return False

"""Which blocks a frame says anything about."""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.fusion.blocks import BLOCK_VOXELS, BlockVolume, unique_blocks
from kinectbench.geometry import Camera

TILE_PX = 16
SAMPLE_PX = 4
# Nearer corners are not projected: their block counts as visible.
NEAREST_M = 0.05


def blocks_near_surface(
    depth_m: NDArray[np.float32],
    camera: Camera,
    T_world_camera: NDArray[np.float64],
    margin_m: float,
    voxel_size_m: float,
) -> NDArray[np.int32]:
    """Blocks of a world-aligned volume within `margin_m` of a frame's depth, along the viewing rays.

    Every fourth pixel is looked at: at 4 m these are 30 mm apart, less than half a block of 5 mm voxels.

    Returns:
        (n, 3) int32, unique, sorted.
    """
    block_m = BLOCK_VOXELS * voxel_size_m
    offsets_m = np.linspace(-margin_m, margin_m, max(2, int(np.ceil(4 * margin_m / block_m)) + 1))
    v, u = np.mgrid[: depth_m.shape[0] : SAMPLE_PX, : depth_m.shape[1] : SAMPLE_PX]
    sampled = depth_m[::SAMPLE_PX, ::SAMPLE_PX]
    u, v, z = u[sampled > 0], v[sampled > 0], sampled[sampled > 0].astype(np.float64)
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(len(u))])
    turned, origin = T_world_camera[:3, :3] @ rays / block_m, T_world_camera[:3, 3:] / block_m
    found = [np.floor(turned * (z + offset_m) + origin).astype(np.int64) for offset_m in offsets_m]
    return unique_blocks(np.concatenate(found, axis=1).T)


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


def _farthest(depth_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """The greatest depth in each tile of 16 x 16 pixels; 0 where nothing was measured."""
    height, width = depth_m.shape
    padded = np.pad(depth_m, ((0, -height % TILE_PX), (0, -width % TILE_PX)))
    rows = padded.reshape(-1, TILE_PX, padded.shape[1]).max(axis=1)
    farthest: NDArray[np.float32] = rows.reshape(len(rows), -1, TILE_PX).max(axis=2)
    return farthest


@numba.njit(cache=True, error_model="numpy")
def _visible(  # type: ignore[no-untyped-def]
    blocks, block_m, farthest, T, intrinsics, width, height, truncation_m
):
    """For each block whether it is in view and not wholly behind: by the rectangle around its corners."""
    seen = np.zeros(len(blocks), np.bool_)
    fx, fy, cx, cy = intrinsics
    for b in range(len(blocks)):
        nearest, left, right, top, bottom = np.inf, np.inf, -np.inf, np.inf, -np.inf
        for corner in range(8):
            gx = (blocks[b, 0] + (corner & 1)) * block_m
            gy = (blocks[b, 1] + (corner >> 1 & 1)) * block_m
            gz = (blocks[b, 2] + (corner >> 2)) * block_m
            z = T[2, 0] * gx + T[2, 1] * gy + T[2, 2] * gz + T[2, 3]
            inverse = 1 / max(z, NEAREST_M)
            u = fx * (T[0, 0] * gx + T[0, 1] * gy + T[0, 2] * gz + T[0, 3]) * inverse + cx
            v = fy * (T[1, 0] * gx + T[1, 1] * gy + T[1, 2] * gz + T[1, 3]) * inverse + cy
            nearest, left, right = min(nearest, z), min(left, u), max(right, u)
            top, bottom = min(top, v), max(bottom, v)
        if nearest < NEAREST_M:
            seen[b] = True
        elif right >= -0.5 and bottom >= -0.5 and left <= width - 0.5 and top <= height - 0.5:
            # The tiles of the pixels that voxels between the corners round to.
            first_row, last_row = (
                int(max(top - 0.5, 0)) // TILE_PX,
                int(min(bottom + 1, height - 1)) // TILE_PX,
            )
            first, last = int(max(left - 0.5, 0)) // TILE_PX, int(min(right + 1, width - 1)) // TILE_PX
            deepest = farthest[first_row : last_row + 1, first : last + 1].max()
            seen[b] = deepest > 0 and nearest <= deepest + truncation_m
    return seen

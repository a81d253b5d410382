"""Find the blocks of a volume that a frame can update."""

from collections.abc import Callable
from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera, depth_sigma_m
from kinectbench.core.types import Float32, Float64, Int32
from kinectbench.stages.fuse.blocks import BLOCK_VOXELS, BlockVolume, unique_blocks

# Larger tiles leave out fewer blocks, smaller ones take longer to search: 1,000 frames of a chair take
# 39 s of the processor with 8, and 40 to 42 s with 4 (measured by turns).
TILE_PX = 8
# Surfaces update voxels behind them up to the truncation, plus this many sigmas of depth. By a truncation of
# 20 mm alone, the mean of depth of 3.3 m (17 mm) is 5 mm too deep, that of 3.9 m (25 mm) 16 mm; with two
# deviations both are 1 mm off (normal noise, computed). Nearer than 2.55 m they are less than 20 mm.
BEHIND_SURFACE_SIGMAS = 2.0
# Rays less than half a block apart miss no block; every fourth pixel finds thin things.
SAMPLES_APART_BLOCKS, MAX_SAMPLE_PX = 0.4, 4
# How far nine of ten pixels measure at most is found in every sixteenth pixel of every sixteenth row.
FEW_PX, FAR_PERCENTILE = 16, 90
# Nearer corners are not projected: their block counts as visible.
NEAREST_M = 0.05
# How a frame sees a block: in some way, or all of it free.
SEEN: Final = 1
CLEAR: Final = 2
# No block lies there.
NOWHERE = np.int64(np.iinfo(np.int64).min)


def blocks_near_surface(
    depth_m: Float32, camera: Camera, T_world_camera: Float64, margin_m: float, voxel_size_m: float
) -> Int32:
    """Find the world-aligned blocks within `margin_m` of a frame's depth, along the viewing rays.

    At least every fourth pixel along rows and columns is sampled. At the 90th percentile of depth,
    neighbouring samples are at most 0.4 blocks apart, unless every pixel is sampled already.

    Returns:
        (n, 3) int32, unique, sorted.
    """
    block_m = BLOCK_VOXELS * voxel_size_m
    offsets_m = np.linspace(-margin_m, margin_m, int(np.ceil(4 * margin_m / block_m)) + 1)
    some_m = depth_m[::FEW_PX, ::FEW_PX]
    far_m = float(np.percentile(some_m[some_m > 0], FAR_PERCENTILE)) if some_m.any() else 1.0
    step_px = int(SAMPLES_APART_BLOCKS * block_m * min(camera.fx, camera.fy) / far_m)
    step_px = min(max(step_px, 1), MAX_SAMPLE_PX)
    blocks = _blocks_on_rays(depth_m, step_px, camera.intrinsics, T_world_camera[:3] / block_m, offsets_m)
    return unique_blocks(blocks)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _blocks_on_rays(depth, step, intrinsics, T, offsets):  # type: ignore[no-untyped-def]
    """Return blocks (n, 3) int64 around the points of every `step`-th pixel, without consecutive repeats.

    `T` (3, 4) maps the camera frame, metres, to block coordinates. A block is taken at each of the `offsets`
    from a pixel's depth, metres.
    """
    fx, fy, cx, cy = intrinsics
    height, width = depth.shape
    samples = ((height - 1) // step + 1) * ((width - 1) // step + 1)
    blocks, count = np.empty((samples * len(offsets), 3), np.int64), 0
    last_i, last_j, last_k = NOWHERE, NOWHERE, NOWHERE
    for v in range(0, height, step):
        for u in range(0, width, step):
            if depth[v, u] > 0:
                x, y = (u - cx) / fx, (v - cy) / fy
                along_x = T[0, 0] * x + T[0, 1] * y + T[0, 2]
                along_y = T[1, 0] * x + T[1, 1] * y + T[1, 2]
                along_z = T[2, 0] * x + T[2, 1] * y + T[2, 2]
                for offset in offsets:
                    z = depth[v, u] + offset
                    i = np.int64(np.floor(along_x * z + T[0, 3]))
                    j = np.int64(np.floor(along_y * z + T[1, 3]))
                    k = np.int64(np.floor(along_z * z + T[2, 3]))
                    if i != last_i or j != last_j or k != last_k:
                        blocks[count, 0], blocks[count, 1], blocks[count, 2] = i, j, k
                        last_i, last_j, last_k = i, j, k
                        count += 1
    return blocks[:count]


def visible_blocks(
    volume: BlockVolume,
    depth_m: Float32,
    camera: Camera,
    T_camera_grid: Float64,
    truncation_m: float,
    clear_m: Callable[[Float32], Float32],
) -> NDArray[np.uint8]:
    """Return how a frame sees each block, (n,) uint8: 0 (not), `SEEN`, or `CLEAR` (can only be free).

    A block is not seen if it projects outside the image, or lies behind all depth measured where it projects.
    It is `CLEAR` if it lies in front of all this depth by at least `clear_m(depth)`, metres. `clear_m` must
    be convex.
    """
    block_m = BLOCK_VOXELS * volume.voxel_size_m
    nearest_m, farthest_m = _of_tiles(depth_m)
    # Between the two depths it asks for no more than at both.
    ends_m = np.stack([np.minimum(nearest_m, farthest_m), farthest_m])
    clear_to_m = np.where(farthest_m > 0, (ends_m - clear_m(ends_m)).min(axis=0), np.float32(np.inf))
    # Distance beyond the truncation that is still updated.
    noisy_m = BEHIND_SURFACE_SIGMAS * depth_sigma_m(farthest_m) - np.float32(truncation_m)
    farthest_m[farthest_m > 0] += np.maximum(noisy_m[farthest_m > 0], np.float32(0))
    seen: NDArray[np.uint8] = _visible(
        volume.blocks, block_m, clear_to_m, farthest_m, T_camera_grid, camera.intrinsics, camera.width,
        camera.height, truncation_m,
    )  # fmt: skip
    return seen


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _of_tiles(depth):  # type: ignore[no-untyped-def]
    """Return the smallest and the largest depth in each tile of pixels; infinity and 0 without depth."""
    height, width = depth.shape
    shape = (height - 1) // TILE_PX + 1, (width - 1) // TILE_PX + 1
    nearest, farthest = np.full(shape, np.float32(np.inf)), np.zeros(shape, np.float32)
    low, high = np.empty(width, np.float32), np.empty(width, np.float32)
    for row in range(shape[0]):
        # Rows are joined first: of them the compiler joins many pixels at once.
        low[:], high[:] = np.float32(np.inf), np.float32(0)
        for v in range(row * TILE_PX, min((row + 1) * TILE_PX, height)):
            depths = depth[v]
            for u in range(width):
                low[u] = min(low[u], depths[u] if depths[u] > 0 else np.float32(np.inf))
                high[u] = max(high[u], depths[u])
        for column in range(shape[1]):
            for u in range(column * TILE_PX, min((column + 1) * TILE_PX, width)):
                nearest[row, column] = min(nearest[row, column], low[u])
                farthest[row, column] = max(farthest[row, column], high[u])
    return nearest, farthest


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _visible(  # type: ignore[no-untyped-def]
    blocks, block_m, clear_to, farthest, T, intrinsics, width, height, truncation_m
):
    """Compute `visible_blocks` from an axis-aligned box around each block in the camera frame.

    Both `clear_to` and `farthest` have a value for each tile of pixels, metres: the depth up to which voxels
    can only be free, and the depth of the farthest surface that updates voxels (0: none). `T` (4, 4) maps the
    volume's frame to the camera. `blocks` (n, 3) are block coordinates, and `block_m` is a block's edge,
    metres. `intrinsics`, `width` and `height` are those of the image; `truncation_m` is in metres.
    """
    seen = np.zeros(len(blocks), np.uint8)
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
            seen[b] = SEEN if far > 0 else 0
        else:
            # The tiles of the pixels that voxels in the box round to.
            by_near, by_far = 1 / near, 1 / far
            left, right = _span(fx, x - half[0], x + half[0], by_near, by_far, cx, width)
            top, bottom = _span(fy, y - half[1], y + half[1], by_near, by_far, cy, height)
            if _any_beyond(farthest, left, right, top, bottom, near - truncation_m):
                seen[b] = CLEAR if _all_beyond(clear_to, left, right, top, bottom, far) else SEEN
    return seen


@numba.njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _span(focal, low, high, by_near, by_far, middle, count):  # type: ignore[no-untyped-def]
    """Return the first and last tile, along one image axis, of the pixels to which a box projects.

    The box lies at `low` to `high` along that axis, metres; `by_near` and `by_far` are 1 / its nearest and
    farthest z. `middle` is the principal point, `count` the width or height of the image, pixels.
    """
    first = focal * min(low * by_near, low * by_far) + middle - 0.5
    last = focal * max(high * by_near, high * by_far) + middle + 1
    return int(max(first, 0.0)) // TILE_PX, int(np.floor(min(last, count - 1.0) / TILE_PX))


@numba.njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _any_beyond(farthest, left, right, top, bottom, depth_m):  # type: ignore[no-untyped-def]
    """Whether `farthest` is `depth_m` or more in any tile of a rectangle (inclusive); 0 means no depth."""
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            if farthest[row, column] > 0 and farthest[row, column] >= depth_m:
                return True
    return False


@numba.njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _all_beyond(clear_to, left, right, top, bottom, depth_m):  # type: ignore[no-untyped-def]
    """Whether voxels up to `depth_m` can only be free (`clear_to`) in all tiles of a rectangle, inclusive."""
    least = np.float32(np.inf)
    for row in range(top, bottom + 1):
        for column in range(left, right + 1):
            least = min(least, clear_to[row, column])
        if least < depth_m:
            return False
    return True

"""The fusion kernel: one depth frame into the blocks of a volume."""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.fusion.blocks import BLOCK_VOXELS, BlockVolume
from kinectbench.fusion.pixel_weights import BORDER_PX, pixel_weights
from kinectbench.fusion.visible_blocks import visible_blocks
from kinectbench.geometry import Camera, invert_rigid
from kinectbench.geometry.depth_noise import SIGMA_GROWTH_PER_M, SIGMA_NEAR_DEPTH_M, SIGMA_NEAR_M

SURFACE_SIGMAS = 2.0
HALF_DIAGONAL = 0.87
# A frame's vote is one addition: a voxel's two counts lie in one integer.
FREE_VOTE, SURFACE_VOTE, NO_VOTE = np.int32(1), np.int32(1 << 16), np.int32(0)
SLAB_VOXELS = BLOCK_VOXELS * BLOCK_VOXELS
NEAREST_M = np.float32(1e-3)
BEHIND_CAMERA_M = np.float32(1e6)
SURFACE_SIGMAS_SQUARED = np.float32(SURFACE_SIGMAS**2)
FAST = {"contract", "arcp", "nsz", "reassoc"}


def integrate(
    volume: BlockVolume,
    depth_m: NDArray[np.float32],
    camera: Camera,
    T_world_camera: NDArray[np.float64],
    truncation_m: float,
    pose_sigma_m: float = 0.0,
) -> None:
    """Fuse one frame into the volume's arrays (in place: this is the one hot loop of fusion).

    A voxel at camera depth z whose nearest pixel measures d has the projective signed distance
    s = d - z (Curless & Levoy 1996). It is averaged with weight 1 / sigma^2 where s >= -truncation,
    clipped at +truncation; sigma holds the noise of the depth and of the pose. A frame votes `surface`
    where |s| <= max(2 sigma, half a voxel's diagonal) and `free` in front of that. Voxels behind the
    surface get nothing.

    Args:
        volume: blocks to fuse into.
        depth_m: (height, width) float32, metres along z, 0 = none.
        camera: pinhole intrinsics; pixel centres are integers, so the lookup rounds to nearest.
        T_world_camera: (4, 4).
        truncation_m: TSDF truncation, metres.
        pose_sigma_m: by how much the frame's pose may be off, metres.
    """
    T_camera_grid = invert_rigid(T_world_camera) @ volume.T_world_grid
    seen = visible_blocks(volume, depth_m, camera, T_camera_grid, truncation_m)
    pixels = pixel_weights(depth_m, camera, pose_sigma_m)
    # Half a pixel more, and cutting off the fraction rounds to the nearest pixel.
    offset_px = BORDER_PX + 0.5
    lens = np.array([camera.fx, camera.fy, camera.cx + offset_px, camera.cy + offset_px], np.float32)
    tsdf, weight, votes = (
        values.reshape(-1, BLOCK_VOXELS, SLAB_VOXELS)
        for values in (volume.tsdf, volume.weight, volume.votes.view(np.int32))
    )
    noise_m = _noise_m(volume.voxel_size_m, pose_sigma_m)
    _integrate(
        seen, volume.blocks, tsdf, weight, votes, pixels, T_camera_grid, lens,
        np.float32(volume.voxel_size_m), np.float32(truncation_m), noise_m,
    )  # fmt: skip


def _noise_m(voxel_size_m: float, pose_sigma_m: float) -> NDArray[np.float32]:
    """What the width of the `surface` vote is made of: depth noise (a, b, c), pose, half a diagonal."""
    depth = (SIGMA_NEAR_M, SIGMA_GROWTH_PER_M, SIGMA_NEAR_DEPTH_M)
    return np.array([*depth, pose_sigma_m, HALF_DIAGONAL * voxel_size_m], np.float32)


@numba.njit(cache=True, error_model="numpy", fastmath=FAST)
def _integrate(  # type: ignore[no-untyped-def]
    seen, blocks, tsdf, weight, votes, pixels, T, lens, voxel, truncation, noise
):
    """Slab by slab of 16 x 16 voxels, in three steps: project, fetch, update.

    Apart, the compiler can vectorise the first and the last; and a slab at a time, because a vector that is
    read right after its parts were written stalls the processor.
    """
    pixel = np.empty(SLAB_VOXELS, np.uint32)
    z = np.empty(SLAB_VOXELS, np.float32)
    depth, added = np.empty(SLAB_VOXELS, np.float32), np.empty(SLAB_VOXELS, np.float32)
    height, width = pixels.shape[:2]
    of_pixel = pixels.reshape(-1, 2)
    for b in seen:
        for i in range(BLOCK_VOXELS):
            _project(pixel, z, blocks[b], i, T, lens, voxel, width, height)
            for n in range(SLAB_VOXELS):
                depth[n] = of_pixel[pixel[n], 0]
                added[n] = of_pixel[pixel[n], 1]
            _update(tsdf[b, i], weight[b, i], votes[b, i], depth, added, z, truncation, noise)


@numba.njit(cache=True, error_model="numpy", fastmath=FAST)
def _project(pixel, z, block, i, T, lens, voxel, width, height):  # type: ignore[no-untyped-def]
    """Depth and pixel of each voxel of a slab; outside of the image a pixel of its border, which is empty."""
    f32 = np.float32
    right, bottom, row_length = f32(width - 1), f32(height - 1), np.int32(width)
    fx, fy, cx, cy = lens[0], lens[1], lens[2], lens[3]
    across, down, along = f32(T[0, 2]) * voxel, f32(T[1, 2]) * voxel, f32(T[2, 2]) * voxel
    gx = (block[0] * BLOCK_VOXELS + i + 0.5) * voxel
    gz = (block[2] * BLOCK_VOXELS + 0.5) * voxel
    for j in range(BLOCK_VOXELS):
        gy = (block[1] * BLOCK_VOXELS + j + 0.5) * voxel
        x0 = f32(T[0, 0] * gx + T[0, 1] * gy + T[0, 2] * gz + T[0, 3])
        y0 = f32(T[1, 0] * gx + T[1, 1] * gy + T[1, 2] * gz + T[1, 3])
        z0 = f32(T[2, 0] * gx + T[2, 1] * gy + T[2, 2] * gz + T[2, 3])
        for k in range(BLOCK_VOXELS):
            ahead = z0 + along * f32(k)
            inverse = f32(1) / max(ahead, NEAREST_M)
            u = fx * (x0 + across * f32(k)) * inverse + cx
            v = fy * (y0 + down * f32(k)) * inverse + cy
            column = np.int32(min(max(u, f32(0)), right))
            row = np.int32(min(max(v, f32(0)), bottom))
            pixel[j * BLOCK_VOXELS + k] = np.uint32(row * row_length + column)
            z[j * BLOCK_VOXELS + k] = ahead if ahead > NEAREST_M else BEHIND_CAMERA_M


@numba.njit(cache=True, error_model="numpy", fastmath=FAST)
def _update(tsdf, weight, votes, depth, added, z, truncation, noise):  # type: ignore[no-untyped-def]
    """Average the distances of a slab into it and count the votes; overwrites `added` and `z`."""
    near, growth, near_depth, pose, half_diagonal = noise[0], noise[1], noise[2], noise[3], noise[4]
    distance = z
    any_added = np.float32(0)
    for n in range(SLAB_VOXELS):
        distance[n] = depth[n] - z[n]
        added[n] = added[n] if distance[n] >= -truncation else np.float32(0)
        any_added += added[n]
    if any_added == 0:
        return
    for n in range(SLAB_VOXELS):
        total = weight[n] + added[n]
        share = added[n] / max(total, np.float32(1e-20))
        tsdf[n] += (min(distance[n], truncation) - tsdf[n]) * share
        weight[n] = total
        sigma = near + growth * (depth[n] - near_depth) * (depth[n] - near_depth)
        # (max(2 sigma, half a diagonal))^2
        reach = max(SURFACE_SIGMAS_SQUARED * (sigma * sigma + pose * pose), half_diagonal * half_diagonal)
        ahead = FREE_VOTE if distance[n] > 0 else NO_VOTE
        vote = SURFACE_VOTE if distance[n] * distance[n] <= reach else ahead
        votes[n] += vote if added[n] > 0 else NO_VOTE

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
SLAB_CELLS, BLOCK_CELLS = BLOCK_VOXELS**2, BLOCK_VOXELS**3
# A pixel's depth and weight are fetched at once: the two halves of 64 bits.
LOWER_HALF, HALF_BITS = np.uint64(0xFFFFFFFF), np.uint64(32)
NEAREST_M = np.float32(1e-3)
BEHIND_CAMERA_M = np.float32(1e6)
# Twice the noise of a depth of 8 m.
BEFORE_FAR_M = np.float32(0.25)
SURFACE_SIGMAS_SQUARED = np.float32(SURFACE_SIGMAS**2)
FAST = {"contract", "arcp", "nsz", "reassoc"}


def integrate(
    volume: BlockVolume,
    depth_m: NDArray[np.float32],
    camera: Camera,
    T_world_camera: NDArray[np.float64],
    truncation_m: float,
    pose_sigma_m: float = 0.0,
    farthest_m: float = np.inf,
) -> None:
    """Fuse one frame into the volume's arrays (in place: this is the one hot loop of fusion).

    A voxel at camera depth z whose nearest pixel measures d has the projective signed distance
    s = d - z (Curless & Levoy 1996). It is averaged with weight 1 / sigma^2 where s >= -truncation,
    clipped at +truncation; sigma holds the noise of the depth and of the pose. A frame votes `surface`
    where |s| <= max(2 sigma, half a voxel's diagonal) and `free` in front of that. Voxels behind the
    surface get nothing. Of a pixel beyond `farthest_m` only voxels a quarter of a metre in front of it hear:
    they are free.

    Args:
        volume: blocks to fuse into.
        depth_m: (height, width) float32, metres along z, 0 = none.
        camera: pinhole intrinsics; pixel centres are integers, so the lookup rounds to nearest.
        T_world_camera: (4, 4).
        truncation_m: TSDF truncation, metres.
        pose_sigma_m: by how much the frame's pose may be off, metres.
        farthest_m: depth beyond it is not fused as a surface, metres.
    """
    T_camera_grid = invert_rigid(T_world_camera) @ volume.T_world_grid
    seen = visible_blocks(volume, depth_m, camera, T_camera_grid, truncation_m)
    pixels = pixel_weights(depth_m, camera, pose_sigma_m, farthest_m)
    # Pixel coordinates times z, but for the principal point; its half a pixel more, and cutting off the
    # fraction, round to the nearest pixel.
    to_pixels = np.diag([camera.fx, camera.fy, 1.0]) @ T_camera_grid[:3]
    middle_px = np.array([camera.cx, camera.cy], np.float32) + np.float32(BORDER_PX + 0.5)
    tsdf, weight, votes = (
        values.reshape(-1, BLOCK_CELLS)
        for values in (volume.tsdf, volume.weight, volume.votes.view(np.int32))
    )
    noise_m = _noise_m(volume.voxel_size_m, pose_sigma_m)
    _integrate(
        seen, volume.blocks, tsdf, weight, votes, pixels.view(np.uint64)[..., 0], to_pixels, middle_px,
        volume.voxel_size_m, np.float32(truncation_m), noise_m,
    )  # fmt: skip


def _noise_m(voxel_size_m: float, pose_sigma_m: float) -> NDArray[np.float32]:
    """What the width of the `surface` vote is made of: depth noise (a, b, c), pose, half a diagonal."""
    depth = (SIGMA_NEAR_M, SIGMA_GROWTH_PER_M, SIGMA_NEAR_DEPTH_M)
    return np.array([*depth, pose_sigma_m, HALF_DIAGONAL * voxel_size_m], np.float32)


@numba.njit(cache=True, error_model="numpy", fastmath=FAST)
def _integrate(  # type: ignore[no-untyped-def]
    seen, blocks, tsdf, weight, votes, pixels, to_pixels, middle, voxel, truncation, noise
):
    """Block by block in three steps: project, fetch, update.

    Apart, the compiler can vectorise the first and the last.
    """
    index = np.empty(BLOCK_CELLS, np.uint32)
    fetched = np.empty(BLOCK_CELLS, np.uint64)
    z = np.empty(BLOCK_CELLS, np.float32)
    depth, added = np.empty(BLOCK_CELLS, np.float32), np.empty(BLOCK_CELLS, np.float32)
    inside = _inside_block(to_pixels, voxel)
    corner = np.empty(3, np.float32)
    height, width = pixels.shape
    of_pixel = pixels.reshape(-1)
    for b in seen:
        gx, gy, gz = blocks[b]
        for axis in range(3):
            row = to_pixels[axis]
            corner[axis] = (row[0] * gx + row[1] * gy + row[2] * gz) * (BLOCK_VOXELS * voxel) + row[3]
        _project(index, z, corner, inside, middle, width, height)
        for n in range(BLOCK_CELLS):
            fetched[n] = of_pixel[index[n]]
        _update(tsdf[b], weight[b], votes[b], fetched, depth, added, z, truncation, noise)


@numba.njit(cache=True, error_model="numpy")
def _inside_block(to_pixels, voxel):  # type: ignore[no-untyped-def]
    """What lies between a block's corner and the centre of each voxel, projected: (3, 512) float32."""
    inside = np.empty((3, BLOCK_CELLS), np.float32)
    for axis in range(3):
        for n in range(BLOCK_CELLS):
            i, j, k = n // SLAB_CELLS, n // BLOCK_VOXELS % BLOCK_VOXELS, n % BLOCK_VOXELS
            row = to_pixels[axis]
            inside[axis, n] = voxel * (row[0] * (i + 0.5) + row[1] * (j + 0.5) + row[2] * (k + 0.5))
    return inside


@numba.njit(cache=True, error_model="numpy", fastmath=FAST)
def _project(index, z, corner, inside, middle, width, height):  # type: ignore[no-untyped-def]
    """Depth and pixel of each voxel of a block; beside the image, a pixel of its border, which is empty."""
    f32 = np.float32
    right, bottom, row_length = f32(width - 1), f32(height - 1), np.int32(width)
    across, down, along = inside[0], inside[1], inside[2]
    for n in range(BLOCK_CELLS):
        ahead = corner[2] + along[n]
        inverse = f32(1) / max(ahead, NEAREST_M)
        u = (corner[0] + across[n]) * inverse + middle[0]
        v = (corner[1] + down[n]) * inverse + middle[1]
        column = np.int32(min(max(u, f32(0)), right))
        row = np.int32(min(max(v, f32(0)), bottom))
        index[n] = np.uint32(row * row_length + column)
        z[n] = ahead if ahead > NEAREST_M else BEHIND_CAMERA_M


@numba.njit(cache=True, error_model="numpy", fastmath=FAST)
def _update(tsdf, weight, votes, fetched, depth, added, z, truncation, noise):  # type: ignore[no-untyped-def]
    """Average the distances of a block into it and count the votes; overwrites `depth`, `added` and `z`."""
    near, growth, near_depth, pose, half_diagonal = noise[0], noise[1], noise[2], noise[3], noise[4]
    distance = z
    any_added = np.float32(0)
    for n in range(BLOCK_CELLS):
        depth[n] = np.uint32(fetched[n] & LOWER_HALF).view(np.float32)
        distance[n] = depth[n] - z[n]
        added_here = np.uint32(fetched[n] >> HALF_BITS).view(np.float32)
        least = -truncation if added_here >= 0 else BEFORE_FAR_M
        added[n] = abs(added_here) if distance[n] >= least else np.float32(0)
        any_added += added[n]
    if any_added == 0:
        return
    for n in range(BLOCK_CELLS):
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

"""The fusion kernel: one depth frame into the blocks of a volume."""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.fusion.blocks import BLOCK_VOXELS, BlockVolume
from kinectbench.geometry import Camera, invert_rigid
from kinectbench.geometry.depth_noise import SIGMA_GROWTH_PER_M, SIGMA_NEAR_DEPTH_M, SIGMA_NEAR_M

SURFACE_SIGMAS = 2.0


def integrate(
    volume: BlockVolume,
    depth_m: NDArray[np.float32],
    camera: Camera,
    T_world_camera: NDArray[np.float64],
    truncation_m: float,
) -> None:
    """Fuse one frame into the volume's arrays (in place: this is the one hot loop of fusion).

    A voxel at camera depth z whose nearest pixel measures d has the projective signed distance
    s = d - z (Curless & Levoy 1996). It is averaged with weight 1 / sigma(d)^2 where s > -truncation,
    clipped at +truncation. A frame votes `surface` where |s| <= max(2 sigma(d), half a voxel's
    diagonal) and `free` in front of that. Voxels behind the surface get nothing.

    Args:
        volume: blocks to fuse into.
        depth_m: (height, width) float32, metres along z, 0 = none.
        camera: pinhole intrinsics; pixel centres are integers, so the lookup rounds to nearest.
        T_world_camera: (4, 4).
        truncation_m: TSDF truncation, metres.
    """
    T_camera_grid = invert_rigid(T_world_camera) @ volume.T_world_grid
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
    _integrate(
        volume.blocks, volume.tsdf, volume.weight, volume.free, volume.surface,
        depth_m, T_camera_grid, intrinsics, volume.voxel_size_m, truncation_m,
    )  # fmt: skip


@numba.njit(cache=True, error_model="numpy")
def _integrate(  # type: ignore[no-untyped-def]
    blocks, tsdf, weight, free, surface, depth, T, intrinsics, voxel, truncation
):
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    radius = 0.5 * np.sqrt(3.0) * BLOCK_VOXELS * voxel
    # The frustum's side planes, as slopes: a block whose sphere lies outside one is skipped.
    left, right = -(cx + 0.5) / fx, (width - 0.5 - cx) / fx
    top, bottom = -(cy + 0.5) / fy, (height - 0.5 - cy) / fy
    side = np.sqrt(1.0 + np.array([left, right, top, bottom]) ** 2)
    deepest = depth.max() + truncation
    for b in range(blocks.shape[0]):
        ox = (blocks[b, 0] * BLOCK_VOXELS + 0.5) * voxel
        oy = (blocks[b, 1] * BLOCK_VOXELS + 0.5) * voxel
        oz = (blocks[b, 2] * BLOCK_VOXELS + 0.5) * voxel
        half = 0.5 * (BLOCK_VOXELS - 1) * voxel
        mx, my, mz = ox + half, oy + half, oz + half
        bx = T[0, 0] * mx + T[0, 1] * my + T[0, 2] * mz + T[0, 3]
        by = T[1, 0] * mx + T[1, 1] * my + T[1, 2] * mz + T[1, 3]
        bz = T[2, 0] * mx + T[2, 1] * my + T[2, 2] * mz + T[2, 3]
        if bz + radius <= 0.0 or bz - radius > deepest:
            continue
        if left * bz - bx > radius * side[0] or bx - right * bz > radius * side[1]:
            continue
        if top * bz - by > radius * side[2] or by - bottom * bz > radius * side[3]:
            continue
        for i in range(BLOCK_VOXELS):
            for j in range(BLOCK_VOXELS):
                gx, gy = ox + i * voxel, oy + j * voxel
                x0 = T[0, 0] * gx + T[0, 1] * gy + T[0, 2] * oz + T[0, 3]
                y0 = T[1, 0] * gx + T[1, 1] * gy + T[1, 2] * oz + T[1, 3]
                z0 = T[2, 0] * gx + T[2, 1] * gy + T[2, 2] * oz + T[2, 3]
                for k in range(BLOCK_VOXELS):
                    step = k * voxel
                    z = z0 + T[2, 2] * step
                    if z <= 0.0:
                        continue
                    u = fx * (x0 + T[0, 2] * step) / z + cx + 0.5
                    v = fy * (y0 + T[1, 2] * step) / z + cy + 0.5
                    if u < 0.0 or v < 0.0 or u >= width or v >= height:
                        continue
                    d = depth[int(v), int(u)]
                    distance = d - z
                    if d <= 0.0 or distance < -truncation:
                        continue
                    spread = d - SIGMA_NEAR_DEPTH_M
                    sigma = SIGMA_NEAR_M + SIGMA_GROWTH_PER_M * spread * spread
                    margin = max(SURFACE_SIGMAS * sigma, 0.87 * voxel)
                    if distance > margin:
                        free[b, i, j, k] += 1
                    elif distance >= -margin:
                        surface[b, i, j, k] += 1
                    w = 1e-6 / (sigma * sigma)
                    old = weight[b, i, j, k]
                    tsdf[b, i, j, k] += (min(distance, truncation) - tsdf[b, i, j, k]) * w / (old + w)
                    weight[b, i, j, k] = old + w

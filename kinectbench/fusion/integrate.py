"""The fusion kernel: one depth frame into the blocks of a volume."""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.fusion.blocks import BLOCK_VOXELS, BlockVolume
from kinectbench.geometry import Camera, invert_rigid, transform_points
from kinectbench.geometry.depth_noise import depth_sigma_m

SURFACE_SIGMAS = 2.0
HALF_DIAGONAL = 0.87
SLANT_REACH_PX = 2
MAX_SLANT = np.float32(10)


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
    s = d - z (Curless & Levoy 1996). It is averaged with weight 1 / sigma^2 where s > -truncation,
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
    sigma_m = np.hypot(depth_sigma_m(depth_m), pose_sigma_m)
    # The weight is 0 where nothing was measured, so such a pixel changes nothing.
    along_axis_m = sigma_m * _slant(depth_m, camera)
    weight_per_mm2 = np.where(depth_m > 0, 1e-6 / along_axis_m**2, 0.0).astype(np.float32)
    margin_m = np.maximum(SURFACE_SIGMAS * sigma_m, HALF_DIAGONAL * volume.voxel_size_m).astype(np.float32)
    near = _blocks_in_view(volume, float(depth_m.max()) + truncation_m, camera, T_camera_grid)
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    _integrate(
        near, volume.blocks, volume.tsdf, volume.weight, volume.free, volume.surface,
        depth_m.reshape(-1), weight_per_mm2.reshape(-1), margin_m.reshape(-1), camera.width, camera.height,
        T_camera_grid, intrinsics, np.float32(volume.voxel_size_m), np.float32(truncation_m),
    )  # fmt: skip


def _slant(depth_m: NDArray[np.float32], camera: Camera) -> NDArray[np.float32]:
    """1 / cos of the angle between the viewing axis and the surface's normal, (height, width), at most 10.

    What is an error of x along the normal is x / cos along the axis; next to a depth edge, where pixels
    mix two surfaces, the slant is at its limit.
    """
    reach = SLANT_REACH_PX
    padded = np.pad(depth_m, reach, mode="edge")
    du = (padded[reach:-reach, 2 * reach :] - padded[reach:-reach, : -2 * reach]) / (2 * reach)
    dv = (padded[2 * reach :, reach:-reach] - padded[: -2 * reach, reach:-reach]) / (2 * reach)
    depth = np.maximum(depth_m, np.float32(1e-3))
    slope = np.hypot(du * np.float32(camera.fx) / depth, dv * np.float32(camera.fy) / depth)
    return np.minimum(np.hypot(slope, np.float32(1)), MAX_SLANT)


def _blocks_in_view(
    volume: BlockVolume, deepest_m: float, camera: Camera, T_camera_grid: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Indices of the blocks whose bounding sphere meets the camera's frustum."""
    size_m = BLOCK_VOXELS * volume.voxel_size_m
    x, y, z = transform_points(T_camera_grid, (volume.blocks + 0.5) * size_m).T
    radius_m = 0.5 * np.sqrt(3.0) * size_m
    inside = (z + radius_m > 0) & (z - radius_m < deepest_m)
    for across, focal_px, centre_px, count in (
        (x, camera.fx, camera.cx, camera.width),
        (y, camera.fy, camera.cy, camera.height),
    ):
        low, high = -(centre_px + 0.5) / focal_px, (count - 0.5 - centre_px) / focal_px
        inside &= low * z - across <= radius_m * np.hypot(1.0, low)
        inside &= across - high * z <= radius_m * np.hypot(1.0, high)
    return np.flatnonzero(inside)


@numba.njit(cache=True, error_model="numpy", fastmath={"contract", "arcp", "nsz", "reassoc"})
def _integrate(  # type: ignore[no-untyped-def]
    near,
    blocks,
    tsdf,
    weight,
    free,
    surface,
    depth,
    pixel_weight,
    pixel_margin,
    width,
    height,
    T,
    K,
    voxel,
    truncation,
):
    """Row by row of 16 voxels, in three steps that the compiler vectorises: project, look up, update."""
    f32 = np.float32
    zero, one = f32(0), f32(1)
    fx, fy, cx, cy = K[0], K[1], K[2] + f32(0.5), K[3] + f32(0.5)
    across, down, along = f32(T[0, 2]), f32(T[1, 2]), f32(T[2, 2])
    pixel = np.empty(BLOCK_VOXELS, np.int32)
    z, d, w, margin = np.empty((4, BLOCK_VOXELS), np.float32)
    for b in near:
        oz = (blocks[b, 2] * BLOCK_VOXELS + 0.5) * voxel
        for i in range(BLOCK_VOXELS):
            gx = (blocks[b, 0] * BLOCK_VOXELS + i + 0.5) * voxel
            for j in range(BLOCK_VOXELS):
                gy = (blocks[b, 1] * BLOCK_VOXELS + j + 0.5) * voxel
                x0 = f32(T[0, 0] * gx + T[0, 1] * gy + T[0, 2] * oz + T[0, 3])
                y0 = f32(T[1, 0] * gx + T[1, 1] * gy + T[1, 2] * oz + T[1, 3])
                z0 = f32(T[2, 0] * gx + T[2, 1] * gy + T[2, 2] * oz + T[2, 3])
                for k in range(BLOCK_VOXELS):
                    step = f32(k) * voxel
                    z[k] = z0 + along * step
                    inverse = one / max(z[k], f32(1e-3))
                    u = fx * (x0 + across * step) * inverse + cx
                    v = fy * (y0 + down * step) * inverse + cy
                    inside = (u >= zero) & (v >= zero) & (u < width) & (v < height) & (z[k] > f32(1e-3))
                    column = np.int32(min(max(u, zero), f32(width - 1)))
                    row = np.int32(min(max(v, zero), f32(height - 1)))
                    pixel[k] = row * np.int32(width) + column if inside else -1
                for k in range(BLOCK_VOXELS):
                    at = max(pixel[k], 0)
                    d[k], margin[k] = depth[at], pixel_margin[at]
                    w[k] = pixel_weight[at] if pixel[k] >= 0 else zero
                for k in range(BLOCK_VOXELS):
                    distance = d[k] - z[k]
                    measured = (w[k] > zero) & (distance >= -truncation)
                    added = w[k] if measured else zero
                    total = weight[b, i, j, k] + added
                    share = added / max(total, f32(1e-20))
                    tsdf[b, i, j, k] += (min(distance, truncation) - tsdf[b, i, j, k]) * share
                    weight[b, i, j, k] = total
                    ahead = distance > margin[k]
                    free[b, i, j, k] += np.uint16(measured & ahead)
                    surface[b, i, j, k] += np.uint16(measured & ~ahead & (distance >= -margin[k]))

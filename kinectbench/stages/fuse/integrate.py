"""The fusion kernel: integrates depth frames, with a weight for each pixel, into the blocks of a volume."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import islice

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import (
    SIGMA_GROWTH_PER_M,
    SIGMA_NEAR_DEPTH_M,
    SIGMA_NEAR_M,
    Camera,
    depth_sigma_m,
    invert_rigid,
)
from kinectbench.core.threads import ahead, in_parts
from kinectbench.core.types import Float32, Float64
from kinectbench.core.voxels.observation import FADING_VOXELS, HALF_DIAGONAL, HIDDEN_SHARE
from kinectbench.stages.fuse.blocks import BLOCK_VOXELS, BlockVolume
from kinectbench.stages.fuse.visible_blocks import BEHIND_SURFACE_SIGMAS, CLEAR, visible_blocks

# This many frames pass through each block while the block lies in the cache.
BATCH_FRAMES = 8
# Farther in front of a surface than this many standard deviations, a frame sees through: 2.3 % of normal
# noise lies there by itself.
SURFACE_SIGMAS = 2.0
BEHIND_SIGMAS = np.float32(BEHIND_SURFACE_SIGMAS)
HIDDEN = np.float32(HIDDEN_SHARE)
# A frame's weight is full within WINDOW_SIGMAS standard deviations of its depth, in front of the surface as
# well as behind it, or the zero crossing would shift. In front, it is full again beyond CLEAR_SIGMAS, where
# space is free. A simulated board of 12 mm that is seen from both sides (true poses, noise of 4.8 mm) comes
# out 2.3 mm too thick with a window of 2 behind and no limit in front, 1.4 mm with 1.5, and 1.0 mm with 1.2.
# But a narrow window also takes weight from good measurements: with tracked poses, F at 5 mm of the same
# shelf is .991 with 2, .992 with 1.5, and .990 with 1.2.
WINDOW_SIGMAS, CLEAR_SIGMAS = 1.5, 2.5
# A frame's vote is one addition: a voxel's two counts lie in one integer.
FREE_VOTE, SURFACE_VOTE, NO_VOTE = np.int32(1), np.int32(1 << 16), np.int32(0)
# Each count has 16 bits, and stops at the largest number in them.
VOTE_BITS, MOST_VOTES = np.uint32(16), np.uint32(0xFFFF)
# Voxels of a layer of a block, and of a block.
SLAB_CELLS, BLOCK_CELLS = BLOCK_VOXELS**2, BLOCK_VOXELS**3
# Voxels nearer to the camera's plane, or behind it, count as so far away that no depth reaches them.
NEAREST_M, BEHIND_CAMERA_M = np.float32(1e-3), np.float32(1e6)
# Twice the noise of a depth of 8 m.
BEFORE_FAR_M = np.float32(0.25)
# Weights are in 1/mm^2, all else in metres.
PER_MM2 = np.float32(1e6)
# Distances are compared squared.
SURFACE_SIGMAS_SQUARED = np.float32(SURFACE_SIGMAS**2)
FAST = {"contract", "arcp", "nsz", "reassoc"}
# What projects beside the image falls into its border, which has no depth.
BORDER_PX = 1
# A surface's slope is taken from pixels this far to either side: a Kinect's noise hardly correlates over
# four.
SLANT_REACH_PX = 2
# Next to a depth edge, where pixels mix two surfaces, 1 / cos has no bound: 84 degrees.
MAX_SLANT = 10.0


@dataclass(frozen=True)
class DepthFrame:
    """A depth image and its camera pose.

    Attributes:
        depth_m: (height, width) float32, metres along z, 0 = none.
        T_world_camera: (4, 4).
        pose_sigma_m: pose error (standard deviation) that lowers the frame's weight, metres.
        vote_sigma_m: pose error (standard deviation) that widens the range of `surface` votes, metres.
        closely: whether poses are accurate enough to reduce the weight close to the surface, on both sides.
    """

    depth_m: Float32
    T_world_camera: Float64
    pose_sigma_m: float
    vote_sigma_m: float
    closely: bool = True


def integrate(
    volume: BlockVolume,
    frames: Iterable[DepthFrame],
    camera: Camera,
    truncation_m: float,
    farthest_m: float = np.inf,
) -> None:
    """Fuse frames into the volume's arrays (in place: this is the one hot loop of fusion).

    A voxel at camera depth z whose nearest pixel measures d has the projective signed distance s = d - z
    (Curless & Levoy 1996). sigma is the standard deviation of s from the noise of depth and pose. s is
    clipped to +-truncation and averaged with weight (cos / sigma)^2, where cos is the cosine of the angle
    between the surface's normal and the viewing axis. Voxels are not updated if they lie behind the surface
    by more than the larger of the truncation and two standard deviations of the depth. With a smaller limit,
    the mean would lie too deep. Each updated voxel gets a vote: `free` if s > max(2 sigma, half a voxel's
    diagonal), else `surface`.

    A voxel that lies behind the surface, along its normal, by more than max(1.5 sigma, half a voxel's
    diagonal) is hidden: it may be solid or empty. There the frame's weight falls within half a voxel to a
    thousandth, so that frames from other directions decide. The weight falls in the same way in front of the
    surface, up to 2.5 sigma, because cutting noise on one side only would shift the mean. (If `closely` is
    false for a frame, the weight falls only behind the surface, beyond 2 sigma.)

    A pixel with depth beyond `farthest_m` only updates voxels at least 0.25 m in front of it, as free.

    Args:
        volume: blocks to fuse into.
        frames: depth images; a few at a time are held in memory.
        camera: pinhole intrinsics of all; pixel centres are integers, so the lookup rounds to nearest.
        truncation_m: TSDF truncation, metres.
        farthest_m: depth beyond it is not fused as a surface, metres.
    """
    remaining = iter(frames)
    # Depth and weight of every pixel; the border stays empty.
    padded = camera.height + 2 * BORDER_PX, camera.width + 2 * BORDER_PX
    pixels = np.zeros((BATCH_FRAMES, *padded, 2), np.float32)
    slope = np.array([camera.fx, camera.fy], np.float32) / np.float32(2 * SLANT_REACH_PX)
    while batch := list(islice(remaining, BATCH_FRAMES)):
        _fill_pixels(pixels, batch, slope, volume.voxel_size_m, farthest_m)
        _integrate_batch(volume, batch, pixels[: len(batch)], camera, truncation_m, farthest_m)


def _fill_pixels(
    pixels: Float32, batch: list[DepthFrame], slope: Float32, voxel_size_m: float, farthest_m: float
) -> None:
    noise_m = [_noise_m(voxel_size_m, frame) for frame in batch]

    def fill(start: int, stop: int) -> None:
        for n in range(start, stop):
            _set_pixels(pixels[n], batch[n].depth_m, slope, noise_m[n], np.float32(farthest_m))

    in_parts(fill, len(batch))


def _integrate_batch(
    volume: BlockVolume,
    batch: list[DepthFrame],
    pixels: Float32,
    camera: Camera,
    truncation_m: float,
    farthest_m: float,
) -> None:
    T_camera_grid = [invert_rigid(frame.T_world_camera) @ volume.T_world_grid for frame in batch]

    def visible(posed: tuple[DepthFrame, Float64]) -> NDArray[np.uint8]:
        frame, T = posed
        clear_m = _clear_m(frame, volume.voxel_size_m, truncation_m, farthest_m)
        return visible_blocks(volume, frame.depth_m, camera, T, truncation_m, clear_m)

    seen = np.stack(list(ahead(visible, zip(batch, T_camera_grid, strict=True))))
    # Pixel coordinates times z, except for the principal point; its half a pixel more, and cutting off the
    # fraction, round to the nearest pixel.
    to_pixels = np.stack([np.diag([camera.fx, camera.fy, 1.0]) @ T[:3] for T in T_camera_grid])
    middle_px = np.array([camera.cx, camera.cy], np.float32) + np.float32(BORDER_PX + 0.5)
    noise_m = np.stack([_noise_m(volume.voxel_size_m, frame) for frame in batch])
    tsdf, weight, votes = (
        values.reshape(-1, BLOCK_CELLS) for values in (volume.tsdf, volume.weight, volume.votes)
    )

    def part(start: int, stop: int) -> None:
        _integrate(
            start, stop, seen, volume.blocks, tsdf, weight, votes, pixels, to_pixels,
            middle_px, volume.voxel_size_m, np.float32(truncation_m), noise_m,
        )  # fmt: skip

    in_parts(part, len(volume.blocks))


def _noise_m(voxel_size_m: float, frame: DepthFrame) -> Float32:
    """Return a frame's parameters (9,) for the kernels, in metres and 1/m.

    In this order: SIGMA_NEAR_M, SIGMA_GROWTH_PER_M and SIGMA_NEAR_DEPTH_M of the noise of depth;
    `pose_sigma_m` and `vote_sigma_m`; half a voxel's diagonal; 1 / the distance within which the weight falls
    to its least; and two limits in standard deviations. The weight is full up to the first limit on both
    sides of the surface, and again beyond the second limit in front of it.
    """
    depth = (SIGMA_NEAR_M, SIGMA_GROWTH_PER_M, SIGMA_NEAR_DEPTH_M)
    poses = (frame.pose_sigma_m, frame.vote_sigma_m)
    fading_per_m = 1 / (FADING_VOXELS * voxel_size_m)
    window = (WINDOW_SIGMAS, CLEAR_SIGMAS) if frame.closely else (SURFACE_SIGMAS, 0.0)
    return np.array([*depth, *poses, HALF_DIAGONAL * voxel_size_m, fading_per_m, *window], np.float32)


def _clear_m(
    frame: DepthFrame, voxel_size_m: float, truncation_m: float, farthest_m: float
) -> Callable[[Float32], Float32]:
    """Make a function that returns how far in front of a measured depth `_add_clear` equals `_add`.

    The function's argument, the depth, and its result are in metres. The result holds for surfaces at any
    angle.
    """
    least_m = max(truncation_m, HALF_DIAGONAL * voxel_size_m)
    sigmas = MAX_SLANT * CLEAR_SIGMAS if frame.closely else SURFACE_SIGMAS

    def clear_m(depth_m: Float32) -> Float32:
        spread_m = np.sqrt(depth_sigma_m(depth_m) ** 2 + frame.vote_sigma_m**2)
        before_m = np.where(depth_m > farthest_m, max(least_m, float(BEFORE_FAR_M)), least_m)
        return np.asarray(np.maximum(sigmas * spread_m, before_m), np.float32)

    return clear_m


@numba.njit(cache=True, error_model="numpy", fastmath=FAST, nogil=True)
def _integrate(  # type: ignore[no-untyped-def]
    start, stop, seen, blocks, tsdf, weight, votes, pixels, to_pixels, middle, voxel, truncation, noise
):
    """Update blocks start to stop: for each frame project, fetch and add up; then merge once for all frames.

    These steps are separate loops, so that the compiler can vectorise all but the fetching. Each block passes
    through memory once for all frames.

    For f frames and n blocks: `seen` (f, n) as from `visible_blocks`; `blocks` (n, 3) block coordinates;
    `tsdf`, `weight` and `votes` (n, 512), changed in place; `noise` (f, 9) as from `_noise_m`. For each
    pixel, `pixels` (f, height, width, 2) float32 hold depth, metres, and weight; their border is empty.
    `to_pixels` (f, 3, 4) maps the volume's frame to camera axes, with x and y multiplied by fx and fy.
    `middle` (2,) is the principal point, moved for the border and for rounding. `voxel` (edge) and
    `truncation` are in metres.
    """
    index = np.empty(BLOCK_CELLS, np.uint32)
    weights, both = np.empty(BLOCK_CELLS, np.float32), np.empty(BLOCK_CELLS, np.uint64)
    measured = both.view(np.float32)
    z = np.empty(BLOCK_CELLS, np.float32)
    new_total, new_weight = np.zeros(BLOCK_CELLS, np.float32), np.zeros(BLOCK_CELLS, np.float32)
    new_votes = np.zeros(BLOCK_CELLS, np.int32)
    corner = np.empty(3, np.float32)
    frames, height, width, _ = pixels.shape
    of_pixel = pixels.reshape(frames, height * width, 2)
    both_of_pixel = pixels.reshape(frames, height * width * 2).view(np.uint64)
    inside = np.empty((frames, 3, BLOCK_CELLS), np.float32)
    for f in range(frames):
        _inside_block(inside[f], to_pixels[f], voxel)
    for b in range(start, stop):
        gx, gy, gz = blocks[b]
        any_new = False
        for f in range(frames):
            if seen[f, b]:
                for axis in range(3):
                    row = to_pixels[f, axis]
                    along = row[0] * gx + row[1] * gy + row[2] * gz
                    corner[axis] = along * (BLOCK_VOXELS * voxel) + row[3]
                _project(index, z, corner, inside[f], middle, width, height)
                if seen[f, b] == CLEAR:
                    for n in range(BLOCK_CELLS):
                        weights[n] = of_pixel[f, index[n], 1]
                    any_new |= _add_clear(new_total, new_weight, new_votes, weights, truncation)
                else:
                    for n in range(BLOCK_CELLS):
                        both[n] = both_of_pixel[f, index[n]]  # depth and weight at once
                    any_new |= _add(new_total, new_weight, new_votes, measured, z, truncation, noise[f])
        if any_new:
            _merge(tsdf[b], weight[b], new_total, new_weight)
            _count(votes[b], new_votes)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _inside_block(inside, to_pixels, voxel):  # type: ignore[no-untyped-def]
    """Set `inside` (3, 512) to the voxels' offsets in a block, rotated by `to_pixels` (3, 4)."""
    for axis in range(3):
        for n in range(BLOCK_CELLS):
            i, j, k = n // SLAB_CELLS, n // BLOCK_VOXELS % BLOCK_VOXELS, n % BLOCK_VOXELS
            row = to_pixels[axis]
            inside[axis, n] = voxel * (row[0] * (i + 0.5) + row[1] * (j + 0.5) + row[2] * (k + 0.5))


@numba.njit(cache=True, error_model="numpy", fastmath=FAST, nogil=True)
def _project(index, z, corner, inside, middle, width, height):  # type: ignore[no-untyped-def]
    """Set `z` (512,) and `index` (512,): depth, metres, and flat pixel index of each voxel of a block.

    Voxels outside the image get a pixel of the empty border. `corner` (3,) is the block's corner, and
    `inside` (3, 512) are the voxels' offsets from it; both in camera axes, with x and y multiplied by fx and
    fy. `middle` (2,) is the principal point, moved for rounding; `width` and `height` include the border.
    """
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


@numba.njit(cache=True, error_model="numpy", fastmath=FAST, nogil=True)
def _add(new_total, new_weight, new_votes, measured, z, truncation, noise):  # type: ignore[no-untyped-def]
    """Add a frame's weighted distances, weights and votes to a block's sums; return whether any was added.

    The sums (512,) are of weight * distance, of weights, and of votes. `measured` (1024,) holds depth and
    weight of the pixel to which each voxel projects, by turns. `z` (512,) is each voxel's depth, metres.
    `noise` (9,) is as from `_noise_m`.
    """
    f32 = np.float32
    near, growth, near_depth, pose, vote_pose = noise[0], noise[1], noise[2], noise[3], noise[4]
    half_diagonal, fading_per_m, window, clear = noise[5], noise[6], noise[7], noise[8]
    any_added = f32(0)
    for n in range(BLOCK_CELLS):
        depth, weight = measured[2 * n], measured[2 * n + 1]
        distance = depth - z[n]
        sigma = near + growth * (depth - near_depth) * (depth - near_depth)
        least = -max(truncation, BEHIND_SIGMAS * sigma) if weight >= 0 else BEFORE_FAR_M
        added = abs(weight) if distance >= least else f32(0)
        any_added += added
        # (max(2 sigma, half a diagonal))^2
        reach = max(
            SURFACE_SIGMAS_SQUARED * (sigma * sigma + vote_pose * vote_pose), half_diagonal * half_diagonal
        )
        vote = FREE_VOTE if distance > 0 and distance * distance > reach else SURFACE_VOTE
        new_votes[n] += vote if added > 0 else NO_VOTE
        # The weight holds the square of the cosine: along the normal, distances are shorter by that.
        along = distance * np.sqrt(added * PER_MM2 * (sigma * sigma + pose * pose))
        spread = np.sqrt(sigma * sigma + vote_pose * vote_pose)
        outside = abs(along) - max(window * spread, half_diagonal)
        share = max(min(f32(1) - outside * fading_per_m, f32(1)), HIDDEN)
        added *= share if along <= clear * spread else f32(1)
        new_total[n] += added * max(min(distance, truncation), -truncation)
        new_weight[n] += added
    return any_added > 0


@numba.njit(cache=True, error_model="numpy", fastmath=FAST, nogil=True)
def _add_clear(new_total, new_weight, new_votes, weights, truncation):  # type: ignore[no-untyped-def]
    """Add a frame to a block's sums as `_add` does, for a block far in front of all measured depth.

    There, each distance is the truncation and each vote is `free`.
    """
    any_added = np.float32(0)
    for n in range(BLOCK_CELLS):
        added = abs(weights[n])
        any_added += added
        new_votes[n] += FREE_VOTE if added > 0 else NO_VOTE
        new_total[n] += added * truncation
        new_weight[n] += added
    return any_added > 0


@numba.njit(cache=True, error_model="numpy", fastmath=FAST, nogil=True)
def _merge(tsdf, weight, new_total, new_weight):  # type: ignore[no-untyped-def]
    """Merge the sums of a batch into a block's means and weights, and reset the sums to zero.

    All are (512,): the block's `tsdf` and `weight`, and the sums of weight * distance and of weights.
    """
    for n in range(BLOCK_CELLS):
        total = weight[n] + new_weight[n]
        tsdf[n] = (tsdf[n] * weight[n] + new_total[n]) / max(total, np.float32(1e-20))
        weight[n] = total
        new_total[n], new_weight[n] = np.float32(0), np.float32(0)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _count(votes, new_votes):  # type: ignore[no-untyped-def]
    """Add the votes of a batch to a block's, each count up to 65,535, and reset the batch's to zero."""
    u32 = np.uint32
    for n in range(BLOCK_CELLS):
        old, new = votes[n], u32(new_votes[n])
        free = min((old & MOST_VOTES) + (new & MOST_VOTES), MOST_VOTES)
        surface = min((old >> VOTE_BITS) + (new >> VOTE_BITS), MOST_VOTES)
        votes[n] = free | (surface << VOTE_BITS)
        new_votes[n] = np.int32(0)


@numba.njit(cache=True, error_model="numpy", fastmath={"contract", "nsz", "reassoc"}, nogil=True)
def _set_pixels(pixels, depth_m, slope, noise, farthest):  # type: ignore[no-untyped-def]
    """Set depth and weight of every pixel inside the border.

    The weight is 1 / (sigma / cos)^2 in 1/mm^2, and 0 where nothing was measured. sigma is the noise of depth
    and pose. cos is the cosine of the angle between the surface's normal and the viewing axis: an error of x
    along the normal is x / cos along the axis. 1 / cos is computed from the pixels two to either side. It is
    limited to 10, because it has no bound at depth edges, where pixels mix two surfaces. Beyond `farthest`
    the weight is negative, which means that the pixel only marks voxels well in front of it as free.

    It works row by row on slices, because indices that may be negative stop the compiler from vectorising.

    `pixels` (height + 2, width + 2, 2) float32 are set; `depth_m` is (height, width), 0 = none. `slope` (2,)
    is fx and fy divided by the 4 pixels over which 1 / cos is measured; `noise` (9,) as from `_noise_m`.
    """
    f32 = np.float32
    height, width = depth_m.shape
    near, growth, near_depth, pose = noise[0], noise[1], noise[2], noise[3]
    padded = np.empty(width + 2 * SLANT_REACH_PX, np.float32)
    left, right = padded[: -2 * SLANT_REACH_PX], padded[2 * SLANT_REACH_PX :]
    for v in range(height):
        row_depth_m = depth_m[v]
        above, below = depth_m[max(v - SLANT_REACH_PX, 0)], depth_m[min(v + SLANT_REACH_PX, height - 1)]
        padded[:SLANT_REACH_PX], padded[-SLANT_REACH_PX:] = row_depth_m[0], row_depth_m[-1]
        padded[SLANT_REACH_PX:-SLANT_REACH_PX] = row_depth_m
        out = pixels[v + BORDER_PX, BORDER_PX:-BORDER_PX].reshape(-1)
        for u in range(width):
            d = row_depth_m[u]
            inverse = f32(1) / max(d, f32(1e-3))
            across = (right[u] - left[u]) * slope[0] * inverse
            down = (below[u] - above[u]) * slope[1] * inverse
            slant = min(f32(1) + across * across + down * down, f32(MAX_SLANT * MAX_SLANT))
            sigma = near + growth * (d - near_depth) * (d - near_depth)
            weight = f32(1e-6) / ((sigma * sigma + pose * pose) * slant)
            out[2 * u] = d
            out[2 * u + 1] = (weight if d <= farthest else -weight) if d > 0 else f32(0)

"""The stage `fuse`: all good frames into one surface of the whole scene."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.config import FusionSettings
from kinectbench.errors import TrackingError
from kinectbench.fusion.blocks import (
    BlockVolume,
    blocks_of_grid,
    dense_grid,
    empty_volume,
    unique_blocks,
)
from kinectbench.fusion.color import color_vertices
from kinectbench.fusion.integrate import DepthFrame, integrate
from kinectbench.fusion.mesh import extract_mesh
from kinectbench.fusion.pixel_weights import MAX_SLANT
from kinectbench.fusion.visible_blocks import blocks_near_surface
from kinectbench.fusion.vote_trust import POSE_SIGMAS, ray_width_m, trust_in_votes
from kinectbench.geometry import Grid, TriangleMesh
from kinectbench.sequence import Sequence
from kinectbench.tracking.trajectory import Trajectory

Progress = Callable[[int, int], None]

# Surface of less than this share of the median weight was seen too badly to show. A surface that two of five
# frames see at the steepest slant that still counts has about as much.
LEAST_WEIGHT_SHARE = 0.4 / MAX_SLANT**2
# Depth is believed to be beyond the fused range up to so many times that, and up to the distance for which
# integrate's quarter of a metre is enough; farther, it is often none at all.
FAR_RANGES, FARTHEST_M = 2.0, 8.0


@dataclass(frozen=True)
class Reconstruction:
    """The fused scene.

    Attributes:
        volume: TSDF, weights and votes near the surfaces; its frame is the world.
        mesh: the surface, world frame, metres, coloured where colour is registered to depth.
    """

    volume: BlockVolume
    mesh: TriangleMesh


@dataclass(frozen=True)
class Observation:
    """What the frames say about every voxel of a dense grid; arrays have the grid's shape.

    Attributes:
        grid: the voxels.
        tsdf: float32, metres, positive in front of the surface; 0 where weight is 0.
        weight: float32, 1/mm^2; 0 = never observed.
        free: uint16, frames that saw through.
        surface: uint16, frames that measured a surface there, or less than the truncation before it.
    """

    grid: Grid
    tsdf: NDArray[np.float32]
    weight: NDArray[np.float32]
    free: NDArray[np.uint16]
    surface: NDArray[np.uint16]


def fuse(
    sequence: Sequence, trajectory: Trajectory, settings: FusionSettings, progress: Progress | None = None
) -> Reconstruction:
    """Fuse every good frame (Curless & Levoy 1996, block-sparse) and extract the surface.

    Raises:
        TrackingError: no frame has a pose.
    """
    frames = trajectory.good_frames
    if len(frames) == 0:
        raise TrackingError("no frame has a pose: nothing to fuse; trajectory/health.json has the reasons")
    voxel_size_m = settings.scene_voxel_size_m
    truncation_m = _truncation_m(trajectory, voxel_size_m, settings)
    found, distances_m = [], []
    for index in frames:
        depth_m = usable_depth_m(sequence, int(index), settings)
        if depth_m.any():
            distances_m.append(np.median(depth_m[depth_m > 0]))
        T_world_camera = trajectory.T_world_camera[index]
        near = blocks_near_surface(depth_m, sequence.camera, T_world_camera, truncation_m, voxel_size_m)
        found.append(near)
    blocks = unique_blocks(np.concatenate(found).astype(np.int64))
    volume = empty_volume(blocks, voxel_size_m, np.eye(4))
    _integrate_frames(volume, sequence, trajectory, frames, settings, progress)
    crossed = (volume.weight > 0) & (np.abs(volume.tsdf) < voxel_size_m)
    least = LEAST_WEIGHT_SHARE * float(np.median(volume.weight[crossed])) if crossed.any() else 0.0
    distance_m = float(np.median(distances_m)) if distances_m else 0.0
    width_m = ray_width_m(sequence.camera, trajectory, distance_m)
    mesh = extract_mesh(volume, min_weight=least, trust=trust_in_votes(width_m, voxel_size_m))
    return Reconstruction(volume, color_vertices(mesh, sequence, trajectory))


def observe(
    sequence: Sequence,
    trajectory: Trajectory,
    frames: Iterable[int],
    grid: Grid,
    settings: FusionSettings,
    progress: Progress | None = None,
) -> Observation:
    """Fuse frames into a dense grid, so that empty space has votes, too.

    Depth beyond the range that is fused says that all before it is free: under a table's top the cameras look
    at a floor farther away than the table.

    Args:
        sequence: the recording.
        trajectory: poses.
        frames: which frames.
        grid: sides must be multiples of 8 cells.
        settings: depth range, truncation (in voxels of this grid).
        progress: called with (done, total).
    """
    volume = empty_volume(blocks_of_grid(grid), grid.voxel_size_m, grid.T_world_grid)
    _integrate_frames(volume, sequence, trajectory, list(frames), settings, progress, far=True)
    return Observation(
        grid,
        tsdf=dense_grid(volume.tsdf, grid.shape),
        weight=dense_grid(volume.weight, grid.shape),
        free=dense_grid(volume.free, grid.shape),
        surface=dense_grid(volume.surface, grid.shape),
    )


def merge(first: Observation, second: Observation) -> Observation:
    """What two disjoint sets of frames say together: weighted mean of the TSDFs, sums of the votes."""
    weight = first.weight + second.weight
    total = first.tsdf * first.weight + second.tsdf * second.weight
    tsdf = np.divide(total, weight, out=np.zeros_like(total), where=weight > 0)
    return Observation(first.grid, tsdf, weight, first.free + second.free, first.surface + second.surface)


def usable_depth_m(
    sequence: Sequence, index: int, settings: FusionSettings, far: bool = False
) -> NDArray[np.float32]:
    """Depth of a frame in metres, 0 outside the range that is fused; `far`: with what lies beyond it."""
    depth_m, farthest_m = sequence.depth_m(index), settings.max_depth_m
    if far:
        farthest_m = max(farthest_m, min(FAR_RANGES * farthest_m, FARTHEST_M))
    depth_m[(depth_m < settings.min_depth_m) | (depth_m > farthest_m)] = 0.0
    return depth_m


def _truncation_m(trajectory: Trajectory, voxel_size_m: float, settings: FusionSettings) -> float:
    """Truncation of the TSDF: some voxels, but no less than three times the poses' uncertainty.

    Frames that are off by more than the truncation would not be averaged: they would leave a second surface.
    """
    return max(settings.truncation_voxels * voxel_size_m, POSE_SIGMAS * trajectory.usual_pose_sigma_m)


def _integrate_frames(
    volume: BlockVolume,
    sequence: Sequence,
    trajectory: Trajectory,
    frames: Iterable[int],
    settings: FusionSettings,
    progress: Progress | None,
    far: bool = False,
) -> None:
    truncation_m = _truncation_m(trajectory, volume.voxel_size_m, settings)
    chosen = [int(index) for index in frames]

    def read() -> Iterator[DepthFrame]:
        for done, index in enumerate(chosen, start=1):
            depth_m = usable_depth_m(sequence, index, settings, far)
            yield DepthFrame(depth_m, trajectory.T_world_camera[index], trajectory.pose_sigma_m(index))
            if progress:
                progress(done, len(chosen))

    integrate(volume, read(), sequence.camera, truncation_m, settings.max_depth_m)

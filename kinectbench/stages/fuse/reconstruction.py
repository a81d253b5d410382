"""The stage `fuse`: fuses good frames, evenly spread, into one surface of the whole scene."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import TrackingError
from kinectbench.core.artefacts.reconstruction import DepthRangePart, ReconstructionFile
from kinectbench.core.geometry import Grid, TriangleMesh, write_ply
from kinectbench.core.sequence import Sequence
from kinectbench.core.threads import ahead
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float32, Int32, Progress
from kinectbench.core.voxels.npz import npz_bytes
from kinectbench.core.voxels.observation import (
    Observation,
    evident_weight,
    pose_reach_m,
    ray_width_m,
    trust_in_votes,
)
from kinectbench.settings.models import FusionSettings
from kinectbench.stages.fuse.blocks import (
    BlockVolume,
    blocks_of_grid,
    dense_grid,
    empty_volume,
    in_cubes,
    unique_blocks,
)
from kinectbench.stages.fuse.depth_range import (
    FARTHEST_M,
    depth_range_of,
    grid_range_m,
    range_warnings,
    some_frames,
)
from kinectbench.stages.fuse.integrate import MAX_SLANT, DepthFrame, integrate
from kinectbench.stages.fuse.mesh import color_vertices, extract_mesh
from kinectbench.stages.fuse.visible_blocks import blocks_near_surface

# Surface of less than this share of the median weight was seen too badly to show. A surface that two of five
# frames see at the steepest angle that still counts has about as much.
LEAST_WEIGHT_SHARE = 0.4 / MAX_SLANT**2
# Depth is believed to be beyond the fused range up to this many times that, and up to 8 m, for which
# integrate's quarter of a metre is enough.
FAR_RANGES = 2.0
# Edge of the scene's voxels where the settings give none: the finer one where the frames' rays are narrower.
# On simulated objects F at 5 mm rises from 0.897 to 0.945 (bookshelf), 0.937 to 0.975 (mug) and 0.888 to
# 0.903 (lamp); fusing takes 20 to 55 % longer.
FINE_VOXEL_M, COARSE_VOXEL_M = 0.0075, 0.01
# Where usual poses are less certain, whole frames lie off, and their noise is not cut closely: else faces of
# a real cabinet (10 mm) come out less flat. The limit is that of good poses in `stages.track.verdict`.
CLOSE_POSE_SIGMA_M = 0.005
# The object is found in the scene, and afterwards fused from all frames. The scene of a longer recording is
# fused from this many frames, but at least one in ten: three a second at 30 Hz. Of 1,000 frames around a
# chair, 300 give an F at 5 mm of .9945 in a third of the time, and all give .9947.
SCENE_FRAMES, SCENE_STEP = 300, 10
# The typical distance is the median over this many frames.
DISTANCE_FRAMES = 60


@dataclass(frozen=True)
class Reconstruction:
    """The fused scene.

    Attributes:
        volume: TSDF, weights and votes near the surfaces; its frame is the world.
        mesh: the surface, world frame, metres, coloured where colour is registered to depth.
        depth_range: the largest depth that was fused, and the share of the depth beyond it.
    """

    volume: BlockVolume
    mesh: TriangleMesh
    depth_range: DepthRangePart


def fuse(
    sequence: Sequence, trajectory: Trajectory, settings: FusionSettings, progress: Progress | None = None
) -> Reconstruction:
    """Fuse good frames (Curless & Levoy 1996, block-sparse) and extract the surface.

    At most 300 frames, or a tenth of the good frames if that is more, are fused, evenly spread. Unless the
    settings give the largest depth, it is chosen from the recording (`depth_range`).

    Raises:
        TrackingError: no frame has a pose.
    """
    frames = trajectory.good_frames
    if len(frames) == 0:
        raise TrackingError("no frame has a pose: nothing to fuse; trajectory/health.json has the reasons")
    chosen = depth_range_of(sequence, frames, trajectory.T_world_camera[frames], settings)
    settings = settings.model_copy(update={"max_depth_m": chosen.max_depth_m})
    distance_m = _usual_distance_m(sequence, frames, settings)
    width_m = ray_width_m(sequence.camera, trajectory.median_pose_sigma_m, distance_m)
    voxel_size_m = settings.scene_voxel_size_m or scene_voxel_size_m(width_m)
    truncation_m = _truncation_m(trajectory, voxel_size_m, settings)
    frames = some_frames(frames, max(SCENE_FRAMES, len(frames) // SCENE_STEP))

    def near_surface(index: np.int64) -> Int32:
        depth_m = usable_depth_m(sequence, int(index), settings)
        T_world_camera = trajectory.T_world_camera[index]
        return blocks_near_surface(depth_m, sequence.camera, T_world_camera, truncation_m, voxel_size_m)

    blocks = unique_blocks(np.concatenate(list(ahead(near_surface, frames))).astype(np.int64))
    volume = empty_volume(blocks, voxel_size_m, np.eye(4))
    _integrate_frames(volume, sequence, trajectory, frames, settings, progress)
    crossed = (volume.weight > 0) & (np.abs(volume.tsdf) < voxel_size_m)
    least = LEAST_WEIGHT_SHARE * float(np.median(volume.weight[crossed])) if crossed.any() else 0.0
    mesh = extract_mesh(volume, min_weight=least, trust=trust_in_votes(width_m, voxel_size_m))
    return Reconstruction(volume, color_vertices(mesh, sequence, trajectory), chosen)


def scene_voxel_size_m(ray_width_m: float) -> float:
    """Return the edge of the scene's voxels, metres: 7.5 mm if rays are narrower than that, else 10 mm."""
    return FINE_VOXEL_M if ray_width_m < FINE_VOXEL_M else COARSE_VOXEL_M


def write_reconstruction(reconstruction: Reconstruction, folder: Path) -> None:
    """Write mesh.ply, reconstruction.json, and volume.npz with blocks joined to cubes of 16^3 voxels.

    volume.npz: `blocks` (n, 3) int32, `tsdf` and `weight` (n, 16, 16, 16) float16 in metres and 1/mm^2,
    `free` and `surface` (n, 16, 16, 16) uint16 votes, `voxel_size_m`, `T_world_grid` (4, 4).
    """
    volume = reconstruction.volume
    write_ply(reconstruction.mesh, folder / "mesh.ply")
    chosen = reconstruction.depth_range
    ReconstructionFile(depth_range=chosen, warnings=range_warnings(chosen)).write(folder)
    values = {
        "tsdf": volume.tsdf.astype(np.float16),
        "weight": np.minimum(volume.weight, 6e4).astype(np.float16),
        "free": volume.free,
        "surface": volume.surface,
    }
    cubes = {name: in_cubes(volume.blocks, of_blocks) for name, of_blocks in values.items()}
    arrays = {
        "format_version": np.asarray(1),
        "blocks": cubes["tsdf"][0],
        **{name: of_cubes for name, (_, of_cubes) in cubes.items()},
        "voxel_size_m": np.asarray(volume.voxel_size_m),
        "T_world_grid": volume.T_world_grid,
    }
    (folder / "volume.npz").write_bytes(npz_bytes(arrays, level=1))


def observe(
    sequence: Sequence,
    trajectory: Trajectory,
    frames: Iterable[int],
    grid: Grid,
    settings: FusionSettings,
    progress: Progress | None = None,
) -> Observation:
    """Fuse frames into a dense grid, including votes for empty space.

    Depth is fused as a surface up to the farthest point of the grid (`grid_range_m`), unless the settings
    give the largest depth. Depth beyond that only marks the space in front of it as free. An example is the
    space under a table's top, through which the cameras see a floor that is farther away than the table. The
    grid's sides must be multiples of 8 cells; the truncation is in its voxels.
    """
    frames = np.asarray(list(frames), np.int64)
    max_depth_m = grid_range_m(trajectory.T_world_camera[frames], grid, settings)
    settings = settings.model_copy(update={"max_depth_m": max_depth_m})
    volume = empty_volume(blocks_of_grid(grid), grid.voxel_size_m, grid.T_world_grid)
    _integrate_frames(volume, sequence, trajectory, frames, settings, progress, far=True)
    tsdf, weight = dense_grid(volume.tsdf, grid.shape), dense_grid(volume.weight, grid.shape)
    return Observation(
        grid,
        tsdf=tsdf,
        weight=evident_weight(tsdf, weight, grid.voxel_size_m),
        free=dense_grid(volume.free, grid.shape),
        surface=dense_grid(volume.surface, grid.shape),
    )


def _usual_distance_m(sequence: Sequence, frames: NDArray[np.int64], settings: FusionSettings) -> float:
    """Return the median of some frames' median depths, metres; 0 if none of these frames has depth."""
    chosen = frames[np.unique(np.linspace(0, len(frames) - 1, DISTANCE_FRAMES).round().astype(int))]
    depths_m = ahead(lambda index: usable_depth_m(sequence, int(index), settings), chosen)
    medians_m = [np.median(depth_m[depth_m > 0]) for depth_m in depths_m if depth_m.any()]
    return float(np.median(medians_m)) if medians_m else 0.0


def usable_depth_m(sequence: Sequence, index: int, settings: FusionSettings, far: bool = False) -> Float32:
    """Return the depth of a frame, metres, 0 outside the fused range.

    With `far`, depth is kept up to twice the end of that range, but not beyond 8 m.
    """
    depth_m, farthest_m = sequence.depth_m(index), _max_depth_m(settings)
    if far:
        farthest_m = max(farthest_m, min(FAR_RANGES * farthest_m, FARTHEST_M))
    depth_m *= (depth_m >= settings.min_depth_m) & (depth_m <= farthest_m)  # faster than by a mask
    return depth_m


def _max_depth_m(settings: FusionSettings) -> float:
    return np.inf if settings.max_depth_m is None else settings.max_depth_m


def _truncation_m(trajectory: Trajectory, voxel_size_m: float, settings: FusionSettings) -> float:
    """Return the truncation of the TSDF, metres: some voxels, but at least three sigma of the poses.

    If poses were off by more than the truncation, their surfaces would not be averaged but remain as double
    surfaces. Poses that were not checked do not widen it: see `pose_reach_m`.
    """
    return max(settings.truncation_voxels * voxel_size_m, pose_reach_m(trajectory.median_pose_sigma_m))


def _pose_sigmas_m(trajectory: Trajectory, frame: int) -> tuple[float, float]:
    """Return two standard deviations of a frame's pose, metres: for its weight, and for `surface` votes.

    For the weight, an unchecked pose gets the largest plausible error. In the votes, such an error would
    cancel `free` votes near the surface, so an unchecked pose gets the median error of the checked poses. If
    no pose was checked, both are 0 and only the noise of depth counts. With 20 mm for all poses, near pixels
    counted no more than far pixels, and the box around a simulated object of half a metre was 4 to 11 mm
    larger on each axis.
    """
    usual_m = trajectory.median_pose_sigma_m
    if trajectory.pose_sigma_m is None or usual_m is None:
        return 0.0, 0.0
    sigma_m = float(trajectory.pose_sigma_m[frame])
    return trajectory.assumed_pose_sigma_m(frame), usual_m if np.isnan(sigma_m) else sigma_m


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
    closely = (trajectory.median_pose_sigma_m or 0.0) <= CLOSE_POSE_SIGMA_M
    chosen = [int(index) for index in frames]

    def posed(index: int) -> DepthFrame:
        depth_m = usable_depth_m(sequence, index, settings, far)
        sigmas_m = _pose_sigmas_m(trajectory, index)
        return DepthFrame(depth_m, trajectory.T_world_camera[index], *sigmas_m, closely)

    def read() -> Iterator[DepthFrame]:
        for done, frame in enumerate(ahead(posed, chosen), start=1):
            yield frame
            if progress:
                progress(done, len(chosen))

    integrate(volume, read(), sequence.camera, truncation_m, _max_depth_m(settings))
    beside_m = sequence.beside_m
    if far and beside_m is not None:
        # Depth beside the object votes for free space in front of it, but makes no surface.
        beside = (
            DepthFrame(beside_m(index), trajectory.T_world_camera[index], *_pose_sigmas_m(trajectory, index))
            for index in chosen
        )
        integrate(volume, beside, sequence.camera, truncation_m, farthest_m=0.0)

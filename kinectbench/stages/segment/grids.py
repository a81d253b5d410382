"""The two grids of an object, a fine one around it and a coarse one around that, and what their cells are."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import Camera, Grid, OrientedBox, rigid, transform_points
from kinectbench.core.geometry.boxes import yaw_rotation
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float64, Int64
from kinectbench.core.voxels.observation import Observation, ray_width_m
from kinectbench.settings.models import FloorCuts
from kinectbench.stages.segment.evidence import FloorLayers
from kinectbench.stages.segment.floor import Floor, floor_cut_m, low_cut_m

# Around the object, or as many voxels as this has of the usual ones if that is less.
MARGIN_M, MARGIN_VOXELS = 0.05, 10
FLOOR_LAYERS = 4
SURROUND_FACTOR = 4
# Free space far from the object is seen by nearly every frame: some of them are enough.
SURROUND_FRAMES = 40
# Of the fine grid in all, and of the coarse one along an axis: a laptop's memory.
MAX_VOXELS, MAX_SURROUND_CELLS = 1 << 26, 400
# The sides of both are multiples of it: fusion works in blocks of 8.
CUBE_VOXELS = 16


def object_grid(box: OrientedBox, floor: Floor, voxel_size_m: float, *, given: bool = False) -> Grid:
    """The fine grid around a box (`given`: a person's): aligned with it, four cells below the floor.

    Raises:
        SegmentationError: it would take more than 2^26 voxels: over a minute, and more than 5 GB.
    """
    margin_m = min(MARGIN_M, MARGIN_VOXELS * voxel_size_m)
    size_m = np.array(box.size_m) + 2 * margin_m
    size_m[2] = box.center_m[2] + box.size_m[2] / 2 + margin_m + FLOOR_LAYERS * voxel_size_m
    blocks = np.ceil(size_m / (voxel_size_m * CUBE_VOXELS))  # as floats: as integers the product may overflow
    if blocks.prod() > MAX_VOXELS // CUBE_VOXELS**3:
        what, advice = "the object", "give a box around the object"
        if given:
            what, advice = "with its margin the given box", "give a smaller one, close around the object,"
        raise SegmentationError(
            f"{what} is {size_m[0]:.1f} x {size_m[1]:.1f} x {size_m[2]:.1f} m: too large for voxels of "
            f"{voxel_size_m * 1000:.0f} mm; {advice} in benchmark.yaml, or larger voxels"
        )
    nx, ny, nz = (int(n) * CUBE_VOXELS for n in blocks)
    turn = yaw_rotation(box.yaw_rad)
    corner = turn @ np.array([-nx / 2, -ny / 2, 0.0]) * voxel_size_m
    corner += [box.center_m[0], box.center_m[1], -FLOOR_LAYERS * voxel_size_m]
    return Grid((nx, ny, nz), voxel_size_m, floor.T_world_floor @ rigid(turn, corner))


def floor_layers(floor: Floor, segmentation: FloorCuts, voxel_size_m: float) -> FloorLayers:
    """Which layers of an object's grid are floor, contact with it, and low parts of the object.

    Args:
        floor: of the recording; its noise says how low an object's parts can be told from it.
        segmentation: both cuts.
        voxel_size_m: of the grid.
    """
    cut = max(1, round(floor_cut_m(floor, segmentation) / voxel_size_m))
    # Rounded up: what lies below the low cut may be the floor.
    low_m = low_cut_m(floor, segmentation)
    contact = min(max(1, int(np.ceil(low_m / voxel_size_m - 1e-6))), cut)
    return FloorLayers(FLOOR_LAYERS, contact, cut - contact)


def usual_ray_width_m(camera: Camera, trajectory: Trajectory, middle_world: Float64) -> float:
    """How wide the frames' rays are at a point (3,), at their median distance from it, metres."""
    cameras_world = trajectory.T_world_camera[trajectory.good_frames, :3, 3]
    distance_m = float(np.median(np.linalg.norm(cameras_world - middle_world, axis=1)))
    return ray_width_m(camera, trajectory.median_pose_sigma_m, distance_m)


def surround_frames(frames: Int64) -> Int64:
    """At most 40 of the good frames (n,), evenly spread."""
    some: Int64 = frames[np.unique(np.linspace(0, len(frames) - 1, SURROUND_FRAMES).astype(int))]
    return some


def surround_grid(grid: Grid, floor: Floor) -> Grid:
    """A coarse grid that holds every cube a pair in framing `object` can have, whatever its orientation.

    Its cells are four voxels wide, around very large objects wider.
    """
    radius_m = 0.5 * float(np.linalg.norm(grid.size_m))
    half_m = 1.1 * np.sqrt(3.0) * radius_m
    factor = max(SURROUND_FACTOR, int(np.ceil(2 * half_m / (MAX_SURROUND_CELLS * grid.voxel_size_m))))
    voxel_m = factor * grid.voxel_size_m
    side = int(np.ceil(2 * half_m / (voxel_m * CUBE_VOXELS))) * CUBE_VOXELS
    middle_world = transform_points(grid.T_world_grid, grid.size_m / 2)
    rotation = floor.T_world_floor[:3, :3]
    corner = middle_world - rotation @ np.full(3, side * voxel_m / 2)
    return Grid((side, side, side), voxel_m, rigid(rotation, corner))


def surround_labels(around: Observation, floor: Floor | None) -> NDArray[np.uint8]:
    """FREE where frames saw through, OTHER at measured surfaces and below the floor, if any, else UNKNOWN."""
    labels = np.full(around.grid.shape, Label.UNKNOWN, np.uint8)
    labels[(around.weight > 0) & (around.tsdf <= 0)] = Label.OTHER
    labels[((around.weight > 0) & (around.tsdf > 0)) | (around.free >= 2)] = Label.FREE
    if floor is None:
        return labels
    # The grid is upright: heights depend on the last axis only.
    origin_floor = transform_points(floor.T_floor_world, around.grid.T_world_grid[:3, 3])
    heights_m = origin_floor[2] + (np.arange(around.grid.shape[2]) + 0.5) * around.grid.voxel_size_m
    labels[:, :, heights_m < 0] = Label.OTHER
    return labels

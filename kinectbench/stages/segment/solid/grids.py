"""The grids of an object: their voxel size, extent and layers, and the labels of the coarse grid."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import SegmentationError
from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import Camera, Grid, OrientedBox, rigid, transform_points, yaw_rotation
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float64
from kinectbench.core.voxels.observation import RAY_WIDTHS_VOXELS, Observation, ray_width_m
from kinectbench.settings.models import FloorCuts, FusionSettings
from kinectbench.stages.segment.find.floor import Floor
from kinectbench.stages.segment.find.scale import enlarged_transform
from kinectbench.stages.segment.solid.evidence import BLURRED_PIXELS, FloorLayers

# Margin around the object; less where this many voxels are less.
MARGIN_M, MARGIN_VOXELS = 0.05, 10
# Layers below the floor: more than the two that smoothing the solid reaches, so that feet are not rounded.
FLOOR_LAYERS = 4
# Voxels along a cell of the coarse grid, which only tells what is far from the object.
SURROUND_FACTOR = 4
# Half the side of the coarse grid, in radii of the ball around the fine one's cube, so that no ray misses it.
SURROUND_RADII = 1.1
# Largest number of voxels of the fine grid, and of cells of the coarse one along an axis: a laptop's memory.
MAX_VOXELS, MAX_SURROUND_CELLS = 1 << 26, 400
# The sides of both grids are multiples of it: fusion works in blocks of 8.
CUBE_VOXELS = 16
# The rules for solids were chosen on furniture with these voxels. Larger ones are taken only where a person
# says so. A small thing recorded from near is enlarged until it is as many voxels long as furniture.
REFERENCE_VOXEL_M = 0.005
# Below this, noise leaves nothing to resolve, however near the camera (chosen by hand).
LEAST_VOXEL_M = 0.001
# An object is to be this many voxels long: a thing of 40 cm on a table has the reference voxels (chosen by
# hand; with 5 mm a mug's wall is one and a half voxels).
VOXELS_LONG = 80
# Voxels are multiples of it.
STEP_M = 0.00025


def object_grid(
    box: OrientedBox, floor: Floor, voxel_size_m: float, *, given: bool = False, layers: int = FLOOR_LAYERS
) -> Grid:
    """Return the fine grid around a box, aligned with it, from `layers` layers below the floor upwards.

    `given`, whether the user gave the box, only changes the message of the error.

    Raises:
        SegmentationError: the grid would have more than 2^26 voxels (over a minute, and more than 5 GB).
    """
    margin_m = min(MARGIN_M, MARGIN_VOXELS * voxel_size_m)
    size_m = np.array(box.size_m) + 2 * margin_m
    size_m[2] = box.center_m[2] + box.size_m[2] / 2 + margin_m + layers * voxel_size_m
    blocks = np.ceil(size_m / (voxel_size_m * CUBE_VOXELS))  # as floats: as integers the product may overflow
    if blocks.prod() > MAX_VOXELS // CUBE_VOXELS**3:
        what, advice = "the object", "give a box around the object"
        if given:
            what, advice = "with its margin the given box", "give a smaller one, close around the object,"
        raise SegmentationError(
            f"{what} is {size_m[0]:.1f} x {size_m[1]:.1f} x {size_m[2]:.1f} m: too large for voxels of "
            f"{voxel_size_m * 1000:.0f} mm; {advice} in benchmark.yaml, or larger voxels",
            what="too-large",
        )
    nx, ny, nz = (int(n) * CUBE_VOXELS for n in blocks)
    turn = yaw_rotation(box.yaw_rad)
    corner = turn @ np.array([-nx / 2, -ny / 2, 0.0]) * voxel_size_m
    corner += [box.center_m[0], box.center_m[1], -layers * voxel_size_m]
    return Grid((nx, ny, nz), voxel_size_m, floor.T_world_floor @ rigid(turn, corner))


def floor_layers(floor: Floor | None, segmentation: FloorCuts, voxel_size_m: float) -> FloorLayers:
    """Return how many layers of the object's grid lie about the floor; all are 0 if there is no floor."""
    if floor is None:
        return FloorLayers(below=0, contact=0)
    cut = max(1, round(floor.cut_m(segmentation) / voxel_size_m))
    # Rounded up, as a surface below the low cut may be the floor.
    low_m = floor.low_cut_m(segmentation)
    contact = min(max(1, int(np.ceil(low_m / voxel_size_m - 1e-6))), cut)
    return FloorLayers(FLOOR_LAYERS, contact, cut - contact)


def median_distance_m(trajectory: Trajectory, point_world: Float64) -> float:
    """Return the cameras' median distance from a point (3,), metres."""
    cameras_world = trajectory.T_world_camera[trajectory.good_frames, :3, 3]
    return float(np.median(np.linalg.norm(cameras_world - point_world, axis=1)))


def middle_world(grid: Grid) -> Float64:
    """Return the middle of a grid, (3,), world frame, metres."""
    return transform_points(grid.T_world_grid, grid.size_m / 2)


def blurred_height_m(camera: Camera, trajectory: Trajectory, grid: Grid) -> float:
    """Return the height up to which the sensor may close a gap between floor and object, metres."""
    return BLURRED_PIXELS * median_distance_m(trajectory, middle_world(grid)) / camera.fx


def surround_grid(grid: Grid, floor: Floor) -> Grid:
    """Return a coarse grid that holds the cube of any pair in framing `object`, in any orientation.

    Its cells are as wide as four voxels of `grid`, and wider around very large objects.
    """
    radius_m = 0.5 * float(np.linalg.norm(grid.size_m))
    half_m = SURROUND_RADII * np.sqrt(3.0) * radius_m
    factor = max(SURROUND_FACTOR, int(np.ceil(2 * half_m / (MAX_SURROUND_CELLS * grid.voxel_size_m))))
    voxel_m = factor * grid.voxel_size_m
    side = int(np.ceil(2 * half_m / (voxel_m * CUBE_VOXELS))) * CUBE_VOXELS
    rotation = floor.T_world_floor[:3, :3]
    corner = middle_world(grid) - rotation @ np.full(3, side * voxel_m / 2)
    return Grid((side, side, side), voxel_m, rigid(rotation, corner))


def surround_labels(around: Observation, floor: Floor | None) -> NDArray[np.uint8]:
    """Label the cells of the coarse grid; the first rule that holds decides.

    OTHER: below the floor, if there is one. FREE: in front of a surface, or seen through by two frames or
    more. OTHER: behind a surface. UNKNOWN: the rest.
    """
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


def choose_resolution(
    box: OrientedBox, floor: Floor, camera: Camera, trajectory: Trajectory, fusion: FusionSettings
) -> tuple[float, float]:
    """Choose the voxel size by the box and the frames' resolution, unless the settings state it.

    Voxels narrower than the frames' rays would wrongly appear to be seen through.

    Returns:
        Edge of a voxel, metres; and a scale: the solid is made in a world that is 1 / scale times as large,
        in which the voxels have the size for which the rules were chosen.
    """
    if fusion.voxel_size_m is not None:
        return fusion.voxel_size_m, 1.0
    distance_m = median_distance_m(trajectory, transform_points(floor.T_world_floor, np.array(box.center_m)))
    width_m = ray_width_m(camera, trajectory.median_pose_sigma_m, distance_m)
    wanted_m = max(max(box.size_m) / VOXELS_LONG, width_m / RAY_WIDTHS_VOXELS[0])
    steps = int(np.ceil(np.clip(wanted_m, LEAST_VOXEL_M, REFERENCE_VOXEL_M) / STEP_M - 1e-6))
    voxel_size_m = round(steps * STEP_M, 6)
    return voxel_size_m, voxel_size_m / REFERENCE_VOXEL_M


def enlarged_observation(seen: Observation, scale: float) -> Observation:
    """Return the same observation in a world that is 1 / scale times as large."""
    if scale == 1:
        return seen
    grid = seen.grid
    larger = Grid(grid.shape, grid.voxel_size_m / scale, enlarged_transform(grid.T_world_grid, scale))
    return replace(seen, grid=larger, tsdf=seen.tsdf / np.float32(scale))

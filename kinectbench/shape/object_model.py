"""The stage `segment`: floor, object, solid, labels and quality of one recording."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.config import FusionSettings, SegmentationSettings
from kinectbench.errors import SegmentationError
from kinectbench.fusion.blocks import CUBE_VOXELS
from kinectbench.fusion.reconstruction import Observation, merge, observe
from kinectbench.fusion.vote_trust import ray_width_m
from kinectbench.geometry import Grid, OrientedBox, TriangleMesh, rigid, transform_points
from kinectbench.geometry.box import yaw_rotation
from kinectbench.segmentation.floor import Floor
from kinectbench.segmentation.low_parts import low_cut_m
from kinectbench.segmentation.segment import Segmentation, segment
from kinectbench.sequence import Sequence
from kinectbench.shape.labels import Label
from kinectbench.shape.quality import measure_quality, surface_sigma_m
from kinectbench.shape.solid import FloorLayers, SolidShape, solidify
from kinectbench.shape.witness import witness
from kinectbench.tracking.trajectory import Trajectory

MARGIN_M = 0.05
FLOOR_LAYERS = 4
SURROUND_FACTOR = 4
# Free space far from the object is seen by nearly every frame: some of them are enough.
SURROUND_FRAMES = 40
# Of the fine grid in all, and of the coarse one along an axis: a laptop's memory.
MAX_VOXELS, MAX_SURROUND_CELLS = 1 << 26, 400
Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class ObjectModel:
    """The object, as every view will be compared with it.

    Attributes:
        floor: the floor and frame `floor`.
        box: upright box around the object, floor frame.
        shape: solid, labels, probability and closed mesh on a fine grid around the object.
        surround: coarse grid around that, as far as any pair's cube can reach.
        surround_labels: uint8 of the coarse grid's shape: FREE, OTHER or UNKNOWN.
        surface_sigma_m: standard deviation of the fused surface, metres.
        quality: figures about it, plain JSON values, as stored in quality.json.
    """

    floor: Floor
    box: OrientedBox
    shape: SolidShape
    surround: Grid
    surround_labels: NDArray[np.uint8]
    surface_sigma_m: float
    quality: dict[str, Any]


def build_object(
    sequence: Sequence,
    trajectory: Trajectory,
    scene: TriangleMesh,
    given_box: OrientedBox | None,
    segmentation: SegmentationSettings,
    fusion: FusionSettings,
    progress: Progress | None = None,
) -> ObjectModel:
    """Find the object in the fused scene and make it solid.

    The odd and the even frames are fused apart and then together, so that the shape's repeatability
    costs no further pass over the frames.

    Args:
        sequence: the recording.
        trajectory: its poses.
        scene: the fused scene's surface, world frame.
        given_box: a person's box (floor frame), or None to choose the object automatically.
        segmentation: floor and object settings.
        fusion: voxel size and depth range.
        progress: called with (done, total).

    Raises:
        SegmentationError: no floor, no object, or a box with nothing in it.
        ShapeError: no solid can be made.
    """
    chosen = segment(scene, trajectory, given_box, segmentation)
    grid = object_grid(chosen.box, chosen.floor, fusion.voxel_size_m, given=given_box is not None)
    frames = trajectory.good_frames
    halves = [observe(sequence, trajectory, frames[start::2], grid, fusion, progress) for start in (0, 1)]
    excluded = chosen.excluded(grid, given_box)
    layers = floor_layers(chosen.floor, segmentation, fusion.voxel_size_m)
    middle_world = transform_points(grid.T_world_grid, grid.size_m / 2)
    away_m = np.linalg.norm(trajectory.T_world_camera[frames, :3, 3] - middle_world, axis=1)
    width_m = ray_width_m(sequence.camera, trajectory, float(np.median(away_m)))
    odd, even = (solidify(half, excluded, layers, width_m) for half in halves)
    sigma_m = surface_sigma_m(*halves)
    together = merge(*halves)
    # Of a large object each of them is a gigabyte.
    del halves
    whole = solidify(together, excluded, layers, width_m)
    seen = witness(sequence, trajectory, scene, chosen)
    # Given poses are taken at their word.
    pose_sigma_m = 0.0 if trajectory.source == "trust" else trajectory.usual_pose_sigma_m
    quality = measure_quality(chosen, (whole, odd, even), sigma_m, seen, pose_sigma_m)
    surround = surround_grid(grid, chosen)
    some = frames[np.unique(np.linspace(0, len(frames) - 1, SURROUND_FRAMES).astype(int))]
    around = observe(sequence, trajectory, some, surround, fusion)
    labels = surround_labels(around, chosen.floor)
    return ObjectModel(chosen.floor, quality.box, whole, surround, labels, sigma_m, quality.figures)


def object_grid(box: OrientedBox, floor: Floor, voxel_size_m: float, *, given: bool = False) -> Grid:
    """The fine grid around a box (`given`: a person's): aligned with it, four cells below the floor.

    Raises:
        SegmentationError: it would take more than 2^26 voxels: over a minute, and more than 5 GB.
    """
    size_m = np.array(box.size_m) + 2 * MARGIN_M
    size_m[2] = box.center_m[2] + box.size_m[2] / 2 + MARGIN_M + FLOOR_LAYERS * voxel_size_m
    blocks = np.ceil(size_m / (voxel_size_m * CUBE_VOXELS)).astype(int)
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


def floor_layers(floor: Floor, segmentation: SegmentationSettings, voxel_size_m: float) -> FloorLayers:
    """Which layers of an object's grid are floor, contact with it, and low parts of the object.

    Args:
        floor: of the recording; its noise says how low an object's parts can be told from it.
        segmentation: both cuts.
        voxel_size_m: of the grid.
    """
    cut = max(1, round(segmentation.floor_cut_m / voxel_size_m))
    # Rounded up: what lies below the low cut may be the floor.
    low_m = low_cut_m(floor, segmentation)
    contact = min(max(1, int(np.ceil(low_m / voxel_size_m - 1e-6))), cut)
    return FloorLayers(FLOOR_LAYERS, contact, cut - contact)


def surround_grid(grid: Grid, chosen: Segmentation) -> Grid:
    """A coarse grid that holds every cube a pair in framing `object` can have, whatever its orientation.

    Its cells are four voxels wide, around very large objects wider.
    """
    radius_m = 0.5 * float(np.linalg.norm(grid.size_m))
    half_m = 1.1 * np.sqrt(3.0) * radius_m
    factor = max(SURROUND_FACTOR, int(np.ceil(2 * half_m / (MAX_SURROUND_CELLS * grid.voxel_size_m))))
    voxel_m = factor * grid.voxel_size_m
    side = int(np.ceil(2 * half_m / (voxel_m * CUBE_VOXELS))) * CUBE_VOXELS
    middle_world = transform_points(grid.T_world_grid, grid.size_m / 2)
    rotation = chosen.floor.T_world_floor[:3, :3]
    corner = middle_world - rotation @ np.full(3, side * voxel_m / 2)
    return Grid((side, side, side), voxel_m, rigid(rotation, corner))


def surround_labels(around: Observation, floor: Floor) -> NDArray[np.uint8]:
    """FREE where frames saw through, OTHER at measured surfaces and below the floor, else UNKNOWN."""
    labels = np.full(around.grid.shape, Label.UNKNOWN, np.uint8)
    labels[(around.weight > 0) & (around.tsdf <= 0)] = Label.OTHER
    labels[((around.weight > 0) & (around.tsdf > 0)) | (around.free >= 2)] = Label.FREE
    # The grid is upright: heights depend on the last axis only.
    origin_floor = transform_points(floor.T_floor_world, around.grid.T_world_grid[:3, 3])
    heights_m = origin_floor[2] + (np.arange(around.grid.shape[2]) + 0.5) * around.grid.voxel_size_m
    labels[:, :, heights_m < 0] = Label.OTHER
    return labels

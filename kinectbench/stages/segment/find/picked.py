"""The point on the object that the user picked, as a pixel of a frame."""

from typing import NamedTuple

import numpy as np

from kinectbench.core import SegmentationError
from kinectbench.core.geometry import Camera, transform_points
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float32, Float64
from kinectbench.stages.segment.find.object import Segmentation

# A hand does not click more exactly: ten pixels of a picture that is shown at 320 of 640 columns are twenty.
NEAR_PX = 20
PICK_AGAIN = "pick a pixel on the object, or remove `pick` from benchmark.yaml"
ANOTHER = "pick one of another frame, or remove `pick` from benchmark.yaml"
# A picked point belongs to the object if it lies within this many cells (30 mm; less where cameras were near)
# of the middle of one that holds its surface: a cell that touches it, and the noise of a pixel's depth.
BESIDE_CELLS = 2


class PickedPoint(NamedTuple):
    """A point that the user picked in a frame.

    Attributes:
        frame: number of the frame in the recording.
        pixel: column and row.
        point_world: (3,) the surface point that the pixel shows, world frame, metres.
    """

    frame: int
    pixel: tuple[int, int]
    point_world: Float64


def point_under(depth_m: Float32, camera: Camera, pixel: tuple[int, int]) -> Float64 | None:
    """Return the surface point (3,) that a pixel shows, or the nearest pixel with depth; camera frame.

    The unit is metres. The result is None if no pixel within 20 pixels has depth.

    Args:
        depth_m: (height, width), 0 = none.
        camera: of the depth.
        pixel: column and row.
    """
    rows, columns = np.nonzero(depth_m)
    away_px = np.hypot(columns - pixel[0], rows - pixel[1])
    if not len(rows) or away_px.min() > NEAR_PX:
        return None
    row, column = (each[away_px.argmin()] for each in (rows, columns))
    return np.asarray(camera.rays_at(column, row) * float(depth_m[row, column]))


def picked_point(
    sequence: Sequence, trajectory: Trajectory, frame: int, pixel: tuple[int, int]
) -> PickedPoint:
    """Find the surface point that a pixel of a frame shows, or else the nearest pixel with depth.

    Args:
        sequence: the recording.
        trajectory: the recording's poses.
        frame: number of the frame among the recording's depth frames, from 0, damaged ones included.
        pixel: column and row.

    Raises:
        SegmentationError: there is no such frame or pixel, the frame was damaged or has no pose, or there is
            no depth near the pixel.
    """
    camera, recorded = sequence.camera, sequence.recorded or range(len(sequence))
    if frame > recorded[-1]:
        raise _bad(frame, pixel, f"there is no whole frame {frame}: the last one is {recorded[-1]}")
    if frame not in recorded:
        raise _bad(frame, pixel, f"frame {frame} is damaged, and was left out", ANOTHER)
    if pixel[0] >= camera.width or pixel[1] >= camera.height:
        raise _bad(frame, pixel, f"depth has {camera.width} x {camera.height} pixels")
    index = recorded.index(frame)
    T_world_camera = trajectory.T_world_camera[index]
    if not np.isfinite(T_world_camera).all():
        raise _bad(frame, pixel, f"frame {frame} has no pose", ANOTHER)
    found = point_under(sequence.depth_m(index), camera, pixel)
    if found is None:
        raise _bad(frame, pixel, f"there is no depth within {NEAR_PX} pixels of it")
    return PickedPoint(frame, pixel, transform_points(T_world_camera, found))


def check_picked(picked: PickedPoint, chosen: Segmentation) -> None:
    """Refuse an object that does not lie at the picked point.

    Raises:
        SegmentationError: the object lies elsewhere.
    """
    point_floor = transform_points(chosen.floor.T_floor_world, picked.point_world)
    middles_floor = (chosen.object_cells + 0.5) * chosen.cell_m
    beside_m = float(np.linalg.norm(middles_floor - point_floor, axis=1).min())
    if beside_m > BESIDE_CELLS * chosen.cell_m:
        shown = f"it shows the floor or something else, {beside_m:.2f} m beside the nearest thing"
        raise _bad(picked.frame, picked.pixel, f"{shown} that stands on the floor")


def _bad(frame: int, pixel: tuple[int, int], why: str, to_do: str = PICK_AGAIN) -> SegmentationError:
    value = f"{{frame: {frame}, pixel: [{pixel[0]}, {pixel[1]}]}}"
    return SegmentationError(f"pick: {value}: {why}; {to_do}", what="bad-pick")

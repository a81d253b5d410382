"""The point on the object that a person picked, as a pixel of a frame."""

import numpy as np

from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import Camera, transform_points
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float32, Float64

# A hand does not click more exactly: ten pixels of a picture that is shown at 320 of 640 columns are twenty.
NEAR_PX = 20
PICK_AGAIN = "name a pixel on the object under `pick` in benchmark.yaml"


def point_under(depth_m: Float32, camera: Camera, pixel: tuple[int, int]) -> Float64 | None:
    """The point (3,) of the nearest pixel with depth, camera frame, metres; None: there is none near by.

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


def picked_point(sequence: Sequence, trajectory: Trajectory, frame: int, pixel: tuple[int, int]) -> Float64:
    """The point (3,) that a pixel of a frame shows, world frame, metres.

    Raises:
        SegmentationError: the frame has no pose, or no depth near the pixel.
    """
    if frame >= len(sequence) or not np.isfinite(trajectory.T_world_camera[frame]).all():
        raise SegmentationError(f"pick: frame {frame} has no pose; {PICK_AGAIN}", what="bad-pick")
    found = point_under(sequence.depth_m(frame), sequence.camera, pixel)
    if found is None:
        raise SegmentationError(
            f"pick: frame {frame} has no depth within {NEAR_PX} pixels of {list(pixel)}; {PICK_AGAIN}",
            what="bad-pick",
        )
    return transform_points(trajectory.T_world_camera[frame], found)

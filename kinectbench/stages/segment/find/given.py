"""What the user states about the object: a box around it, a point on it, its plane and its underside.

A box has an anchor: the camera pose of one frame, which identifies the floor frame that it was chosen in.
"""

import hashlib
from dataclasses import dataclass, replace
from math import atan2
from typing import NamedTuple

import numpy as np

from kinectbench.core import SegmentationError
from kinectbench.core.artefacts.object import AnchoredBoxPart
from kinectbench.core.geometry import (
    BoxAnchor,
    Camera,
    OrientedBox,
    Pose,
    invert_rigid,
    quaternion_xyzw_from_rotation,
    rigid,
    rotation_from_quaternion_xyzw,
    transform_points,
)
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float32, Float64, Underside
from kinectbench.settings.edit import box_line
from kinectbench.settings.models import Vector4
from kinectbench.stages.segment.find.floor import Floor

CHOOSE = "choose it again by `kinectbench segment --suggest`"
# Two boxes or pieces whose sides lie this near to each other are the same place.
SAME_M = 0.06
# Digits of a hash: 64 bits, which two of some thousand different frames do not share by chance.
DIGITS = 16
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


@dataclass(frozen=True)
class GivenObject:
    """What the user states about the object; nothing by default.

    Attributes:
        box: around it, floor frame; None: it is the piece that the cameras look at.
        plane_world: (a, b, c, d) of a x + b y + c z + d = 0, the plane it stands on, metres, world of the
            trajectory; None: the plane is found.
        underside: whether its underside is closed or open, where no frame saw it; "unseen": not stated.
        picked: a point on it; None: none was picked.
    """

    box: OrientedBox | None = None
    plane_world: Vector4 | None = None
    underside: Underside = "unseen"
    picked: PickedPoint | None = None


NOTHING_GIVEN = GivenObject()


def anchor_of(floor: Floor, trajectory: Trajectory, sequence: Sequence) -> BoxAnchor:
    """Return the anchor of a floor frame: index, camera pose and depth hash of the middle good frame."""
    frames = trajectory.good_frames
    frame = int(frames[len(frames) // 2])
    pose = _pose(floor.T_floor_world @ trajectory.T_world_camera[frame])
    return BoxAnchor(frame, pose, _depth_sha256(sequence, frame))


def reanchored(box: OrientedBox, sequence: Sequence) -> OrientedBox:
    """Return the box with the present index of its anchor frame, found by the hash of that frame's depth.

    The index changes if a recording is cut. A box without an anchor or a hash is returned unchanged.

    Raises:
        SegmentationError: no frame of the sequence has the depth of the anchor frame.
    """
    if box.anchor is None or box.anchor.depth_sha256 is None:
        return box
    frame, _, depth_sha256 = box.anchor
    for index in (*range(frame, len(sequence)), *range(min(frame, len(sequence)))):
        if _depth_sha256(sequence, index) == depth_sha256:
            return replace(box, anchor=box.anchor._replace(frame=index))
    raise SegmentationError(
        f"the box in benchmark.yaml is anchored to a frame, then number {frame}, whose depth is not in the "
        f"recording any more; {CHOOSE}",
        what="box-moved",
    )


def _depth_sha256(sequence: Sequence, frame: int) -> str:
    return hashlib.sha256(sequence.frames.depth_native(frame).tobytes()).hexdigest()[:DIGITS]


def check_anchor(box: OrientedBox, floor: Floor, trajectory: Trajectory, scale: float = 1.0) -> None:
    """Refuse a box that was chosen in another floor frame: with another trajectory, or on another plane.

    A box without an anchor, written by hand, is accepted. Two measurements of one floor are never equal, so
    the floor frame counts as the same if no corner of the box moves by more than 6 cm times `scale`, the
    scale of the scene.

    Raises:
        SegmentationError: the box was chosen in another frame, or its anchor frame has no pose. The message
            gives the box converted to this floor frame, if it stays upright.
    """
    if box.anchor is None:
        return
    frame, was, depth_sha256 = box.anchor
    known = frame < len(trajectory.T_world_camera) and np.isfinite(trajectory.T_world_camera[frame]).all()
    if not known:
        raise SegmentationError(
            f"the box in benchmark.yaml is anchored to frame {frame}, which has no pose now; {CHOOSE}",
            what="box-moved",
        )
    T_floor_camera = floor.T_floor_world @ trajectory.T_world_camera[frame]
    T_then_camera = rigid(rotation_from_quaternion_xyzw(np.array(was[3:])), was[:3])
    T_now_then = T_floor_camera @ invert_rigid(T_then_camera)
    corners = transform_points(T_now_then, box.corners_floor())
    moved_m = float(np.linalg.norm(corners - box.corners_floor(), axis=1).max())
    if moved_m <= SAME_M * scale:
        return
    x, y, z = transform_points(T_now_then, np.array(box.center_m))
    turn_rad = atan2(T_now_then[1, 0], T_now_then[0, 0])
    yaw_rad = atan2(np.sin(box.yaw_rad + turn_rad), np.cos(box.yaw_rad + turn_rad))
    same = OrientedBox((x, y, z), box.size_m, yaw_rad)
    now = BoxAnchor(frame, _pose(T_floor_camera), depth_sha256)
    upright = np.linalg.norm(corners - same.corners_floor(), axis=1).max() <= SAME_M * scale
    line = box_line(AnchoredBoxPart.of_anchored(same, now))
    place = f"for the same place now write `{line}`, or " if upright else ""
    raise SegmentationError(
        "the box in benchmark.yaml was chosen in another floor frame, of another trajectory or plane: by "
        f"frame {frame} it would be {moved_m:.2f} m off; {place}{CHOOSE}",
        what="box-moved",
    )


def _pose(T: Float64) -> Pose:
    """Convert a pose (4, 4) to (x, y, z, qx, qy, qz, qw), as in a trajectory file."""
    x, y, z = (float(value) for value in T[:3, 3])
    qx, qy, qz, qw = (float(value) for value in quaternion_xyzw_from_rotation(T[:3, :3]))
    return x, y, z, qx, qy, qz, qw


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


def check_picked(picked: PickedPoint, beside_m: float, cell_m: float) -> None:
    """Refuse an object at a distance of `beside_m`, metres, from the picked point: two of its cells or more.

    Raises:
        SegmentationError: the object lies elsewhere.
    """
    if beside_m > BESIDE_CELLS * cell_m:
        shown = f"it shows the floor or something else, {beside_m:.2f} m beside the nearest thing"
        raise _bad(picked.frame, picked.pixel, f"{shown} that stands on the floor")


def _bad(frame: int, pixel: tuple[int, int], why: str, to_do: str = PICK_AGAIN) -> SegmentationError:
    value = f"{{frame: {frame}, pixel: [{pixel[0]}, {pixel[1]}]}}"
    return SegmentationError(f"pick: {value}: {why}; {to_do}", what="bad-pick")

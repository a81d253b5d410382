"""Anchors of boxes: the camera pose of one frame identifies the floor frame that a box was chosen in."""

import hashlib
from dataclasses import replace
from math import atan2

import numpy as np

from kinectbench.core import SegmentationError
from kinectbench.core.artefacts.object import AnchoredBoxPart
from kinectbench.core.geometry import (
    BoxAnchor,
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
from kinectbench.core.types import Float64
from kinectbench.settings.edit import box_line
from kinectbench.stages.segment.find.floor import Floor

CHOOSE = "choose it again by `kinectbench segment --suggest`"
# Two boxes or pieces whose sides lie this near to each other are the same place.
SAME_M = 0.06
# Digits of a hash: 64 bits, which two of some thousand different frames do not share by chance.
DIGITS = 16


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

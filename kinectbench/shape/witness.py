"""What the recording could see of the object: sides never looked at, too few frames, things that moved."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import TriangleMesh
from kinectbench.segmentation.floor import Floor
from kinectbench.segmentation.moving import moving_frames
from kinectbench.segmentation.segment import Segmentation
from kinectbench.sequence import Sequence
from kinectbench.tracking.trajectory import Trajectory

# A Kinect measures surfaces up to about this slant: an upright side is seen from so far around.
SEEN_WITHIN_RAD = np.radians(75.0)
MIN_FRAMES = 10
# Real floors scatter by up to 6 mm, what is refused as no plane by 20 mm.
MAX_FLOOR_NOISE_M = 0.010


@dataclass(frozen=True)
class UnseenSide:
    """The widest range of directions from which the object was not looked at.

    Attributes:
        gap_rad: its width, radians, 0 to 2 pi.
        towards_rad: its middle, seen from the object, from the floor's x axis, counter-clockwise from above.
        share: share of all upright directions that a side may face in which no camera would have seen it.
    """

    gap_rad: float
    towards_rad: float
    share: float


@dataclass(frozen=True)
class Witness:
    """Figures for quality.json, and a line for people for each thing that is wrong."""

    figures: dict[str, Any]
    warnings: tuple[str, ...]


def unseen_side(T_floor_camera: NDArray[np.float64], center_floor: NDArray[np.float64]) -> UnseenSide:
    """The widest gap between the cameras around the object, seen from above (own rule).

    A side within 75 degrees of a camera's direction counts as seen, so that a gap of 150 degrees hides
    nothing upright.

    Args:
        T_floor_camera: (n, 4, 4), n > 0.
        center_floor: (3,) the middle of the object.
    """
    x, y, _ = (T_floor_camera[:, :3, 3] - center_floor).T
    angles = np.sort(np.arctan2(y, x))
    gaps = np.diff(angles, append=angles[0] + 2 * np.pi)
    widest = int(np.argmax(gaps))
    gap_rad = float(gaps[widest])
    towards_rad = float(np.angle(np.exp(1j * (angles[widest] + gap_rad / 2))))
    return UnseenSide(gap_rad, towards_rad, max(0.0, gap_rad - 2 * SEEN_WITHIN_RAD) / (2 * np.pi))


def _of_trajectory(trajectory: Trajectory) -> list[str]:
    """What its own health says against it: shape and poses cannot be better than that."""
    health = trajectory.health
    if health.get("grade") != "not good":
        return []
    better = health.get("recommended")
    if better not in (None, trajectory.source):
        remedy = f"; `trajectory: {better}` is recommended"
    elif trajectory.source == "trust":
        remedy = "; if odd and even frames agree better with `trajectory: refine`, take that"
    else:
        remedy = ""
    return [f"the trajectory is {health['verdict']}{remedy}"]


def _of_floor(floor: Floor) -> list[str]:
    """A warning of a floor that is hardly flat: it may be something else."""
    if not floor.found or floor.noise_m <= MAX_FLOOR_NOISE_M:
        return []
    return [
        f"the floor found scatters by {1000 * floor.noise_m:.0f} mm, a flat one by 1 to 6: it may be another "
        "surface; record with more of the floor in view, or give a box"
    ]


def witness(sequence: Sequence, trajectory: Trajectory, scene: TriangleMesh, chosen: Segmentation) -> Witness:
    """Say what speaks against the recording: bad poses, a side never seen, few frames, movement, the choice.

    Args:
        sequence: the recording.
        trajectory: its poses.
        scene: the fused surface, world frame.
        chosen: floor and object.
    """
    good = trajectory.good_frames
    T_floor_camera = chosen.floor.T_floor_world @ trajectory.T_world_camera[good]
    side = unseen_side(T_floor_camera, np.array(chosen.box.center_m))
    moving = moving_frames(sequence, trajectory, scene, chosen.floor)
    warnings = [*_of_trajectory(trajectory), *_of_floor(chosen.floor), *chosen.doubts]
    if side.share > 0:
        x, y = np.cos(side.towards_rad), np.sin(side.towards_rad)
        warnings.append(
            f"no frame looks at the object's side towards ({x:.1f}, {y:.1f}) of the floor frame, "
            f"{side.share:.0%} of the way around: what is there is inferred; walk around the object"
        )
    if len(good) < MIN_FRAMES:
        warnings.append(f"made from {len(good)} frames only: too few to average the noise; record more")
    if moving.frames:
        warnings.append(
            f"in {len(moving.frames)} of {moving.judged} frames looked at (such as {moving.frames[0]}) "
            "something stands before the scene that the others do not see: a person walking through, or "
            "poses that are off? record without, or let the poses be tracked"
        )
    figures = {
        "good_frames": len(good),
        "unseen_side": {
            "gap_deg": round(float(np.degrees(side.gap_rad)), 1),
            "towards_deg": round(float(np.degrees(side.towards_rad)), 1),
            "share": round(side.share, 4),
        },
        "moving": {
            "judged": moving.judged,
            "frames": list(moving.frames),
            "largest_share": round(moving.largest_share, 4),
        },
    }
    return Witness(figures, tuple(warnings))

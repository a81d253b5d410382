"""How far measured ties disagree with the final poses: what is left of loops, and how sure a pose is."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera, invert_rigid, rotation_angle_rad, transform_points
from kinectbench.sequence import Sequence
from kinectbench.tracking.tracked import Tie, Tracked

Float64 = NDArray[np.float64]

# A loop is believed if the robust kernel left it at least this weight.
BELIEVED_WEIGHT = 0.5
# Keyframes whose ties the robust kernel all but removed are held by nothing.
MIN_WEIGHT = 0.1
# A correction is taken over so many points across and down the image.
GRID = 5
# For views without any depth.
USUAL_DEPTH_M = 1.5


@dataclass(frozen=True)
class TieCorrection:
    """A tie, and by how much the final poses move and turn its frame b against what it measured.

    Attributes:
        tie: the tie.
        shift_m: rms over a grid of pixels at b's median depth, metres; NaN if a frame has no pose.
        turn_rad: angle, radians; NaN likewise.
    """

    tie: Tie
    shift_m: float
    turn_rad: float

    @property
    def believed(self) -> bool:
        """Whether the pose graph holds on to it."""
        return self.tie.weight >= BELIEVED_WEIGHT


def median_depths_m(sequence: Sequence, frames: Iterable[int]) -> dict[int, float]:
    """Median measured depth of each frame, metres; of frames without depth a usual 1.5 m."""
    medians = {}
    for frame in sorted(set(frames)):
        depth_m = sequence.depth_m(frame)[::4, ::4]
        measured = depth_m[depth_m > 0]
        medians[frame] = float(np.median(measured)) if len(measured) else USUAL_DEPTH_M
    return medians


def tie_correction(tie: Tie, T_world_camera: Float64, camera: Camera, depth_m: float) -> TieCorrection:
    """Compare one tie with the final poses (own rule).

    Args:
        tie: between frames a and b.
        T_world_camera: (n, 4, 4), NaN where there is no pose.
        camera: intrinsics.
        depth_m: at which points of b are taken.
    """
    T_a_b = invert_rigid(T_world_camera[tie.a]) @ T_world_camera[tie.b]
    if not np.isfinite(T_a_b).all():
        return TieCorrection(tie, np.nan, np.nan)
    T_measured_final = invert_rigid(tie.T_a_b) @ T_a_b
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, GRID), np.linspace(0, camera.height - 1, GRID))
    rays = np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1)
    points = depth_m * rays.reshape(-1, 3)
    moved_m = np.linalg.norm(transform_points(T_measured_final, points) - points, axis=1)
    turn_rad = float(rotation_angle_rad(T_measured_final[:3, :3]))
    return TieCorrection(tie, float(np.sqrt(np.mean(moved_m**2))), turn_rad)


def pose_sigma_m(sequence: Sequence, tracked: Tracked, corrections: Iterable[TieCorrection]) -> Float64:
    """By how much each frame's pose may be off: what the ties of its keyframe disagree with it by (own rule).

    The weighted rms of their corrections over the square root of 2, because a correction may be due to either
    of a tie's frames. A frame's keyframe is the nearest one in time.

    Returns:
        (n,) metres; NaN where there is no pose, or no tie.
    """
    n = len(sequence)
    if not len(tracked.keyframes):
        return np.full(n, np.nan)
    weights, squares_m2 = np.zeros(n), np.zeros(n)
    for each in corrections:
        if np.isfinite(each.shift_m):
            ends = [each.tie.a, each.tie.b]
            weights[ends] += each.tie.weight
            squares_m2[ends] += each.tie.weight * each.shift_m**2
    tied = weights >= MIN_WEIGHT
    sigma_m = np.full(n, np.nan)
    sigma_m[tied] = np.sqrt(squares_m2[tied] / weights[tied] / 2)
    posed = np.isfinite(tracked.T_world_camera).all(axis=(1, 2))
    return np.where(posed, sigma_m[_nearest_keyframes(sequence.stamps_ns, tracked.keyframes)], np.nan)


def _nearest_keyframes(stamps_ns: NDArray[np.int64], keyframes: NDArray[np.int64]) -> NDArray[np.int64]:
    """The keyframe (n,) nearest in time to each frame, the earlier one of two."""
    after = np.clip(np.searchsorted(keyframes, np.arange(len(stamps_ns))), 0, len(keyframes) - 1)
    before = np.maximum(after - 1, 0)
    to_after_ns = np.abs(stamps_ns[keyframes[after]] - stamps_ns)
    to_before_ns = np.abs(stamps_ns - stamps_ns[keyframes[before]])
    return keyframes[np.where(to_before_ns <= to_after_ns, before, after)]

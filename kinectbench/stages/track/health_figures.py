"""Statistics of constraints and frames for health.json.

Constraints: their disagreement with the final poses, from which the uncertainty of the poses follows.
Frames: median depth, motion, jumps, sharpness, and where the camera was lost.
"""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.trajectory import Jump, LostStretch
from kinectbench.core.geometry import Camera, invert_rigid, rotation_angle_rad, transform_points
from kinectbench.core.images import image_sharpness
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.compare import has_pose
from kinectbench.core.types import Bools, Float64
from kinectbench.stages.track.frame_maps import gray_frame, reduced_gray
from kinectbench.stages.track.tracked import Constraint, Tracked

# A loop is accepted if the robust kernel gives it at least this weight.
ACCEPTED_WEIGHT = 0.5
# A keyframe is unconstrained if the weights of its constraints add up to less than this.
MIN_WEIGHT = 0.1
# A correction is averaged over a grid of this many points in each direction of the image.
GRID = 5
# A step is a jump if it is this long, and this many times as fast as 95 % of the steps: of 65 simulated scans
# tracked within 65 mm none has one; of seven whose poses are off by 0.7 m and more, four do.
JUMP_M, JUMP_TIMES = 0.5, 2.0
# Assumed for frames without depth.
TYPICAL_DEPTH_M = 1.5


@dataclass(frozen=True)
class ConstraintCorrection:
    """A constraint between frames a and b, and the motion from the measured to the final pose of b in a.

    Attributes:
        constraint: constraint between frames a and b.
        shift_m: rms displacement over a grid of pixels at b's median depth, metres; NaN if a frame has no
            pose.
        turn_rad: rotation angle, radians; NaN if a frame has no pose.
    """

    constraint: Constraint
    shift_m: float
    turn_rad: float

    @property
    def accepted(self) -> bool:
        """Whether the pose graph gave the constraint a weight of at least 0.5."""
        return self.constraint.weight >= ACCEPTED_WEIGHT


def median(values: Float64) -> float:
    """Return the median of the finite values of an array (n,); NaN if there are none."""
    of = values[np.isfinite(values)]
    return float(np.median(of)) if len(of) else np.nan


def median_depths_m(sequence: Sequence, frames: Iterable[int]) -> dict[int, float]:
    """Return {frame: median depth in metres}; 1.5 m for frames without depth."""
    medians = {}
    for frame in sorted(set(frames)):
        depth_m = sequence.depth_m(frame)[::4, ::4]
        measured = depth_m[depth_m > 0]
        medians[frame] = float(np.median(measured)) if len(measured) else TYPICAL_DEPTH_M
    return medians


def constraint_correction(
    constraint: Constraint, T_world_camera: Float64, camera: Camera, depth_m: float
) -> ConstraintCorrection:
    """Compare one constraint with the final poses.

    Args:
        constraint: constraint between frames a and b.
        T_world_camera: (n, 4, 4), NaN where a frame has no pose.
        camera: intrinsics.
        depth_m: depth at which points of b are sampled, metres.
    """
    T_a_b = invert_rigid(T_world_camera[constraint.a]) @ T_world_camera[constraint.b]
    if not np.isfinite(T_a_b).all():
        return ConstraintCorrection(constraint, np.nan, np.nan)
    T_measured_final = invert_rigid(constraint.T_a_b) @ T_a_b
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, GRID), np.linspace(0, camera.height - 1, GRID))
    points = depth_m * camera.rays_at(u, v).reshape(-1, 3)
    moved_m = np.linalg.norm(transform_points(T_measured_final, points) - points, axis=1)
    turn_rad = float(rotation_angle_rad(T_measured_final[:3, :3]))
    return ConstraintCorrection(constraint, float(np.sqrt(np.mean(moved_m**2))), turn_rad)


def pose_sigma_m(
    sequence: Sequence, tracked: Tracked, corrections: Iterable[ConstraintCorrection]
) -> Float64:
    """Return the uncertainty of each pose, from the corrections of its keyframe's constraints.

    It is the weighted rms of the corrections, divided by the square root of 2, because either frame of a
    constraint may cause the correction. A frame's keyframe is the nearest one in time.

    Returns:
        (n,) metres; NaN for frames without pose, or whose keyframe's weights sum to less than 0.1.
    """
    n = len(sequence)
    if not len(tracked.keyframes):
        return np.full(n, np.nan)
    weights, squares_m2 = np.zeros(n), np.zeros(n)
    for each in corrections:
        if np.isfinite(each.shift_m):
            ends = [each.constraint.a, each.constraint.b]
            weights[ends] += each.constraint.weight
            squares_m2[ends] += each.constraint.weight * each.shift_m**2
    constrained = weights >= MIN_WEIGHT
    sigma_m = np.full(n, np.nan)
    sigma_m[constrained] = np.sqrt(squares_m2[constrained] / weights[constrained] / 2)
    posed = has_pose(tracked.T_world_camera)
    return np.where(posed, sigma_m[_nearest_keyframes(sequence.stamps_ns, tracked.keyframes)], np.nan)


def _nearest_keyframes(stamps_ns: NDArray[np.int64], keyframes: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the keyframe (n,) nearest in time to each frame; of two equally near keyframes, the earlier."""
    after = np.clip(np.searchsorted(keyframes, np.arange(len(stamps_ns))), 0, len(keyframes) - 1)
    before = np.maximum(after - 1, 0)
    to_after_ns = np.abs(stamps_ns[keyframes[after]] - stamps_ns)
    to_before_ns = np.abs(stamps_ns - stamps_ns[keyframes[before]])
    return keyframes[np.where(to_before_ns <= to_after_ns, before, after)]


def motion(T_world_camera: Float64, stamps_ns: NDArray[np.int64]) -> tuple[Float64, Float64]:
    """Speed and turn rate of the camera since the previous frame.

    Args:
        T_world_camera: (n, 4, 4), NaN where a frame has no pose.
        stamps_ns: (n,) strictly increasing.

    Returns:
        (n,) metres per second and (n,) radians per second; NaN if either frame has no pose.
    """
    speed_m_per_s, turn_rad_per_s = (np.full(len(stamps_ns), np.nan) for _ in range(2))
    T_before_now = invert_rigid(T_world_camera[:-1]) @ T_world_camera[1:]
    elapsed_s = np.diff(stamps_ns) / 1e9
    speed_m_per_s[1:] = np.linalg.norm(T_before_now[:, :3, 3], axis=1) / elapsed_s
    turn_rad_per_s[1:] = rotation_angle_rad(T_before_now[:, :3, :3]) / elapsed_s
    return speed_m_per_s, turn_rad_per_s


def jumps(T_world_camera: Float64, stamps_ns: NDArray[np.int64]) -> Iterator[Jump]:
    """Yield steps between consecutive poses, longer than 0.5 m and more than twice as fast as 95 % of them.

    Args:
        T_world_camera: (n, 4, 4), NaN where a frame has no pose.
        stamps_ns: (n,) strictly increasing.
    """
    posed = np.flatnonzero(has_pose(T_world_camera))
    if len(posed) < 2:
        return
    moved_m = np.linalg.norm(np.diff(T_world_camera[posed, :3, 3], axis=0), axis=1)
    speed_m_per_s = moved_m / (np.diff(stamps_ns[posed]) / 1e9)
    times = speed_m_per_s / max(float(np.percentile(speed_m_per_s, 95)), 1e-9)
    for k in np.flatnonzero((moved_m > JUMP_M) & (times > JUMP_TIMES)).tolist():
        yield Jump(
            from_frame=int(posed[k]),
            to_frame=int(posed[k + 1]),
            moved_m=round(float(moved_m[k]), 2),
            times_as_fast=round(float(times[k]), 1),
        )


def lost_stretches(
    stamps_ns: NDArray[np.int64], lost: Bools, reasons: Mapping[int, str]
) -> list[LostStretch]:
    """Return the runs of consecutive lost frames, each with its most frequent reason.

    Args:
        stamps_ns: (n,) stamps of all frames.
        lost: (n,) whether each frame is lost.
        reasons: why a frame is lost, by frame.

    Returns:
        One row for each run; times in seconds from the first frame of the recording.
    """
    frames = np.flatnonzero(lost)
    runs = np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1) if len(frames) else []
    return [
        LostStretch(
            first_frame=int(run[0]),
            last_frame=int(run[-1]),
            from_s=round(int(stamps_ns[run[0]] - stamps_ns[0]) / 1e9, 3),
            to_s=round(int(stamps_ns[run[-1]] - stamps_ns[0]) / 1e9, 3),
            reason=Counter(reasons.get(f, "no pose") for f in run.tolist()).most_common(1)[0][0],
        )
        for run in runs
    ]


def sharpness(sequence: Sequence, known: Mapping[int, float]) -> Float64:
    """Sharpness (n,) of each frame's colour (`image_sharpness`); NaN if the frame has no colour.

    Args:
        sequence: the recording.
        known: sharpness of frames whose colour has been read.
    """
    frames = range(len(sequence))
    return np.array([known[f] if f in known else _frame_sharpness(sequence, f) for f in frames])


def _frame_sharpness(sequence: Sequence, index: int) -> float:
    """Sharpness of a frame's colour: at working resolution if registered to depth, else at half its size."""
    if sequence.color_registered:
        gray = reduced_gray(sequence, index)
    else:
        gray = gray_frame(sequence, index, cv2.IMREAD_REDUCED_GRAYSCALE_2)
    return np.nan if gray is None else image_sharpness(gray)

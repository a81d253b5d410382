"""Frame by frame: state, residual, motion and blur; and where the camera was lost."""

from collections import Counter
from collections.abc import Mapping
from collections.abc import Sequence as Rows
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import invert_rigid, rotation_angle_rad
from kinectbench.sequence import Sequence
from kinectbench.tracking.frame_maps import reduced_gray
from kinectbench.tracking.json_figures import mm, seconds, share
from kinectbench.tracking.sharpness import image_sharpness, relative_blur
from kinectbench.tracking.tracked import Tracked

Float64 = NDArray[np.float64]


def frame_rows(
    stamps_ns: NDArray[np.int64],
    tracked: Tracked,
    states: Rows[str],
    *,
    shift_m: Float64,
    residual_m: Float64,
    sharpness: Float64,
) -> list[dict[str, Any]]:
    """A row of figures per frame.

    Args:
        stamps_ns: (n,).
        tracked: what the tracker found.
        states: (n,) tracked, relocalised, lost or rejected.
        shift_m: (n,) by how much each pose may be off, metres; NaN where unknown.
        residual_m: (n,) to other frames, metres; NaN where unknown.
        sharpness: (n,) of the colour; NaN where there is none.
    """
    speed_m_per_s, turn_rad_per_s = motion(tracked.T_world_camera, stamps_ns)
    blurred = relative_blur(sharpness)
    return [
        {
            "frame": frame,
            "state": state,
            "residual_mm": mm(residual_m[frame]),
            "shift_mm": mm(shift_m[frame]),
            "inlier_share": share(tracked.inlier_share[frame]),
            "speed_m_per_s": share(speed_m_per_s[frame]),
            "turn_rad_per_s": share(turn_rad_per_s[frame]),
            "blur": share(blurred[frame]),
        }
        for frame, state in enumerate(states)
    ]


def motion(T_world_camera: Float64, stamps_ns: NDArray[np.int64]) -> tuple[Float64, Float64]:
    """How fast each camera moved and turned since the frame before.

    Args:
        T_world_camera: (n, 4, 4), NaN where there is no pose.
        stamps_ns: (n,) strictly increasing.

    Returns:
        (n,) metres per second and (n,) radians per second; NaN where one of the two frames has no pose.
    """
    speed_m_per_s, turn_rad_per_s = (np.full(len(stamps_ns), np.nan) for _ in range(2))
    T_before_now = invert_rigid(T_world_camera[:-1]) @ T_world_camera[1:]
    elapsed_s = np.diff(stamps_ns) / 1e9
    speed_m_per_s[1:] = np.linalg.norm(T_before_now[:, :3, 3], axis=1) / elapsed_s
    turn_rad_per_s[1:] = rotation_angle_rad(T_before_now[:, :3, :3]) / elapsed_s
    return speed_m_per_s, turn_rad_per_s


def lost_stretches(
    stamps_ns: NDArray[np.int64], lost: NDArray[np.bool_], reasons: Mapping[int, str]
) -> list[dict[str, Any]]:
    """Runs of lost frames: from where to where, and the most frequent reason.

    Args:
        stamps_ns: (n,).
        lost: (n,).
        reasons: why, per lost frame.

    Returns:
        A row each; times in seconds from the first frame of the recording on.
    """
    frames = np.flatnonzero(lost)
    runs = np.split(frames, np.flatnonzero(np.diff(frames) > 1) + 1) if len(frames) else []
    return [
        {
            "first_frame": int(run[0]),
            "last_frame": int(run[-1]),
            "from_s": seconds(stamps_ns[run[0]] - stamps_ns[0]),
            "to_s": seconds(stamps_ns[run[-1]] - stamps_ns[0]),
            "reason": Counter(reasons.get(f, "no pose") for f in run.tolist()).most_common(1)[0][0],
        }
        for run in runs
    ]


def sharpness(sequence: Sequence, known: Mapping[int, float]) -> Float64:
    """Sharpness of the colour of each frame (`image_sharpness`): (n,); NaN where there is none.

    Args:
        sequence: the recording.
        known: of frames whose colour has been read already.
    """
    frames = range(len(sequence))
    return np.array([known[f] if f in known else _frame_sharpness(sequence, f) for f in frames])


def _frame_sharpness(sequence: Sequence, index: int) -> float:
    """Of one frame, read at the resolution the tracker works at, or at half its own."""
    gray = reduced_gray(sequence, index) if sequence.color_registered else _half_gray(sequence, index)
    return np.nan if gray is None else image_sharpness(gray)


def _half_gray(sequence: Sequence, index: int) -> NDArray[np.uint8] | None:
    import cv2

    encoded = sequence.frames.color_encoded(index)
    if encoded is None:
        return None
    gray = cv2.imdecode(np.frombuffer(encoded[1], np.uint8), cv2.IMREAD_REDUCED_GRAYSCALE_2)
    return None if gray is None else np.asarray(gray, dtype=np.uint8)

"""The stage `track`: a pose for every frame that can be tracked, and the trajectory's health.

A trusted trajectory is checked against the depth (`check_given`); its poses are kept, except for frames that
disagree. Without a given trajectory, or to refine one, `tracker.track_frames` estimates every pose. Then the
trajectory is graded (`health`).
"""

import numpy as np

from kinectbench.core import TrackingError
from kinectbench.core.artefacts.trajectory import Source
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.association import poses_at
from kinectbench.core.trajectory.compare import has_pose
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float64, Progress, no_progress
from kinectbench.settings.models import TrackingSettings, TrajectoryMode
from kinectbench.stages.track.check_given import (
    CAUSES,
    GivenCheck,
    as_refined,
    check_given,
    trusted,
    warnings_of,
)
from kinectbench.stages.track.health import health
from kinectbench.stages.track.outliers import far_warnings, outlier_warnings
from kinectbench.stages.track.tracked import Tracked
from kinectbench.stages.track.tracker import track_frames

# Fewer poses see an object from too few sides for fusion.
MIN_GOOD_FRAMES = 3
# Given poses farther from the origin are refused. A scene's vertices are numbered in 20 bits along each axis
# (`fuse.mesh`): 1048 m either way with the finest voxels, 2 mm. Depth reaches 20 m beyond a camera.
WORLD_REACH_M = 1000.0


def track(
    sequence: Sequence,
    mode: TrajectoryMode | None,
    settings: TrackingSettings,
    progress: Progress | None = None,
) -> Trajectory:
    """Estimate the camera pose of every frame; frames without a reliable pose have none.

    Args:
        sequence: the recording.
        mode: how to use a given trajectory: trust it (frames that disagree lose their pose), refine it, or
            ignore it. None: trust it if there is one; then the depth must agree with three poses or more.
        settings: settings for the check of given poses.
        progress: called with (done, total).

    Raises:
        TrackingError: the given trajectory is needed but missing or unusable, or does not fit the frames; or
            fewer than three frames have a pose.
    """
    given = sequence.given_trajectory
    if sequence.trajectory_error and mode != "ignore":
        raise TrackingError(
            f"{sequence.trajectory_error}; `trajectory: ignore` does without it", what="bad-given"
        )
    if mode == "ignore" or (mode is None and given is None):
        return _finished(sequence, "tracked", track_frames(sequence, None, progress), [], None)
    if given is None:
        raise TrackingError(
            f"trajectory: {mode} asks for a given trajectory, but the recording has none; use ignore",
            what="no-given",
        )
    T_given = poses_at(given, sequence.stamps_ns, settings.max_stamp_gap_s)
    posed = int(np.isfinite(T_given[:, 0, 0]).sum())
    if posed < MIN_GOOD_FRAMES:
        raise TrackingError(_too_few_poses(sequence, posed), what="no-match")
    _refuse_far(T_given)
    n = len(sequence)
    # Progress: the tracker counts every frame twice.
    rounds = 3 if mode == "refine" else 1
    report = progress or no_progress
    checked = check_given(sequence, T_given, settings, lambda done, total: report(done, rounds * total))
    warnings = warnings_of(sequence, checked)
    if mode != "refine":
        kept, agreeing = trusted(checked, settings), int(checked.agrees.sum())
        if mode is None and agreeing < MIN_GOOD_FRAMES <= int(has_pose(kept.T_world_camera).sum()):
            raise TrackingError(
                f"the depth agrees with {agreeing} of the {posed} given poses, the others overlap too little "
                f"to be checked: {CAUSES}, and are they in metres? `trajectory: trust` goes on with them, "
                "`trajectory: ignore` does without them",
                what="given-unchecked",
            )
        return _finished(sequence, "trust", kept, warnings, checked)
    refined = track_frames(sequence, T_given, lambda done, total: report(n + done, n + total))
    check = as_refined(sequence, checked, refined.T_world_camera, settings)
    return _finished(sequence, "refine", refined, warnings, check)


def _finished(
    sequence: Sequence, source: Source, tracked: Tracked, warnings: list[str], check: GivenCheck | None
) -> Trajectory:
    posed = int(np.isfinite(tracked.T_world_camera[:, 0, 0]).sum())
    if posed < MIN_GOOD_FRAMES:
        reasons = sorted(set(tracked.reasons.values()))
        advice = "record more slowly, or give a trajectory"
        if source == "trust":
            advice = "correct the poses or the depth"
        raise TrackingError(
            f"only {posed} of {len(sequence)} frames can be used, and {MIN_GOOD_FRAMES} are needed"
            f"{': ' if reasons else ''}{'; '.join(reasons)}; {advice}",
            what="too-few-poses",
        )
    lines = [*warnings, *outlier_warnings(tracked.reasons, source), *far_warnings(tracked.T_world_camera)]
    figures = health(sequence, source, tracked, lines, check)
    return Trajectory(
        stamps_ns=sequence.stamps_ns,
        T_world_camera=tracked.T_world_camera,
        source=source,
        # Rounded as when stored, so that a trajectory read back is equal to this one.
        pose_sigma_m=figures.pose_sigma_m(),
        health=figures,
        depth_calibration=tracked.calibration,
    )


def _refuse_far(T_given: Float64) -> None:
    """Raise TrackingError for given poses (n, 4, 4) more than 1000 m from the world's origin on an axis."""
    off_m = np.nan_to_num(np.abs(T_given[:, :3, 3]).max(axis=1))
    frame = int(np.argmax(off_m))
    if off_m[frame] > WORLD_REACH_M:
        raise TrackingError(
            f"the given pose of frame {frame} lies {off_m[frame]:.0f} m from the world's origin, and a scene "
            f"reaches to {WORLD_REACH_M:.0f} m: give metres, remove wrong poses, and subtract the first "
            "position from all where they are of a map (GPS, UTM)",
            what="bad-given",
        )


def _too_few_poses(sequence: Sequence, posed: int) -> str:
    given = sequence.given_trajectory
    ranges = [
        f"{stamps[0] / 1e9:.3f}-{stamps[-1] / 1e9:.3f} s"
        for stamps in (sequence.stamps_ns, given.stamps_ns if given else sequence.stamps_ns)
    ]
    apart = given is None or (
        given.stamps_ns[0] > sequence.stamps_ns[-1] or given.stamps_ns[-1] < sequence.stamps_ns[0]
    )
    problem = f"gives {posed} of {len(sequence)} frames a pose, and {MIN_GOOD_FRAMES} are needed"
    if posed == 0:
        problem = "shares no time with the frames" if apart else "has no pose close to the time of any frame"
    return (
        f"the given trajectory {problem}: frames {ranges[0]}, trajectory {ranges[1]}; "
        "use stamps of one clock, or `trajectory: ignore`"
    )

"""The built trajectory against the true one."""

from dataclasses import dataclass

import numpy as np

from kinectbench.evaluate.registration import Registration
from kinectbench.simulate.truth import Truth
from kinectbench.tracking.compare import MIN_MATCHED, TrajectoryError, compare_poses, has_pose
from kinectbench.tracking.trajectory import Trajectory


@dataclass(frozen=True)
class TrajectoryFigures:
    """How much of a recording was tracked, and how well. Frames count as in the build's sequence.

    Attributes:
        frames: frames in the sequence.
        tracked: frames with a pose.
        tracked_share: `tracked / frames`.
        lost: frames for which no pose was found.
        rejected: frames whose pose was found and left out, because their depth disagrees with it.
        foreign_tracked: frames that show another scene and have a pose all the same.
        error: of the poses of the frames whose truth is known; None if there are fewer than three.
    """

    frames: int
    tracked: int
    tracked_share: float
    lost: tuple[int, ...]
    rejected: tuple[int, ...]
    foreign_tracked: tuple[int, ...]
    error: TrajectoryError | None


def trajectory_figures(trajectory: Trajectory, truth: Truth, registration: Registration) -> TrajectoryFigures:
    """Compare the poses of all matched frames (see `tracking.compare`), and count the others.

    The alignment of ATE is the least-squares one of the positions, whatever the registration says.
    """
    posed = has_pose(trajectory.T_world_camera)
    common = posed & registration.shown
    error = None
    if common.sum() >= MIN_MATCHED:
        true_frame = registration.true_frame[common]
        error = compare_poses(trajectory.T_world_camera[common], truth.T_world_camera[true_frame])
    rejected = tuple(int(row["frame"]) for row in trajectory.health.get("rejected", []))
    lost = np.setdiff1d(np.flatnonzero(~posed), rejected)
    foreign = posed & (registration.true_frame >= 0) & ~registration.shown
    return TrajectoryFigures(
        frames=len(posed),
        tracked=int(posed.sum()),
        tracked_share=float(posed.mean()),
        lost=tuple(lost.tolist()),
        rejected=rejected,
        foreign_tracked=tuple(np.flatnonzero(foreign).tolist()),
        error=error,
    )

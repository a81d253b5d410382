"""Compare a built trajectory with a reference in TUM format: error statistics and a plot."""

import math
from dataclasses import dataclass

from kinectbench.core import TrackingError
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.clock_offset import ClockOffset, clock_offset
from kinectbench.core.trajectory.compare import TrajectoryError, compare_poses, has_pose, match_stamps
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.stages.track.pictures import comparison_picture, timeline


@dataclass(frozen=True)
class TrajectoryComparison:
    """The errors of a trajectory against a reference.

    Attributes:
        frames: number of frames of the recording.
        tracked: number of frames with a pose.
        error: errors over the poses that both trajectories have.
        clock: delay of the reference's clock; None if unknown or negligible.
    """

    frames: int
    tracked: int
    error: TrajectoryError
    clock: ClockOffset | None = None

    def row(self) -> dict[str, float | int | None]:
        """Return the error statistics that are printed and written as JSON, in mm, degrees and ms.

        Relative errors (rmse) are from one matched frame to the next (`rpe_frame_*`), and over one metre of
        path (`rpe_metre_*`; None if the path is shorter). `ate_rmse_moved_mm` is the absolute error after
        the clock offset is removed. It and `clock_late_ms` are None if no offset is found.
        """
        error, metre_m, metre_rad = self.error, self.error.rpe_metre_m, self.error.rpe_metre_rad
        return {
            "frames": self.frames,
            "tracked": self.tracked,
            "tracked_share": self.tracked / self.frames,
            "matched": error.matched,
            "ate_rmse_mm": 1000 * error.ate_m.rmse,
            "ate_median_mm": 1000 * error.ate_m.median,
            "ate_max_mm": 1000 * error.ate_m.max,
            "rpe_frame_mm": 1000 * error.rpe_frame_m.rmse,
            "rpe_frame_deg": math.degrees(error.rpe_frame_rad.rmse),
            "rpe_metre_mm": None if metre_m is None else 1000 * metre_m.rmse,
            "rpe_metre_deg": None if metre_rad is None else math.degrees(metre_rad.rmse),
            "clock_late_ms": None if self.clock is None else 1000 * self.clock.late_s,
            "ate_rmse_moved_mm": None if self.clock is None else 1000 * self.clock.ate_moved_m,
        }


def compare_with(trajectory: Trajectory, reference: GivenTrajectory) -> tuple[TrajectoryComparison, bytes]:
    """Compare a trajectory with a reference, at the frames for which both have a pose.

    Returns:
        The error statistics, and a plot (PNG file).

    Raises:
        TrackingError: fewer than three poses match by stamp.
    """
    frames, rows = match_stamps(trajectory.stamps_ns, reference.stamps_ns)
    if not len(frames):
        ours, theirs = (
            f"{stamps[0] / 1e9:.3f}-{stamps[-1] / 1e9:.3f} s"
            for stamps in (trajectory.stamps_ns, reference.stamps_ns)
        )
        raise TrackingError(
            f"no stamp is a frame's: the frames are of {ours}, the trajectory is of {theirs}; "
            "give one of this recording, on its clock",
            what="no-match",
        )
    posed = has_pose(trajectory.T_world_camera[frames])
    T_estimate = trajectory.T_world_camera[frames[posed]]
    T_reference = reference.T_world_camera[rows[posed]]
    error = compare_poses(T_estimate, T_reference)
    clock = clock_offset(trajectory.stamps_ns, trajectory.T_world_camera, reference)
    figures = TrajectoryComparison(len(trajectory.stamps_ns), len(trajectory.good_frames), error, clock)
    moments, when = timeline(trajectory.stamps_ns)
    return figures, comparison_picture(error, T_estimate, T_reference, moments[frames[posed]], when)

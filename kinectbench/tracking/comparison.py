"""A built trajectory against one in TUM format: figures for a table and for machines, and a picture."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kinectbench.errors import TrackingError
from kinectbench.sequence import GivenTrajectory
from kinectbench.tracking.compare import compare_poses, has_pose, match_stamps
from kinectbench.tracking.pictures import comparison_picture, timeline
from kinectbench.tracking.trajectory import Trajectory

if TYPE_CHECKING:
    from rich.table import Table

COLUMNS = {
    "recording": "recording",
    "matched": "matched",
    "tracked_share": "tracked %",
    "ate_rmse_mm": "ATE rmse mm",
    "ate_median_mm": "median",
    "ate_max_mm": "max",
    "rpe_frame_mm": "RPE mm/frame",
    "rpe_frame_deg": "°/frame",
    "rpe_metre_mm": "mm/m",
    "rpe_metre_deg": "°/m",
}


@dataclass(frozen=True)
class Comparison:
    """A trajectory against a reference (`tracking.compare`); millimetres and degrees.

    Attributes:
        frames: of the recording.
        tracked: of these, frames with a pose.
        tracked_share: `tracked / frames`.
        matched: frames with a pose that the reference has one for.
        ate_rmse_mm: absolute trajectory error after rigid alignment.
        ate_median_mm: its median.
        ate_max_mm: its maximum.
        rpe_frame_mm: relative error from one matched frame to the next, rmse.
        rpe_frame_deg: its angle, rmse.
        rpe_metre_mm: relative error over a metre of path, rmse; None if the path is shorter.
        rpe_metre_deg: its angle, rmse, or None.
    """

    frames: int
    tracked: int
    tracked_share: float
    matched: int
    ate_rmse_mm: float
    ate_median_mm: float
    ate_max_mm: float
    rpe_frame_mm: float
    rpe_frame_deg: float
    rpe_metre_mm: float | None
    rpe_metre_deg: float | None


def compare_with(trajectory: Trajectory, reference: GivenTrajectory) -> tuple[Comparison, bytes]:
    """Compare all frames that both have a pose for.

    Returns:
        The figures, and a picture (PNG file).

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
            "give one of this recording, on its clock"
        )
    posed = has_pose(trajectory.T_world_camera[frames])
    T_estimate = trajectory.T_world_camera[frames[posed]]
    T_reference = reference.T_world_camera[rows[posed]]
    error = compare_poses(T_estimate, T_reference)
    tracked, n = len(trajectory.good_frames), len(trajectory.stamps_ns)
    metre_m, metre_rad = error.rpe_metre_m, error.rpe_metre_rad
    figures = Comparison(
        frames=n,
        tracked=tracked,
        tracked_share=tracked / n,
        matched=error.matched,
        ate_rmse_mm=1000 * error.ate_m.rmse,
        ate_median_mm=1000 * error.ate_m.median,
        ate_max_mm=1000 * error.ate_m.max,
        rpe_frame_mm=1000 * error.rpe_frame_m.rmse,
        rpe_frame_deg=float(np.degrees(error.rpe_frame_rad.rmse)),
        rpe_metre_mm=None if metre_m is None else 1000 * metre_m.rmse,
        rpe_metre_deg=None if metre_rad is None else float(np.degrees(metre_rad.rmse)),
    )
    moments, when = timeline(trajectory.stamps_ns)
    return figures, comparison_picture(error, T_estimate, T_reference, moments[frames[posed]], when)


def comparison_table(rows: Sequence[Mapping[str, Any]], reference: str) -> "Table":
    """The table that people see: a row per recording, the fields of `Comparison` and its `recording`."""
    from rich.table import Table
    from rich.text import Text

    table = Table(title=Text(f"against {reference}"), title_justify="left")
    for key, title in COLUMNS.items():
        table.add_column(title, justify="left" if key == "recording" else "right")
    for row in rows:
        table.add_row(*(Text(_cell(key, row[key])) for key in COLUMNS))
    return table


def _cell(key: str, value: Any) -> str:
    if value is None:
        return "–"
    if key == "tracked_share":
        return f"{100 * value:.1f}"
    return f"{value:.2f}" if isinstance(value, float) else str(value)

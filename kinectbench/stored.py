"""Reading what two stages made together."""

from pathlib import Path

from kinectbench.ingest.sequence_folder import read_sequence
from kinectbench.sequence import Sequence
from kinectbench.tracking.trajectory import Trajectory
from kinectbench.tracking.trajectory_folder import read_trajectory


def read_tracked(build: Path) -> tuple[Sequence, Trajectory]:
    """The sequence, its depth as the tracker calibrated it, and the trajectory of `build/<recording>/`."""
    sequence = read_sequence(build / "sequence")
    trajectory = read_trajectory(build / "trajectory", sequence.stamps_ns)
    return sequence.calibrated(trajectory.depth_calibration), trajectory

"""From frames to a Trajectory: one pose per frame, or the reason why there is none."""

from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.stages.track.track import track

__all__ = ["Trajectory", "track"]

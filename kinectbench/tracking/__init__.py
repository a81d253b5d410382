"""From frames to a Trajectory: one pose per frame, or the reason why there is none."""

from kinectbench.tracking.track import track
from kinectbench.tracking.trajectory import Trajectory

__all__ = ["Trajectory", "track"]

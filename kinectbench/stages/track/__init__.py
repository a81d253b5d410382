"""Estimate a `Trajectory` from frames: one pose per frame, or the reason for none."""

from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.stages.track.track import track

__all__ = ["Trajectory", "track"]

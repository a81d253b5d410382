"""From frames and poses to a TSDF, visibility votes and a mesh."""

from kinectbench.fusion.reconstruction import Observation, Reconstruction, fuse, merge, observe

__all__ = ["Observation", "Reconstruction", "fuse", "merge", "observe"]

"""From frames and poses to a TSDF, visibility votes and a mesh."""

from kinectbench.stages.fuse.reconstruction import Reconstruction, fuse, observe

__all__ = ["Reconstruction", "fuse", "observe"]

"""Fuse frames and poses into a TSDF with visibility votes, and extract a mesh."""

from kinectbench.stages.fuse.reconstruction import Reconstruction, fuse, observe

__all__ = ["Reconstruction", "fuse", "observe"]

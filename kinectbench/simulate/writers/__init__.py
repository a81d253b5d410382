"""Writers of recordings: one file per format, and one line here.

A writer gets where to write, the camera and the frames, and writes them; it never sees the truth.
"""

from collections.abc import Callable, Iterable
from pathlib import Path

from kinectbench.geometry import Camera
from kinectbench.simulate.writers.frame import RecordedFrame
from kinectbench.simulate.writers.rosbag1 import write_rosbag1
from kinectbench.simulate.writers.tum import write_tum

Writer = Callable[[Path, Camera, Iterable[RecordedFrame]], None]

WRITERS: dict[str, Writer] = {
    "tum": write_tum,
    "bag": write_rosbag1,
}

__all__ = ["WRITERS", "RecordedFrame", "Writer", "write_rosbag1", "write_tum"]

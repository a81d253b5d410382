"""Writers of recordings: one file per format, and one line here.

A writer gets where to write, the cameras and the frames, and writes them; it never sees the truth.
"""

from collections.abc import Callable, Iterable
from pathlib import Path

from kinectbench.simulate.spec import Format
from kinectbench.simulate.writers.bop import write_bop
from kinectbench.simulate.writers.cut import cut
from kinectbench.simulate.writers.folder import write_folder
from kinectbench.simulate.writers.frame import RecordedFrame, Rig
from kinectbench.simulate.writers.klg import write_klg
from kinectbench.simulate.writers.phones import write_scanner_app, write_stray
from kinectbench.simulate.writers.realsense import write_realsense, write_realsense_old
from kinectbench.simulate.writers.redwood import write_redwood
from kinectbench.simulate.writers.rosbag1 import write_rosbag1, write_rosbag1_compressed
from kinectbench.simulate.writers.rosbag2 import write_rosbag2_mcap, write_rosbag2_sqlite
from kinectbench.simulate.writers.sens import write_sens
from kinectbench.simulate.writers.seven_scenes import write_seven_scenes
from kinectbench.simulate.writers.stamps import stamp_as_read
from kinectbench.simulate.writers.tum import write_tum

Writer = Callable[[Path, Rig, Iterable[RecordedFrame]], None]

# A writer fills an empty folder; those of SUFFIXES make a file that does not exist yet.
WRITERS: dict[Format, Writer] = {
    "tum": write_tum,
    "7scenes": write_seven_scenes,
    "folder": write_folder,
    "redwood": write_redwood,
    "bag": write_rosbag1,
    "bag_compressed": write_rosbag1_compressed,
    "ros2_sqlite": write_rosbag2_sqlite,
    "ros2_mcap": write_rosbag2_mcap,
    "realsense": write_realsense,
    "realsense_old": write_realsense_old,
    "klg": write_klg,
    "sens": write_sens,
    "stray": write_stray,
    "scanner_app": write_scanner_app,
    "bop": write_bop,
}
# The formats that are one file, and what its name ends in.
SUFFIXES: dict[Format, str] = {
    "bag": ".bag",
    "bag_compressed": ".bag",
    "realsense": ".bag",
    "realsense_old": ".bag",
    "klg": ".klg",
    "sens": ".sens",
}

__all__ = [
    "SUFFIXES",
    "WRITERS",
    "RecordedFrame",
    "Rig",
    "Writer",
    "cut",
    "stamp_as_read",
]

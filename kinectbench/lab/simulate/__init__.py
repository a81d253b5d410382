"""Objects, scenes, camera paths, the Kinect noise model, writers of recordings."""

from typing import Literal

# The containers that recordings are written in; here, where a help text finds them without what is heavy.
Format = Literal[
    "tum",
    "7scenes",
    "folder",
    "redwood",
    "bag",
    "bag_compressed",
    "ros2_sqlite",
    "ros2_mcap",
    "realsense",
    "realsense_old",
    "klg",
    "sens",
    "stray",
    "scanner_app",
    "bop",
    "wildrgbd",
    "nerfstudio",
    "polycam",
    "redwood_zip",
    "record3d",
    "scannet",
    "sun3d",
    "azure_kinect",
]

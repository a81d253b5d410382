"""Writers of recordings: a function for each format, and one line here.

A writer gets where to write, the cameras and the frames, and writes them; it never sees the truth.
"""

import os
from collections.abc import Callable, Iterable
from functools import partial
from pathlib import Path

from kinectbench.core.errors import RecordingError
from kinectbench.core.trajectory.stamps import NS_PER_S
from kinectbench.lab.simulate import Format
from kinectbench.lab.simulate.writers.archives import write_record3d, write_redwood_zip
from kinectbench.lab.simulate.writers.bags import write_rosbag1, write_rosbag2
from kinectbench.lab.simulate.writers.binary_logs import write_klg, write_sens
from kinectbench.lab.simulate.writers.captures import write_nerfstudio, write_polycam
from kinectbench.lab.simulate.writers.frame import RecordedFrame, Rig
from kinectbench.lab.simulate.writers.image_folders import (
    write_bop,
    write_folder,
    write_redwood,
    write_seven_scenes,
    write_tum,
    write_wildrgbd,
)
from kinectbench.lab.simulate.writers.matroska import NS_PER_MS, write_azure_kinect
from kinectbench.lab.simulate.writers.phones import write_scanner_app, write_stray
from kinectbench.lab.simulate.writers.realsense import write_realsense
from kinectbench.lab.simulate.writers.scene_folders import write_scannet, write_sun3d

Writer = Callable[[Path, Rig, Iterable[RecordedFrame]], None]

# A writer fills an empty folder; those of SUFFIXES make a file that does not exist yet.
WRITERS: dict[Format, Writer] = {
    "tum": write_tum,
    "7scenes": write_seven_scenes,
    "folder": write_folder,
    "redwood": write_redwood,
    "bag": partial(write_rosbag1, depth_code="raw"),
    "bag_compressed": partial(write_rosbag1, depth_code="png"),
    "ros2_sqlite": partial(write_rosbag2, depth_code="raw", mcap=False),
    "ros2_mcap": partial(write_rosbag2, depth_code="rvl", mcap=True),
    "realsense": partial(write_realsense, old=False),
    "realsense_old": partial(write_realsense, old=True),
    "klg": write_klg,
    "sens": write_sens,
    "stray": write_stray,
    "scanner_app": write_scanner_app,
    "bop": write_bop,
    "wildrgbd": write_wildrgbd,
    "nerfstudio": write_nerfstudio,
    "polycam": write_polycam,
    "redwood_zip": write_redwood_zip,
    "record3d": write_record3d,
    "scannet": write_scannet,
    "sun3d": write_sun3d,
    "azure_kinect": write_azure_kinect,
}
# The formats that are one file, and what its name ends in.
SUFFIXES: dict[Format, str] = {
    "bag": ".bag",
    "bag_compressed": ".bag",
    "realsense": ".bag",
    "realsense_old": ".bag",
    "klg": ".klg",
    "sens": ".sens",
    "redwood_zip": ".zip",
    "record3d": ".r3d",
    "azure_kinect": ".mkv",
}
# Where `cut` looks for the image that comes last, and the formats whose stamps are microseconds.
DEPTH_IMAGES = ("depth/*.png", "frame-*.depth.png", "depth_*.png", "keyframes/depth/*.png")
MICROSECONDS = ("tum", "klg", "sens", "stray", "polycam")
WITHOUT_STAMPS = ("7scenes", "folder", "bop", "wildrgbd", "nerfstudio", "scannet")

__all__ = ["SUFFIXES", "WRITERS", "RecordedFrame", "Rig", "Writer", "cut", "stamp_as_read"]


def stamp_as_read(file_format: Format, index: int, stamp_ns: int) -> int:
    """The stamp in nanoseconds under which a reader finds a frame (own rule).

    Bags keep stamps, TUM folders, .klg, .sens, StrayScanner and Polycam keep microseconds, Redwood's names
    and SUN3D's twelve digits of them, Azure Kinect milliseconds. 7-Scenes, plain folders, BOP, WildRGB-D,
    ScanNet's folders and transforms.json have none: there a frame's number counts seconds. 3D Scanner App
    and Record3D have seconds as a float.

    Args:
        file_format: of the recording.
        index: the frame's place among those that were written, from 0.
        stamp_ns: of the frame as written, nanoseconds.
    """
    if file_format in WITHOUT_STAMPS:
        return index * NS_PER_S
    if file_format in ("scanner_app", "record3d"):
        return round(stamp_ns / NS_PER_S * NS_PER_S)
    if file_format == "azure_kinect":
        return stamp_ns // NS_PER_MS * NS_PER_MS
    if file_format in ("redwood", "redwood_zip", "sun3d"):
        return stamp_ns // 1000 % 10**12 * 1000
    return stamp_ns // 1000 * 1000 if file_format in MICROSECONDS else stamp_ns


def cut(path: Path, share: float) -> None:
    """Take the end off a finished recording.

    A file loses its last bytes, a bag its index with them. In a folder the bag, or else the depth image whose
    name comes last, loses them; every other file stays, lists that name it too (own rule).

    Args:
        path: the recording.
        share: of the bytes that go, 0 to below 1.

    Raises:
        RecordingError: a folder without depth images.
    """
    assert 0 <= share < 1
    files = [path] if path.is_file() else [*path.glob("*.db3"), *path.glob("*.mcap")]
    files = files or [image for pattern in DEPTH_IMAGES for image in path.glob(pattern)]
    if not files:
        raise RecordingError(f"{path}: has no depth image to cut off; record more frames, or cut nothing")
    os.truncate(max(files), round(max(files).stat().st_size * (1 - share)))

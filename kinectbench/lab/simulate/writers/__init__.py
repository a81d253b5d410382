"""The registry of formats in which simulated recordings are written, each with its writer.

Packages add formats by the entry point `kinectbench.formats` (`kinectbench.lab.plugins`); a checkout after
`make setup` has the formats of `benchmarks/plugins`.
"""

import os
from collections.abc import Mapping
from functools import cache, partial
from pathlib import Path

from kinectbench.core import RecordingError
from kinectbench.lab.plugins import plugins
from kinectbench.lab.simulate.writers.bags import write_rosbag1, write_rosbag2
from kinectbench.lab.simulate.writers.frame import (
    FileFormat,
    RecordedFrame,
    Rig,
    frames_as_seconds,
    whole_microseconds,
)
from kinectbench.lab.simulate.writers.image_folders import write_folder, write_tum

OWN_FORMATS: Mapping[str, FileFormat] = {
    "tum": FileFormat(write_tum, whole_microseconds, masks=True),
    "folder": FileFormat(write_folder, frames_as_seconds, masks=True),
    "bag": FileFormat(partial(write_rosbag1, depth_code="raw"), suffix=".bag"),
    "bag_compressed": FileFormat(partial(write_rosbag1, depth_code="png"), suffix=".bag"),
    "ros2_sqlite": FileFormat(partial(write_rosbag2, depth_code="raw", mcap=False)),
    "ros2_mcap": FileFormat(partial(write_rosbag2, depth_code="rvl", mcap=True)),
}
# Patterns by which `cut` finds the last depth image.
DEPTH_IMAGES = ("depth/*.png", "frame-*.depth.png", "depth_*.png", "keyframes/depth/*.png")

__all__ = ["OWN_FORMATS", "FileFormat", "RecordedFrame", "Rig", "cut", "formats"]


@cache
def formats() -> Mapping[str, FileFormat]:
    """Return {name: format}: TUM RGB-D, plain folders, bags of ROS 1 and 2, then those of plug-ins.

    Raises:
        SettingsError: a plug-in cannot be used.
    """
    return plugins("kinectbench.formats", FileFormat, OWN_FORMATS)


def cut(path: Path, share: float) -> None:
    """Truncate the file of a finished recording, or the last file in its folder.

    In a folder, that is the bag, or else the last depth image by name; all other files stay, including lists
    that name this image. A bag also loses its index.

    Args:
        path: the recording.
        share: share of the file's bytes that is cut off, 0 to below 1.

    Raises:
        RecordingError: the folder has no depth images.
    """
    assert 0 <= share < 1
    files = [path] if path.is_file() else [*path.glob("*.db3"), *path.glob("*.mcap")]
    files = files or [image for pattern in DEPTH_IMAGES for image in path.glob(pattern)]
    if not files:
        raise RecordingError(
            f"{path}: has no depth image to cut off; record more frames, or cut nothing", what="no-depth"
        )
    os.truncate(max(files), round(max(files).stat().st_size * (1 - share)))

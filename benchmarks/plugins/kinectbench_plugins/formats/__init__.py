"""Formats of recordings that tests and benchmarks write: those of data sets, phones and other programs."""

from functools import partial

from kinectbench.core.trajectory.stamps import NS_PER_S
from kinectbench.lab.simulate.writers.frame import (
    FileFormat,
    frames_as_seconds,
    whole_microseconds,
)
from kinectbench_plugins.formats.archives import write_record3d, write_redwood_zip
from kinectbench_plugins.formats.binary_logs import write_klg, write_sens
from kinectbench_plugins.formats.captures import write_nerfstudio, write_polycam
from kinectbench_plugins.formats.hdf5 import angles_as_seconds, write_ycb
from kinectbench_plugins.formats.image_folders import (
    write_bop,
    write_redwood,
    write_seven_scenes,
    write_wildrgbd,
)
from kinectbench_plugins.formats.matroska import NS_PER_MS, write_azure_kinect
from kinectbench_plugins.formats.phones import write_scanner_app, write_stray
from kinectbench_plugins.formats.realsense import write_realsense
from kinectbench_plugins.formats.scene_folders import write_scannet, write_sun3d


def whole_milliseconds(index: int, stamp_ns: int) -> int:
    """The stamp of Matroska as Azure Kinect's recorder writes it."""
    return stamp_ns // NS_PER_MS * NS_PER_MS


def twelve_digits(index: int, stamp_ns: int) -> int:
    """The stamp in names of Redwood and SUN3D: the last twelve digits of the microseconds."""
    return stamp_ns // 1000 % 10**12 * 1000


def float_seconds(index: int, stamp_ns: int) -> int:
    """The stamp of apps that keep seconds as a float."""
    return round(stamp_ns / NS_PER_S * NS_PER_S)


FORMATS = {
    "7scenes": FileFormat(write_seven_scenes, frames_as_seconds),
    "redwood": FileFormat(write_redwood, twelve_digits),
    "realsense": FileFormat(partial(write_realsense, old=False), suffix=".bag"),
    "realsense_old": FileFormat(partial(write_realsense, old=True), suffix=".bag"),
    "klg": FileFormat(write_klg, whole_microseconds, ".klg"),
    "sens": FileFormat(write_sens, whole_microseconds, ".sens"),
    "stray": FileFormat(write_stray, whole_microseconds),
    "scanner_app": FileFormat(write_scanner_app, float_seconds),
    "bop": FileFormat(write_bop, frames_as_seconds, masks=True),
    "wildrgbd": FileFormat(write_wildrgbd, frames_as_seconds, masks=True),
    "nerfstudio": FileFormat(write_nerfstudio, frames_as_seconds),
    "polycam": FileFormat(write_polycam, whole_microseconds),
    "redwood_zip": FileFormat(write_redwood_zip, twelve_digits, ".zip"),
    "record3d": FileFormat(write_record3d, float_seconds, ".r3d"),
    "scannet": FileFormat(write_scannet, frames_as_seconds),
    "sun3d": FileFormat(write_sun3d, twelve_digits),
    "azure_kinect": FileFormat(write_azure_kinect, whole_milliseconds, ".mkv"),
    "ycb": FileFormat(write_ycb, angles_as_seconds, masks=True),
}

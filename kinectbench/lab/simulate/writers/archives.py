"""Recordings that are zip archives: Redwood's scans."""

import zipfile
from collections.abc import Iterable
from pathlib import Path

from kinectbench.lab.simulate.writers.frame import RecordedFrame, Rig


def add_member(archive: zipfile.ZipFile, name: str, data: bytes) -> None:
    """Add a member that is stored as it is, with a date that never changes."""
    archive.writestr(zipfile.ZipInfo(name), data)


def write_redwood_zip(path: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a scan of Redwood's as a zip archive: depth/ and rgb/NUMBER-MICROSECONDS.

    Depth is in mm. Frames are numbered from 1, depth and colour each with stamps of their own. The layout
    holds neither intrinsics nor poses; colour of the size of depth counts as registered.
    """
    with zipfile.ZipFile(path, "x") as archive:
        for index, frame in enumerate(frames):
            depth_us, color_us = (ns // 1000 % 10**12 for ns in (frame.stamp_ns, frame.color_stamp_ns))
            add_member(archive, f"depth/{index + 1:07d}-{depth_us:012d}.png", frame.depth_png())
            add_member(archive, f"rgb/{index + 1:07d}-{color_us:012d}.jpg", frame.color_jpeg())

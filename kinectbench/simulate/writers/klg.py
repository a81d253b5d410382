"""ElasticFusion's log: zlib depth in mm and JPEG colour in one file."""

import struct
import zlib
from collections.abc import Iterable
from pathlib import Path

from kinectbench.simulate.writers.frame import RecordedFrame, Rig

DEPTH_SCALE = 1000.0


def write_klg(path: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a recording to a file that does not exist yet.

    The number of frames stands at its start. Stamps are those of depth in microseconds. The layout has no
    place for size, intrinsics or poses, nor for a colour camera of its own: colour that is not registered is
    left out.
    """
    with path.open("wb") as file:
        file.write(struct.pack("<i", 0))
        count = 0
        for frame in frames:
            depth = zlib.compress(frame.depth_native(DEPTH_SCALE).astype("<u2").tobytes(), 6)
            color = frame.color_jpeg() if rig.color_registered else b""
            file.write(struct.pack("<qii", frame.stamp_ns // 1000, len(depth), len(color)))
            file.write(depth)
            file.write(color)
            count += 1
        file.seek(0)
        file.write(struct.pack("<i", count))

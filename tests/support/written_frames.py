"""Analytic frames that the writers of recordings write, and how they are read back."""

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path

import numpy as np
from ingest_writers import whole_frames
from numpy.typing import NDArray
from read_pictures import decoded_picture

from kinectbench.core.geometry import Camera, rigid, rotation_from_quaternion_xyzw
from kinectbench.lab.simulate.writers import RecordedFrame, Rig, formats
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.recording import RawFrame, Recording

SCALE = dict.fromkeys(formats(), 1000.0) | {"tum": 5000.0, "record3d": 5000.0, "ycb": 10_000.0}
BAGS = ["bag", "bag_compressed"]
# Their depth images are PNG files.
FOLDERS = ["tum", "7scenes", "folder", "redwood"]
START_NS = 1_400_000_000_123_456_000
STEP_NS = 33_333_000
DELAY_NS = 7_001_000
DEPTH = Camera(64, 48, 60.0, 61.0, 31.5, 22.25)
COLOR = Camera(80, 60, 75.0, 76.0, 40.0, 28.5)
# Their layouts do not say the intrinsics.
SETTINGS = dict.fromkeys(("klg", "redwood_zip"), CameraSettings(**asdict(DEPTH)))
T_COLOR_DEPTH = rigid(rotation_from_quaternion_xyzw([0.01, 0, 0, 1]), [-0.025, 0.001, 0])


def rig(registered: bool) -> Rig:
    return Rig(DEPTH, DEPTH, True, np.eye(4)) if registered else Rig(DEPTH, COLOR, False, T_COLOR_DEPTH)


def pose(index: int) -> NDArray[np.float64]:
    """Turned about all axes and moved, differently for each frame."""
    return rigid(rotation_from_quaternion_xyzw([0.1, 0.02 * index, -0.3, 0.9]), [0.1 * index, 1.25, -1 / 3])


def frame(
    index: int, registered: bool = True, given: bool = True, delay_ns: int = DELAY_NS, stamp_ns: int = -1
) -> RecordedFrame:
    """A slanted wall with a hole, colour with a ramp in each direction; different for each frame."""
    v, u = np.mgrid[: DEPTH.height, : DEPTH.width]
    depth_m = (1.2345 + (u + 0.1 * v + index) / 200).astype(np.float32)
    depth_m[:4, :6] = 0
    camera = rig(registered).color
    v, u = np.mgrid[: camera.height, : camera.width]
    color_rgb = np.dstack([2 * u, 3 * v, np.full_like(u, 30 * (index % 8))]).astype(np.uint8)
    stamp_ns = START_NS + index * STEP_NS if stamp_ns < 0 else stamp_ns
    return RecordedFrame(stamp_ns, depth_m, stamp_ns + delay_ns, color_rgb, pose(index) if given else None)


def write(
    out: Path, name: str, frames: Sequence[RecordedFrame] | Iterator[RecordedFrame], registered: bool = True
) -> Path:
    return formats()[name].write_new(out, rig(registered), frames)


def read(recording: Recording) -> list[RawFrame]:
    return list(whole_frames(recording))


def color_rgb(raw: RawFrame) -> NDArray[np.float64]:
    assert raw.color is not None
    decoded = decoded_picture(raw.color[1])
    rgb: NDArray[np.float64] = decoded[..., ::-1].astype(float)
    return rgb


def digests(out: Path) -> dict[str, str]:
    files = [out] if out.is_file() else sorted(f for f in out.rglob("*") if f.is_file())
    return {str(f.relative_to(out)): hashlib.sha256(f.read_bytes()).hexdigest() for f in files}

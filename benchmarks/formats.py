"""The frames of a 7-Scenes folder wrapped in every container that is read, and what comes back of them.

FOLDER is one sequence of 7-Scenes. Its frames are written by the writers of `kinectbench simulate`, depth and
encoded colour as they are, colour taken for registered, and are ingested each in a process of its own: how
many frames, colour equal by bytes or by pixels, intrinsics, the trajectory's largest difference, whether the
layout has masks, seconds of CPU and peak memory of that process.
"""

import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from figures import Figure, arguments, at_most, equals, run, told
from numpy.typing import NDArray

from kinectbench.core.sequence import Sequence
from kinectbench.lab.simulate.writers import RecordedFrame, Rig, formats
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.recording import RawFrame, Recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence

# What a layout cannot hold: no stated pose; colour as a video.
WITHOUT_POSES = {"realsense", "realsense_old", "klg", "redwood_zip", "azure_kinect"}
COLOR = {
    "7scenes": "pixels",
    "wildrgbd": "pixels",
    "realsense": "pixels",
    "realsense_old": "pixels",
    "stray": "video",
}
MASKS = {"bop", "wildrgbd"}
# Numbers as float32, or text with nine decimals.
POSE_TOLERANCE = 1e-6
PEAK_MB = 500.0
START_NS = 1_400_000_000_000_000_000
STEP_NS = 33_333_000


@dataclass(frozen=True)
class StoredFrame(RecordedFrame):
    """A frame whose depth and colour are handed on as they were stored."""

    depth: NDArray[np.uint16] | None = None
    jpeg: bytes = b""

    def depth_native(self, depth_scale: float = 1000.0) -> NDArray[np.uint16]:
        assert self.depth is not None
        # Every other layout is in millimetres as the source is.
        return (self.depth * np.uint16(round(depth_scale / 1000))).astype(np.uint16)

    def color_jpeg(self) -> bytes:
        return self.jpeg


def stored_frames(source: Recording) -> Iterator[StoredFrame]:
    assert source.given_trajectory is not None
    for index, raw in enumerate(map(source.frame, range(len(source)))):
        assert isinstance(raw, RawFrame) and raw.color is not None
        stamp_ns = START_NS + index * STEP_NS
        bgr = cv2.imdecode(np.frombuffer(raw.color[1], np.uint8), cv2.IMREAD_COLOR)
        T = source.given_trajectory.T_world_camera[index]
        depth_m = raw.depth.astype(np.float32) / np.float32(source.depth_scale)
        rgb = np.ascontiguousarray(bgr[..., ::-1])
        yield StoredFrame(stamp_ns, depth_m, stamp_ns, rgb, T, None, raw.depth, raw.color[1])


def settings_of(name: str, source: Recording) -> CameraSettings | None:
    """What has to be said of a container that does not say its intrinsics."""
    c = source.camera
    if name not in ("klg", "7scenes", "redwood_zip"):
        return None
    return CameraSettings(width=c.width, height=c.height, fx=c.fx, fy=c.fy, cx=c.cx, cy=c.cy)


def ingest_one(path: Path, folder: Path, camera: str) -> None:
    """In a process of its own: ingest, and print seconds of CPU and peak memory in MB."""
    settings = CameraSettings.model_validate_json(camera) if camera else None
    started = time.process_time()
    write_sequence(open_recording(path, settings), folder)
    seconds = time.process_time() - started
    # Unlike getrusage, this does not count what the process that started this one had.
    status = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    peak_kb = next(int(line.split()[1]) for line in status if line.startswith("VmHWM"))
    print(json.dumps([seconds, peak_kb / 1024]))


def compared(sequence: Sequence, source: Recording, name: str) -> dict[str, object]:
    """What came back, against the source."""
    scale = sequence.depth_scale / source.depth_scale
    color_bytes = color_pixels = depth = 0
    for index, raw in enumerate(map(source.frame, range(len(source)))):
        assert isinstance(raw, RawFrame) and raw.color is not None
        depth += np.array_equal(sequence.frames.depth_native(index), raw.depth * np.uint16(round(scale)))
        color = sequence.frames.color_encoded(index)
        if color is None:
            continue
        color_bytes += color[1] == raw.color[1]
        rgb = sequence.color_rgb(index)
        bgr = cv2.imdecode(np.frombuffer(raw.color[1], np.uint8), cv2.IMREAD_COLOR)
        color_pixels += rgb is not None and np.array_equal(rgb[..., ::-1], bgr)
    given, apart = sequence.given_trajectory, None
    if given is not None and source.given_trajectory is not None:
        apart = float(np.abs(given.T_world_camera - source.given_trajectory.T_world_camera).max())
    K = np.abs(sequence.camera.K - source.camera.K).max()
    return {"depth": depth, "bytes": color_bytes, "pixels": color_pixels, "K": float(K), "apart": apart}


def measured(name: str, source: Recording, root: Path) -> list[Figure]:
    """Wrap, ingest and compare one container."""
    folder = root / f"{name}.sequence"
    rig = Rig(source.camera, source.camera, True, np.eye(4))
    path = formats()[name].write_new(root / name, rig, stored_frames(source))
    settings = settings_of(name, source)
    camera = settings.model_dump_json() if settings else ""
    command = [sys.executable, __file__, "--one", str(path), str(folder), camera]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        return [equals(f"{name}: ingest", done.stderr.strip().splitlines()[-1:], [])]
    seconds, peak_mb = json.loads(done.stdout)
    found, frames = compared(read_sequence(folder), source, name), len(source)
    kind = COLOR.get(name, "bytes")
    color = found["pixels"] if kind == "pixels" else found["bytes"]
    poses = "-" if name in WITHOUT_POSES else f"{found['apart']:.1e}"
    row = (
        f"{found['depth']} frames, colour {frames if kind == 'video' else color} ({kind}), intrinsics off by "
        f"{found['K']:.0e} px, trajectory off by {poses}, masks {'read' if name in MASKS else '-'}, "
        f"{seconds:.1f} s, {peak_mb:.0f} MB"
    )
    figures = [told(name, row), equals(f"{name}: depth equal to the bit", found["depth"], frames)]
    if kind != "video":
        figures.append(equals(f"{name}: colour equal ({kind})", color, frames))
    if name not in WITHOUT_POSES:
        apart = np.inf if found["apart"] is None else float(str(found["apart"]))
        figures.append(at_most(f"{name}: trajectory, largest difference", apart, POSE_TOLERANCE))
    return [*figures, at_most(f"{name}: peak memory, MB", peak_mb, PEAK_MB)]


def measure(folder: Path, names: list[str]) -> list[Figure]:
    source = open_recording(folder)
    found: list[Figure] = []
    for name in names or list(formats()):
        with tempfile.TemporaryDirectory() as root:
            found += measured(name, source, Path(root))
    return found


def main() -> None:
    if sys.argv[1:2] == ["--one"]:
        ingest_one(Path(sys.argv[2]), Path(sys.argv[3]), sys.argv[4])
        return
    parser = arguments(__doc__)
    parser.add_argument("folder", type=Path, metavar="FOLDER", help="one sequence of 7-Scenes")
    parser.add_argument("--formats", nargs="*", default=[], metavar="NAME", help="only these")
    options = parser.parse_args()
    run(options, lambda: measure(options.folder, options.formats))


if __name__ == "__main__":
    main()

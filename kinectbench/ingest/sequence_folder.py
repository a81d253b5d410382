"""A Sequence on disk: written from a recording frame by frame, read at random.

camera.json           format_version, width, height, fx, fy, cx, cy, depth_scale, color_registered,
                      registered_by (recording, calibration or null), source_format, frames (their number),
                      warnings, trajectory_error (why a given trajectory is not used, or "")
frames.json           rows: index, stamp_ns, depth, color, mask (paths in the folder; color and mask may be
                      null)
depth/000000.kbd      uint16 in native units, 0 = no measurement, as `depth_code` packs it; PNG in version 1
color/000000.jpg|png  as it was encoded; a PNG where it was brought onto the pixels of depth
mask/000000.png       0 or 255 = the object; only if the recording has masks
given_trajectory.txt  TUM text, camera to world; only if the recording has one
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from kinectbench.errors import KinectBenchError, RecordingError, StorageError
from kinectbench.geometry import Camera
from kinectbench.ingest.depth_code import decode_depth, encode_depth
from kinectbench.ingest.images import (
    DamagedImageError,
    decode_color_bgr,
    decode_depth_png,
    decode_mask,
    encode_png,
)
from kinectbench.ingest.plausibility import FrameChecks, Tally, trajectory_problem
from kinectbench.ingest.recording import ColorCalibration, DamagedFrame, RawFrame, Recording
from kinectbench.ingest.registration import ColorRegistration
from kinectbench.ingest.trajectory_file import read_trajectory, trajectory_text
from kinectbench.sequence import Sequence
from kinectbench.workspace import pretty_json, storage_errors

FORMAT_VERSION = 2
READABLE_VERSIONS = (1, 2)
CAMERA = "camera.json"
FRAMES = "frames.json"
TRAJECTORY = "given_trajectory.txt"
DEPTH_SUFFIX = ".kbd"
CAMERA_KEYS = ("width", "height", "fx", "fy", "cx", "cy")


class Watch(Protocol):
    """Looks on while frames are written."""

    def see(self, index: int, frame: RawFrame) -> None:
        """Look at a frame of the recording."""
        ...

    def warnings(self) -> list[str]:
        """What there is to say after the last one, one line each."""
        ...


def write_sequence(
    recording: Recording,
    folder: Path,
    progress: Callable[[int, int], None] | None = None,
    *,
    needs_trajectory: bool = True,
    watch: Watch | None = None,
) -> list[str]:
    """Write a recording into an empty folder, holding one frame at a time, and check it on the way.

    Args:
        recording: what to write; its damaged frames are left out while they are less than 5 %.
        folder: is made if it is not there.
        progress: called with (frames done, frames in all) after each.
        needs_trajectory: refuse a recording whose given trajectory is broken or of another time; else it is
            left out with a warning.
        watch: is shown each frame that is whole, as it was recorded, and adds its warnings.

    Returns:
        Warnings, one line each; they are stored in camera.json too.

    Raises:
        RecordingError: the recording cannot be used; the message says what is wrong and where.
        StorageError: the folder cannot be written.
    """
    problem = trajectory_problem(recording)
    if problem and needs_trajectory:
        raise RecordingError(f"{problem}; `trajectory: ignore` does without it")
    with storage_errors(folder):
        for name in ("depth", "color"):
            (folder / name).mkdir(parents=True, exist_ok=True)
    registered_by = "recording" if recording.color_registered else None
    register = None
    if recording.color_calibration is not None and not recording.color_registered:
        register = _Registered(recording, recording.color_calibration)
        registered_by = "calibration"
    checks, tally = FrameChecks(recording), Tally(recording)
    rows: list[dict[str, Any]] = []
    for done, frame in enumerate(recording.frames(), start=1):
        try:
            rows += _write_checked(frame, len(rows), folder, checks, tally, register)
            if watch and isinstance(frame, RawFrame):
                watch.see(done - 1, frame)
        except DamagedImageError as error:
            tally.leave_out(str(error))
        if progress:
            progress(done, len(recording))
    warnings = [*recording.warnings, *tally.verdict(), *checks.verdict()]
    if problem:
        warnings.append(f"{problem}; it is ignored")
    if watch:
        warnings += watch.warnings()
    head = {"format_version": FORMAT_VERSION, **asdict(recording.camera)}
    head |= {"depth_scale": recording.depth_scale, "color_registered": registered_by is not None}
    head |= {"registered_by": registered_by}
    head |= {"source_format": recording.format, "frames": len(rows), "warnings": warnings}
    head |= {"trajectory_error": problem}
    with storage_errors(folder):
        (folder / CAMERA).write_text(pretty_json(head))
        (folder / FRAMES).write_text(pretty_json(rows))
        if recording.given_trajectory is not None and not problem:
            (folder / TRAJECTORY).write_text(trajectory_text(recording.given_trajectory))
    return warnings


def read_sequence(folder: Path) -> Sequence:
    """Open a folder that `write_sequence` made; images are read when asked for.

    Raises:
        StorageError: the folder is incomplete, damaged or of another format version.
    """
    try:
        head = json.loads((folder / CAMERA).read_text())
        rows = json.loads((folder / FRAMES).read_text())
        if head["format_version"] not in READABLE_VERSIONS:
            raise StorageError(
                f"{folder}: written in format version {head['format_version']}; {_again(folder)}"
            )
        trajectory = read_trajectory(folder / TRAJECTORY)[0] if (folder / TRAJECTORY).is_file() else None
        masks = tuple(row.get("mask") for row in rows)
        frames = FolderFrames(
            folder, tuple(row["depth"] for row in rows), tuple(row["color"] for row in rows), masks
        )
        return Sequence(
            camera=Camera(*(head[key] for key in CAMERA_KEYS)),
            depth_scale=head["depth_scale"],
            stamps_ns=np.array([row["stamp_ns"] for row in rows], np.int64),
            color_registered=head["color_registered"],
            given_trajectory=trajectory,
            trajectory_error=head.get("trajectory_error", ""),
            frames=frames,
            masks=frames.mask if any(masks) else None,
        )
    except StorageError:
        raise
    except (OSError, ValueError, KeyError, TypeError, KinectBenchError) as error:
        raise StorageError(f"{folder}: cannot be read as a sequence ({error}); {_again(folder)}") from error


@dataclass(frozen=True)
class FolderFrames:
    """Frames that lie in a sequence folder.

    Attributes:
        folder: the sequence folder.
        depth: path of each depth image within it.
        color: path of each colour image within it, or None.
        masks: path of each given mask within it, or None.
    """

    folder: Path
    depth: tuple[str, ...]
    color: tuple[str | None, ...]
    masks: tuple[str | None, ...] = ()

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        """Depth of one frame: (height, width) uint16, 0 = no measurement.

        Raises:
            StorageError: the image is missing or damaged.
        """
        data = self._bytes(self.depth[index])
        name = str(self.folder / self.depth[index])
        try:
            return decode_depth(data) if name.endswith(DEPTH_SUFFIX) else decode_depth_png(data, name)
        except (ValueError, RecordingError) as error:
            raise StorageError(f"{name}: is damaged ({error}); {_again(self.folder)}") from error

    def mask(self, index: int) -> NDArray[np.bool_] | None:
        """The mask that came with a frame: (height, width) bool, or None.

        Raises:
            StorageError: the image is missing or damaged.
        """
        name = self.masks[index] if self.masks else None
        if name is None:
            return None
        try:
            return decode_mask(self._bytes(name), name)
        except RecordingError as error:
            raise StorageError(f"{self.folder / name}: is damaged; {_again(self.folder)}") from error

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        """Colour of one frame as it was encoded: (suffix, bytes), or None.

        Raises:
            StorageError: the image is missing.
        """
        name = self.color[index]
        return None if name is None else (Path(name).suffix, self._bytes(name))

    def _bytes(self, name: str) -> bytes:
        try:
            return (self.folder / name).read_bytes()
        except OSError as error:
            reason = error.strerror
            raise StorageError(
                f"{self.folder / name}: cannot be read ({reason}); {_again(self.folder)}"
            ) from error


class _Registered:
    """Brings the colour of frames onto their depth."""

    def __init__(self, recording: Recording, calibration: ColorCalibration) -> None:
        self._register = ColorRegistration(recording.camera, calibration)
        self._scale = recording.depth_scale
        self._size_px = (calibration.camera.width, calibration.camera.height)

    def __call__(self, frame: RawFrame) -> RawFrame:
        if frame.color is None:
            return frame
        bgr = decode_color_bgr(frame.color[1], f"colour of {frame.name}")
        if bgr.shape[1::-1] != self._size_px:
            raise RecordingError(
                f"{frame.name}: its colour is {bgr.shape[1]}x{bgr.shape[0]}, but its camera makes "
                f"{self._size_px[0]}x{self._size_px[1]}: correct the calibration, or remove it"
            )
        depth_m = frame.depth.astype(np.float32) / np.float32(self._scale)
        return replace(frame, color=(".png", encode_png(self._register(depth_m, bgr))))


def _write_checked(
    frame: RawFrame | DamagedFrame,
    index: int,
    folder: Path,
    checks: FrameChecks,
    tally: Tally,
    register: _Registered | None,
) -> list[dict[str, Any]]:
    """Write one frame; its row, or none if it is damaged."""
    if isinstance(frame, DamagedFrame):
        tally.leave_out(frame.why)
        return []
    color_suffix = checks.check(frame)
    if register is not None:
        frame, color_suffix = register(frame), color_suffix and ".png"
    depth = f"depth/{index:06d}{DEPTH_SUFFIX}"
    color = None if frame.color is None else f"color/{index:06d}{color_suffix}"
    mask = None if frame.mask is None else f"mask/{index:06d}.png"
    with storage_errors(folder):
        (folder / depth).write_bytes(encode_depth(frame.depth))
        if frame.color is not None:
            (folder / f"{color}").write_bytes(frame.color[1])
        if frame.mask is not None:
            (folder / "mask").mkdir(exist_ok=True)
            pixels = np.where(frame.mask, np.uint8(255), np.uint8(0))
            (folder / f"{mask}").write_bytes(encode_png(pixels))
    return [{"index": index, "stamp_ns": frame.stamp_ns, "depth": depth, "color": color, "mask": mask}]


def _again(folder: Path) -> str:
    return f"delete {folder} and run `kinectbench ingest` again"

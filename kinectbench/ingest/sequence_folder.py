"""A Sequence on disk: written from a recording frame by frame, read at random.

camera.json           format_version, width, height, fx, fy, cx, cy, depth_scale, color_registered,
                      source_format, frames (their number), warnings
frames.json           rows: index, stamp_ns, depth, color (paths in the folder; color may be null)
depth/000000.png      uint16 in native units, 0 = no measurement; the recorded file where that is unchanged
color/000000.jpg|png  as it was encoded
given_trajectory.txt  TUM text, camera to world; only if the recording has one
"""

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.errors import KinectBenchError, StorageError
from kinectbench.geometry import Camera
from kinectbench.ingest.images import DamagedImageError, encode_png
from kinectbench.ingest.plausibility import FrameChecks, Tally
from kinectbench.ingest.recording import DamagedFrame, RawFrame, Recording
from kinectbench.ingest.trajectory_file import read_trajectory, trajectory_text
from kinectbench.sequence import Sequence
from kinectbench.workspace import pretty_json, storage_errors

FORMAT_VERSION = 1
CAMERA = "camera.json"
FRAMES = "frames.json"
TRAJECTORY = "given_trajectory.txt"
CAMERA_KEYS = ("width", "height", "fx", "fy", "cx", "cy")


def write_sequence(
    recording: Recording, folder: Path, progress: Callable[[int, int], None] | None = None
) -> list[str]:
    """Write a recording into an empty folder, holding one frame at a time, and check it on the way.

    Args:
        recording: what to write; its damaged frames are left out while they are less than 5 %.
        folder: is made if it is not there.
        progress: called with (frames done, frames in all) after each.

    Returns:
        Warnings, one line each; they are stored in camera.json too.

    Raises:
        RecordingError: the recording cannot be used; the message says what is wrong and where.
        StorageError: the folder cannot be written.
    """
    with storage_errors(folder):
        for name in ("depth", "color"):
            (folder / name).mkdir(parents=True, exist_ok=True)
    checks, tally = FrameChecks(recording), Tally(recording)
    rows: list[dict[str, Any]] = []
    for done, frame in enumerate(recording.frames(), start=1):
        try:
            rows += _write_checked(frame, len(rows), folder, checks, tally)
        except DamagedImageError as error:
            tally.leave_out(str(error))
        if progress:
            progress(done, len(recording))
    warnings = [*recording.warnings, *tally.verdict(), *checks.verdict([row["stamp_ns"] for row in rows])]
    head = {"format_version": FORMAT_VERSION, **asdict(recording.camera)}
    head |= {"depth_scale": recording.depth_scale, "color_registered": recording.color_registered}
    head |= {"source_format": recording.format, "frames": len(rows), "warnings": warnings}
    with storage_errors(folder):
        (folder / CAMERA).write_text(pretty_json(head))
        (folder / FRAMES).write_text(pretty_json(rows))
        if recording.given_trajectory is not None:
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
        if head["format_version"] != FORMAT_VERSION:
            raise StorageError(
                f"{folder}: written in format version {head['format_version']}; {_again(folder)}"
            )
        trajectory = read_trajectory(folder / TRAJECTORY)[0] if (folder / TRAJECTORY).is_file() else None
        return Sequence(
            camera=Camera(*(head[key] for key in CAMERA_KEYS)),
            depth_scale=head["depth_scale"],
            stamps_ns=np.array([row["stamp_ns"] for row in rows], np.int64),
            color_registered=head["color_registered"],
            given_trajectory=trajectory,
            frames=FolderFrames(
                folder, tuple(row["depth"] for row in rows), tuple(row["color"] for row in rows)
            ),
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
    """

    folder: Path
    depth: tuple[str, ...]
    color: tuple[str | None, ...]

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        """Depth of one frame: (height, width) uint16, 0 = no measurement.

        Raises:
            StorageError: the image is missing or damaged.
        """
        import cv2

        data = np.frombuffer(self._bytes(self.depth[index]), np.uint8)
        depth = cv2.imdecode(data, cv2.IMREAD_UNCHANGED) if data.size else None
        if depth is None or depth.dtype != np.uint16:
            raise StorageError(f"{self.folder / self.depth[index]}: is damaged; {_again(self.folder)}")
        return np.asarray(depth, dtype=np.uint16)

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


def _write_checked(
    frame: RawFrame | DamagedFrame, index: int, folder: Path, checks: FrameChecks, tally: Tally
) -> list[dict[str, Any]]:
    """Write one frame; its row, or none if it is damaged."""
    if isinstance(frame, DamagedFrame):
        tally.leave_out(frame.why)
        return []
    color_suffix = checks.check(frame)
    depth_name, color_name = f"depth/{index:06d}.png", None
    with storage_errors(folder):
        (folder / depth_name).write_bytes(frame.depth_png or encode_png(frame.depth))
        if frame.color is not None:
            color_name = f"color/{index:06d}{color_suffix}"
            (folder / color_name).write_bytes(frame.color[1])
    return [{"index": index, "stamp_ns": frame.stamp_ns, "depth": depth_name, "color": color_name}]


def _again(folder: Path) -> str:
    return f"delete {folder} and run `kinectbench ingest` again"

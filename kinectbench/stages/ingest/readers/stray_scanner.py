"""Folders of StrayScanner: rgb.mp4, depth/ (PNG or .npy), confidence/, camera_matrix.csv, odometry.csv."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import RecordingError, is_too_large, printable, read_head
from kinectbench.core.trajectory.stamps import first_by_stamp, parse_stamp_ns
from kinectbench.core.trajectory.text_rows import parse_floats, read_matrix, text_rows
from kinectbench.core.trajectory.trajectory_file import TimedPose, read_given, trajectory_from_poses
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.image_names import FRAME_NUMBER
from kinectbench.stages.ingest.images import DamagedImageError
from kinectbench.stages.ingest.known_names import first_file, visible
from kinectbench.stages.ingest.readers.folder import DepthFormat
from kinectbench.stages.ingest.readers.phone_images import GRAVITY_UP, PhoneRecording, intrinsics_of_depth
from kinectbench.stages.ingest.recording import FrameFiles, first_depth_size

if TYPE_CHECKING:
    from cv2 import VideoCapture

DEPTH_SCALE = 1000.0
# Early versions of the app wrote arrays; PNG is taken where there are both.
DEPTH_KINDS, KINDS = ("*.npy", "*.png"), "000000.png or .npy"
# An MP4 starts with a box: four bytes of length and this name.
MP4_HEAD = b"\0\0\0\0ftyp"
# Makes FFmpeg within OpenCV print nothing (av_log's AV_LOG_QUIET).
FFMPEG_SAYS, NOTHING = "OPENCV_FFMPEG_LOGLEVEL", "-8"
COLUMNS = ("timestamp", "frame", "x", "y", "z", "qx", "qy", "qz", "qw")


@dataclass
class _Video:
    """The frames of a video by number; consecutive frames are read without seeking."""

    path: Path
    capture: "VideoCapture | None" = None
    next: int = 0

    def frame(self, number: int) -> NDArray[np.uint8] | None:
        """Read a frame as BGR (height, width, 3) uint8; None if the video does not contain it."""
        import cv2

        with _quiet():
            if self.capture is None:
                self.capture = cv2.VideoCapture()
                if read_head(self.path, len(MP4_HEAD))[4:] == MP4_HEAD[4:]:  # other files are not tried
                    self.capture.open(str(self.path), cv2.CAP_FFMPEG)
            sides_px = [
                self.capture.get(side) for side in (cv2.CAP_PROP_FRAME_WIDTH, cv2.CAP_PROP_FRAME_HEIGHT)
            ]
            if is_too_large(*sides_px):
                return None
            if number != self.next:
                self.capture.set(cv2.CAP_PROP_POS_FRAMES, number)
            self.next = number + 1
            done, bgr = self.capture.read()
        return bgr if done else None


@dataclass(frozen=True, kw_only=True)
class StrayScannerRecording(PhoneRecording):
    """A folder of StrayScanner; its poses are camera to world in optical axes, as in its own tools.

    Attributes:
        numbers: number of each frame in the video.
        video: the video; None if there is none.
    """

    format: ClassVar[str] = "stray"
    uses: ClassVar[frozenset[str]] = frozenset({"min_confidence"})
    looks_for: ClassVar[str] = "a folder with odometry.csv, camera_matrix.csv, depth/000000.png (rgb.mp4)"
    up_world: ClassVar[tuple[float, float, float] | None] = GRAVITY_UP

    numbers: tuple[int, ...] = ()
    video: _Video | None = field(default=None, compare=False)

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder has an odometry.csv and depth/."""
        return (path / "odometry.csv").is_file() and (path / "depth").is_dir()

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """Read odometry.csv, and keep the frames with depth."""
        images = visible(path / "depth", *DEPTH_KINDS)
        depth = {int(f.stem): f for f in images if FRAME_NUMBER.fullmatch(f.stem)}
        rows = _read_odometry(path / "odometry.csv")
        paired = [(number, row) for number, row in rows if number in depth]
        if not paired:
            what = f"no row of odometry.csv names an image in depth/, such as {KINDS}"
            raise RecordingError(f"{path}: {what}", what="no-frame")
        alone = len(depth.keys() - {number for number, _ in paired})
        order, warnings = first_by_stamp([row.stamp_ns for _, row in paired], str(path), "rows")
        if alone:
            warnings.append(f"{path}: {alone} depth images have no row in odometry.csv and were left out")
        numbers = tuple(paired[i][0] for i in order)
        files = tuple(FrameFiles(paired[i][1].stamp_ns, depth[paired[i][0]], None) for i in order)
        size_px, stored = first_depth_size(files), DepthFormat.of(files, settings.depth_scale)
        video = _Video(path / "rgb.mp4") if (path / "rgb.mp4").is_file() else None
        first = video.frame(0) if video else None
        color_px = None if first is None else (first.shape[1], first.shape[0])
        if color_px is None:
            warnings.append(f"{path}: rgb.mp4 is missing or cannot be read; there will be no colour")
        K = read_matrix(path / "camera_matrix.csv", 3)
        intrinsics = intrinsics_of_depth(K, color_px, size_px, path, settings)
        poses = [row for _, row in paired]
        trajectory, pose_warnings, error = read_given(lambda: trajectory_from_poses(poses, str(path)))
        return cls(
            path=path,
            places=files,
            camera=intrinsics.camera(size_px, path),
            depth_scale=stored.depth_scale or intrinsics.depth_scale or DEPTH_SCALE,
            float_scale=stored.float_scale,
            channels=stored.channels,
            kind=stored.kind,
            color_registered=color_px is not None,
            given_trajectory=trajectory,
            trajectory_error=error,
            warnings=(*warnings, *stored.warnings, *pose_warnings),
            confidence=tuple(first_file([path / "confidence" / f"{depth[n].stem}.png"]) for n in numbers),
            min_confidence=settings.min_confidence,
            numbers=numbers,
            video=video if color_px else None,
        )

    def color(self, index: int) -> tuple[str, bytes] | None:
        """Return the colour of a frame from the video, at depth's size; None if there is no video.

        Raises:
            DamagedImageError: the video has no such frame, or another aspect ratio than depth.
        """
        if self.video is None:
            return None
        number = self.numbers[index]
        bgr = self.video.frame(number)
        if bgr is None:
            raise DamagedImageError(f"{self.video.path}: has no frame {number}; the video is cut off")
        return self.shrunk(bgr, f"{self.video.path}, frame {number}")


def _read_odometry(path: Path) -> list[tuple[int, TimedPose]]:
    """Read the rows of odometry.csv: the number of a frame, and its pose."""
    lines = text_rows(path)
    if not lines:
        raise RecordingError(f"{path}: is empty")
    names = [name.strip() for name in lines[0][1].split(",")]
    missing = [name for name in COLUMNS if name not in names]
    if missing:
        raise RecordingError(f"{path}: its first line does not name the column {missing[0]}")
    rows = []
    for where, line in lines[1:]:
        words = [word.strip() for word in line.split(",")]
        if len(words) != len(names):
            raise RecordingError(f"{where}: holds {len(words)} values, not {len(names)}")
        values = dict(zip(names, words, strict=True))
        if not FRAME_NUMBER.fullmatch(values["frame"]):
            raise RecordingError(f"{where}: '{printable(values['frame'])}' is not a frame number")
        numbers = parse_floats([values[name] for name in COLUMNS[2:]], where)
        stamp_ns = parse_stamp_ns(values["timestamp"], where)
        rows.append(
            (int(values["frame"]), TimedPose(stamp_ns, tuple(numbers[:3]), tuple(numbers[3:]), where))
        )
    return rows


@contextmanager
def _quiet() -> Iterator[None]:
    """Keep OpenCV from printing about videos that it cannot read."""
    import cv2

    os.environ.setdefault(FFMPEG_SAYS, NOTHING)  # read when the first video is opened
    level = cv2.utils.logging.getLogLevel()
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    try:
        yield
    finally:
        cv2.utils.logging.setLogLevel(level)

"""3D Scanner App's folders (all data): depth_, conf_ and frame_ files of each frame, JSON of its camera."""

import json
import re
from itertools import pairwise
from pathlib import Path
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from kinectbench.config import CameraSettings
from kinectbench.errors import RecordingError
from kinectbench.ingest.images import DamagedImageError, image_header
from kinectbench.ingest.phone_images import COLOR_PX, PhoneRecording, scaled
from kinectbench.ingest.recording import FrameFiles, first_depth_size, read_image_file
from kinectbench.ingest.stamps import NS_PER_S
from kinectbench.ingest.text_rows import read_text
from kinectbench.ingest.trajectory_file import read_given, trajectory_from_matrices
from kinectbench.sequence import GivenTrajectory

DEPTH_SCALE = 1000.0
DEPTH_NAME = re.compile(r"depth_(\d{1,9})\.png")
# ARKit's camera looks along -z with y up.
OPENGL_FROM_OPTICAL = np.diag([1.0, -1.0, -1.0, 1.0])


class ScannerAppRecording(PhoneRecording):
    """A folder of 3D Scanner App; colour is there for some frames only."""

    format: ClassVar[str] = "scanner_app"
    looks_for: ClassVar[str] = "a folder with depth_00000.png and frame_00000.json (conf_, frame_*.jpg)"

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder has a depth image with its JSON."""
        return path.is_dir() and any(
            found and (path / f"frame_{found[1]}.json").is_file()
            for found in (DEPTH_NAME.fullmatch(file.name) for file in path.iterdir())
        )

    @classmethod
    def open(cls, path: Path, settings: CameraSettings | None) -> Self:
        """List the frames by number and read every JSON."""
        found = ((DEPTH_NAME.fullmatch(file.name), file) for file in path.iterdir())
        stems = sorted((match[1] for match, _ in found if match), key=int)
        cameras = [_read_camera(path / f"frame_{stem}.json") for stem in stems]
        stamps_ns, warnings = _stamps_ns(path, cameras)
        colors = (path / f"frame_{stem}.jpg" for stem in stems)
        files = tuple(
            FrameFiles(stamp_ns, path / f"depth_{stem}.png", color if color.is_file() else None)
            for stamp_ns, stem, color in zip(stamps_ns, stems, colors, strict=True)
        )
        size_px = first_depth_size(files)
        K = next((_matrix(camera, "intrinsics", 3) for camera in cameras if camera), None)
        said = scaled(np.full((3, 3), np.nan) if K is None else K, _color_size(files), size_px)
        trajectory, lost, error = read_given(lambda: _read_poses(path, stamps_ns, cameras))
        confidence = (path / f"conf_{stem}.png" for stem in stems)
        intrinsics = said.overridden_by(settings)
        return cls(
            path=path,
            files=files,
            camera=intrinsics.camera(size_px, path),
            depth_scale=intrinsics.depth_scale or DEPTH_SCALE,
            color_registered=any(file.color for file in files),
            given_trajectory=trajectory,
            trajectory_error=error,
            warnings=(*warnings, *lost),
            confidence=tuple(file if file.is_file() else None for file in confidence),
            min_confidence=(settings or CameraSettings()).min_confidence,
        )


def _read_camera(file: Path) -> dict[str, Any] | None:
    """The JSON of a frame, or None if it is not there."""
    if not file.is_file():
        return None
    try:
        said = json.loads(read_text(file))
    except (ValueError, RecursionError) as error:
        raise RecordingError(f"{file}: is not valid JSON ({error})") from error
    if not isinstance(said, dict):
        raise RecordingError(f"{file}: must hold an object with intrinsics and cameraPoseARFrame")
    return said | {"file": str(file)}


def _matrix(camera: dict[str, Any], key: str, side: int) -> NDArray[np.float64]:
    """A square matrix that is stored row by row."""
    try:
        numbers = np.array(camera.get(key), np.float64).reshape(-1)
    except (TypeError, ValueError):
        numbers = np.empty(0)
    if numbers.size != side * side:
        raise RecordingError(f"{camera['file']}: '{key}' must hold {side * side} numbers")
    return numbers.reshape(side, side)


def _read_poses(
    path: Path, stamps_ns: list[int], cameras: list[dict[str, Any] | None]
) -> tuple[GivenTrajectory | None, list[str]]:
    poses = [_pose(camera) for camera in cameras]
    if all(pose is None for pose in poses):
        return None, []
    return trajectory_from_matrices(stamps_ns, poses, str(path))


def _pose(camera: dict[str, Any] | None) -> NDArray[np.float64] | None:
    """Camera to world in optical axes."""
    if camera is None or "cameraPoseARFrame" not in camera:
        return None
    return np.asarray(_matrix(camera, "cameraPoseARFrame", 4) @ OPENGL_FROM_OPTICAL)


def _stamps_ns(path: Path, cameras: list[dict[str, Any] | None]) -> tuple[list[int], list[str]]:
    """The times of the frames, where all have one and they increase; else the frames count seconds."""
    times = [camera.get("time") if camera else None for camera in cameras]
    if all(isinstance(time, int | float) and np.isfinite(time) for time in times):
        stamps_ns = [round(float(time) * NS_PER_S) for time in times if time is not None]
        if all(after > before for before, after in pairwise(stamps_ns)):
            return stamps_ns, []
    counted = [index * NS_PER_S for index in range(len(cameras))]
    return counted, [f"{path}: not every frame has a time of its own; frames are counted instead"]


def _color_size(files: tuple[FrameFiles, ...]) -> tuple[int, int]:
    for file in files:
        if file.color is not None:
            try:
                return image_header(read_image_file(file.color), str(file.color))[1:]
            except DamagedImageError:
                continue
    return COLOR_PX

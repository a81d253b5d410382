"""Folders of 3D Scanner App (all data): depth_, conf_ and frame_ files per frame, and JSON of its camera."""

import re
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from kinectbench.core import RecordingError, listed_paths
from kinectbench.core.trajectory.stamps import counted_ns
from kinectbench.core.trajectory.trajectory_file import read_given, trajectory_from_matrices
from kinectbench.core.types import Float64
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.json_values import json_numbers, read_camera_of_frame
from kinectbench.stages.ingest.known_names import first_file
from kinectbench.stages.ingest.readers.phone_images import (
    GRAVITY_UP,
    OPENGL_FROM_OPTICAL,
    PhoneRecording,
    intrinsics_of_depth,
    times_or_counted,
)
from kinectbench.stages.ingest.recording import Evidence, FrameFiles, first_color_size, first_depth_size

DEPTH_SCALE = 1000.0
# Keys of a frame's JSON that are read, and the required keys in words.
CAMERA_KEYS, NEEDED = ("time", "intrinsics", "cameraPoseARFrame"), "intrinsics and cameraPoseARFrame"
DEPTH_NAME = re.compile(r"depth_(\d{1,9})\.png")


class ScannerAppRecording(PhoneRecording):
    """A folder of 3D Scanner App; only some frames have colour."""

    format: ClassVar[str] = "scanner_app"
    uses: ClassVar[frozenset[str]] = frozenset({"min_confidence"})
    looks_for: ClassVar[str] = "a folder with depth_00000.png and frame_00000.json (conf_, frame_*.jpg)"
    up_world: ClassVar[tuple[float, float, float] | None] = GRAVITY_UP
    evidence: ClassVar[Evidence] = "copy"
    verified: ClassVar[str] = "92 frames of boards on a floor (Apache 2.0)"

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder has a depth image with its JSON."""
        return path.is_dir() and any(
            (path / f"frame_{file.stem.removeprefix('depth_')}.json").is_file()
            for file in listed_paths(path, wanted=DEPTH_NAME.fullmatch)
        )

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """List the frames by number and read every JSON."""
        depth_files = listed_paths(path, wanted=DEPTH_NAME.fullmatch)
        stems = sorted((file.stem.removeprefix("depth_") for file in depth_files), key=int)
        json_files = [path / f"frame_{stem}.json" for stem in stems]
        cameras = [read_camera_of_frame(file, NEEDED, CAMERA_KEYS) for file in json_files]
        times_s = json_numbers([camera.get("time") if camera else None for camera in cameras])
        stamps_ns, warnings = times_or_counted(times_s, counted_ns(len(cameras)), path)
        files = tuple(
            FrameFiles(stamp_ns, path / f"depth_{stem}.png", first_file([path / f"frame_{stem}.jpg"]))
            for stamp_ns, stem in zip(stamps_ns, stems, strict=True)
        )
        size_px = first_depth_size(files)
        K = next((_matrix(camera, "intrinsics", 3) for camera in cameras if camera), None)
        K = np.full((3, 3), np.nan) if K is None else K
        trajectory, lost, error = read_given(
            lambda: trajectory_from_matrices(stamps_ns, [_pose(camera) for camera in cameras], str(path))
        )
        intrinsics = intrinsics_of_depth(K, first_color_size(files), size_px, path, settings)
        return cls(
            path=path,
            places=files,
            camera=intrinsics.camera(size_px, path),
            depth_scale=intrinsics.depth_scale or DEPTH_SCALE,
            color_registered=any(file.color for file in files),
            given_trajectory=trajectory,
            trajectory_error=error,
            warnings=(*warnings, *lost),
            confidence=tuple(first_file([path / f"conf_{stem}.png"]) for stem in stems),
            min_confidence=settings.min_confidence,
        )


def _matrix(camera: dict[str, object], key: str, side: int) -> Float64:
    """Return the matrix (side, side) under a key, which is stored row-major."""
    numbers = json_numbers(camera.get(key))
    if numbers.size != side * side:
        raise RecordingError(f"{camera['file']}: '{key}' must hold {side * side} numbers")
    return numbers.reshape(side, side)


def _pose(camera: dict[str, object] | None) -> Float64 | None:
    """Return camera to world (4, 4) in optical axes; None if the frame has no pose."""
    if camera is None or "cameraPoseARFrame" not in camera:
        return None
    with np.errstate(invalid="ignore"):  # values may not be finite
        return np.asarray(_matrix(camera, "cameraPoseARFrame", 4) @ OPENGL_FROM_OPTICAL)

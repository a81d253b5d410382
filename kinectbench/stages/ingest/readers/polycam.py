"""Polycam's raw data: keyframes/ with depth, images and cameras, in files named by microseconds.

By Polycam's page (github.com/PolyCam/polyform): depth is in mm; confidence is 0, 127 or 255; a JSON for each
frame has intrinsics, width and height of its image, and row-major `t_00` to `t_23`, camera to world in
ARKit's axes aligned with gravity, y up. `corrected_cameras/` and `corrected_images/` contain the optimised
poses and the undistorted images.
"""

import re
from pathlib import Path
from typing import ClassVar, Self

import numpy as np

from kinectbench.core import GivenPosesError, RecordingError
from kinectbench.core.trajectory.trajectory_file import read_given, trajectory_from_matrices
from kinectbench.core.types import Float64
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.json_values import json_numbers, number_of, read_camera_of_frame
from kinectbench.stages.ingest.known_names import first_file, visible
from kinectbench.stages.ingest.readers.phone_images import (
    GRAVITY_UP,
    OPENGL_FROM_OPTICAL,
    PhoneRecording,
    one_camera,
    scaled_to_depth,
)
from kinectbench.stages.ingest.recording import FrameFiles, first_depth_size

# Depth is in millimetres, stamps in microseconds.
DEPTH_SCALE = 1000.0
NS_PER_US = 1000
# Larger numbers of microseconds do not fit 64-bit nanoseconds.
STAMP_US = re.compile(r"[0-8]?\d{1,15}")
# The highest of the three confidence values 0, 127 and 255.
HIGH = 255
CAMERA_KEYS = ("fx", "fy", "cx", "cy", "width", "height")
# Rows and columns of the camera-to-world matrix.
POSE_KEYS = tuple(f"t_{row}{column}" for row in range(3) for column in range(4))


class PolycamRecording(PhoneRecording):
    """A folder of Polycam's raw data; its optimised poses are used if present."""

    format: ClassVar[str] = "polycam"
    uses: ClassVar[frozenset[str]] = frozenset({"min_confidence"})
    looks_for: ClassVar[str] = "a folder with keyframes/depth and keyframes/cameras or corrected_cameras"
    up_world: ClassVar[tuple[float, float, float] | None] = GRAVITY_UP

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether the folder has keyframes/ with depth/ and cameras."""
        inside = path / "keyframes"
        cameras = any((inside / name).is_dir() for name in ("cameras", "corrected_cameras"))
        return cameras and (inside / "depth").is_dir()

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """List the depth images by stamp, and read the camera of each image."""
        inside = path / "keyframes"
        corrected = bool(visible(inside / "corrected_cameras", "*.json"))
        kind = "corrected_" if corrected else ""
        warnings = [] if corrected else [f"{path}: has no corrected_cameras; ARKit's own poses are taken"]
        depth = {int(f.stem): f for f in visible(inside / "depth", "*.png") if STAMP_US.fullmatch(f.stem)}
        if not depth:
            raise RecordingError(
                f"{inside / 'depth'}: holds no depth image; export the raw data again", what="no-depth"
            )
        stems = [depth[stamp_us].stem for stamp_us in sorted(depth)]
        files = tuple(
            FrameFiles(
                int(stem) * NS_PER_US,
                depth[int(stem)],
                first_file([inside / f"{kind}images" / f"{stem}.jpg"]),
            )
            for stem in stems
        )
        needed, keys = "the intrinsics and t_00 to t_23", (*CAMERA_KEYS, *POSE_KEYS)
        json_files = [inside / f"{kind}cameras" / f"{stem}.json" for stem in stems]
        cameras = [read_camera_of_frame(file, needed, keys) for file in json_files]
        size_px = first_depth_size(files)
        K, color_px, varied = _shared(inside / f"{kind}cameras", cameras)
        recorded = scaled_to_depth(K, color_px, size_px, path)
        stamps_ns = [file.stamp_ns for file in files]
        trajectory, lost, error = read_given(
            lambda: trajectory_from_matrices(stamps_ns, [_pose(camera) for camera in cameras], str(path))
        )
        intrinsics = recorded.overridden_by(settings)
        return cls(
            path=path,
            places=files,
            camera=intrinsics.camera(size_px, path),
            depth_scale=intrinsics.depth_scale or DEPTH_SCALE,
            color_registered=any(file.color for file in files),
            given_trajectory=trajectory,
            trajectory_error=error,
            warnings=(*warnings, *varied, *lost),
            confidence=tuple(first_file([inside / "confidence" / f"{stem}.png"]) for stem in stems),
            min_confidence=settings.min_confidence,
            full_confidence=HIGH,
        )


def _shared(
    folder: Path, cameras: list[dict[str, object] | None]
) -> tuple[Float64, tuple[int, int], list[str]]:
    """Return the common pinhole matrix of the images, their size, and warnings."""
    known = [camera for camera in cameras if camera]
    if not known:
        raise RecordingError(
            f"{folder}: holds no camera of a depth image; export the raw data again", what="no-intrinsics"
        )
    rows = np.array([[number_of(c.get(key), f"{c['file']}: '{key}'") for key in CAMERA_KEYS] for c in known])
    if (rows[:, 4:] != rows[0, 4:]).any():
        raise RecordingError(
            f"{folder}: its images are of several sizes; a recording must keep one camera", what="two-cameras"
        )
    K, warnings = one_camera(rows[:, :4], folder)
    return K, (int(rows[0, 4]), int(rows[0, 5])), warnings


def _pose(camera: dict[str, object] | None) -> Float64 | None:
    """Return camera to world (4, 4) in optical axes; None if the frame has no pose."""
    if camera is None or POSE_KEYS[0] not in camera:
        return None
    numbers = json_numbers([camera.get(key) for key in POSE_KEYS])
    if numbers.shape != (12,):
        raise GivenPosesError(f"{camera['file']}: t_00 to t_23 must be numbers")
    with np.errstate(invalid="ignore"):  # values may not be finite
        return np.asarray(np.vstack([numbers.reshape(3, 4), [0, 0, 0, 1]]) @ OPENGL_FROM_OPTICAL)

"""Objects of YCB's Berkeley RGB-D data: five PrimeSense cameras around a turntable, depth in HDF5.

NPc_A.h5 has `depth`, and NPc_A.jpg is colour, of camera c at angle A of the turntable, degrees.
calibration.h5 has the cameras, and poses/NP5_A_pose.h5 the pose of NP5's colour camera relative to the
turntable. Keys and the unit, 0.1 mm times NPc_ir_depth_scale, are those of YCB's script
ycb_generate_point_cloud.py (in chenxi-wang/ycb-scripts and StefanieStoppel/CVP_YCB_preprocessing). So is the
convention that masks/NPc_A_mask.pbm has colour's pixels, and 0 on the object. Not verified here on a file:
that NPc_rgb_d are OpenCV's k1 k2 p1 p2 k3.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import RecordingError, is_too_large
from kinectbench.core.encoded_images import decoded_image
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.stamps import NS_PER_S
from kinectbench.core.trajectory.trajectory_file import read_given, rigid_or_none, trajectory_from_matrices
from kinectbench.core.types import Bools, Float64
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.depth_files import hdf5_arrays
from kinectbench.stages.ingest.images import DamagedImageError
from kinectbench.stages.ingest.intrinsics import Intrinsics, pinhole, scale_warnings
from kinectbench.stages.ingest.known_names import first_file, visible
from kinectbench.stages.ingest.recording import (
    ColorCalibration,
    FileRecording,
    FrameFiles,
    first_color_size,
    first_depth_size,
    read_image_file,
    without_color,
)

SENSORS = ("NP1", "NP2", "NP3", "NP4", "NP5")
CALIBRATION = "calibration.h5"
# The header of a bitmap: P1 or P4, comments, width and height (Netpbm's pbm(5)).
BITMAP = re.compile(rb"P[14](?:\s+#[^\n]*)*\s+(\d{1,6})\s+(\d{1,6})\s")
NAMED = re.compile(r"NP[1-5]_(\d{1,9})")
# Units per metre: 0.1 mm.
DEPTH_SCALE = 10_000.0
# Keys of calibration.h5 and the shapes of their arrays.
SHAPES = {
    "{}_depth_K": (3, 3),
    "{}_rgb_K": (3, 3),
    "{}_rgb_d": (5,),
    "{}_ir_depth_scale": (1,),
    "H_{}_from_NP5": (4, 4),
    "H_{}_ir_from_NP5": (4, 4),
}
DEPTH_K, COLOR_K, COLOR_D, SCALE, COLOR_FROM_NP5, DEPTH_FROM_NP5 = SHAPES
POSE = "H_table_from_reference_camera"


class YcbRecording(FileRecording):
    """An object seen by one camera; the world turns with the table; a stamp is the angle, 1 s per degree."""

    format: ClassVar[str] = "ycb"
    uses: ClassVar[frozenset[str]] = frozenset({"sensor"})
    looks_for: ClassVar[str] = (
        "a folder with NP1_0.h5 and calibration.h5 (NP1_0.jpg, poses/; needs kinectbench[ycb])"
    )

    @classmethod
    def recognises(cls, path: Path) -> bool:
        """Whether one of the cameras has depth at angle 0."""
        return any((path / f"{sensor}_0.h5").is_file() for sensor in SENSORS)

    @classmethod
    def open(cls, path: Path, settings: CameraSettings) -> Self:
        """List the depth images of one camera by angle, with colour and poses."""
        there = [sensor for sensor in SENSORS if (path / f"{sensor}_0.h5").is_file()]
        sensor = settings.sensor or there[0]
        found = {
            int(match[1]): f for f in visible(path, f"{sensor}_*.h5") if (match := NAMED.fullmatch(f.stem))
        }
        if not found:
            raise RecordingError(
                f"{path}: has no depth of `sensor: {sensor}`; name one of {', '.join(there)}", what="no-depth"
            )
        angles = sorted(found)
        files = tuple(
            FrameFiles(
                angle * NS_PER_S,
                found[angle],
                first_file([found[angle].with_suffix(".jpg")]),
                first_file([path / "masks" / f"{found[angle].stem}_mask.pbm"]),
            )
            for angle in angles
        )
        size_px, color_px = first_depth_size(files), first_color_size(files)
        said, warnings = _calibration(path, sensor)
        intrinsics = _intrinsics(said, path).overridden_by(settings)
        camera = intrinsics.camera(size_px, path)
        calibration = None if color_px is None else _color(said, color_px, path)
        registered = calibration is not None and calibration.lies_on(camera)
        trajectory, missing, error = read_given(lambda: _poses(path, said, angles))
        others = ", ".join(name for name in there if name != sensor)
        if others and settings.sensor is None:
            warnings.append(f"{path}: {sensor} is read; `camera: {{sensor: ...}}` takes {others}, too")
        return cls(
            path=path,
            places=files,
            camera=camera,
            depth_scale=intrinsics.depth_scale or DEPTH_SCALE,
            color_registered=registered,
            color_calibration=None if registered else calibration,
            given_trajectory=trajectory,
            trajectory_error=error,
            warnings=(
                *warnings,
                *missing,
                *without_color(path, files),
                *scale_warnings(path, _intrinsics(said, path).depth_scale, settings),
            ),
        )

    def mask(self, file: Path, depth: NDArray[np.uint16]) -> Bools:
        """Read a mask (height, width), mapped from colour's to depth's pixels if colour is calibrated."""
        pixels = _bitmap(read_image_file(file), str(file))
        if self.color_calibration is None:
            return np.asarray(pixels == 0)
        from kinectbench.stages.ingest.registration import ColorRegistration

        register = ColorRegistration(self.camera, self.color_calibration)
        if pixels.shape[::-1] != register.color_px:
            raise DamagedImageError(f"{file}: its size is not that of the colour images")
        white = np.where(pixels == 0, np.uint8(255), np.uint8(0))
        depth_m = depth.astype(np.float32) / np.float32(self.depth_scale)
        return np.asarray(register(depth_m, np.dstack([white] * 3))[..., 0] > 127)


def _bitmap(data: bytes, name: str) -> NDArray[np.uint8]:
    """Read a Netpbm bitmap: (height, width), 0 where it is black."""
    import cv2

    head = BITMAP.match(data)
    if head is None or is_too_large(int(head[1]), int(head[2])):
        raise DamagedImageError(f"{name}: is no bitmap (P1 or P4), or too large")
    try:
        return np.asarray(decoded_image(data, cv2.IMREAD_GRAYSCALE), np.uint8)
    except ValueError as error:
        raise DamagedImageError(f"{name}: {error}") from error


def _calibration(path: Path, sensor: str) -> tuple[dict[str, Float64], list[str]]:
    """Return a camera's arrays in calibration.h5, {key of SHAPES: array}, and a warning on missing arrays."""
    names = {key: key.format(sensor) for key in SHAPES}
    if not (path / CALIBRATION).is_file():
        return {}, [
            f"{path}: has no {CALIBRATION}: neither intrinsics nor poses nor the place of colour are known"
        ]
    arrays = _arrays(path / CALIBRATION, {names[key]: shape for key, shape in SHAPES.items()})
    said = {key: arrays[name] for key, name in names.items() if name in arrays}
    lacking = [name for key, name in names.items() if key not in said]
    return said, [f"{path / CALIBRATION}: lacks {', '.join(lacking)}"] if lacking else []


def _arrays(file: Path, shapes: Mapping[str, tuple[int, ...]]) -> dict[str, Float64]:
    """Read the arrays in `shapes` that an HDF5 file has, as float64.

    Raises:
        RecordingError: an array is not finite or has another shape.
    """
    most = max(int(np.prod(shape)) for shape in shapes.values())
    try:
        found = hdf5_arrays(read_image_file(file), str(file), shapes, most)
    except DamagedImageError as error:
        raise RecordingError(f"{error}; copy it again", what="malformed") from error
    for key, values in found.items():
        if values.shape != shapes[key] or not np.isfinite(values).all():
            raise RecordingError(
                f"{file}: '{key}' is of shape {values.shape}, or not finite; wanted {shapes[key]}",
                what="malformed",
            )
    return {key: np.asarray(values, np.float64) for key, values in found.items()}


def _intrinsics(said: Mapping[str, Float64], path: Path) -> Intrinsics:
    """Make intrinsics of depth (pinhole, as in YCB's script) from calibration.h5's arrays, `said`."""
    if DEPTH_K not in said:
        return Intrinsics()
    scale = float(said[SCALE][0]) if SCALE in said else 1.0
    if scale <= 0:
        raise RecordingError(
            f"{path / CALIBRATION}: its depth scale {scale:g} is not above 0", what="malformed"
        )
    K = pinhole(said[DEPTH_K], path / CALIBRATION)
    return Intrinsics(fx=K.fx, fy=K.fy, cx=K.cx, cy=K.cy, depth_scale=DEPTH_SCALE / scale)


def _color(said: Mapping[str, Float64], color_px: tuple[int, int], path: Path) -> ColorCalibration | None:
    """Return colour's calibration from `said` (calibration.h5); None if it is missing or not rigid."""
    places = [rigid_or_none(said[key]) for key in (COLOR_FROM_NP5, DEPTH_FROM_NP5) if key in said]
    color, *depth = places or [None]
    if COLOR_K not in said or color is None or not depth or depth[0] is None:
        return None
    camera = pinhole(said[COLOR_K], path / CALIBRATION).camera(color_px, path)
    distortion = said.get(COLOR_D, np.zeros(5))
    T_color_depth = color @ np.linalg.inv(depth[0])
    return ColorCalibration(camera, tuple(distortion.tolist()) if distortion.any() else (), T_color_depth)


def _poses(
    path: Path, said: Mapping[str, Float64], angles: Sequence[int]
) -> tuple[GivenTrajectory | None, list[str]]:
    """Return depth's trajectory in the turntable's frame, 1 s per degree of `angles`, and warnings.

    The trajectory is None if poses, or the transform from the camera of the poses, are missing.
    """
    files = [path / "poses" / f"NP5_{angle}_pose.h5" for angle in angles]
    if not any(file.is_file() for file in files):
        return None, [f"{path}: has no poses/NP5_0_pose.h5; the object is tracked by its depth alone"]
    depth_from_np5 = rigid_or_none(said[DEPTH_FROM_NP5]) if DEPTH_FROM_NP5 in said else None
    if depth_from_np5 is None:
        return None, [
            f"{path}: its poses are of NP5, and {CALIBRATION} does not say where this camera is to it"
        ]
    poses = [_arrays(file, {POSE: (4, 4)}).get(POSE) if file.is_file() else None for file in files]
    matrices = [None if pose is None else pose @ np.linalg.inv(depth_from_np5) for pose in poses]
    return trajectory_from_matrices([angle * NS_PER_S for angle in angles], matrices, str(path))

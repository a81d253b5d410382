"""The calibration of an Azure Kinect or Femto: `calibration.json`, as the sensor stores it."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinectbench.core import IntrinsicsError, RecordingError
from kinectbench.core.geometry import Camera, rigid
from kinectbench.core.trajectory.trajectory_file import rigid_or_none
from kinectbench.core.types import Bools, Float64
from kinectbench.stages.ingest.intrinsics import Intrinsics
from kinectbench.stages.ingest.json_values import json_numbers, number_of
from kinectbench.stages.ingest.recording import ColorCalibration

CALIBRATION_FILE = "calibration.json"
DEPTH_LOCATION, COLOR_LOCATION = "CALIBRATION_CameraLocationD0", "CALIBRATION_CameraLocationPV0"
# By the SDK's intrinsic_transformation.c both are Brown's model with six radial terms, as in OpenCV; but
# Rational6KT halves the cross terms of tangential distortion.
BROWN_CONRADY = "CALIBRATION_LensDistortionModelBrownConrady"
RATIONAL = "CALIBRATION_LensDistortionModelRational6KT"
UNDISTORT = "undistort its images, and bring them in another format (`kinectbench formats`)"
PARAMETERS = 14
# Depth modes by image size: size of the sensor's image after binning, and pixels cropped at the left and top
# (the SDK's mode_specific_calibration.c).
DEPTH_MODES = {
    (320, 288): (512, (96, 90)),
    (640, 576): (1024, (192, 180)),
    (512, 512): (512, (0, 0)),
    (1024, 1024): (1024, (0, 0)),
}
# The colour sensor's image is 4:3; early calibrations are of its middle part, 16:9.
COLOR_HEIGHT, EARLY_HEIGHT = 3 / 4, 9 / 16
# Used if the calibration states none: 120 degrees (the SDK's value).
USUAL_RADIUS = 1.7
LEAST_RADIUS = 1e-4


@dataclass(frozen=True)
class AzureCamera:
    """One camera in the calibration file.

    Attributes:
        sensor_px: width and height of the sensor, pixels.
        focal: fx and fy as fractions of the sensor's width and height.
        center: cx and cy as fractions of that width and height; (0, 0) is the corner of the first pixel.
        distortion: k1 k2 p1 p2 k3 k4 k5 k6, in OpenCV's order.
        T_camera_rig: (4, 4), rig to camera, metres.
        radius: largest distance from the axis, on the plane at depth 1, at which distortion is defined.
    """

    sensor_px: tuple[int, int]
    focal: tuple[float, float]
    center: tuple[float, float]
    distortion: tuple[float, ...]
    T_camera_rig: Float64
    radius: float


@dataclass(frozen=True)
class AzureCalibration:
    """The depth camera and the colour camera; colour is None if the file has none."""

    of_depth: AzureCamera
    of_color: AzureCamera | None

    @classmethod
    def of(cls, raw: dict[str, object], path: Path) -> "AzureCalibration":
        """Read the cameras from the file's JSON object; `path` is the recording, for messages.

        Raises:
            RecordingError: the depth camera is missing, or a value is invalid.
        """
        where = f"{path}: {CALIBRATION_FILE}"
        information = raw.get("CalibrationInformation")
        cameras = information.get("Cameras") if isinstance(information, dict) else None
        if not isinstance(cameras, list):
            raise RecordingError(f"{where}: has no list of Cameras in CalibrationInformation")
        placed = {str(c.get("Location")): _camera(c, where) for c in cameras if isinstance(c, dict)}
        if DEPTH_LOCATION not in placed:
            raise RecordingError(f"{where}: has no camera at {DEPTH_LOCATION}, which is depth's")
        return cls(placed[DEPTH_LOCATION], placed.get(COLOR_LOCATION))

    def depth(self, size_px: tuple[int, int], path: Path) -> tuple[Intrinsics, tuple[float, ...]]:
        """Return intrinsics, and distortion in OpenCV's order, for depth images of this size.

        Raises:
            RecordingError: no depth mode has this size.
        """
        camera = self.of_depth
        if size_px in DEPTH_MODES:
            side, crop_px = DEPTH_MODES[size_px]
            return _in_pixels(camera, (side, side), crop_px), camera.distortion
        if size_px != camera.sensor_px:
            sizes = ", ".join(f"{width}x{height}" for width, height in DEPTH_MODES)
            raise IntrinsicsError(
                f"{path}: its depth is {size_px[0]}x{size_px[1]}, which is no mode of the sensor ({sizes}): "
                "give fx, fy, cx, cy under `camera:` after converting it to another format"
            )
        return _in_pixels(camera, size_px, (0, 0)), camera.distortion

    def color(self, size_px: tuple[int, int], path: Path) -> ColorCalibration | None:
        """Return the calibration of colour images of this size relative to depth.

        The result is None if there is no colour camera.

        Raises:
            RecordingError: the intrinsics do not fit images of this size.
        """
        if self.of_color is None:
            return None
        whole = (size_px[0], size_px[0] * COLOR_HEIGHT)
        used = _in_pixels(self.of_color, whole, (0, (whole[1] - size_px[1]) / 2))
        T = self.of_color.T_camera_rig @ np.linalg.inv(self.of_depth.T_camera_rig)
        distorted = any(self.of_color.distortion)
        return ColorCalibration(used.camera(size_px, path), self.of_color.distortion if distorted else (), T)

    def beyond_radius(self, camera: Camera) -> Bools:
        """Find pixels of undistorted depth where the distortion model is undefined: (height, width) bool."""
        rays = camera.rays()
        return np.asarray(np.hypot(rays[..., 0], rays[..., 1]) > self.of_depth.radius)


def _in_pixels(
    camera: AzureCamera, image_px: tuple[float, float], crop_px: tuple[float, float]
) -> Intrinsics:
    """Convert to pixels: the sensor is scaled to `image_px`, then `crop_px` are cut off left and above."""
    fx, fy = (share * px for share, px in zip(camera.focal, image_px, strict=True))
    cx, cy = (c * px - crop - 0.5 for c, px, crop in zip(camera.center, image_px, crop_px, strict=True))
    return Intrinsics(fx=fx, fy=fy, cx=cx, cy=cy)


def _camera(raw: dict[str, object], where: str) -> AzureCamera:
    location = str(raw.get("Location")).removeprefix("CALIBRATION_CameraLocation")
    where = f"{where}: camera {location}"
    intrinsics, place = raw.get("Intrinsics"), raw.get("Rt")
    if not isinstance(intrinsics, dict) or not isinstance(place, dict):
        raise RecordingError(f"{where} needs Intrinsics and Rt")
    model = intrinsics.get("ModelType")
    if model not in (BROWN_CONRADY, RATIONAL):
        raise RecordingError(
            f"{where}: the model {model!r:.60} of lenses is not read; {UNDISTORT}", what="lens"
        )
    numbers = json_numbers(intrinsics.get("ModelParameters"))
    if numbers.shape[:1] < (PARAMETERS,) or numbers.ndim != 1 or not np.isfinite(numbers[:PARAMETERS]).all():
        raise RecordingError(f"{where}: ModelParameters must hold {PARAMETERS} numbers")
    cx, cy, fx, fy, k1, k2, k3, k4, k5, k6, codx, cody, p2, p1 = numbers[:PARAMETERS].tolist()
    if codx or cody:
        raise RecordingError(
            f"{where}: a centre of distortion beside the axis is not read; {UNDISTORT}", what="lens"
        )
    if model == RATIONAL and (p1 or p2):
        raise RecordingError(
            f"{where}: the tangential terms of {model} are not read; {UNDISTORT}", what="lens"
        )
    sensor = [number_of(raw.get(key), f"{where}: {key}") for key in ("SensorWidth", "SensorHeight")]
    if not 16 <= min(sensor) <= max(sensor) <= 1 << 14:
        raise RecordingError(f"{where}: a sensor of {sensor[0]:g}x{sensor[1]:g} pixels is none")
    if location == "PV0" and abs(sensor[1] / sensor[0] - EARLY_HEIGHT) < 1e-3:
        shrink = EARLY_HEIGHT / COLOR_HEIGHT
        fy, cy = fy * shrink, cy * shrink + (1 - shrink) / 2
    radius = number_of(raw.get("MetricRadius", 0), f"{where}: MetricRadius")
    return AzureCamera(
        (int(sensor[0]), int(sensor[1])),
        (fx, fy),
        (cx, cy),
        (k1, k2, p1, p2, k3, k4, k5, k6),
        _place(place, where),
        radius if radius > LEAST_RADIUS else USUAL_RADIUS,
    )


def _place(raw: dict[str, object], where: str) -> Float64:
    """Read rig to camera (4, 4), metres, from Rotation (nine row-major numbers) and Translation."""
    R, t_m = json_numbers(raw.get("Rotation")), json_numbers(raw.get("Translation"))
    if R.size == 9 and t_m.size == 3:
        T = rigid_or_none(rigid(R.reshape(3, 3), t_m.reshape(3)))
        if T is not None:
            return T
    raise RecordingError(f"{where}: Rt must hold the nine numbers of a rotation, and three of a translation")

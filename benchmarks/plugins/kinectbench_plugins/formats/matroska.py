"""Recordings of Azure Kinect: Matroska files by PyAV, as k4arecorder lays them out."""

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from kinectbench.core.errors import RecordingError
from kinectbench.core.geometry import Camera
from kinectbench.core.storage import pretty_json
from kinectbench.core.types import Float64
from kinectbench.lab.simulate.writers.frame import RecordedFrame, Rig
from kinectbench.stages.ingest.readers.azure_calibration import DEPTH_MODES

TIME_BASE = Fraction(1, 1000)
NS_PER_MS = 1_000_000
# k4arecorder's names of the sensor's modes, by the size of their images.
MODES = {
    (320, 288): "NFOV_2X2BINNED",
    (640, 576): "NFOV_UNBINNED",
    (512, 512): "WFOV_2X2BINNED",
    (1024, 1024): "WFOV_UNBINNED",
}
MODEL = "CALIBRATION_LensDistortionModelBrownConrady"


def write_azure_kinect(path: Path, rig: Rig, frames: Iterable[RecordedFrame]) -> None:
    """Write a .mkv that does not exist yet: tracks DEPTH (big-endian mm) and COLOR (MJPG), calibration.json.

    Stamps are milliseconds. A depth image of a mode's size is cropped from the sensor's as that mode does it;
    any other is its sensor's whole image. The layout has no place for poses.

    Raises:
        RecordingError: stamps go back, which such a file cannot hold.
    """
    import av

    options = {"allow_raw_vfw": "1", "fflags": "+bitexact"}
    with av.open(str(path), "w", format="matroska", options=options) as container:
        container.metadata["K4A_DEPTH_DELAY_NS"] = "0"
        depth = _add_track(container, "rawvideo", "gray16be", "DEPTH", rig.depth)
        depth.metadata["K4A_DEPTH_MODE"] = MODES.get((rig.depth.width, rig.depth.height), "NFOV_UNBINNED")
        color = _add_track(container, "mjpeg", "yuvj420p", "COLOR", rig.color)
        color.metadata["K4A_COLOR_MODE"] = f"MJPG_{rig.color.height}P"
        calibration = pretty_json(_calibration(rig)).encode()
        container.add_attachment("calibration.json", "application/octet-stream", calibration)
        for frame in frames:
            _add(container, depth, frame.stamp_ns, frame.depth_native().astype(">u2").tobytes())
            _add(container, color, frame.color_stamp_ns, frame.color_jpeg())


def _add_track(container: Any, codec: str, pixels: str, name: str, camera: Camera) -> Any:
    track = container.add_stream(codec, rate=30)
    track.width, track.height, track.pix_fmt = camera.width, camera.height, pixels
    track.time_base = TIME_BASE
    track.metadata["title"] = name
    return track


def _add(container: Any, track: Any, stamp_ns: int, data: bytes) -> None:
    import av

    packet = av.Packet(data)
    packet.stream, packet.time_base, packet.is_keyframe = track, TIME_BASE, True
    packet.pts = packet.dts = stamp_ns // NS_PER_MS
    try:
        container.mux(packet)
    except ValueError as error:
        raise RecordingError(f"{container.name}: a .mkv cannot hold stamps that go back ({error})") from error


def _calibration(rig: Rig) -> dict[str, Any]:
    """What the sensor says of its cameras; colour is a part of a sensor of 4:3."""
    depth, color = rig.depth, rig.color
    whole = (depth.width, depth.height)
    side, crop_px = DEPTH_MODES.get(whole, (0, (0, 0)))
    color_height = color.width * 3 / 4
    color_crop_px = (0, (color_height - color.height) / 2)
    cameras = [
        _camera("D0", depth, (side, side) if side else whole, crop_px, np.eye(4)),
        _camera("PV0", color, (color.width, color_height), color_crop_px, rig.T_color_depth),
    ]
    return {"CalibrationInformation": {"Cameras": cameras}}


def _camera(
    location: str,
    camera: Camera,
    sensor_px: tuple[float, float],
    crop_px: tuple[float, float],
    T: Float64,
) -> dict[str, Any]:
    """A camera whose image is cropped on the left and above from one of that size."""
    width, height = sensor_px
    center = [(camera.cx + 0.5 + crop_px[0]) / width, (camera.cy + 0.5 + crop_px[1]) / height]
    return {
        "Location": f"CALIBRATION_CameraLocation{location}",
        "SensorWidth": width,
        "SensorHeight": height,
        "MetricRadius": 0.0,
        "Intrinsics": {
            "ModelType": MODEL,
            "ModelParameterCount": 14,
            "ModelParameters": [*center, camera.fx / width, camera.fy / height, *[0.0] * 10],
        },
        "Rt": {"Rotation": T[:3, :3].ravel().tolist(), "Translation": T[:3, 3].tolist()},
    }

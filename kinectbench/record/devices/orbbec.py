"""Orbbec's Femto and Gemini by Orbbec's SDK; colour stays the JPEG that the camera encodes."""

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from kinectbench.core import CaptureError
from kinectbench.core.geometry import Camera, rigid
from kinectbench.core.types import MM_PER_M
from kinectbench.record.interface import POLL_MS, Device, Frame, Setup, polled
from kinectbench.stages.ingest.recording import ColorCalibration
from kinectbench.stages.ingest.undistortion import Undistortion

if TYPE_CHECKING:
    from pyorbbecsdk import FrameSet, OBCameraDistortion, OBCameraIntrinsic

# OpenCV's order; Orbbec's Brown model has the same coefficients.
COEFFICIENTS = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")


class Orbbec(Device):
    """The first camera that Orbbec's SDK finds."""

    name = "orbbec"
    cameras = "Orbbec Femto and Gemini"
    extra = "record-orbbec"

    def plugged_in(self) -> tuple[str, ...]:
        """Return names and serial numbers of the cameras."""
        ob = _sdk()
        found = ob.Context().query_devices()
        return tuple(
            f"{found.get_device_name_by_index(k)} {found.get_device_serial_number_by_index(k)}"
            for k in range(found.get_count())
        )

    def open(self) -> Setup:
        """Start depth and colour in their usual modes, synchronised; the first pair gives the depth unit."""
        ob = _sdk()
        if not self.plugged_in():
            raise CaptureError(f"{self.name}: no camera is plugged in")
        pipeline, config = ob.Pipeline(), ob.Config()
        depths = pipeline.get_stream_profile_list(ob.OBSensorType.DEPTH_SENSOR)
        depth_profile = depths.get_default_video_stream_profile()
        colors = pipeline.get_stream_profile_list(ob.OBSensorType.COLOR_SENSOR)
        # A size of 0 means any; the SDK takes the first profile of that format.
        color_profile = colors.get_video_stream_profile(1280, 0, ob.OBFormat.MJPG, 30)
        config.enable_stream(depth_profile)
        config.enable_stream(color_profile)
        config.set_frame_aggregate_output_mode(ob.OBFrameAggregateOutputMode.FULL_FRAME_REQUIRE)
        pipeline.enable_frame_sync()
        pipeline.start(config)
        self._pipeline = pipeline
        self._first = next(polled(self._next, self.name))
        mm_a_unit = float(self._first.get_depth_frame().get_depth_scale())
        camera = _camera(depth_profile.get_intrinsic())
        bent = _distortion(depth_profile.get_distortion())
        self._undistortion = Undistortion(camera, bent) if any(bent) else None
        place = depth_profile.get_extrinsic_to(color_profile)
        # The SDK's translations are in mm.
        T_color_depth = rigid(np.reshape(place.rot, (3, 3)), np.ravel(place.transform) / MM_PER_M)
        color_bent = _distortion(color_profile.get_distortion())
        calibration = ColorCalibration(
            _camera(color_profile.get_intrinsic()), color_bent if any(color_bent) else (), T_color_depth
        )
        return Setup(camera, MM_PER_M / mm_a_unit, False, calibration)

    def frames(self) -> Iterator[Frame]:
        """Yield depth as pinhole images, with the colour of the same time."""
        last: int | None = None
        yield self._frame(self._first)
        for found in polled(self._next, self.name):
            number = found.get_depth_frame().get_index()
            if last is not None:
                self.missed += max(number - last - 1, 0)
            last = number
            yield self._frame(found)

    def close(self) -> None:
        """Stop both streams."""
        if hasattr(self, "_pipeline"):
            self._pipeline.stop()

    def _next(self) -> "FrameSet | None":
        """Return the next pair of depth and colour; None if none arrived."""
        found = self._pipeline.wait_for_frames(POLL_MS)
        if found is None or found.get_depth_frame() is None or found.get_color_frame() is None:
            return None
        return found

    def _frame(self, found: "FrameSet") -> Frame:
        depth, color = found.get_depth_frame(), found.get_color_frame()
        shape = depth.get_height(), depth.get_width()
        image = np.frombuffer(bytes(depth.get_data()), np.uint16).reshape(shape)
        if self._undistortion is not None:
            image = self._undistortion.depth(image)
        jpeg = (".jpg", bytes(color.get_data()))
        return Frame(depth.get_timestamp_us() * 1000, image, jpeg, color.get_timestamp_us() * 1000)


def _sdk() -> Any:
    """Import Orbbec's SDK, and stop it from writing a folder Log/ into the working folder."""
    import pyorbbecsdk as ob

    ob.Context.set_logger_to_file(ob.OBLogLevel.NONE, "")
    return ob


def _camera(said: "OBCameraIntrinsic") -> Camera:
    return Camera(said.width, said.height, said.fx, said.fy, said.cx, said.cy)


def _distortion(said: "OBCameraDistortion") -> tuple[float, ...]:
    return tuple(float(getattr(said, name)) for name in COEFFICIENTS)

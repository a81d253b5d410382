"""Azure Kinect by Microsoft's SDK: depth in its narrow mode; colour stays the JPEG from the camera."""

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from kinectbench.core import CaptureError
from kinectbench.core.geometry import Camera, rigid
from kinectbench.core.types import MM_PER_M, Float64
from kinectbench.record.interface import POLL_MS, Device, Frame, Setup, polled
from kinectbench.stages.ingest.recording import ColorCalibration
from kinectbench.stages.ingest.undistortion import Undistortion

if TYPE_CHECKING:
    from pyk4a import PyK4ACapture

# Sizes of the modes NFOV_UNBINNED and RES_720P.
DEPTH_PX, COLOR_PX = (640, 576), (1280, 720)


class AzureKinect(Device):
    """The first Azure Kinect."""

    name = "azure"
    cameras = "Azure Kinect"
    extra = "record-azure"
    system = "its depth engine, which is closed and needs a display (DISPLAY) on Linux"

    def plugged_in(self) -> tuple[str, ...]:
        """Return the name of each camera: "Azure Kinect" and its index."""
        import pyk4a

        return tuple(f"Azure Kinect {number}" for number in range(pyk4a.connected_device_count()))

    def open(self) -> Setup:
        """Start both cameras, synchronised."""
        import pyk4a

        if not pyk4a.connected_device_count():
            raise CaptureError(f"{self.name}: no camera is plugged in")
        config = pyk4a.Config(
            color_resolution=pyk4a.ColorResolution.RES_720P,
            color_format=pyk4a.ImageFormat.COLOR_MJPG,
            depth_mode=pyk4a.DepthMode.NFOV_UNBINNED,
            camera_fps=pyk4a.FPS.FPS_30,
            synchronized_images_only=True,
        )
        self._device = pyk4a.PyK4A(config)
        self._device.start()
        said, of_depth, of_color = self._device.calibration, *map(pyk4a.CalibrationType, (0, 1))
        camera = _camera(said.get_camera_matrix(of_depth), DEPTH_PX)
        self._undistortion = Undistortion(camera, said.get_distortion_coefficients(of_depth).tolist())
        rotation, translation_m = said.get_extrinsic_parameters(of_depth, of_color)
        calibration = ColorCalibration(
            _camera(said.get_camera_matrix(of_color), COLOR_PX),
            tuple(said.get_distortion_coefficients(of_color).tolist()),
            rigid(rotation, np.ravel(translation_m)),
        )
        return Setup(camera, MM_PER_M, False, calibration)

    def frames(self) -> Iterator[Frame]:
        """Yield frames; depth is undistorted to pinhole images, each pixel from the nearest measured one."""
        for capture in polled(self._next, self.name, lambda capture: capture.depth is not None):
            depth, color = capture.depth, capture.color
            if depth is None:
                continue
            image = self._undistortion.depth(np.asarray(depth, np.uint16))
            jpeg = None if color is None else (".jpg", bytes(np.asarray(color, np.uint8)))
            # The device's stamps are in microseconds.
            color_ns = None if color is None else capture.color_timestamp_usec * 1000
            yield Frame(capture.depth_timestamp_usec * 1000, image, jpeg, color_ns)

    def close(self) -> None:
        """Stop the camera."""
        if hasattr(self, "_device"):
            self._device.stop()

    def _next(self) -> "PyK4ACapture | None":
        import pyk4a

        try:
            return self._device.get_capture(timeout=POLL_MS)
        except pyk4a.K4ATimeoutException:
            return None


def _camera(K: Float64, size_px: tuple[int, int]) -> Camera:
    return Camera(*size_px, float(K[0, 0]), float(K[1, 1]), float(K[0, 2]), float(K[1, 2]))

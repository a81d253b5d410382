"""PrimeSense, Xtion and Astra by OpenNI 2; the camera itself registers depth to colour, if it can."""

import sysconfig
from collections.abc import Iterator
from math import tan
from typing import TYPE_CHECKING, Any

import numpy as np

from kinectbench.core import CaptureError
from kinectbench.core.geometry import Camera
from kinectbench.core.types import MM_PER_M
from kinectbench.record.interface import POLL_MS, Device, Frame, Setup, polled

if TYPE_CHECKING:
    from openni.openni2 import VideoFrame

# VGA at 30 Hz: the largest mode of a PrimeSense sensor with depth registered to colour.
WIDTH, HEIGHT, RATE_HZ = 640, 480, 30


class OpenNI(Device):
    """The first camera that OpenNI 2 finds."""

    name = "openni"
    cameras = "PrimeSense, Asus Xtion, Orbbec Astra"
    extra = "record-openni"
    system = (
        "OpenNI 2 itself: `apt install libopenni2-dev`, or OPENNI2_REDIST=FOLDER of Orbbec's own for an Astra"
    )

    def plugged_in(self) -> tuple[str, ...]:
        """Return the addresses (URIs) of the cameras."""
        return tuple(map(_text, _library().Device.enumerate_uris()))

    def open(self) -> Setup:
        """Start depth in mm and colour, both 640x480, registered if the camera supports it."""
        openni2 = _library()
        if not openni2.Device.enumerate_uris():
            raise CaptureError(f"{self.name}: no camera is plugged in")
        device = openni2.Device.open_any()
        self._depth, self._color = device.create_depth_stream(), device.create_color_stream()
        self._depth.configure_mode(WIDTH, HEIGHT, RATE_HZ, openni2.PIXEL_FORMAT_DEPTH_1_MM)
        self._color.configure_mode(WIDTH, HEIGHT, RATE_HZ, openni2.PIXEL_FORMAT_RGB888)
        registered = device.is_image_registration_mode_supported(openni2.IMAGE_REGISTRATION_DEPTH_TO_COLOR)
        if registered:
            device.set_image_registration_mode(openni2.IMAGE_REGISTRATION_DEPTH_TO_COLOR)
        for stream in (self._depth, self._color):
            stream.set_mirroring_enabled(False)
            stream.start()
        device.set_depth_color_sync_enabled(True)
        self._device = device
        # OpenNI gives the fields of view, and no other intrinsics; registered depth has colour's.
        seen = self._color if registered else self._depth
        fx = WIDTH / 2 / tan(seen.get_horizontal_fov() / 2)
        fy = HEIGHT / 2 / tan(seen.get_vertical_fov() / 2)
        return Setup(
            Camera(WIDTH, HEIGHT, fx, fy, (WIDTH - 1) / 2, (HEIGHT - 1) / 2), MM_PER_M, bool(registered)
        )

    def frames(self) -> Iterator[Frame]:
        """Yield depth and colour of the same time, as the camera pairs them."""
        last: int | None = None
        for depth, color in polled(self._next, self.name):
            if last is not None:
                self.missed += max(depth.frameIndex - last - 1, 0)
            last = depth.frameIndex
            image = np.array(depth.get_buffer_as_uint16(), np.uint16).reshape(depth.height, depth.width)
            rgb = np.array(color.get_buffer_as_uint8(), np.uint8).reshape(color.height, color.width, 3)
            # Stamps are in microseconds.
            yield Frame(depth.timestamp * 1000, image, rgb, color.timestamp * 1000)

    def close(self) -> None:
        """Stop both streams."""
        for name in ("_depth", "_color"):
            if hasattr(self, name):
                getattr(self, name).stop()

    def _next(self) -> tuple["VideoFrame", "VideoFrame"] | None:
        if _library().wait_for_any_stream([self._depth], POLL_MS / 1000) is None:
            return None
        return self._depth.read_frame(), self._color.read_frame()


def _library() -> Any:
    """Return OpenNI 2, initialised from OPENNI2_REDIST or from Debian's folder."""
    from openni import openni2

    if not openni2.is_initialized():
        places = [*openni2._default_dll_directories, f"/usr/lib/{sysconfig.get_config_var('MULTIARCH')}"]
        openni2.initialize(places)
    return openni2


def _text(uri: object) -> str:
    return uri.decode(errors="replace") if isinstance(uri, bytes) else str(uri)

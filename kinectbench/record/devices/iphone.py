"""iPhone or iPad by cable, with the app Record3D and its library: depth of low confidence is left out."""

import threading
import time
from collections.abc import Iterator

import numpy as np

from kinectbench.core import CaptureError
from kinectbench.core.geometry import Camera
from kinectbench.core.types import Float32
from kinectbench.record.interface import POLL_MS, Device, Frame, Setup, polled
from kinectbench.stages.ingest.images import FLOAT_SCALE, quantised
from kinectbench.stages.ingest.recording import ColorCalibration

# ARKit's confidence is 0, 1 or 2; the readers of phone recordings discard depth below 2, too.
LEAST_CONFIDENCE = 2


class IPhone(Device):
    """The first iPhone or iPad on which Record3D streams by USB."""

    name = "iphone"
    cameras = "iPhone and iPad with LiDAR or Face ID, by cable"
    extra = "record-iphone"
    system = "the app Record3D with USB streaming switched on; on Linux usbmuxd: `apt install usbmuxd`"

    def plugged_in(self) -> tuple[str, ...]:
        """Return the identifiers of the phones."""
        from record3d import Record3DStream

        return tuple(each.udid for each in Record3DStream.get_connected_devices())

    def open(self) -> Setup:
        """Connect, and wait for the first frame, which gives the image sizes."""
        from record3d import Record3DStream

        found = Record3DStream.get_connected_devices()
        if not found:
            raise CaptureError(f"{self.name}: no phone is plugged in; {self.system}")
        self._came, self._ended = threading.Event(), False
        self._stream = Record3DStream()
        self._stream.on_new_frame = self._came.set
        self._stream.on_stream_stopped = self._stop
        if not self._stream.connect(found[0]):
            raise CaptureError(f"{self.name}: does not answer; {self.system}")
        self._first = next(polled(self._next, self.name))
        said, shape = self._stream.get_intrinsic_mat(), self._stream.get_rgb_frame().shape
        height, width = self._first.depth.shape
        # Record3D gives the intrinsics of colour; tx and ty are the principal point. Pixel centres are
        # integers.
        color = Camera(shape[1], shape[0], said.fx, said.fy, said.tx, said.ty)
        x, y = width / color.width, height / color.height
        cx, cy = (said.tx + 0.5) * x - 0.5, (said.ty + 0.5) * y - 0.5
        camera = Camera(width, height, said.fx * x, said.fy * y, cx, cy)
        if color == camera:
            return Setup(camera, FLOAT_SCALE, True)
        return Setup(camera, FLOAT_SCALE, False, ColorCalibration(color, (), np.eye(4)))

    def frames(self) -> Iterator[Frame]:
        """Yield each frame; its stamp is its time of arrival, because the library gives no stamps."""
        yield self._first
        yield from polled(self._next, self.name)

    def close(self) -> None:
        """Disconnect from the phone."""
        if hasattr(self, "_stream"):
            self._stream.disconnect()

    def _stop(self) -> None:
        self._ended = True

    def _next(self) -> Frame | None:
        if self._ended:
            raise CaptureError(f"{self.name}: the stream has stopped; look at the cable and the app")
        if not self._came.wait(POLL_MS / 1000):
            return None
        self._came.clear()
        stamp_ns = time.monotonic_ns()
        metres: Float32 = np.array(self._stream.get_depth_frame(), np.float32)
        with np.errstate(invalid="ignore"):  # values that are no depth
            depth = quantised(metres)
        confidence = np.asarray(self._stream.get_confidence_frame())
        if confidence.shape == depth.shape:  # Face ID's camera has no confidence
            depth = np.where(confidence >= LEAST_CONFIDENCE, depth, np.uint16(0))
        return Frame(stamp_ns, depth, np.array(self._stream.get_rgb_frame(), np.uint8))

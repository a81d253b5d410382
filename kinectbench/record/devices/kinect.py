"""Kinect for Xbox 360 and for Windows v1 by libfreenect, which registers depth to colour."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import CaptureError
from kinectbench.core.geometry import Camera
from kinectbench.core.types import MM_PER_M, Rgb
from kinectbench.record.interface import Device, Frame, Setup

# Default intrinsics of ROS's openni_launch for an uncalibrated Kinect whose depth is registered to colour.
CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
# The Kinect's clock counts 60 MHz in 32 bits: it wraps every 72 s (libfreenect, "timestamp").
TICKS_PER_S, TICKS = 60_000_000, 1 << 32


class Kinect(Device):
    """The first Kinect v1."""

    name = "kinect"
    cameras = "Kinect v1 (Xbox 360, Windows)"
    extra = "record-kinect"
    system = "libfreenect itself: `apt install libfreenect-dev`"

    def plugged_in(self) -> tuple[str, ...]:
        """Return the name of each camera: "Kinect" and its index."""
        import freenect

        context = freenect.init()
        count = freenect.num_devices(context) if context else 0
        if context:
            freenect.shutdown(context)
        return tuple(f"Kinect {number}" for number in range(count))

    def open(self) -> Setup:
        """Return the setup: depth in mm, registered to colour. The streams start with the first frame."""
        if not self.plugged_in():
            raise CaptureError(f"{self.name}: no camera is plugged in")
        return Setup(CAMERA, MM_PER_M, True)

    def frames(self) -> Iterator[Frame]:
        """Yield each new depth image with the newest colour image."""
        import freenect

        ticks, clock = None, 0
        while True:
            found: tuple[NDArray[np.uint16], int] | None = freenect.sync_get_depth(
                0, freenect.DEPTH_REGISTERED
            )
            seen: tuple[Rgb, int] | None = freenect.sync_get_video(0, freenect.VIDEO_RGB)
            if found is None or seen is None:
                raise CaptureError(f"{self.name}: no frame came; look at its cable and its power")
            (depth, depth_ticks), (rgb, color_ticks) = found, seen
            if depth_ticks == ticks:
                continue
            clock += 0 if ticks is None else (depth_ticks - ticks) % TICKS
            ticks = depth_ticks
            # The stamps of both images differ by less than half a wrap of the clock.
            apart = (color_ticks - depth_ticks + TICKS // 2) % TICKS - TICKS // 2
            stamp_ns, color_ns = (of * 1_000_000_000 // TICKS_PER_S for of in (clock, clock + apart))
            yield Frame(stamp_ns, np.array(depth, np.uint16), np.array(rgb, np.uint8), color_ns)

    def close(self) -> None:
        """Stop the streams."""
        import freenect

        freenect.sync_stop()

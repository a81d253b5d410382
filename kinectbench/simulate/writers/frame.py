"""One frame as a recorder gets it, and its encoded images."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

JPEG_QUALITY = 85


@dataclass(frozen=True)
class RecordedFrame:
    """What the sensor delivers at one time.

    Attributes:
        stamp_ns: time of depth and colour, nanoseconds.
        depth_m: (height, width) float32, metres along z, 0 = no measurement.
        color_rgb: (height, width, 3) uint8, registered to depth.
        T_world_camera: (4, 4) float64, optical camera axes.
    """

    stamp_ns: int
    depth_m: NDArray[np.float32]
    color_rgb: NDArray[np.uint8]
    T_world_camera: NDArray[np.float64]

    def depth_native(self, depth_scale: float) -> NDArray[np.uint16]:
        """Depth in native units, `round(metres * depth_scale)`; what does not fit is no measurement."""
        native = np.round(self.depth_m.astype(np.float64) * depth_scale)
        return np.where(native > 65534, 0, native).astype(np.uint16)

    def color_jpeg(self) -> bytes:
        """Colour as a JPEG file."""
        import cv2

        bgr = np.ascontiguousarray(self.color_rgb[..., ::-1])
        ok, encoded = cv2.imencode(".jpg", bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY])
        assert ok
        return bytes(encoded)


def png_bytes(image: NDArray[np.uint8] | NDArray[np.uint16]) -> bytes:
    """A one-channel image (height, width) as a PNG file."""
    import cv2

    ok, encoded = cv2.imencode(".png", image, [cv2.IMWRITE_PNG_COMPRESSION, 6])
    assert ok
    return bytes(encoded)

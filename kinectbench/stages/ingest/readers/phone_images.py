"""What phones with a LiDAR scanner have in common: one camera, colour far larger than depth; confidence."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.types import Float64
from kinectbench.stages.ingest.images import DamagedImageError, decode_color_bgr, encode_png, image_header
from kinectbench.stages.ingest.intrinsics import Intrinsics
from kinectbench.stages.ingest.recording import FileRecording, read_image_file

# Of ARKit's colour images, where none is there to tell.
COLOR_PX = (1920, 1440)


@dataclass(frozen=True, kw_only=True)
class PhoneRecording(FileRecording):
    """Images of a phone: colour is brought to the size of depth, and depth of low confidence left out.

    Attributes:
        confidence: the confidence image of each frame (0, 1, 2), or None.
        min_confidence: depth below is no measurement.
    """

    confidence: tuple[Path | None, ...] = ()
    min_confidence: int = 0

    def clean_depth(self, depth: NDArray[np.uint16], index: int) -> NDArray[np.uint16]:
        """Turn depth of low confidence into 0."""
        file = self.confidence[index] if self.confidence else None
        if file is None or self.min_confidence == 0:
            return depth
        confidence = decode_color_bgr(read_image_file(file), str(file))[..., 0]
        if confidence.shape != depth.shape:
            raise DamagedImageError(f"{file}: its size is not that of the depth image")
        return np.where(confidence >= self.min_confidence, depth, np.uint16(0))

    def color(self, index: int) -> tuple[str, bytes] | None:
        """Colour of a frame at the size of depth: as it was encoded if it has it, else a PNG; or None."""
        file = self.places[index].color
        if file is None:
            return None
        data = read_image_file(file)
        suffix, *size_px = image_header(data, str(file))
        if size_px == [self.camera.width, self.camera.height]:
            return suffix, data
        return self.shrunk(decode_color_bgr(data, str(file)))

    def shrunk(self, bgr: NDArray[np.uint8]) -> tuple[str, bytes]:
        """Colour (height, width, 3) averaged over the pixels of depth, as PNG."""
        import cv2

        size_px = (self.camera.width, self.camera.height)
        if bgr.shape[1::-1] != size_px:
            bgr = np.asarray(cv2.resize(bgr, size_px, interpolation=cv2.INTER_AREA), np.uint8)
        return ".png", encode_png(bgr)


def scaled(K: Float64, color_px: tuple[int, int], depth_px: tuple[int, int]) -> Intrinsics:
    """Intrinsics (3, 3) of colour for depth of another size; integer pixel centres, edges that agree."""
    x, y = depth_px[0] / color_px[0], depth_px[1] / color_px[1]
    return Intrinsics(
        fx=float(K[0, 0]) * x,
        fy=float(K[1, 1]) * y,
        cx=(float(K[0, 2]) + 0.5) * x - 0.5,
        cy=(float(K[1, 2]) + 0.5) * y - 0.5,
    )

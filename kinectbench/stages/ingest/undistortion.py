"""Remove the distortion of a lens from images."""

from collections.abc import Sequence
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera

Pixel = TypeVar("Pixel", np.uint8, np.uint16)


class Undistortion:
    """Maps distorted images of a camera to pinhole images with the same intrinsics."""

    def __init__(self, camera: Camera, coefficients: Sequence[float]) -> None:
        """Prepare the maps.

        Args:
            camera: intrinsics of the distorted images, and of the pinhole images.
            coefficients: k1 k2 p1 p2 [k3 [k4 k5 k6]] (Brown 1971), in the order of OpenCV, and of ROS's
                plumb_bob and rational_polynomial.
        """
        import cv2

        K, D = camera.K, np.asarray(coefficients, np.float64)
        size = (camera.width, camera.height)
        self._maps = cv2.initUndistortRectifyMap(K, D, np.eye(3), K, size, cv2.CV_32FC1)

    def depth(self, image: NDArray[Pixel]) -> NDArray[Pixel]:
        """Undistort depth (height, width) of the camera by the nearest pixel; 0 outside the distorted image.

        Like `color`, it returns an image of another size unchanged; the checks of frames refuse it later.
        """
        import cv2

        return self._map(image, cv2.INTER_NEAREST)

    def color(self, bgr: NDArray[Pixel]) -> NDArray[Pixel]:
        """Undistort colour (height, width, 3) by interpolation; black outside the distorted image."""
        import cv2

        return self._map(bgr, cv2.INTER_LINEAR)

    def _map(self, image: NDArray[Pixel], interpolation: int) -> NDArray[Pixel]:
        import cv2

        if image.shape[:2] != self._maps[0].shape:
            return image
        return np.asarray(cv2.remap(image, *self._maps, interpolation), image.dtype)

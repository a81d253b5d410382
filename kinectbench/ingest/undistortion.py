"""Removing lens distortion, so that everything after has a pinhole camera."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera


class Undistortion:
    """Maps distorted images of a camera to the pinhole images with the same intrinsics."""

    def __init__(self, camera: Camera, coefficients: Sequence[float]) -> None:
        """Prepare the maps.

        Args:
            camera: intrinsics of the distorted images, kept for the pinhole ones.
            coefficients: k1 k2 p1 p2 [k3 [k4 k5 k6]], as ROS's plumb_bob and rational_polynomial and OpenCV
                order them (Brown 1971).
        """
        import cv2

        K, D = camera.K, np.asarray(coefficients, np.float64)
        size = (camera.width, camera.height)
        self._maps = cv2.initUndistortRectifyMap(K, D, np.eye(3), K, size, cv2.CV_32FC1)

    def depth(self, depth: NDArray[np.uint16]) -> NDArray[np.uint16]:
        """Undistort depth (height, width): each pixel takes the nearest one's depth, or 0 outside."""
        import cv2

        return np.asarray(cv2.remap(depth, *self._maps, cv2.INTER_NEAREST), np.uint16)

    def color(self, color: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Undistort colour (height, width, 3) with linear interpolation; black outside."""
        import cv2

        return np.asarray(cv2.remap(color, *self._maps, cv2.INTER_LINEAR), np.uint8)

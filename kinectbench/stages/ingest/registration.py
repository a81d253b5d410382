"""Register colour to depth pixels by projecting each depth pixel's point into the colour camera."""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera
from kinectbench.core.types import Bools, Float32
from kinectbench.stages.ingest.recording import ColorCalibration
from kinectbench.stages.ingest.undistortion import Undistortion

# A point farther than this share of its distance behind the nearest surface on its ray is occluded.
HIDDEN_SHARE = 0.02
# A depth pixel covers this many pixels of the z-buffer in each direction, so that the z-buffer has no holes.
SPLAT_PX = 1


class ColorRegistration:
    """Maps images of a colour camera, of size `color_px`, to a depth camera's pixels, with a z-buffer."""

    def __init__(self, depth: Camera, calibration: ColorCalibration) -> None:
        """Prepare for images of a pinhole depth camera and a colour camera."""
        self._rays = depth.rays().astype(np.float32)
        self._color = calibration.camera
        self.color_px = (calibration.camera.width, calibration.camera.height)
        distorted = bool(calibration.distortion)
        self._pinhole = Undistortion(calibration.camera, calibration.distortion) if distorted else None
        self._T = np.asarray(calibration.T_color_depth, np.float32)
        # Pixels of the z-buffer are at least as wide as depth pixels in the colour image.
        self._shrink = max(1.0, calibration.camera.fx / depth.fx, calibration.camera.fy / depth.fy)

    def __call__(self, depth_m: Float32, bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """Compute the colour of every depth pixel.

        Args:
            depth_m: (height, width), metres, 0 = none; such a pixel gets the depth of its nearest neighbour,
                but occludes nothing.
            bgr: (colour height, colour width, 3), as recorded.

        Returns:
            (height, width, 3); black if the colour camera does not see the point, because it is outside the
            image or occluded.
        """
        import cv2

        if not depth_m.any():
            return np.zeros((*depth_m.shape, 3), np.uint8)
        image = bgr if self._pinhole is None else self._pinhole.color(bgr)
        u, v, z = self._project(_filled(depth_m))
        shape = int(self._color.height / self._shrink) + 2, int(self._color.width / self._shrink) + 2
        zbuffer = np.full(shape, np.inf, np.float32)
        _splat(u, v, z, depth_m > 0, np.float32(self._shrink), zbuffer)
        seen = np.empty(depth_m.shape, np.bool_)
        _find_seen(u, v, z, np.float32(self._shrink), zbuffer, np.array(self.color_px, np.float32), seen)
        sampled = cv2.remap(image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        return np.where(seen[..., None], sampled, np.uint8(0)).astype(np.uint8)

    def _project(self, depth_m: Float32) -> tuple[Float32, Float32, Float32]:
        """Project each pixel's point into the colour image: u, v (pixels), and depth there (metres).

        Each is (height, width) of the depth image.
        """
        points = self._rays * depth_m[..., None] @ self._T[:3, :3].T + self._T[:3, 3]
        z = np.ascontiguousarray(points[..., 2], np.float32)
        near = np.maximum(z, 1e-3)
        u = points[..., 0] / near * np.float32(self._color.fx) + np.float32(self._color.cx)
        v = points[..., 1] / near * np.float32(self._color.fy) + np.float32(self._color.cy)
        return np.ascontiguousarray(u, np.float32), np.ascontiguousarray(v, np.float32), z


def _filled(depth_m: Float32) -> Float32:
    """Fill holes in depth from the nearest pixel."""
    import cv2

    holes = (depth_m <= 0).astype(np.uint8)
    if not holes.any():
        return depth_m
    _, labels = cv2.distanceTransformWithLabels(holes, cv2.DIST_L2, 3, labelType=cv2.DIST_LABEL_PIXEL)
    values = np.zeros(int(labels.max()) + 1, np.float32)
    known = holes == 0
    values[labels[known]] = depth_m[known]
    return np.asarray(values[labels], np.float32)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _splat(u: Float32, v: Float32, z: Float32, known: Bools, shrink: float, zbuffer: Float32) -> None:
    """Write the depths `z` of points at colour pixels (u, v) to the z-buffer pixels they cover; nearest wins.

    Points that are not `known` are skipped; a z-buffer pixel is `shrink` colour pixels wide.
    """
    height, width = zbuffer.shape
    for row in range(u.shape[0]):
        for column in range(u.shape[1]):
            if not known[row, column] or z[row, column] <= 0:
                continue
            x, y = (u[row, column] + 0.5) / shrink, (v[row, column] + 0.5) / shrink
            if not (-1 < x < width and -1 < y < height):
                continue
            for j in range(max(int(y - 0.5), 0), min(int(y + 0.5) + SPLAT_PX, height)):
                for i in range(max(int(x - 0.5), 0), min(int(x + 0.5) + SPLAT_PX, width)):
                    zbuffer[j, i] = min(zbuffer[j, i], z[row, column])


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _find_seen(
    u: Float32, v: Float32, z: Float32, shrink: float, zbuffer: Float32, size: Float32, seen: Bools
) -> None:
    """Set `seen` where the point at colour pixel (u, v), depth `z`, is inside the image and not occluded.

    `size` is the colour image's width and height; a z-buffer pixel is `shrink` colour pixels wide.
    """
    for row in range(u.shape[0]):
        for column in range(u.shape[1]):
            x, y, depth = u[row, column], v[row, column], z[row, column]
            inside = depth > 0 and -0.5 <= x < size[0] - 0.5 and -0.5 <= y < size[1] - 0.5
            if inside:
                nearest = zbuffer[int((y + 0.5) / shrink), int((x + 0.5) / shrink)]
                inside = depth <= nearest * (1 + HIDDEN_SHARE)
            seen[row, column] = inside

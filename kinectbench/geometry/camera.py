"""The pinhole camera: optical axes (x right, y down, z forward), integer pixel centres."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Camera:
    """Intrinsics of an undistorted camera: `u = fx x/z + cx`, `v = fy y/z + cy`, in pixels.

    The centre of the top-left pixel is (0, 0).
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    @property
    def K(self) -> NDArray[np.float64]:
        """The (3, 3) intrinsic matrix in pixels."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], dtype=np.float64)

    def rays(self) -> NDArray[np.float64]:
        """Directions through every pixel centre with z = 1: (height, width, 3), camera frame."""
        u, v = np.meshgrid(np.arange(self.width), np.arange(self.height))
        x, y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        return np.stack([x, y, np.ones_like(x)], axis=-1)

    def backproject(self, depth_m: NDArray[np.floating]) -> NDArray[np.float64]:
        """Depth (height, width) in metres along z to points (height, width, 3) in the camera frame."""
        return self.rays() * np.asarray(depth_m, dtype=np.float64)[..., None]

    def project(self, points_camera: NDArray[np.floating]) -> NDArray[np.float64]:
        """Points (..., 3) in the camera frame, z > 0, to pixels (..., 2) as (u, v)."""
        x, y, z = np.moveaxis(np.asarray(points_camera, dtype=np.float64), -1, 0)
        return np.stack([self.fx * x / z + self.cx, self.fy * y / z + self.cy], axis=-1)

"""Pinhole cameras with optical axes (x right, y down, z forward) and integer pixel centres.

And the normals of a depth image, from differences of neighbouring pixels.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry.mesh import TriangleMesh, raycaster
from kinectbench.core.types import Float32, Float64


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
    def K(self) -> Float64:
        """The (3, 3) intrinsic matrix in pixels."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], dtype=np.float64)

    @property
    def intrinsics(self) -> Float64:
        """(4,): fx, fy, cx, cy in pixels."""
        return np.array([self.fx, self.fy, self.cx, self.cy])

    def every(self, step_px: int) -> "Camera":
        """Return the camera of an image subsampled to every `step_px`-th row and column from the first on."""
        width, height = -(-self.width // step_px), -(-self.height // step_px)
        return Camera(width, height, *(float(each) for each in self.intrinsics / step_px))

    def rays(self) -> Float64:
        """Directions through every pixel centre with z = 1: (height, width, 3), camera frame; read-only."""
        return _rays(self)

    def rays_at(self, u: NDArray[np.number], v: NDArray[np.number]) -> Float64:
        """Directions through pixels (...) with z = 1: (..., 3), camera frame."""
        x, y = (u - self.cx) / self.fx, (v - self.cy) / self.fy
        return np.stack([x, y, np.ones_like(x)], axis=-1)

    def backproject(self, depth_m: NDArray[np.floating]) -> Float64:
        """Convert depth (height, width) in metres along z to points (height, width, 3), camera frame."""
        return self.rays() * np.asarray(depth_m, dtype=np.float64)[..., None]

    def project(self, points_camera: NDArray[np.floating]) -> Float64:
        """Points (..., 3) in the camera frame, z > 0, to pixels (..., 2) as (u, v)."""
        x, y, z = np.moveaxis(np.asarray(points_camera, dtype=np.float64), -1, 0)
        return np.stack([self.fx * x / z + self.cx, self.fy * y / z + self.cy], axis=-1)


@lru_cache(maxsize=2)
def _rays(camera: Camera) -> Float64:
    rays = camera.rays_at(*np.meshgrid(np.arange(camera.width), np.arange(camera.height)))
    rays.flags.writeable = False
    return rays


class DepthRenderer:
    """Renders the depth of one mesh by ray casting (Open3D RaycastingScene).

    Rays go through integer pixel centres, as everywhere in this package. Open3D's own pinhole rays would be
    half a pixel off.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        self._scene, self._tensor = raycaster(mesh)

    def depth_m(self, camera: Camera, T_world_camera: Float64) -> Float32:
        """Return depth along z in metres, (height, width) float32, 0 where the mesh is not hit."""
        return self._hit(self._rays(camera, T_world_camera))[0]

    def depth_and_lift(self, camera: Camera, T_world_camera: Float64) -> tuple[Float32, Float32]:
        """Return `depth_m`, and how far a metre of depth leads away from the plane of the face that is hit.

        The second image is dimensionless, 0 where the mesh is not hit: 1 where a ray along the optical axis
        meets a face head-on, little where it grazes one.
        """
        rays = self._rays(camera, T_world_camera)
        depth_m, normals = self._hit(rays)
        return depth_m, np.abs(np.einsum("ijk,ijk->ij", rays[..., 3:], normals))

    def _rays(self, camera: Camera, T_world_camera: Float64) -> Float32:
        """Return origins and directions, (height, width, 6); directions have z = 1 in the camera's frame."""
        rays = np.empty((camera.height, camera.width, 6), np.float32)
        rays[..., :3], rays[..., 3:] = T_world_camera[:3, 3], camera.rays() @ T_world_camera[:3, :3].T
        return rays

    def _hit(self, rays: Float32) -> tuple[Float32, Float32]:
        """Return depth of the first hits, metres, and unit normals of their faces, world; 0 for none."""
        hits = self._scene.cast_rays(self._tensor(rays))
        depth_m = hits["t_hit"].numpy()  # the ray parameter, as directions have z = 1
        normals_world = hits["primitive_normals"].numpy()
        return np.where(np.isfinite(depth_m), depth_m, 0).astype(np.float32), normals_world


def image_normals(surface: Float64, depth_m: Float32, reach_px: int = 1) -> Float64:
    """Return unit normals towards the camera, from neighbouring pixels; NaN if a neighbour is missing.

    Args:
        surface: (height, width, 3) points, camera axes.
        depth_m: (height, width), 0 without measurement.
        reach_px: distance of the neighbours, pixels.

    Returns:
        (height, width, 3).
    """
    known = np.where((depth_m > 0)[..., None], surface, np.nan)
    across, down = np.full(surface.shape, np.nan), np.full(surface.shape, np.nan)
    across[:, reach_px:-reach_px] = known[:, 2 * reach_px :] - known[:, : -2 * reach_px]
    down[reach_px:-reach_px] = known[2 * reach_px :] - known[: -2 * reach_px]
    normals = np.cross(down, across)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.asarray(normals / np.where(length > 0, length, np.nan))

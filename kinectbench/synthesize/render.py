"""Noise-free depth of one mesh from anywhere."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera, TriangleMesh
from kinectbench.synthesize.views import hull_corners


class DepthCamera:
    """A virtual camera before a mesh, made ready once and then used from anywhere.

    Attributes:
        camera: its intrinsics.
        corners_world: (k, 3) corners of the mesh's convex hull.
    """

    def __init__(self, mesh: TriangleMesh, camera: Camera) -> None:
        """Build the acceleration structure of the mesh (Open3D's, which is Embree)."""
        import open3d as o3d

        self.camera = camera
        self.corners_world = hull_corners(mesh.vertices)
        self._tensor = o3d.core.Tensor.from_numpy
        self._caster = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._caster.add_triangles(
            self._tensor(mesh.vertices.astype(np.float32)), self._tensor(mesh.faces.astype(np.uint32))
        )
        self._x = (np.arange(camera.width) - camera.cx) / camera.fx
        self._y = (np.arange(camera.height) - camera.cy) / camera.fy

    def depth_m(self, T_world_camera: NDArray[np.float64]) -> NDArray[np.float32]:
        """Depth along z (height, width) float32 through integer pixel centres, 0 where nothing is hit.

        The rays are turned, not the mesh. Only those that can hit it are cast.
        """
        rows, columns = self._window(T_world_camera)
        x_axis, y_axis, z_axis = T_world_camera[:3, :3].T
        x, y = self._x[columns, None], self._y[rows, None, None]
        rays = np.empty((y.shape[0], x.shape[0], 6), np.float32)
        rays[..., :3] = T_world_camera[:3, 3]
        rays[..., 3:] = (x * x_axis + z_axis) + y * y_axis
        # Directions have z = 1 in the camera, so a hit's ray parameter is its depth.
        hit_m = self._caster.cast_rays(self._tensor(rays), nthreads=1)["t_hit"].numpy()
        depth_m = np.zeros((self.camera.height, self.camera.width), np.float32)
        depth_m[rows, columns] = np.where(np.isfinite(hit_m), hit_m, 0)
        return depth_m

    def _window(self, T_world_camera: NDArray[np.float64]) -> tuple[slice, slice]:
        """The rows and columns that the mesh lies in."""
        camera = self.camera
        points_camera = (self.corners_world - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
        pixels = camera.project(points_camera)
        low = np.maximum(np.floor(pixels.min(axis=0)), 0).astype(int)
        high = np.minimum(np.ceil(pixels.max(axis=0)), [camera.width - 1, camera.height - 1]).astype(int)
        return slice(low[1], high[1] + 1), slice(low[0], high[0] + 1)

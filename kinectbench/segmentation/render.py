"""The object as a view should see it: depth of its closed mesh along every pixel's ray."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera, TriangleMesh


class DepthRenderer:
    """Casts the rays of a camera's pixels at one mesh (Open3D RaycastingScene).

    Rays go through integer pixel centres, as everywhere here; the library's own pinhole rays would be
    half a pixel off.
    """

    def __init__(self, mesh: TriangleMesh) -> None:
        import open3d as o3d

        self._tensor: Any = o3d.core.Tensor.from_numpy
        self._scene = o3d.t.geometry.RaycastingScene()
        self._scene.add_triangles(
            self._tensor(mesh.vertices.astype(np.float32)), self._tensor(mesh.faces.astype(np.uint32))
        )

    def depth_m(self, camera: Camera, T_world_camera: NDArray[np.float64]) -> NDArray[np.float32]:
        """Depth along z in metres, (height, width) float32, 0 where the mesh is not hit."""
        directions = camera.rays() @ T_world_camera[:3, :3].T
        origins = np.broadcast_to(T_world_camera[:3, 3], directions.shape)
        rays = np.concatenate([origins, directions], axis=-1).astype(np.float32)
        # Directions have z = 1 in the camera's frame, so the ray parameter is the depth.
        hit = self._scene.cast_rays(self._tensor(rays))["t_hit"].numpy()
        return np.where(np.isfinite(hit), hit, 0).astype(np.float32)

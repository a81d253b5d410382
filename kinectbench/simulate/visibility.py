"""Which of the object's surface the cameras ever saw, by one shadow ray from each sample to each camera."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera, invert_rigid, transform_points
from kinectbench.simulate.scene import Scene

Float = NDArray[np.float64]

# Rays start this far off the surface, so that they do not hit where they start.
LIFT_M = 1e-4


class Visibility:
    """A scene made ready for shadow rays."""

    def __init__(self, scene: Scene) -> None:
        """Build the acceleration structure (Open3D's, which is Embree)."""
        import open3d as o3d

        self._tensor = o3d.core.Tensor.from_numpy
        self._caster = o3d.t.geometry.RaycastingScene(nthreads=1)
        for item in scene.items:
            vertices = self._tensor(item.mesh.vertices.astype(np.float32))
            self._caster.add_triangles(vertices, self._tensor(item.mesh.faces.astype(np.uint32)))

    def visible(
        self, points_room: Float, normals_room: Float, camera: Camera, T_room_camera: Float
    ) -> NDArray[np.bool_]:
        """Which points of the surface a camera sees: in its image, facing it, with nothing in between.

        Args:
            points_room: (n, 3), metres.
            normals_room: (n, 3), unit, outward.
            camera: intrinsics.
            T_room_camera: (4, 4).

        Returns:
            bool (n,).
        """
        points_camera = transform_points(invert_rigid(T_room_camera), points_room)
        ahead = points_camera[:, 2] > 0
        pixels = camera.project(np.where(ahead[:, None], points_camera, 1.0))
        inside = (pixels > -0.5) & (pixels < np.array([camera.width, camera.height]) - 0.5)
        towards = T_room_camera[:3, 3] - points_room
        seen: NDArray[np.bool_] = ahead & inside.all(axis=1) & (np.sum(towards * normals_room, axis=1) > 0)
        some = np.flatnonzero(seen)
        origins = points_room[some] + LIFT_M * normals_room[some]
        rays = np.concatenate([origins, T_room_camera[:3, 3] - origins], axis=1).astype(np.float32)
        hidden = self._caster.test_occlusions(self._tensor(rays), tnear=0.0, tfar=1.0, nthreads=1).numpy()
        seen[some[hidden]] = False
        return seen


def sample_surface(
    vertices: Float, faces: NDArray[np.int32], count: int, rng: np.random.Generator
) -> tuple[Float, Float]:
    """Points spread evenly by area over a mesh, one in each of `count` equal shares of it (stratified).

    Args:
        vertices: (v, 3), metres.
        faces: (f, 3).
        count: number of points.
        rng: draws them.

    Returns:
        Points (count, 3) and their faces' unit normals (count, 3), in the mesh's frame.
    """
    a, b, c = (vertices[faces[:, corner]] for corner in range(3))
    crossed = np.cross(b - a, c - a)
    double_area = np.linalg.norm(crossed, axis=1)
    reached = np.cumsum(double_area)
    wanted = (np.arange(count) + rng.random(count)) / count * reached[-1]
    chosen = np.minimum(np.searchsorted(reached, wanted, side="right"), len(faces) - 1)
    root, share = np.sqrt(rng.random((count, 1))), rng.random((count, 1))
    points = (1 - root) * a[chosen] + root * (1 - share) * b[chosen] + root * share * c[chosen]
    return points, crossed[chosen] / np.maximum(double_area[chosen, None], 1e-30)

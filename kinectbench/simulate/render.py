"""Ray casting of a scene through integer pixel centres: exact depth, colour and subject mask."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera
from kinectbench.simulate.scene import Scene
from kinectbench.simulate.texture import Texture

AMBIENT = 0.55
LIGHT_ROOM = np.array([0.35, 0.25, 0.90])
BACKGROUND_RGB = 0.15


@dataclass(frozen=True)
class Rendering:
    """One noise-free frame.

    Attributes:
        depth_m: (height, width) float32 along z, 0 where no surface is hit.
        color_rgb: (height, width, 3) uint8.
        mask: (height, width) bool, the subject.
        cos_incidence: (height, width) float32 in [0, 1], between the ray and the surface's normal.
    """

    depth_m: NDArray[np.float32]
    color_rgb: NDArray[np.uint8]
    mask: NDArray[np.bool_]
    cos_incidence: NDArray[np.float32]


class Renderer:
    """A scene made ready for ray casting once, and then rendered from anywhere."""

    def __init__(self, scene: Scene, texture: Texture) -> None:
        """Build the acceleration structure of the scene (Open3D's, which is Embree)."""
        import open3d as o3d

        self._texture = texture
        self._tensor = tensor = o3d.core.Tensor.from_numpy
        self._caster = o3d.t.geometry.RaycastingScene(nthreads=1)
        for item in scene.items:
            vertices = tensor(item.mesh.vertices.astype(np.float32))
            self._caster.add_triangles(vertices, tensor(item.mesh.triangles.astype(np.uint32)))
        # Geometry ids count from 0 in the order of adding; one more row stands for rays that hit nothing.
        self._color = np.array([item.color_rgb for item in scene.items] + [(BACKGROUND_RGB,) * 3])
        self._contrast = np.array([item.contrast for item in scene.items] + [0.0])
        self._tile_m = np.array([item.tile_m for item in scene.items] + [0.0])
        self._subject = np.array([item.role == "subject" for item in scene.items] + [False])

    def render(self, camera: Camera, T_room_camera: NDArray[np.float64]) -> Rendering:
        """Render one frame from a camera at `T_room_camera` (4, 4).

        Rays are built from `Camera.rays`, since Open3D's own pinhole rays pass half a pixel beside integer
        centres. Directions have z = 1 in the camera, so a hit's ray parameter is its depth.
        """
        directions = camera.rays() @ T_room_camera[:3, :3].T
        origins = np.broadcast_to(T_room_camera[:3, 3], directions.shape)
        rays = np.concatenate([origins, directions], axis=-1).astype(np.float32)
        hits = self._caster.cast_rays(self._tensor(rays), nthreads=1)
        depth_m = hits["t_hit"].numpy()
        hit = np.isfinite(depth_m)
        depth_m = np.where(hit, depth_m, 0).astype(np.float32)
        which = np.where(hit, hits["geometry_ids"].numpy(), len(self._subject) - 1).astype(np.intp)
        normals = hits["primitive_normals"].numpy().astype(np.float64)
        cosine = np.abs(np.sum(normals * directions, axis=-1)) / np.linalg.norm(directions, axis=-1)
        points_room = origins + directions * depth_m[..., None]
        return Rendering(
            depth_m,
            self._shade(points_room, normals, which),
            self._subject[which],
            np.where(hit, np.clip(cosine, 0, 1), 0).astype(np.float32),
        )

    def _shade(
        self, points_room: NDArray[np.float64], normals_room: NDArray[np.float64], which: NDArray[np.intp]
    ) -> NDArray[np.uint8]:
        """Lambert's law with one far light, times the texture: a point has one colour in every view."""
        light = LIGHT_ROOM / np.linalg.norm(LIGHT_ROOM)
        lambert = AMBIENT + (1 - AMBIENT) * np.clip(normals_room @ light, 0, 1)
        factor = self._texture.brightness(
            points_room, normals_room, self._contrast[which], self._tile_m[which]
        )
        color = self._color[which] * (lambert * factor)[..., None]
        return np.asarray(np.round(np.clip(color, 0, 1) * 255), dtype=np.uint8)

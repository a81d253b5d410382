"""Ray casting of a scene through integer pixel centres: exact depth, colour and subject mask."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera
from kinectbench.simulate.scene import Scene
from kinectbench.simulate.shading import Looks, Rendering, pixel_rays, shade
from kinectbench.simulate.texture import Texture

# What rays see that hit nothing: an overcast sky, or a bright room beyond.
BACKGROUND_RGB = (0.78, 0.81, 0.84)


class Renderer:
    """A scene made ready for ray casting once, and then rendered from anywhere."""

    def __init__(self, scene: Scene, texture: Texture) -> None:
        """Build the acceleration structure of the scene (Open3D's, which is Embree)."""
        import open3d as o3d

        self._image = texture.image
        self._tensor = o3d.core.Tensor.from_numpy
        self._caster = o3d.t.geometry.RaycastingScene(nthreads=1)
        for item in scene.items:
            vertices = self._tensor(item.mesh.vertices.astype(np.float32))
            self._caster.add_triangles(vertices, self._tensor(item.mesh.faces.astype(np.uint32)))
        # Open3D's geometry ids count from 0 in the order of adding.
        self._looks = Looks(
            np.array([item.color_rgb for item in scene.items] + [BACKGROUND_RGB], np.float32),
            np.array([item.contrast for item in scene.items] + [0], np.float32),
            np.array([item.tile_m for item in scene.items] + [0], np.float32),
            np.array([item.albedo for item in scene.items] + [0], np.float32),
            np.array([item.role == "subject" for item in scene.items] + [False]),
        )

    def render(self, camera: Camera, T_room_camera: NDArray[np.float64]) -> Rendering:
        """Render one noise-free frame from a camera at `T_room_camera` (4, 4), on one thread."""
        rays = pixel_rays(camera, T_room_camera)
        hits = self._caster.cast_rays(self._tensor(rays), nthreads=1)
        hit_m, items = hits["t_hit"].numpy(), hits["geometry_ids"].numpy()
        normals_room = hits["primitive_normals"].numpy()
        return shade(rays, hit_m, items, normals_room, self._looks, self._image)

"""The virtual camera of synthetic pairs: its views, its poses, and its depth, exact or as of a Kinect."""

from dataclasses import dataclass
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from kinectbench.core.geometry import Camera, TriangleMesh, raycaster, rigid
from kinectbench.lab.simulate.kinect import draw_device, measured_depth
from kinectbench.lab.simulate.render import Rendering

FIELD_OF_VIEW_RAD = float(np.radians(49.124))
# Rotation from the upright frame (x right, y away, z up) to an optical camera that looks along +y.
CAMERA_UPRIGHT = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
# A Kinect with typical distortion, without sun, in front of a surface with the infrared albedo of a grey wall
# (see `KinectNoise.weakest_signal`).
ALBEDO, SUNLIGHT, DISTORTION = 0.6, 0.0, 1.0
UPRIGHT_MODEL = {"z": np.eye(3), "y": np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])}


@dataclass(frozen=True)
class ViewAngles:
    """One orientation of the object: roll, pitch and yaw as multiples of 2 pi / n.

    Attributes:
        steps: the multiples for roll, pitch and yaw, each from 0 to n - 1.
        n: number of steps in a full turn.
    """

    steps: tuple[int, int, int]
    n: int

    @property
    def angles_rad(self) -> tuple[float, float, float]:
        """Roll, pitch and yaw, radians."""
        roll, pitch, yaw = (2 * np.pi * step / self.n for step in self.steps)
        return roll, pitch, yaw

    @property
    def rotation(self) -> NDArray[np.float64]:
        """The upright object's rotation (3, 3): Rz(yaw) Ry(pitch) Rx(roll), about fixed axes."""
        roll, pitch, yaw = self.angles_rad
        return _about(2, yaw) @ _about(1, pitch) @ _about(0, roll)

    @property
    def name(self) -> str:
        """`<roll>_<pitch>_<yaw>`, the ending of the authors' file names."""
        return "_".join(map(str, self.steps))


def all_views(n: int) -> tuple[ViewAngles, ...]:
    """Return the n^3 orientations of a group of views, yaw running fastest (paper, Sec. 3.6: n = 5 and 6)."""
    return tuple(
        ViewAngles((roll, pitch, yaw), n) for roll, pitch, yaw in product(range(n), range(n), range(n))
    )


def virtual_camera(image_px: int) -> Camera:
    """Return the paper authors' camera: field of view 49.124 degrees, principal point at half the width."""
    focal_px = image_px / (2 * np.tan(FIELD_OF_VIEW_RAD / 2))
    return Camera(image_px, image_px, focal_px, focal_px, image_px / 2, image_px / 2)


def camera_pose(
    vertices_world: NDArray[np.float64], view: ViewAngles, camera: Camera, up: Literal["y", "z"]
) -> NDArray[np.float64]:
    """Return the camera's pose for a view: T_world_camera (4, 4), in the model's own frame.

    Instead of the object, the camera rotates about the centre of the object's bounding box. Its distance is
    such that the smallest sphere around this centre that contains all vertices just fits into the image. So
    the object fits in every orientation, and the distance is the same for all views of a model.

    Args:
        vertices_world: (n, 3), the model's vertices, or only the corners of its convex hull.
        view: the orientation.
        camera: the virtual camera.
        up: the axis of the model that points up in the view 0_0_0.
    """
    centre = (vertices_world.min(axis=0) + vertices_world.max(axis=0)) / 2
    radius_m = float(np.linalg.norm(vertices_world - centre, axis=1).max())
    # The principal point is half a pixel off the middle, so the nearer borders decide.
    border_px = camera.width - 0.5 - camera.cx
    distance_m = radius_m / np.sin(np.arctan2(border_px, camera.fx))
    rotation_world_camera = (CAMERA_UPRIGHT @ view.rotation @ UPRIGHT_MODEL[up]).T
    return rigid(rotation_world_camera, centre - rotation_world_camera @ [0.0, 0.0, distance_m])


def hull_corners(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the vertices (k, 3) on the convex hull of points (n, 3); all points if they span no volume."""
    try:
        return np.asarray(vertices[ConvexHull(vertices).vertices])
    except (QhullError, ValueError):  # flat, or hardly any vertices
        return vertices


def _about(axis: int, angle_rad: float) -> NDArray[np.float64]:
    """Return the (3, 3) rotation about a coordinate axis, by the right-hand rule."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    rotation = np.eye(3)
    j, k = (axis + 1) % 3, (axis + 2) % 3
    rotation[j, j], rotation[j, k], rotation[k, j], rotation[k, k] = c, -s, s, c
    return rotation


class DepthCamera:
    """A virtual depth camera in front of one mesh, prepared once for all views.

    Attributes:
        camera: the camera's intrinsics.
        corners_world: (k, 3) corners of the mesh's convex hull.
    """

    def __init__(self, mesh: TriangleMesh, camera: Camera) -> None:
        """Build the acceleration structure of the mesh (Open3D's, which is Embree)."""
        self.camera = camera
        self.corners_world = hull_corners(mesh.vertices)
        # The library computes in float32, which is most precise near the origin.
        self._center = (self.corners_world.min(axis=0) + self.corners_world.max(axis=0)) / 2
        centered = TriangleMesh(mesh.vertices - self._center, mesh.faces)
        self._caster, self._tensor = raycaster(centered, threads=1)
        self._x = (np.arange(camera.width) - camera.cx) / camera.fx
        self._y = (np.arange(camera.height) - camera.cy) / camera.fy

    def depth_m(self, T_world_camera: NDArray[np.float64]) -> NDArray[np.float32]:
        """Render exact depth (height, width) float32, metres along z, at integer pixel centres; 0: no hit."""
        return self._seen(T_world_camera)[0]

    def kinect_depth_m(
        self, T_world_camera: NDArray[np.float64], rng: np.random.Generator
    ) -> NDArray[np.float32]:
        """Render depth as a newly drawn Kinect v1 measures it: (height, width) metres, 0 = no measurement.

        Args:
            T_world_camera: (4, 4) pose of the camera.
            rng: draws the Kinect's distortion and its noise.
        """
        depth_m, cosine = self._seen(T_world_camera)
        mask, albedo = depth_m > 0, np.full_like(depth_m, ALBEDO)
        exact = Rendering(depth_m, np.zeros((*depth_m.shape, 3), np.uint8), mask, cosine, albedo)
        return measured_depth(exact, self.camera, draw_device(self.camera, DISTORTION, SUNLIGHT, rng), rng)

    def _seen(self, T_world_camera: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Render depth and the cosine of incidence: both (height, width), 0 without a hit.

        Rays are rotated instead of the mesh. Only rays that can hit the mesh are cast.
        """
        rows, columns = self._window(T_world_camera)
        x_axis, y_axis, z_axis = T_world_camera[:3, :3].T
        x, y = self._x[columns, None], self._y[rows, None, None]
        rays = np.empty((y.shape[0], x.shape[0], 6), np.float32)
        rays[..., :3] = T_world_camera[:3, 3] - self._center
        rays[..., 3:] = (x * x_axis + z_axis) + y * y_axis
        # Directions have z = 1 in the camera, so a hit's ray parameter is its depth.
        hits = self._caster.cast_rays(self._tensor(rays), nthreads=1)
        hit_m, normals = hits["t_hit"].numpy(), hits["primitive_normals"].numpy()
        depth_m, cosine = np.zeros((2, self.camera.height, self.camera.width), np.float32)
        depth_m[rows, columns] = np.where(np.isfinite(hit_m), hit_m, 0)
        along = np.abs((normals * rays[..., 3:]).sum(axis=-1)) / np.linalg.norm(rays[..., 3:], axis=-1)
        cosine[rows, columns] = np.where(np.isfinite(hit_m), along, 0)
        return depth_m, cosine

    def _window(self, T_world_camera: NDArray[np.float64]) -> tuple[slice, slice]:
        """Return the rows and columns of the image that can contain the mesh."""
        camera = self.camera
        points_camera = (self.corners_world - T_world_camera[:3, 3]) @ T_world_camera[:3, :3]
        pixels = camera.project(points_camera)
        low = np.maximum(np.floor(pixels.min(axis=0)), 0).astype(int)
        high = np.minimum(np.ceil(pixels.max(axis=0)), [camera.width - 1, camera.height - 1]).astype(int)
        return slice(low[1], high[1] + 1), slice(low[0], high[0] + 1)

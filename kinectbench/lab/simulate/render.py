"""Render a scene by ray casting, and test which surface points a camera sees."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera, OrientedBox, box_mesh, invert_rigid, raycaster, transform_points
from kinectbench.core.types import Bools, Float32, Float64
from kinectbench.lab.simulate.objects.shapes import surface, turned
from kinectbench.lab.simulate.scene import Item
from kinectbench.lab.simulate.spec import PathSettings

# A power of two, so that coordinates wrap by masking bits.
TEXTURE_PX = 512
PIXELS_PER_M = 256.0
BLURS_PX = (1.5, 5.0, 16.0, 50.0)
AMBIENT = np.float32(0.55)
# Direction to the one distant light, a unit vector in the room.
LIGHT_ROOM = (np.float32(0.3508), np.float32(0.2506), np.float32(0.9022))
JOINT_M = 0.012
JOINT_SHADE = 0.55
TILE_CONTRAST = 0.25


def make_texture(rng: np.random.Generator) -> Float32:
    """Draw a periodic noise texture (512, 512) in [-1, 1], which covers 2 m x 2 m.

    It is a normalised sum of white noise blurred at four scales: detail at every scale lets a tracker work
    from near and far.
    """
    frequency = np.fft.fftfreq(TEXTURE_PX)
    squared = frequency[:, None] ** 2 + frequency[None, :] ** 2
    image = np.zeros((TEXTURE_PX, TEXTURE_PX))
    for blur_px in BLURS_PX:
        gain = np.exp(-2 * (np.pi * blur_px) ** 2 * squared)
        white = rng.standard_normal((TEXTURE_PX, TEXTURE_PX))
        octave = np.fft.ifft2(np.fft.fft2(white) * gain).real
        image += octave / octave.std()
    return np.asarray(np.clip(image / (2.5 * image.std()), -1, 1), np.float32)


class Looks(NamedTuple):
    """Material of each item of a scene, in the scene's order; the last row is the background.

    Attributes:
        color_rgb: (n, 3) float32 in [0, 1].
        contrast: (n,) float32, strength of the noise texture, in [0, 1].
        tile_m: (n,) float32, edge of floor tiles, metres; 0: no tiles.
        albedo: (n,) float32, share of infrared light that is reflected.
        subject: (n,) bool, whether the item belongs to the subject.
    """

    color_rgb: Float32
    contrast: Float32
    tile_m: Float32
    albedo: Float32
    subject: Bools


class Rendering(NamedTuple):
    """Noise-free images of one frame.

    Attributes:
        depth_m: (height, width) float32, metres along z, 0 where nothing is hit.
        color_rgb: (height, width, 3) uint8.
        mask: (height, width) bool, the subject's silhouette.
        cos_incidence: (height, width) float32 in [0, 1], cosine between the ray and the surface's normal.
        albedo: (height, width) float32, share of infrared light that the surface reflects.
    """

    depth_m: Float32
    color_rgb: NDArray[np.uint8]
    mask: Bools
    cos_incidence: Float32
    albedo: Float32


def pixel_rays(camera: Camera, T_room_camera: Float64) -> Float32:
    """Return rays (height, width, 6) through pixel centres: origin and direction, frame `room`.

    The camera's pose is (4, 4), or with a rolling shutter (height, 4, 4), one for each row. Directions have
    z = 1 in the camera's frame, so that a hit's ray parameter is its depth. Pixel centres have integer
    coordinates; Open3D's own pinhole rays are half a pixel off them.
    """
    size, lens = (camera.height, camera.width), (camera.fx, camera.fy, camera.cx, camera.cy)
    T_rows = np.broadcast_to(T_room_camera, (camera.height, 4, 4))
    return np.asarray(_rays(size, lens, np.ascontiguousarray(T_rows, dtype=np.float64)))


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _rays(size, lens, T_rows):  # type: ignore[no-untyped-def]
    fx, fy, cx, cy = lens
    rays = np.empty((size[0], size[1], 6), np.float32)
    for v in range(size[0]):
        y = (v - cy) / fy
        T_room_camera = T_rows[v]
        for u in range(size[1]):
            x = (u - cx) / fx
            for k in range(3):
                turned = T_room_camera[k, 0] * x + T_room_camera[k, 1] * y + T_room_camera[k, 2]
                rays[v, u, k] = T_room_camera[k, 3]
                rays[v, u, 3 + k] = turned
    return rays


@numba.njit(cache=True, error_model="numpy", nogil=True)
def shade(rays, hit_m, item, normals_room, looks, image):  # type: ignore[no-untyped-def]
    """Shade every hit: Lambert's law with one distant light, times the texture at the hit's room position.

    So a point has the same colour in every view. Light and texture have no published source.

    Args:
        rays: (height, width, 6) float32, from `pixel_rays`.
        hit_m: (height, width) float32, ray parameters, infinite where nothing is hit.
        item: (height, width), index of the hit item: its row in `looks`. Any value where nothing is hit.
        normals_room: (height, width, 3) float32, unit.
        looks: `Looks` of the scene.
        image: (512, 512) float32, from `make_texture`.

    Returns:
        The `Rendering`.
    """
    # Row by row in short loops without branches, which vectorise; one loop for everything takes twice the
    # time.
    height, width = hit_m.shape
    depth_m, cosine = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    color, mask = np.empty((height, width, 3), np.uint8), np.empty((height, width), np.bool_)
    albedo = np.empty((height, width), np.float32)
    plane_m, light = np.empty((2, width), np.float32), np.empty(width, np.float32)
    noise, row = np.empty(width, np.float32), np.empty(width, np.int64)
    for v in range(height):
        for u in range(width):
            hit = hit_m[v, u] < np.inf
            depth_m[v, u] = hit_m[v, u] if hit else np.float32(0)
            row[u] = item[v, u] if hit else len(looks.albedo) - 1
        _light_row(rays[v], depth_m[v], normals_room[v], plane_m, light, cosine[v])
        _noise_row(plane_m, image.ravel(), noise)
        _tile_row(plane_m, row, looks, image, noise)
        for u in range(width):
            hit = depth_m[v, u] > 0
            mask[v, u], albedo[v, u] = looks.subject[row[u]], looks.albedo[row[u]]
            cosine[v, u] = cosine[v, u] if hit else np.float32(0)
            factor = np.float32(255) * (light[u] * noise[u] if hit else np.float32(1))
            for k in range(3):
                value = min(factor * looks.color_rgb[row[u], k], np.float32(255))
                color[v, u, k] = np.uint8(value + np.float32(0.5))
    return Rendering(depth_m, color, mask, cosine, albedo)


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _light_row(rays, depth_m, normals, plane_m, light, cosine):  # type: ignore[no-untyped-def]
    """Write light, cosine of incidence and texture coordinates of a row's hits into the last three arrays.

    Args:
        rays: (width, 6), origin and direction.
        depth_m: (width,), ray parameters of the hits.
        normals: (width, 3), unit.
        plane_m: (2, width), written: coordinates of the hits along the two room axes most parallel to the
            surface, metres.
        light: (width,), written: brightness factors.
        cosine: (width,), written: cosine of incidence.
    """
    for u in range(len(depth_m)):
        dx, dy, dz = rays[u, 3], rays[u, 4], rays[u, 5]
        nx, ny, nz = normals[u, 0], normals[u, 1], normals[u, 2]
        across = abs(dx * nx + dy * ny + dz * nz) / np.sqrt(dx * dx + dy * dy + dz * dz)
        cosine[u] = min(across, np.float32(1))
        x, y = rays[u, 0] + depth_m[u] * dx, rays[u, 1] + depth_m[u] * dy
        z = rays[u, 2] + depth_m[u] * dz
        along_x = (abs(nx) >= abs(ny)) & (abs(nx) >= abs(nz))
        along_y = abs(ny) >= abs(nz)
        plane_m[0, u] = y if along_x else x
        plane_m[1, u] = z if along_x | along_y else y
        lit = max(nx * LIGHT_ROOM[0] + ny * LIGHT_ROOM[1] + nz * LIGHT_ROOM[2], np.float32(0))
        light[u] = AMBIENT + (np.float32(1) - AMBIENT) * lit


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _noise_row(plane_m, flat, noise):  # type: ignore[no-untyped-def]
    """Write the periodic texture at a row's texture coordinates into `noise` (width,), bilinearly sampled.

    `plane_m` (2, width) are the coordinates in metres, `flat` is the texture, flattened.
    """
    wrap, one = TEXTURE_PX - 1, np.float32(1)
    for u in range(len(noise)):
        x, y = plane_m[0, u] * np.float32(PIXELS_PER_M), plane_m[1, u] * np.float32(PIXELS_PER_M)
        left, top = np.floor(x), np.floor(y)
        s, t = x - left, y - top
        i, j = np.int32(left) & wrap, np.int32(top) & wrap
        right, below = (i + 1) & wrap, ((j + 1) & wrap) * TEXTURE_PX
        j *= TEXTURE_PX
        upper = (one - s) * flat[j + i] + s * flat[j + right]
        lower = (one - s) * flat[below + i] + s * flat[below + right]
        noise[u] = (one - t) * upper + t * lower


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _tile_row(plane_m, row, looks, image, noise):  # type: ignore[no-untyped-def]
    """Convert a row's `noise` (width,) in place to brightness factors around 1, with tiles and dark joints.

    Args:
        plane_m: (2, width), texture coordinates in metres.
        row: (width,), row in `looks` of each pixel's item.
        looks: `Looks` of the scene.
        image: (512, 512), the texture, which varies the shades of tiles.
        noise: (width,), samples of the texture; overwritten.
    """
    for u in range(len(noise)):
        factor = np.float32(1) + looks.contrast[row[u]] * noise[u]
        tile_m = looks.tile_m[row[u]]
        if tile_m > 0:
            i, j = np.floor(plane_m[0, u] / tile_m), np.floor(plane_m[1, u] / tile_m)
            joint = min(plane_m[0, u] - i * tile_m, plane_m[1, u] - j * tile_m) < JOINT_M
            tint = image[(np.int32(i) * 37) & (TEXTURE_PX - 1), (np.int32(j) * 37) & (TEXTURE_PX - 1)]
            factor *= np.float32(JOINT_SHADE if joint else 1 + TILE_CONTRAST * tint)
        noise[u] = factor


# Colour of rays without a hit: an overcast sky, or a bright room beyond.
BACKGROUND_RGB = (0.78, 0.81, 0.84)
# Rays start this far off the surface, so that they do not hit their own starting point.
LIFT_M = 1e-4


class Renderer:
    """Renders one scene from any camera by ray casting."""

    def __init__(self, items: Sequence[Item], texture: Float32) -> None:
        """Build the acceleration structure of the items (Open3D's, which is Embree)."""
        self._texture = texture
        self._caster, self._tensor = raycaster(*(item.mesh for item in items), threads=1)
        self._looks = Looks(
            np.array([item.color_rgb for item in items] + [BACKGROUND_RGB], np.float32),
            np.array([item.contrast for item in items] + [0], np.float32),
            np.array([item.tile_m for item in items] + [0], np.float32),
            np.array([item.albedo for item in items] + [0], np.float32),
            np.array([item.role == "subject" for item in items] + [False]),
        )

    def render(self, camera: Camera, T_room_rig: Float64, T_rig_camera: Float64 | None = None) -> Rendering:
        """Render one noise-free frame of a camera of a rig, on one thread.

        Args:
            camera: intrinsics.
            T_room_rig: the rig's pose (4, 4), or (height, 4, 4), one for each row of the image.
            T_rig_camera: (4, 4), the camera's pose in the rig; None: the identity.
        """
        rays = pixel_rays(camera, T_room_rig if T_rig_camera is None else T_room_rig @ T_rig_camera)
        hits = self._caster.cast_rays(self._tensor(rays), nthreads=1)
        hit_m, items = hits["t_hit"].numpy(), hits["geometry_ids"].numpy()
        normals_room = hits["primitive_normals"].numpy()
        rendering: Rendering = shade(rays, hit_m, items, normals_room, self._looks, self._texture)
        return rendering

    def visible(
        self, points_room: Float64, normals_room: Float64, camera: Camera, T_room_camera: Float64
    ) -> Bools:
        """Return (n,) bool: whether a camera sees each point, in the image, facing the camera and unoccluded.

        Args:
            points_room: (n, 3), metres.
            normals_room: (n, 3), unit, outward.
            camera: intrinsics.
            T_room_camera: (4, 4) pose of the camera.
        """
        points_camera = transform_points(invert_rigid(T_room_camera), points_room)
        ahead = points_camera[:, 2] > 0
        pixels = camera.project(np.where(ahead[:, None], points_camera, 1.0))
        inside = (pixels > -0.5) & (pixels < np.array([camera.width, camera.height]) - 0.5)
        towards = T_room_camera[:3, 3] - points_room
        seen: Bools = ahead & inside.all(axis=1) & (np.sum(towards * normals_room, axis=1) > 0)
        some = np.flatnonzero(seen)
        origins = points_room[some] + LIFT_M * normals_room[some]
        rays = np.concatenate([origins, T_room_camera[:3, 3] - origins], axis=1).astype(np.float32)
        hidden = self._caster.test_occlusions(self._tensor(rays), tnear=0.0, tfar=1.0, nthreads=1).numpy()
        seen[some[hidden]] = False
        return seen


# Chosen by eye: size and colour of a fist with its forearm, how far the fist reaches up beside the object it
# holds, and the object's height above a table.
ARM_M, ARM_RGB, GRIP_M, HELD_M = (0.07, 0.06, 0.35), (0.75, 0.56, 0.45), 0.015, 0.8
# Chosen by eye: colour of a turntable's plate, and how much wider than the object it is.
PLATE_RGB, PLATE_RATIO = (0.85, 0.85, 0.82), 1.25


@dataclass(frozen=True)
class StillRenderer:
    """Renders moving items and static surroundings, each from its own pose, into one image.

    It has the methods of `Renderer`. Frame `room` moves with the object, so a path's pose is that of the rig
    relative to the object. The object is lit as if the light moved with it.

    Attributes:
        own: renderer of the object, and of the arm or the plate that moves with it.
        around: renderer of everything else.
        T_room_still: (4, 4), the static pose of the camera rig, from which `around` is rendered.
    """

    own: Renderer
    around: Renderer
    T_room_still: Float64

    def render(self, camera: Camera, T_room_rig: Float64, T_rig_camera: Float64 | None = None) -> Rendering:
        """Render one frame like `Renderer.render`; `T_room_rig` is the rig's pose relative to the object."""
        own = self.own.render(camera, T_room_rig, T_rig_camera)
        around = self.around.render(camera, self.T_room_still, T_rig_camera)
        nearer = (own.depth_m > 0) & ((around.depth_m == 0) | (own.depth_m < around.depth_m))
        return Rendering(
            np.where(nearer, own.depth_m, around.depth_m),
            np.where(nearer[..., None], own.color_rgb, around.color_rgb),
            nearer & own.mask,
            np.where(nearer, own.cos_incidence, around.cos_incidence),
            np.where(nearer, own.albedo, around.albedo),
        )

    def visible(
        self, points_room: Float64, normals_room: Float64, camera: Camera, T_room_camera: Float64
    ) -> Bools:
        """Return whether a camera sees each point, like `Renderer.visible`; only moving items occlude."""
        return self.own.visible(points_room, normals_room, camera, T_room_camera)


def still_renderer(
    items: Sequence[Item], texture: Float32, T_room_first: Float64, settings: PathSettings
) -> StillRenderer:
    """Make a renderer whose camera stays where the path starts, while the object moves.

    The object is at the origin; `T_room_first` (4, 4) is the path's first pose, and its `moves` "turntable"
    or "hand".
    """
    own = [item for item in items if item.role == "subject"]
    T_room_still = T_room_first.copy()
    if settings.moves == "hand":
        arm = OrientedBox((0.0, 0.0, GRIP_M - ARM_M[2] / 2), ARM_M)
        own.append(Item("clutter", box_mesh(arm), ARM_RGB, 0.2))
        T_room_still[2, 3] += HELD_M
    elif settings.plate_m > 0:
        vertices = np.concatenate([item.mesh.vertices for item in own])
        wide_m = PLATE_RATIO * float(np.linalg.norm(vertices[:, :2], axis=1).max())
        low_m = -settings.plate_m
        plate = surface(turned([(0.0, low_m), (wide_m, low_m), (wide_m, 0.0), (0.0, 0.0)]))
        own.append(Item("clutter", plate, PLATE_RGB, 0.3))
        T_room_still[2, 3] += settings.plate_m
    around = [item for item in items if item.role != "subject"]
    return StillRenderer(Renderer(own, texture), Renderer(around, texture), T_room_still)


def turning_only(settings: PathSettings) -> PathSettings:
    """Return path settings in which only the turntable moves; settings without turntable stay unchanged."""
    if settings.moves != "turntable":
        return settings
    still = {
        "swing_rad": 0.0,
        "low_pass_share": 0.0,
        "turn_rad": 0.0,
        "shake_m": 0.0,
        "shake_rad": 0.0,
        "reach_share": 0.0,
        "jolt_m": 0.0,
    }
    return settings.model_copy(update={**still, "jolt_rad": 0.0})

"""Rendering against geometry worked out by hand, and its kernel against plain numpy."""

import numpy as np
import pytest
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera, OrientedBox, invert_rigid, transform_points
from kinectbench.core.geometry.mesh import box_mesh, join
from kinectbench.lab.simulate.objects.shapes import Piece, Subject
from kinectbench.lab.simulate.path import look_at
from kinectbench.lab.simulate.render import (
    AMBIENT,
    BACKGROUND_RGB,
    JOINT_M,
    JOINT_SHADE,
    LIGHT_ROOM,
    PIXELS_PER_M,
    TEXTURE_PX,
    TILE_CONTRAST,
    Looks,
    Renderer,
    make_texture,
    pixel_rays,
    shade,
)
from kinectbench.lab.simulate.scene import CLEARANCE_M, Item, Role, make_scene
from kinectbench.lab.simulate.spec import SceneSettings

CAMERA = Camera(160, 120, 131.25, 131.25, 79.5, 59.5)


@pytest.fixture(scope="module")
def texture() -> NDArray[np.float32]:
    return make_texture(np.random.default_rng(0))


def box(
    role: Role,
    centre: tuple[float, float, float],
    size: tuple[float, float, float],
    contrast: float = 0.0,
    **look: float,
) -> Item:
    return Item(role, box_mesh(OrientedBox(centre, size)), (0.5, 0.4, 0.3), contrast, **look)


def table() -> Subject:
    top = Piece("top", box_mesh(OrientedBox((0, 0, 0.7), (1.0, 0.6, 0.04))), (0.5, 0.4, 0.3))
    foot = Piece("foot", box_mesh(OrientedBox((0, 0, 0.34), (0.1, 0.1, 0.68))), (0.2, 0.2, 0.2), 0.1)
    return Subject("table", (top, foot), join([top.mesh, foot.mesh]), "two boxes")


def test_depth_of_the_bare_floor_is_analytic(texture: NDArray[np.float32]) -> None:
    renderer = Renderer([box("floor", (0, 0, -0.05), (40, 40, 0.1), albedo=0.3)], texture)
    T_room_camera = look_at(np.array([0.3, -2.0, 1.5]), np.array([0.0, 0.2, 0.0]))
    frame = renderer.render(CAMERA, T_room_camera)
    falls = -(CAMERA.rays() @ T_room_camera[:3, :3].T)[..., 2]
    hit = frame.depth_m > 0
    assert hit.mean() > 0.9
    assert np.allclose(frame.depth_m[hit], (1.5 / falls)[hit], rtol=2e-6)
    cosine = falls / np.linalg.norm(CAMERA.rays(), axis=-1)
    assert np.allclose(frame.cos_incidence[hit], cosine[hit], atol=1e-5)
    assert np.all(frame.albedo[hit] == np.float32(0.3))
    assert not frame.mask.any()


def test_rays_pass_through_integer_pixel_centres() -> None:
    T_room_camera = look_at(np.array([0.3, -2.0, 1.5]), np.array([0.0, 0.2, 0.0]))
    rays = pixel_rays(CAMERA, T_room_camera)
    assert np.allclose(rays[..., :3], T_room_camera[:3, 3], rtol=1e-6)
    assert np.allclose(rays[..., 3:], CAMERA.rays() @ T_room_camera[:3, :3].T, atol=1e-6)


def test_rays_that_hit_nothing_see_the_background(texture: NDArray[np.float32]) -> None:
    renderer = Renderer([box("subject", (0, 0, 0.25), (0.2, 0.2, 0.2))], texture)
    frame = renderer.render(CAMERA, look_at(np.array([0.0, -2.0, 1.0]), np.array([0.0, 0.0, 0.25])))
    missed = frame.depth_m == 0
    assert 0.5 < missed.mean() < 1
    assert np.all(frame.color_rgb[missed] == np.round(255 * np.array(BACKGROUND_RGB)))
    for image in (frame.mask, frame.cos_incidence, frame.albedo):
        assert not image[missed].any()


def test_points_of_the_subject_land_on_the_depth_and_the_mask(texture: NDArray[np.float32]) -> None:
    renderer = Renderer([box("subject", (0, 0, 0.25), (0.4, 0.3, 0.5))], texture)
    T_room_camera = look_at(np.array([0.1, -1.5, 1.2]), np.array([0.0, 0.0, 0.25]))
    frame = renderer.render(CAMERA, T_room_camera)
    assert np.array_equal(frame.mask, frame.depth_m > 0)
    # The centre of the top, which the camera sees, and one behind the box, which it does not.
    for point, seen in (([0.0, 0.0, 0.5], True), ([0.0, 0.15, 0.1], False)):
        at = transform_points(invert_rigid(T_room_camera), np.array(point))
        u, v = np.round(CAMERA.project(at)).astype(int)
        assert (abs(frame.depth_m[v, u] - at[2]) < 0.01) == seen
    points = transform_points(T_room_camera, CAMERA.backproject(frame.depth_m))[frame.mask]
    outside_m = np.max(np.abs(points - [0, 0, 0.25]) - np.array([0.2, 0.15, 0.25]), axis=1)
    assert np.abs(outside_m).max() < 1e-5


def test_a_point_keeps_its_colour_in_another_view(texture: NDArray[np.float32]) -> None:
    scene = make_scene(table(), 0.0, 2.0, SceneSettings(), np.random.default_rng(1))
    renderer, top = Renderer(scene, texture), np.array([0.1, 0.05, 0.72])
    colors = []
    for position in ([0.1, -1.5, 1.8], [1.4, 0.4, 1.9]):
        T_room_camera = look_at(np.array(position), top)
        colors.append(renderer.render(CAMERA, T_room_camera).color_rgb[59:61, 79:81].mean(axis=(0, 1)))
    assert np.abs(colors[0] - colors[1]).max() < 12


def plain_color(
    rays: NDArray[np.float32],
    depth_m: NDArray[np.float32],
    item: NDArray[np.uint32],
    normals: NDArray[np.float32],
    looks: Looks,
    image: NDArray[np.float32],
) -> NDArray[np.float64]:
    """The documented rule, array by array."""
    points = rays[..., :3] + rays[..., 3:] * depth_m[..., None]
    axes = np.array([[1, 2], [0, 2], [0, 1]])[np.argmax(np.abs(normals), axis=-1)]
    plane_m = np.take_along_axis(points, axes, axis=-1)
    pixels = plane_m * PIXELS_PER_M
    corner = np.floor(pixels).astype(int)
    s, t = np.moveaxis(pixels - corner, -1, 0)
    noise = np.zeros(depth_m.shape)
    for right, below, weight in (
        (0, 0, (1 - s) * (1 - t)),
        (1, 0, s * (1 - t)),
        (0, 1, (1 - s) * t),
        (1, 1, s * t),
    ):
        noise += weight * image[(corner[..., 1] + below) % TEXTURE_PX, (corner[..., 0] + right) % TEXTURE_PX]
    factor = 1 + looks.contrast[item] * noise
    tile_m = np.where(looks.tile_m[item] > 0, looks.tile_m[item], 1.0)[..., None]
    cell, within = np.divmod(plane_m, tile_m)
    first, second = np.moveaxis((cell.astype(int) * 37) % TEXTURE_PX, -1, 0)
    shades = np.where(within.min(axis=-1) < JOINT_M, JOINT_SHADE, 1 + TILE_CONTRAST * image[first, second])
    factor *= np.where(looks.tile_m[item] > 0, shades, 1.0)
    factor *= AMBIENT + (1 - AMBIENT) * np.clip(normals @ np.array(LIGHT_ROOM), 0, 1)
    return np.round(255 * np.clip(looks.color_rgb[item] * factor[..., None], 0, 1))


def test_the_kernel_does_what_plain_numpy_does(texture: NDArray[np.float32]) -> None:
    rng = np.random.default_rng(5)
    T_room_camera = look_at(np.array([0.3, -2.0, 1.5]), np.array([0.0, 0.2, 0.0]))
    rays = pixel_rays(CAMERA, T_room_camera)
    depth_m = rng.uniform(0.5, 5, rays.shape[:2]).astype(np.float32)
    item = rng.integers(0, 3, depth_m.shape).astype(np.uint32)
    normals = rng.standard_normal((*depth_m.shape, 3))
    normals = (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32)
    looks = Looks(
        rng.uniform(0.1, 1, (4, 3)).astype(np.float32),
        np.array([0.0, 0.3, 0.6, 0], np.float32),
        np.array([0.0, 0.4, 0, 0], np.float32),
        np.array([0.1, 0.5, 0.9, 0], np.float32),
        np.array([True, False, False, False]),
    )
    shaded = shade(rays, depth_m, item, normals, looks, texture)
    difference = np.abs(shaded.color_rgb - plain_color(rays, depth_m, item, normals, looks, texture))
    # Rounding may put a point on the other side of a joint.
    assert np.mean(difference.max(axis=-1) > 1) < 1e-3
    assert np.array_equal(shaded.depth_m, depth_m)
    assert np.array_equal(shaded.mask, looks.subject[item])
    assert np.array_equal(shaded.albedo, looks.albedo[item])
    directions = rays[..., 3:] / np.linalg.norm(rays[..., 3:], axis=-1, keepdims=True)
    assert np.allclose(shaded.cos_incidence, np.abs(np.sum(directions * normals, axis=-1)), atol=1e-5)


def test_a_frame_is_the_same_every_time(texture: NDArray[np.float32]) -> None:
    scene = make_scene(table(), 0.0, 2.0, SceneSettings(), np.random.default_rng(1))
    T_room_camera = look_at(np.array([0.3, -2.0, 1.5]), np.array([0.0, 0.2, 0.0]))
    first, second = (Renderer(scene, texture).render(CAMERA, T_room_camera) for _ in range(2))
    assert all(np.array_equal(getattr(first, name), getattr(second, name)) for name in first._fields)


@pytest.mark.parametrize("seed", range(5))
def test_clutter_keeps_its_distance(seed: int) -> None:
    settings = SceneSettings(clutter=3, walls=0)
    scene = make_scene(table(), 0.7, 2.0, settings, np.random.default_rng(seed))
    clutter = [item for item in scene if item.role == "clutter"]
    assert len(clutter) == 3
    subject = np.concatenate([item.mesh.vertices for item in scene if item.role == "subject"])
    radius = np.linalg.norm(subject[:, :2], axis=1).max()
    for item in clutter:
        flat = item.mesh.vertices[:, :2]
        share = np.linspace(0, 1, 21)[:, None, None, None]
        between = flat[:, None] * share + flat[None] * (1 - share)
        assert np.linalg.norm(between, axis=-1).min() >= radius + CLEARANCE_M

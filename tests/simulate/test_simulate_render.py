"""Rendering and orbits against geometry worked out by hand."""

import numpy as np
import pytest

from kinectbench.geometry import Camera, invert_rigid, transform_points
from kinectbench.simulate.furniture import make_object
from kinectbench.simulate.orbit import look_at, orbit_around, orbit_poses
from kinectbench.simulate.render import Renderer
from kinectbench.simulate.scene import CLEARANCE_M, Item, Scene, make_scene
from kinectbench.simulate.solid import Part
from kinectbench.simulate.texture import make_texture

CAMERA = Camera(160, 120, 131.25, 131.25, 79.5, 59.5)


@pytest.fixture(scope="module")
def texture():
    return make_texture(np.random.default_rng(0))


def test_depth_of_the_bare_floor_is_analytic(texture):
    floor = Part("floor", "rectangle", (40, 40), (0, 0, -0.1), (0, 0, 0))
    renderer = Renderer(Scene((Item("floor", floor.mesh(), (0.5, 0.5, 0.5), 0.0),)), texture)
    T_room_camera = look_at(np.array([0.3, -2.0, 1.5]), np.array([0.0, 0.2, 0.0]))
    frame = renderer.render(CAMERA, T_room_camera)
    falls = -(CAMERA.rays() @ T_room_camera[:3, :3].T)[..., 2]
    hit = frame.depth_m > 0
    assert hit.mean() > 0.9
    assert np.allclose(frame.depth_m[hit], (1.5 / falls)[hit], rtol=2e-6)
    cosine = falls / np.linalg.norm(CAMERA.rays(), axis=-1)
    assert np.allclose(frame.cos_incidence[hit], cosine[hit], atol=1e-5)
    assert not frame.mask.any()


def test_points_of_the_subject_land_on_the_depth_and_the_mask(texture):
    box = Part("box", "rectangle", (0.4, 0.3), (0, 0, 0), (0, 0, 0.5))
    renderer = Renderer(Scene((Item("subject", box.mesh(), (0.5, 0.5, 0.5), 0.0),)), texture)
    T_room_camera = look_at(np.array([0.1, -1.5, 1.2]), np.array([0.0, 0.0, 0.25]))
    frame = renderer.render(CAMERA, T_room_camera)
    assert np.array_equal(frame.mask, frame.depth_m > 0)
    # The centre of the top, which the camera sees, and one behind the box, which it does not.
    for point, seen in (([0.0, 0.0, 0.5], True), ([0.0, 0.15, 0.1], False)):
        at = transform_points(invert_rigid(T_room_camera), np.array(point))
        u, v = np.round(CAMERA.project(at)).astype(int)
        assert (abs(frame.depth_m[v, u] - at[2]) < 0.01) == seen
    points = transform_points(T_room_camera, CAMERA.backproject(frame.depth_m))[frame.mask]
    planes = box.planes()
    distance_m = np.max(points @ planes[:, :3].T + planes[:, 3], axis=1)
    assert np.abs(distance_m).max() < 1e-5


def test_a_point_keeps_its_colour_in_another_view(texture):
    solid = make_object("table", 2)
    renderer = Renderer(make_scene(solid, 0.0, np.random.default_rng(1)), texture)
    top = np.array([0.1, 0.05, solid.bounds_m()[1, 2]])
    colors = []
    for position in ([0.1, -1.5, 1.8], [1.4, 0.4, 1.9]):
        T_room_camera = look_at(np.array(position), top)
        colors.append(renderer.render(CAMERA, T_room_camera).color_rgb[59:61, 79:81].mean(axis=(0, 1)))
    assert np.abs(colors[0] - colors[1]).max() < 12


def test_the_orbit_looks_at_the_subject_and_closes():
    solid = make_object("chair", 4)
    orbit = orbit_around(solid, CAMERA, 60, 2.2 * np.pi)
    T_room_camera = orbit_poses(orbit, np.random.default_rng(2))
    rotations = T_room_camera[:, :3, :3]
    assert np.allclose(rotations @ rotations.transpose(0, 2, 1), np.eye(3), atol=1e-12)
    assert np.allclose(np.linalg.det(rotations), 1)
    target_camera = transform_points(invert_rigid(T_room_camera[0]), np.array(orbit.target_room))
    assert target_camera[2] == pytest.approx(orbit.distance_m, rel=0.1)
    for T in T_room_camera:
        at = CAMERA.project(transform_points(invert_rigid(T), np.array(orbit.target_room)))
        assert np.linalg.norm(at - [CAMERA.cx, CAMERA.cy]) < 12
        assert T[2, 1] < -0.5  # image down is down in the room
    turns = np.unwrap(np.arctan2(T_room_camera[:, 1, 3], T_room_camera[:, 0, 3]))
    assert turns[-1] - turns[0] == pytest.approx(2.2 * np.pi, abs=0.1)
    assert T_room_camera[:, 2, 3].min() > 0.3


@pytest.mark.parametrize("seed", range(10))
def test_clutter_keeps_its_distance(seed):
    solid = make_object("table", seed)
    scene = make_scene(solid, 0.7, np.random.default_rng(seed))
    roles = [item.role for item in scene.items]
    assert 1 <= roles.count("clutter") <= 2
    assert 2 <= roles.count("wall") <= 3
    subject = np.concatenate([item.mesh.vertices for item in scene.items if item.role == "subject"])
    radius = np.linalg.norm(subject[:, :2], axis=1).max()
    for item in scene.items:
        if item.role == "clutter":
            corners = item.mesh.vertices[:4, :2]
            share = np.linspace(0, 1, 21)[:, None, None]
            edges = corners * share + np.roll(corners, 1, axis=0) * (1 - share)
            assert np.linalg.norm(edges, axis=-1).min() >= radius + CLEARANCE_M

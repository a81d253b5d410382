"""Colour on the pixels of depth: a textured wall behind a square, with the true colour of every point."""

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera, rigid, rotation_from_quaternion_xyzw
from kinectbench.stages.ingest.recording import ColorCalibration
from kinectbench.stages.ingest.registration import ColorRegistration

DEPTH = Camera(160, 120, 150.0, 151.0, 79.5, 58.0)
COLORS = {
    "as large": Camera(160, 120, 155.0, 155.0, 80.0, 60.0),
    "larger": Camera(480, 360, 430.0, 432.0, 241.0, 178.0),
    "smaller": Camera(80, 60, 76.0, 75.0, 40.0, 30.0),
}
T_COLOR_DEPTH = rigid(rotation_from_quaternion_xyzw([0.004, -0.01, 0.003, 1]), [-0.06, 0.004, 0.01])
WALL_M, SQUARE_M, HALF_M = 2.0, 1.0, 0.15
RED = np.array([20, 30, 220], np.uint8)


def scene(camera: Camera, T_camera_depth: NDArray[np.float64]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Depth along z, BGR and whether it is the square, of every pixel; by rays from its camera."""
    T_depth_camera = np.linalg.inv(T_camera_depth)
    rays = camera.rays() @ T_depth_camera[:3, :3].T
    origin = T_depth_camera[:3, 3]
    points, hits = {}, {}
    for name, z in (("wall", WALL_M), ("square", SQUARE_M)):
        points[name] = origin + rays * ((z - origin[2]) / rays[..., 2])[..., None]
    hits = (np.abs(points["square"][..., :2]) < HALF_M).all(axis=-1)
    found = np.where(hits[..., None], points["square"], points["wall"])
    bgr = np.where(hits[..., None], RED, wall_color(found))
    z_camera = (found @ T_camera_depth[:3, :3].T + T_camera_depth[:3, 3])[..., 2]
    return z_camera, bgr.astype(np.uint8), hits


def wall_color(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Smooth, blue and green by place; never black, never red."""
    x, y = points[..., 0], points[..., 1]
    return np.stack([120 + 100 * np.sin(2 * x), 120 + 100 * np.cos(2 * y), np.zeros_like(x)], axis=-1)


def hidden_from_color() -> NDArray[np.bool_]:
    """Points of the wall that the depth camera sees and the colour camera does not, for the square."""
    points = DEPTH.backproject(scene(DEPTH, np.eye(4))[0])
    eye = np.linalg.inv(T_COLOR_DEPTH)[:3, 3]
    share = (SQUARE_M - eye[2]) / (points[..., 2] - eye[2])
    crossing = eye + share[..., None] * (points - eye)
    color: NDArray[np.bool_] = (np.abs(crossing[..., :2]) < HALF_M).all(axis=-1) & (points[..., 2] > 1.5)
    return color


@pytest.mark.parametrize("name", COLORS)
def test_every_pixel_has_its_own_colour_or_none(name: str) -> None:
    depth_m, true, square = scene(DEPTH, np.eye(4))
    _, recorded, _ = scene(COLORS[name], T_COLOR_DEPTH)
    register = ColorRegistration(DEPTH, ColorCalibration(COLORS[name], (), T_COLOR_DEPTH))
    found = register(depth_m.astype(np.float32), recorded)
    black = np.asarray(~found.any(axis=-1))
    hidden = hidden_from_color()
    assert hidden.sum() > 100
    # What is hidden is black, but for pixels at its edges.
    edge = cv2.dilate(cv2.Canny(square.astype(np.uint8) * 255, 50, 100), np.ones((7, 7)) * 1) > 0
    rim = edge | (
        cv2.dilate(hidden.astype(np.uint8), np.ones((7, 7)))
        != cv2.erode(hidden.astype(np.uint8), np.ones((7, 7)))
    )
    assert black[hidden & ~rim].all()
    assert black[hidden].mean() > 0.8
    points = DEPTH.backproject(depth_m) @ T_COLOR_DEPTH[:3, :3].T + T_COLOR_DEPTH[:3, 3]
    u, v = np.moveaxis(COLORS[name].project(points), -1, 0)
    inside = (u > 0) & (v > 0) & (u < COLORS[name].width - 1) & (v < COLORS[name].height - 1)
    outside = (u < -1) | (v < -1) | (u > COLORS[name].width) | (v > COLORS[name].height)
    assert black[outside].all()
    rest = inside & ~hidden & ~rim
    assert rest.mean() > 0.7
    assert not black[rest].any()
    assert np.abs(found[rest].astype(int) - true[rest]).max() <= 3


def test_pixels_without_depth_take_their_neighbours() -> None:
    depth_m, true, square = scene(DEPTH, np.eye(4))
    holes = depth_m.astype(np.float32)
    holes[100:104, 20:24] = 0  # on the wall
    _, recorded, _ = scene(COLORS["as large"], T_COLOR_DEPTH)
    register = ColorRegistration(DEPTH, ColorCalibration(COLORS["as large"], (), T_COLOR_DEPTH))
    found = register(holes, recorded)
    assert np.abs(found[100:104, 20:24].astype(int) - true[100:104, 20:24]).max() <= 3
    assert not register(np.zeros_like(holes), recorded).any()
    assert square.any()


def test_distorted_colour() -> None:
    depth_m, true, square = scene(DEPTH, np.eye(4))
    camera, k = COLORS["larger"], (0.1, -0.05, 0.001, -0.001, 0.0)
    # The distorted image shows at each pixel what the pinhole camera shows at the undistorted place.
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    pixels = np.stack([u, v], axis=-1).reshape(-1, 1, 2)
    straight = cv2.undistortPoints(pixels, camera.K, np.array(k), P=camera.K).reshape(*u.shape, 2)
    wide = Camera(
        camera.width + 200, camera.height + 200, camera.fx, camera.fy, camera.cx + 100, camera.cy + 100
    )
    _, plain, _ = scene(wide, T_COLOR_DEPTH)
    places = (straight + 100).astype(np.float32)
    recorded = cv2.remap(plain, places[..., 0], places[..., 1], cv2.INTER_LINEAR)
    found = ColorRegistration(DEPTH, ColorCalibration(camera, k, T_COLOR_DEPTH))(
        depth_m.astype(np.float32), recorded
    )
    inner = np.zeros(square.shape, bool)
    inner[20:100, 20:50] = True
    assert np.abs(found[inner].astype(int) - true[inner]).max() <= 4

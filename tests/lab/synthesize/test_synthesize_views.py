"""Viewing angles and the virtual camera: against hand-turned vectors and a ball that must just fit."""

from typing import Literal

import numpy as np
import pytest
import trimesh
from synthesis_shapes import asymmetric

from kinectbench.lab.synthesize.views import ViewAngles, all_views, camera_pose, hull_corners, virtual_camera

CENTRE = np.array([0.1, -0.2, 0.3])
BALL = np.asarray(trimesh.creation.icosphere(4, radius=0.4).vertices) + CENTRE


def test_counts_and_names() -> None:
    views = all_views(5)
    assert len(views) == 125 and len(all_views(6)) == 216
    assert [view.name for view in views[:6]] == ["0_0_0", "0_0_1", "0_0_2", "0_0_3", "0_0_4", "0_1_0"]
    assert views[-1].name == "4_4_4"
    assert all_views(6)[8].angles_rad == (0.0, 2 * np.pi / 6, 2 * 2 * np.pi / 6)


@pytest.mark.parametrize(
    ("steps", "turned"),
    [
        ((1, 0, 0), {"x": [1, 0, 0], "y": [0, 0, 1], "z": [0, -1, 0]}),  # roll about x
        ((0, 1, 0), {"x": [0, 0, -1], "y": [0, 1, 0], "z": [1, 0, 0]}),  # pitch about y
        ((0, 0, 1), {"x": [0, 1, 0], "y": [-1, 0, 0], "z": [0, 0, 1]}),  # yaw about z
        ((1, 0, 1), {"x": [0, 1, 0], "y": [0, 0, 1], "z": [1, 0, 0]}),  # roll first, then yaw
        ((1, 1, 0), {"x": [0, 0, -1], "y": [1, 0, 0], "z": [0, -1, 0]}),  # roll first, then pitch
    ],
)
def test_quarter_turns(steps: tuple[int, int, int], turned: dict[str, list[int]]) -> None:
    rotation = ViewAngles(steps, 4).rotation
    for column, axis in enumerate("xyz"):
        np.testing.assert_allclose(rotation[:, column], turned[axis], atol=1e-15)


def test_same_and_cross_viewing_share_one_orientation() -> None:
    """Both count from zero; of the 216 half are doubled, since (r, p, y) = (r + pi, pi - p, y + pi)."""
    sv = np.array([view.rotation for view in all_views(5)])
    cv = np.array([view.rotation for view in all_views(6)])
    assert len(np.unique(np.round(sv, 9) + 0.0, axis=0)) == 125
    assert len(np.unique(np.round(cv, 9) + 0.0, axis=0)) == 108
    same = np.abs(sv[:, None] - cv[None]).max(axis=(2, 3)) < 1e-9
    assert [(int(a), int(b)) for a, b in np.argwhere(same)] == [(0, 0), (0, 129)]
    assert all_views(6)[129].name == "3_3_3"


@pytest.mark.parametrize("up", ["y", "z"])
def test_the_first_view_is_upright(up: Literal["y", "z"]) -> None:
    pose = camera_pose(BALL, ViewAngles((0, 0, 0), 5), virtual_camera(320), up)
    upwards = np.array([0, 1, 0] if up == "y" else [0, 0, 1])
    ahead = np.array([0, 0, -1] if up == "y" else [0, 1, 0])
    np.testing.assert_allclose(pose[:3, :3] @ [0, -1, 0], upwards, atol=1e-15)
    np.testing.assert_allclose(pose[:3, :3] @ [0, 0, 1], ahead, atol=1e-15)
    np.testing.assert_allclose(np.cross(ahead, upwards), pose[:3, 0], atol=1e-15)


def test_authors_intrinsics() -> None:
    camera = virtual_camera(480)
    assert (camera.width, camera.height, camera.cx, camera.cy) == (480, 480, 240, 240)
    assert camera.fx == camera.fy == pytest.approx(480 / (2 * np.tan(np.radians(49.124) / 2)))


def test_a_ball_just_fits_from_everywhere() -> None:
    camera = virtual_camera(320)
    for view in all_views(5)[::7]:
        pose = camera_pose(BALL, view, camera, "y")
        pixels = camera.project((BALL - pose[:3, 3]) @ pose[:3, :3])
        assert pixels.min() > -0.5 and 317 < pixels.max() < 319.5
        assert np.linalg.norm(pose[:3, 3] - CENTRE) == pytest.approx(0.4 / np.sin(0.427), rel=0.01)


def test_hull_corners_have_the_same_boxes() -> None:
    vertices = np.asarray(asymmetric().subdivide().vertices)
    corners = hull_corners(vertices)
    assert len(corners) < len(vertices) / 4
    for view in all_views(5)[::9]:
        a, b = vertices @ view.rotation, corners @ view.rotation
        np.testing.assert_allclose([a.min(0), a.max(0)], [b.min(0), b.max(0)], atol=1e-12)
    flat = vertices * [1, 1, 0]
    np.testing.assert_array_equal(hull_corners(flat), flat)

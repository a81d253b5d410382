"""Surface samples and shadow rays against geometry worked out by hand."""

import numpy as np
import pytest

from kinectbench.core.geometry import Camera, OrientedBox
from kinectbench.core.geometry.mesh import box_mesh
from kinectbench.core.voxels.point_cells import sample_surface
from kinectbench.lab.simulate.path import look_at
from kinectbench.lab.simulate.render import Renderer
from kinectbench.lab.simulate.scene import Item

CAMERA = Camera(160, 120, 131.25, 131.25, 79.5, 59.5)
NO_TEXTURE = np.zeros((512, 512), np.float32)
BOX = box_mesh(OrientedBox((0, 0, 0.25), (0.4, 0.2, 0.5)))


def test_samples_are_spread_by_area_and_lie_on_the_surface() -> None:
    points, normals = sample_surface(BOX.vertices, BOX.faces, 20_000, np.random.default_rng(0))
    beside = np.abs(np.abs(points - [0, 0, 0.25]) - [0.2, 0.1, 0.25])
    assert beside.min(axis=1).max() < 1e-12
    area = {0: 2 * 0.2 * 0.5, 1: 2 * 0.4 * 0.5, 2: 2 * 0.4 * 0.2}
    for axis, share in area.items():
        assert (np.abs(normals[:, axis]) > 0.99).mean() == pytest.approx(share / sum(area.values()), abs=1e-3)
    assert (np.sum((points - [0, 0, 0.25]) * normals, axis=1) > 0).all()


def test_a_camera_sees_the_sides_that_face_it_unless_something_stands_before_them() -> None:
    points, normals = sample_surface(BOX.vertices, BOX.faces, 4000, np.random.default_rng(0))
    T_room_camera = look_at(np.array([0.0, -2.0, 1.5]), np.array([0.0, 0.0, 0.25]))
    alone = Renderer([Item("subject", BOX, (0.5, 0.5, 0.5), 0.0)], NO_TEXTURE)
    seen = alone.visible(points, normals, CAMERA, T_room_camera)
    # Front and top face this camera, and nothing hides them.
    assert np.array_equal(seen, (normals[:, 1] < -0.5) | (normals[:, 2] > 0.5))
    screen = box_mesh(OrientedBox((0, -0.5, 0.1), (2.0, 0.02, 0.2)))
    items = [Item("subject", BOX, (0.5,) * 3, 0.0), Item("clutter", screen, (0.5,) * 3, 0.0)]
    hidden = Renderer(items, NO_TEXTURE).visible(points, normals, CAMERA, T_room_camera)
    # The ray over the screen's upper front edge (y = -0.51, z = 0.2) meets the front at this height.
    edge_z = 1.5 - 1.3 * (2.0 - 0.1) / (2.0 - 0.51)
    front = normals[:, 1] < -0.5
    clear = np.abs(points[:, 2] - edge_z) > 0.02
    assert np.array_equal(hidden[front & clear], points[front & clear, 2] > edge_z)
    away = look_at(np.array([0.0, -2.0, 1.5]), np.array([0.0, -4.0, 0.25]))
    assert not alone.visible(points, normals, CAMERA, away).any()

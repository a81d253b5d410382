"""One pose far from all others that nothing contradicts: no memory is taken for it, and it is named."""

import cv2
import numpy as np
from raising import raises
from typed import present

from kinectbench.core.box_pictures import plan_picture
from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import OrientedBox, TriangleMesh, rigid
from kinectbench.core.geometry.mesh import join
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float64
from kinectbench.settings.models import SegmentationSettings
from kinectbench.stages.segment.find.object import find_floor_and_object
from kinectbench.stages.segment.find.pieces import select_in_box
from kinectbench.stages.track.outliers import far_warnings

AWAY = np.array([400.0, 300.0, 50.0])
X, Y, Z = 0.01 * np.eye(3)


def sheet(corner: Float64, along: Float64, across: Float64, rows: int, columns: int) -> TriangleMesh:
    i, j = np.meshgrid(np.arange(rows), np.arange(columns), indexing="ij")
    a = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    faces = np.concatenate([[a, a + columns, a + 1], [a + columns, a + columns + 1, a + 1]], axis=1).T
    return TriangleMesh(corner + i.reshape(-1, 1) * along + j.reshape(-1, 1) * across, faces.astype(np.int32))


def poses(count: int = 30) -> Float64:
    """Cameras around the origin that look at it."""
    found = []
    for turn in np.linspace(0, 2 * np.pi, count, endpoint=False):
        at = np.array([1.6 * np.cos(turn), 1.6 * np.sin(turn), 1.2])
        ahead = (np.array([0, 0, 0.2]) - at) / np.linalg.norm(np.array([0, 0, 0.2]) - at)
        right = np.cross(ahead, [0, 0, 1])
        right /= np.linalg.norm(right)
        found.append(rigid(np.stack([right, np.cross(ahead, right), ahead], axis=1), at))
    return np.stack(found)


def scene() -> TriangleMesh:
    """A box of 0.4 m on a floor, and what a frame half a kilometre off shows."""
    low, high = np.array([-0.2, -0.2, 0]), np.array([-0.2, -0.2, 0.4])
    sides = [sheet(low, X, Z, 41, 41), sheet(low + 40 * X, Y, Z, 41, 41), sheet(low + 40 * Y, Z, X, 41, 41)]
    sides += [sheet(low, Z, Y, 41, 41), sheet(high, X, Y, 41, 41)]
    floor = sheet(np.array([-1.5, -1.5, 0]), X, Y, 301, 301)
    return join([floor, *sides, sheet(high + AWAY, X, Y, 41, 41)])


def test_a_scene_with_a_far_patch_is_searched() -> None:
    """A dense grid of it would have 2 x 10^11 cells."""
    T = poses()
    given = OrientedBox((0, 0, 0.25), (0.6, 0.6, 0.5))
    near = Trajectory(np.arange(30) * 10**8, T, "trust")
    for box in (None, given):
        found = find_floor_and_object(scene(), near, box, SegmentationSettings())
        assert abs(np.array(found.box.size_m[:2]) - 0.4 - 0.2 * (box is not None)).max() < 0.02
    T[7, :3, 3] += AWAY
    far = Trajectory(np.arange(30) * 10**8, T, "trust")
    named = r"where the cameras look: .*; 50\d m away from most others: frame 7: .*remove it from the tra"
    with raises(SegmentationError, "segmentation.no-object", match=named):
        find_floor_and_object(scene(), far, None, SegmentationSettings())
    assert len(plan_picture([given], scene().vertices, np.zeros(3), np.eye(4), far)) > 1000


def test_a_box_takes_what_ends_inside_also_with_a_far_patch() -> None:
    near = np.random.default_rng(0).random((4000, 3)) * 0.3
    wall = np.random.default_rng(1).random((9000, 3)) * [2.0, 0.02, 0.3] + [-1.0, 0.5, 0]
    points = np.concatenate([near, wall, near + AWAY])
    in_box = (np.abs(points - [0.15, 0.2, 0.15]) <= 0.36).all(axis=1)
    assert in_box[4000:13000].sum() > 100
    np.testing.assert_array_equal(select_in_box(points, in_box), np.arange(17_000) < 4000)


def test_a_frame_far_from_all_others_is_named() -> None:
    T = poses()
    assert far_warnings(T) == [] == far_warnings(np.full((3, 4, 4), np.nan))
    T[[3, 5]] = np.nan
    T[7, :3, 3] += AWAY
    (line,) = far_warnings(T)
    assert line.startswith("50") and " m away from most others: frame 7: " in line
    T[8:10, :3, 3] -= AWAY
    (line,) = far_warnings(T)
    assert "3 frames (7 to 9)" in line


def test_the_plan_shows_a_board_on_the_floor() -> None:
    """Floor and board are clearly different greys."""
    steps = np.arange(-1.0, 1.0, 0.02)
    points = np.array(np.meshgrid(steps, steps, [0.0])).reshape(3, -1).T
    points[(np.abs(points[:, :2]) < 0.5).all(axis=1), 2] = 0.015
    board = OrientedBox((0, 0, 0.01), (1.0, 1.0, 0.05))
    trajectory = Trajectory(np.arange(30) * 10**8, poses(), "trust")
    plan = plan_picture([board], points, np.zeros(3), np.eye(4), trajectory)
    shown = present(cv2.imdecode(np.frombuffer(plan, np.uint8), cv2.IMREAD_GRAYSCALE))
    greys, pixels = np.unique(shown[shown < 255], return_counts=True)
    floor_and_board = greys[np.argsort(pixels)[-2:]].astype(int)
    assert np.ptp(floor_and_board) > 40

"""Aligning a view to the object: a wrong pose is corrected, a right one is left where it is."""

import numpy as np
import pytest
from analytic_scenes import displaced
from chair_model import Chair
from chair_model import chair as make_chair

from kinectbench.alignment import align_view
from kinectbench.geometry import invert_rigid, rigid, transform_points
from kinectbench.segmentation.render import DepthRenderer

pytestmark = pytest.mark.xdist_group("chair_model")
FRAMES = (1, 8, 15, 21)
# Views with enough smooth surface on the object at this resolution.
WELL_COVERED = (8, 15)


@pytest.fixture(scope="module")
def chair() -> Chair:
    return make_chair()


@pytest.fixture(scope="module")
def renderer(chair) -> DepthRenderer:
    """Of the true object, so that the true pose is the right answer."""
    return DepthRenderer(chair.recorded.mesh_world)


def error_m(chair: Chair, frame: int, T_world_camera) -> float:
    """How far the object's points in this frame are from where they belong, median."""
    depth_m = chair.recorded.sequence.depth_m(frame)
    on_object = chair.recorded.masks[frame] & (depth_m > 0)
    points = chair.recorded.sequence.camera.backproject(depth_m)[on_object]
    truth = chair.recorded.simulation.T_world_camera[frame]
    apart = transform_points(T_world_camera, points) - transform_points(truth, points)
    return float(np.median(np.linalg.norm(apart, axis=1)))


@pytest.mark.parametrize("frame", FRAMES)
def test_a_right_pose_stays(chair, renderer, frame):
    truth = chair.recorded.simulation.T_world_camera[frame]
    sequence = chair.recorded.sequence
    alignment = align_view(sequence.depth_m(frame), sequence.camera, truth, renderer, pose_sigma_m=0.0005)
    np.testing.assert_array_equal(alignment.T_world_camera, truth)
    assert alignment.moved_m == alignment.turned_rad == 0
    unchecked = align_view(sequence.depth_m(frame), sequence.camera, truth, renderer)
    assert error_m(chair, frame, unchecked.T_world_camera) < 0.002
    assert unchecked.moved_m < 0.002 and np.degrees(unchecked.turned_rad) < 0.3


@pytest.mark.parametrize("frame", WELL_COVERED)
@pytest.mark.parametrize(
    ("shift_m", "turn_deg"),
    [
        ((0.015, 0, 0), 0.0),
        ((0, 0.015, 0), 0.0),
        ((0, 0, 0.015), 0.0),
        ((0, 0, 0), 0.8),
        ((0.012, 0, 0.009), 0.8),
    ],
)
def test_a_wrong_pose_is_corrected(chair, renderer, frame, shift_m, turn_deg):
    """A pose off by 15 mm, turned by 0.8 degrees about the object, or both."""
    truth = chair.recorded.simulation.T_world_camera[frame]
    sequence = chair.recorded.sequence
    distance_m = float(np.median(sequence.depth_m(frame)[chair.recorded.masks[frame]]))
    T_camera_object = rigid(np.eye(3), [0, 0, distance_m])
    if any(shift_m):
        moved = displaced(np.eye(4), shift_m, turn_deg)
        wrong = truth @ T_camera_object @ moved @ invert_rigid(T_camera_object)
    else:
        wrong = displaced(truth, shift_m, turn_deg)  # about the camera: 0.8 degrees move the object by 17 mm
    before = error_m(chair, frame, wrong)
    alignment = align_view(sequence.depth_m(frame), sequence.camera, wrong, renderer)
    after = error_m(chair, frame, alignment.T_world_camera)
    assert before > 0.01
    assert after < 0.003
    assert alignment.moved_m == pytest.approx(before, abs=0.004)
    rotation = alignment.T_world_camera[:3, :3]
    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-9)


def test_too_little_to_align_by(chair, renderer):
    sequence = chair.recorded.sequence
    truth = chair.recorded.simulation.T_world_camera[0]
    for depth_m, pose in (
        (np.zeros_like(sequence.depth_m(0)), truth),
        (sequence.depth_m(0), truth @ rigid(np.diag([-1.0, 1.0, -1.0]), np.zeros(3))),  # looks away
    ):
        alignment = align_view(depth_m, sequence.camera, pose, renderer)
        np.testing.assert_array_equal(alignment.T_world_camera, pose)
        assert alignment.moved_m == 0 and alignment.turned_rad == 0


def test_never_farther_than_allowed(chair, renderer):
    """An error beyond the bounds is not half corrected: either the pose is as given, or within them."""
    sequence = chair.recorded.sequence
    for frame in FRAMES:
        wrong = displaced(chair.recorded.simulation.T_world_camera[frame], (0.06, 0.06, 0.0), 4.0)
        alignment = align_view(sequence.depth_m(frame), sequence.camera, wrong, renderer)
        assert alignment.moved_m <= 0.05 and alignment.turned_rad <= 0.05
        if alignment.moved_m == 0:
            np.testing.assert_array_equal(alignment.T_world_camera, wrong)

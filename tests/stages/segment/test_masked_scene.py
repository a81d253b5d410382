"""A given plane under masked frames: the cameras and the object must be above it."""

import numpy as np
import pytest
from analytic_scenes import ring, trajectory_of
from raising import raises

from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.geometry.mesh import isosurface
from kinectbench.stages.segment.find.hints import FloorHint
from kinectbench.stages.segment.find.moving import segment_masked_scene

CAMERAS = trajectory_of(ring(12, 1.5, (0, 0, 0.2)))


def block() -> TriangleMesh:
    """A closed block of 0.2 x 0.2 x 0.3 m on z = 0."""
    field = np.pad(-np.ones((20, 20, 30), np.float32), 1, constant_values=1)
    mesh = isosurface(field)
    return TriangleMesh((mesh.vertices - [11.0, 11.0, 0.5]) * 0.01, mesh.faces)


def test_a_given_plane_below_the_object_is_its_floor() -> None:
    up = np.array([0.0, np.sin(0.1), np.cos(0.1)])
    leaning = FloorHint(plane_world=np.array([0, 0, 1.0, 0]), up_world=up)
    assert segment_masked_scene(block(), CAMERAS, hint=leaning).floor.tilt_rad == pytest.approx(0.1)
    found = segment_masked_scene(block(), CAMERAS, hint=FloorHint(plane_world=np.array([0, 0, 1.0, 0])))
    assert found.floor.given and found.box.size_m[2] == pytest.approx(0.3, abs=0.01)


def test_a_thing_turned_in_a_hand_may_be_seen_mostly_from_below_its_plane() -> None:
    below = trajectory_of(np.concatenate([ring(12, 1.5, (0, 0, 0.2)), ring(28, 1.5, (0, 0, -1.0))]))
    found = segment_masked_scene(block(), below, hint=FloorHint(plane_world=np.array([0, 0, 1.0, 0])))
    assert found.floor.given and found.box.size_m[2] == pytest.approx(0.3, abs=0.01)


@pytest.mark.parametrize("plane", [(0, 0, -1.0, 0), (0, 0, 1.0, -0.4)])
def test_a_given_plane_above_the_cameras_or_the_object_is_refused(plane: tuple[float, ...]) -> None:
    """Upside down, or between the object and the cameras."""
    with raises(SegmentationError, "segmentation.bad-plane"):
        segment_masked_scene(block(), CAMERAS, hint=FloorHint(plane_world=np.array(plane)))

"""A box is taken in the floor frame that it was chosen in, and in no other."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from raising import raises
from typed import present

from kinectbench.core.artefacts.object import AnchoredBoxPart
from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import Camera, OrientedBox, invert_rigid, rigid, transform_points
from kinectbench.core.geometry.rigid import rigid_from_twist
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.types import Float64
from kinectbench.settings.models import BoxSettings
from kinectbench.stages.segment.find.floor import Floor
from kinectbench.stages.segment.find.given import anchor_of, check_anchor, reanchored
from kinectbench.stages.segment.find.planes import floor_frame

BOX = OrientedBox((0.4, 1.5, 0.45), (0.6, 0.5, 0.9), 0.3)


def scene(
    T_new_world: Float64 | None = None, plane_world: tuple[float, ...] = (0, 0, 1, 0.0)
) -> tuple[Floor, Trajectory]:
    """Five cameras above a plane, in another world if asked for."""
    T = np.eye(4) if T_new_world is None else T_new_world
    looking_down = rigid_from_twist(np.array([2.0, 0.1, 0.2, 0, 0, 0]))[:3, :3]
    poses = np.array([T @ rigid(looking_down, (0.3 * step, -0.4, 1.2)) for step in range(5)])
    plane = np.linalg.inv(T).T @ np.array(plane_world, float)
    return Floor(plane, floor_frame(plane), 0.0, 1.0), Trajectory(np.arange(5), poses, "trust")


def recording(frames: range = range(5)) -> Sequence:
    """Some of five frames, each of its own depth."""
    images = [np.full((3, 4), 1000 + frame, np.uint16) for frame in frames]
    store = SimpleNamespace(depth_native=lambda index: images[index])
    camera = Camera(4, 3, 5.0, 5.0, 1.5, 1.0)
    return Sequence(camera, 1000.0, np.arange(len(images)), False, None, store)


def chosen() -> OrientedBox:
    """The box as `--pick` writes it and benchmark.yaml gives it back."""
    written = AnchoredBoxPart.of_anchored(BOX, anchor_of(*scene(), recording())).json_value()
    return BoxSettings.model_validate(written).box()


def test_a_box_is_taken_where_it_was_chosen() -> None:
    check_anchor(chosen(), *scene())
    check_anchor(chosen(), *scene(plane_world=(0.002, 0, 1, 0.004)))  # the floor, found once more
    check_anchor(BOX, *scene(np.diag([-1.0, -1, 1, 1])))  # by hand: nobody knows


@pytest.mark.parametrize(
    "T_new_world",
    [
        rigid(np.diag([-1.0, -1, 1]), (0, 0, 0)),
        rigid(np.eye(3), (0.1, 0, 0)),
        rigid_from_twist(np.array([2.0, -0.4, 0.8, 0.3, 2.0, -1.0])),  # that of a camera
    ],
)
def test_in_another_world_it_is_refused_with_the_same_place_there(T_new_world: Float64) -> None:
    floor, trajectory = scene(T_new_world)
    with raises(SegmentationError, "segmentation.box-moved", match="chosen in another floor frame") as told:
        check_anchor(chosen(), floor, trajectory)
    line = str(told.value).split("`")[1]
    carried = BoxSettings.model_validate(yaml.safe_load(line)["box"]).box()
    check_anchor(carried, floor, trajectory)
    there = transform_points(invert_rigid(floor.T_floor_world), carried.corners_floor())
    here = transform_points(T_new_world @ invert_rigid(scene()[0].T_floor_world), BOX.corners_floor())
    np.testing.assert_allclose(there, here, rtol=0, atol=0.003)  # written in millimetres


def test_on_another_plane_it_is_refused() -> None:
    """A table in the place of the floor: the same place lies lower above it."""
    floor, trajectory = scene(plane_world=(0, 0, 1, -0.7))
    with raises(SegmentationError, "segmentation.box-moved", match=r"0\.70") as told:
        check_anchor(chosen(), floor, trajectory)
    box = yaml.safe_load(str(told.value).split("`")[1])["box"]
    assert box["center_m"] == [0.4, 1.5, -0.25]
    # A wall: no upright box is the same place.
    with raises(SegmentationError, "segmentation.box-moved", match="off; choose"):
        check_anchor(chosen(), *scene(plane_world=(1, 0, 0, 2)))


def test_a_frame_without_a_pose_says_nothing() -> None:
    floor, trajectory = scene()
    poses = trajectory.T_world_camera.copy()
    poses[2] = np.nan
    for gone in (replace(trajectory, T_world_camera=poses), replace(trajectory, T_world_camera=poses[:2])):
        with raises(SegmentationError, "segmentation.box-moved", match="frame 2, which"):
            check_anchor(chosen(), floor, gone)


@pytest.mark.parametrize(("kept", "now"), [(range(5), 2), (range(1, 5), 1), (range(2, 3), 0)])
def test_a_frame_is_found_where_the_recording_was_cut(kept: range, now: int) -> None:
    box = chosen()
    assert reanchored(box, recording(kept)) == replace(box, anchor=present(box.anchor)._replace(frame=now))


def test_a_frame_that_was_cut_away_is_refused() -> None:
    with raises(SegmentationError, "segmentation.box-moved", match="number 2, whose"):
        reanchored(chosen(), recording(range(3, 5)))
    by_hand = replace(chosen(), anchor=None)
    earlier = replace(chosen(), anchor=present(chosen().anchor)._replace(depth_sha256=None))
    for box in (by_hand, earlier):
        assert reanchored(box, recording(range(3, 5))) == box


def test_half_an_anchor_or_no_pose_is_refused() -> None:
    box = {"center_m": [0, 0, 0.5], "size_m": [1, 1, 1], "anchor_frame": 3}
    for wrong in ({}, {"anchor_pose": [0.0] * 7}, {"anchor_pose": [1e300, 0, 0, 0, 0, 0, 1]}):
        with pytest.raises(ValueError, match="anchor"):
            BoxSettings.model_validate({**box, **wrong})

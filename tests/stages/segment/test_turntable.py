"""What turns before a still camera is told from its plate and from what stands around."""

from pathlib import Path
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from analytic_scenes import CAMERA, depth_of, plane, ring
from raising import raises
from read_pictures import read_picture

from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import invert_rigid, transform_points
from kinectbench.core.sequence import Sequence
from kinectbench.lab.simulate.simulate import simulate
from kinectbench.lab.simulate.spec import SimulationSpec
from kinectbench.lab.simulate.truth import Truth, read_truth, truth_folder
from kinectbench.settings.models import CameraSettings
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence
from kinectbench.stages.segment.find.moving import _on_floor, find_turntable, turntable_masks

LEAST_IOU = 0.93


def recorded(root: Path, **path: object) -> tuple[Sequence, Truth]:
    spec = {
        "object": "toy_car:seed=1",
        "seed": 1,
        "format": "folder",
        "path": {"frames": 16, "rate_hz": 4.0, "moves": "turntable", **path},
        "sensor": {"width": 240, "height": 180},
        "given": {"trajectory": "none"},
    }
    simulate(SimulationSpec.model_validate(spec), root / "toy")
    write_sequence(open_recording(root / "toy", CameraSettings()), root / "sequence")
    return read_sequence(root / "sequence"), read_truth(truth_folder(root / "toy"))


@pytest.mark.parametrize("plate_m", [0.0, 0.012, 0.05])
def test_the_object_without_its_plate(plate_m: float, tmp_path: Path) -> None:
    sequence, truth = recorded(tmp_path, plate_m=plate_m)
    masks = turntable_masks(sequence)
    for index in (0, 7, 15):
        drawn = read_picture(tmp_path / "toy.truth" / "masks" / f"{index:06d}.png", cv2.IMREAD_GRAYSCALE)
        true, found = (np.asarray(drawn) > 0) & (sequence.depth_m(index) > 0), masks(index)
        assert found is not None
        assert (true & found).sum() / (true | found).sum() > LEAST_IOU
    floor = find_turntable(sequence).floor
    assert floor is not None
    # What the object stands on, be it the floor or the plate's top.
    T_camera_object = invert_rigid(truth.T_world_camera[0]) @ truth.T_world_object
    stands = transform_points(floor.T_floor_world @ T_camera_object, np.zeros(3))
    assert abs(stands[2]) < 0.005


def test_what_is_held_hangs_in_the_air(tmp_path: Path) -> None:
    sequence, _ = recorded(tmp_path, moves="hand", swing_rad=0.3)
    with raises(SegmentationError, "segmentation.no-turntable", match="air; give"):
        turntable_masks(sequence)


@pytest.mark.parametrize(
    ("path", "complaint"),
    [({"moves": "camera"}, "the camera moves"), ({"arc_rad": 0.0}, "nothing moves before it")],
)
def test_what_is_no_turntable_is_refused(path: dict[str, object], complaint: str, tmp_path: Path) -> None:
    sequence, _ = recorded(tmp_path, **path)
    with raises(SegmentationError, "segmentation.no-turntable", match=complaint):
        turntable_masks(sequence)


@pytest.mark.parametrize(("height_m", "stands"), [(0.005, False), (0.05, True)])
def test_what_moves_within_the_noise_of_its_plane_stands_nowhere(height_m: float, stands: bool) -> None:
    T = ring(1, 1.0)[0]
    watched = Mock(still_m=depth_of([plane((0, 0, 1), 0.0)], CAMERA, T))
    flat = np.random.default_rng(0).uniform([-0.1, -0.1, 0.9 * height_m], [0.1, 0.1, height_m], (500, 3))
    moving = transform_points(invert_rigid(T), flat)
    if stands:
        assert 0.1 < _on_floor(watched, CAMERA, moving).radius_m < 0.18
        return
    with raises(SegmentationError, "segmentation.no-turntable", match="stands on"):
        _on_floor(watched, CAMERA, moving)

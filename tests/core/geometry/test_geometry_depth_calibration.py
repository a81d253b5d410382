"""The tracker's depth calibration is stored, read back, and applied by what reads a tracked recording."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
from analytic_scenes import MemoryFrames, health_of
from ingest_writers import write_tum
from raising import raises

from kinectbench.core.artefacts.trajectory import StoredDepthCalibration
from kinectbench.core.errors import StorageError
from kinectbench.core.geometry import Camera
from kinectbench.core.geometry.depth import (
    NO_CALIBRATION,
    TERMS,
    DepthCalibration,
    corrected_depth_m,
    depth_in_mm,
    too_far_for_mm,
)
from kinectbench.core.sequence import Sequence
from kinectbench.core.trajectory.trajectory import Trajectory, write_trajectory
from kinectbench.engine.steps import read_tracked
from kinectbench.stages.ingest.readers import open_recording
from kinectbench.stages.ingest.sequence_folder import read_sequence, write_sequence

CAMERA = Camera(6, 4, 5.0, 5.0, 2.5, 1.5)


def tilted() -> DepthCalibration:
    """Only the term P_1(x): its value is (2 u + 1) / width - 1."""
    coefficients = np.zeros(len(TERMS))
    coefficients[TERMS.index((1, 0))] = 0.01
    return DepthCalibration(coefficients)


def two_metres() -> Sequence:
    depth = np.full((4, 6), 2000, np.uint16)
    depth[0, 0] = 0
    return Sequence(CAMERA, 1000.0, np.arange(3) * 10**9, False, None, MemoryFrames(lambda index: depth))


def test_the_correction_is_added_to_inverse_depth() -> None:
    found = two_metres().calibrated(tilted()).depth_m(0)
    x = (2 * np.arange(6) + 1) / 6 - 1
    np.testing.assert_allclose(found[1], 1 / (1 / 2 + 0.01 * x), rtol=1e-6)
    assert found[0, 0] == 0  # no measurement stays none


def test_no_calibration_leaves_depth_as_recorded() -> None:
    found = two_metres().calibrated(NO_CALIBRATION)
    assert found.depth_correction_per_m is None
    np.testing.assert_array_equal(found.depth_m(0), two_metres().depth_m(0))


@pytest.fixture
def build(tmp_path: Path) -> Path:
    write_sequence(open_recording(write_tum(tmp_path / "recording")), tmp_path / "sequence")
    stamps_ns = read_sequence(tmp_path / "sequence").stamps_ns
    poses = np.tile(np.eye(4), (len(stamps_ns), 1, 1))
    trajectory = Trajectory(
        stamps_ns, poses, "tracked", health=health_of(len(stamps_ns)), depth_calibration=tilted()
    )
    (tmp_path / "trajectory").mkdir()
    write_trajectory(trajectory, tmp_path / "trajectory")
    return tmp_path


def test_what_is_tracked_is_read_with_corrected_depth(build: Path) -> None:
    sequence, trajectory = read_tracked(build)
    np.testing.assert_array_equal(
        trajectory.depth_calibration.coefficients_per_m, tilted().coefficients_per_m
    )
    recorded = read_sequence(build / "sequence")
    np.testing.assert_array_equal(sequence.depth_m(1), recorded.calibrated(tilted()).depth_m(1))
    assert (sequence.depth_m(1) != recorded.depth_m(1)).any()
    # What was recorded stays what it was.
    np.testing.assert_array_equal(sequence.frames.depth_native(1), recorded.frames.depth_native(1))


def test_an_older_trajectory_has_no_calibration(build: Path) -> None:
    (build / "trajectory" / StoredDepthCalibration.FILE).unlink()
    sequence, trajectory = read_tracked(build)
    assert trajectory.depth_calibration is NO_CALIBRATION and sequence.depth_correction_per_m is None


@pytest.mark.parametrize(
    "change",
    [{"terms": [[0, 1]]}, {"coefficients_per_m": [1.0]}, {"coefficients_per_m": [math.nan] * len(TERMS)}],
)
def test_another_calibration_is_refused(build: Path, change: dict[str, list[list[int] | float]]) -> None:
    path = build / "trajectory" / StoredDepthCalibration.FILE
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with raises(
        StorageError, "storage.damaged", match=r"depth_calibration.json: .*; `kinectbench build --force`"
    ):
        read_tracked(build)


def test_a_sequence_is_calibrated_anew() -> None:
    once = two_metres().calibrated(tilted())
    np.testing.assert_array_equal(once.calibrated(tilted()).depth_m(0), once.depth_m(0))
    assert once.calibrated(NO_CALIBRATION).depth_correction_per_m is None


def test_depth_that_does_not_fit_into_millimetres_of_16_bits_is_no_measurement() -> None:
    """70 m would wrap to 4464 mm, minus one to 64536."""
    rows = [[0, 0.0004, 1.2347, 65.535], [65.5356, 70, 1e9, np.inf], [-1, np.nan, -70, 4.4]]
    depth_m = np.array(rows, np.float32)
    assert depth_in_mm(depth_m).tolist() == [[0, 0, 1235, 65535], [0, 0, 0, 0], [0, 0, 0, 4400]]
    assert depth_in_mm(depth_m).dtype == np.uint16
    assert too_far_for_mm(depth_m) == pytest.approx(4 / 8)
    assert too_far_for_mm(np.zeros((2, 2), np.float32)) == 0


def test_a_correction_places_nothing_behind_the_camera() -> None:
    """1 / 4 - 0.3 < 0: such depth is no measurement, and neither is what comes to lie at infinity."""
    corrected = corrected_depth_m(np.array([0, 1, 2, 4], "f4"), np.array([-0.3, -0.5, -0.5, -0.3], "f4"))
    assert corrected.tolist() == [0, 2, 0, 0]

"""A known depth distortion is found from constraints with known motion, and undone."""

import numpy as np
import pytest
from tracking_scenes import couch

from kinectbench.core.geometry import invert_rigid
from kinectbench.core.geometry.depth import NO_CALIBRATION, TERMS, DepthCalibration
from kinectbench.stages.track.depth_calibration import CalibrationView, calibrate, calibrate_posed
from kinectbench.stages.track.frame_maps import STORED_PER_M, MapCache

pytestmark = pytest.mark.xdist_group("tracking")

PAIRS = [(i, i + step) for step in (1, 3, 5) for i in range(0, 18, 3)]


def distorted(coefficients: np.ndarray) -> MapCache:
    """The couch's frames as a sensor records them whose inverse depth is too small by the correction."""
    maps = MapCache(couch().sequence)
    for index in range(24):
        exact = maps[index][0].depth_m.astype(np.float64)
        error_per_m = DepthCalibration(coefficients).correction_per_m(exact.shape[1], exact.shape[0])
        recorded = np.rint(STORED_PER_M * exact / (1 - exact * error_per_m)).astype(np.uint16)
        maps.improve(index, recorded)
    return maps


def views(frames: MapCache, pairs: list[tuple[int, int]]) -> list[CalibrationView]:
    T = couch().simulation.T_world_camera
    return [CalibrationView(frames[b][0], frames[a][0], invert_rigid(T[a]) @ T[b]) for a, b in pairs]


def test_a_known_distortion_is_found() -> None:
    true = DepthCalibration(bent()).correction_per_m(64, 48)
    found = calibrate(views(distorted(bent()), PAIRS)).correction_per_m(64, 48)
    assert np.corrcoef(found.ravel(), true.ravel())[0, 1] > 0.8
    # Its prior keeps it small where few constraints speak: it takes off a part. No constant is told.
    left = (found - true) - (found - true).mean()
    assert left.std() < 0.8 * true.std()


def test_an_exact_sensor_is_left_as_it_is() -> None:
    found = calibrate(views(distorted(np.zeros(len(TERMS))), PAIRS)).correction_per_m(64, 48)
    assert np.abs(found).max() < 0.002


def bent() -> np.ndarray:
    """Coefficients of a distortion of some millimetres at 2 m."""
    coefficients = np.zeros(len(TERMS))
    coefficients[[TERMS.index((2, 0)), TERMS.index((1, 1)), TERMS.index((0, 2))]] = 0.004, -0.003, 0.003
    return coefficients


def test_frames_of_known_poses_tell_the_distortion() -> None:
    T, frames = couch().simulation.T_world_camera, np.arange(24)
    true = DepthCalibration(bent()).correction_per_m(64, 48)
    found = calibrate_posed(distorted(bent()), T, frames).correction_per_m(64, 48)
    assert np.corrcoef(found.ravel(), true.ravel())[0, 1] > 0.8
    left = (found - true) - (found - true).mean()
    assert left.std() < 0.8 * true.std()


def test_of_an_exact_sensor_known_poses_tell_none() -> None:
    T, frames = couch().simulation.T_world_camera, np.arange(24)
    assert calibrate_posed(distorted(np.zeros(len(TERMS))), T, frames) is NO_CALIBRATION


def test_depth_is_not_corrected_where_the_given_poses_do_not_fit_it_better_then() -> None:
    """Poses that are off by centimetres: what frames agree on by motions of their own does not help them."""
    T, frames = couch().simulation.T_world_camera.copy(), np.arange(24)
    T[:, :3, 3] += np.random.default_rng(0).normal(0, 0.02, (len(T), 3))
    assert calibrate_posed(distorted(bent()), T, frames) is NO_CALIBRATION


def test_frames_that_share_no_view_tell_nothing() -> None:
    T = couch().simulation.T_world_camera
    assert calibrate_posed(distorted(bent()), T, np.array([3])) is NO_CALIBRATION


def test_few_ties_say_nothing() -> None:
    frames = distorted(np.full(len(TERMS), 0.001))
    assert calibrate(views(frames, PAIRS[:3])) is NO_CALIBRATION
    assert calibrate([]) is NO_CALIBRATION

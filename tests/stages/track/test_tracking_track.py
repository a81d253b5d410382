"""Given trajectories: brought to the frames, checked against the depth, stored and read back."""

from dataclasses import replace
from pathlib import Path
from unittest.mock import Mock

import cv2
import numpy as np
import pytest
from analytic_scenes import Furniture, displaced, furniture, health_of, small_spec
from raising import raises
from same_fields import assert_same_fields
from typed import present

from kinectbench.core.artefacts.trajectory import FrameHealth
from kinectbench.core.errors import KinectBenchError, StorageError, TrackingError
from kinectbench.core.geometry import rigid
from kinectbench.core.geometry.depth import TERMS, DepthCalibration
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.association import poses_at
from kinectbench.core.trajectory.trajectory import read_trajectory, write_trajectory
from kinectbench.settings.models import TrackingSettings
from kinectbench.stages.track import Trajectory, track
from kinectbench.stages.track.frame_check import _Checker
from kinectbench.stages.track.frame_maps import MapCache
from kinectbench.stages.track.outliers import OUTLIER_REASON, find_outliers, outlier_warnings

pytestmark = pytest.mark.xdist_group("tracking")
SETTINGS = TrackingSettings()
WRONG = 11


@pytest.fixture(scope="module")
def chair() -> Furniture:
    return furniture(small_spec("couch:seed=4", 24, seed=1, arc_rad=3.0))


def with_poses(chair: Furniture, poses: np.ndarray) -> Furniture:
    given = GivenTrajectory(chair.sequence.stamps_ns, poses)
    return replace(chair, sequence=replace(chair.sequence, given_trajectory=given))


def turned(angle_rad: float) -> np.ndarray:
    turned: np.ndarray = cv2.Rodrigues(np.array([0.0, 0.0, angle_rad]))[0]
    return turned


# --- poses_at


GIVEN = GivenTrajectory(
    np.array([10, 20, 40], np.int64) * 10**7,
    np.stack(
        [
            rigid(np.eye(3), [0, 0, 0]),
            rigid(turned(np.pi / 2), [1, 2, 4]),
            rigid(turned(np.pi / 2), [1, 2, 4]),
        ]
    ),
)


def test_a_stamp_met_exactly() -> None:
    poses = poses_at(GIVEN, np.array([10**8, 2 * 10**8, 4 * 10**8]), 0.1)
    np.testing.assert_array_equal(poses, GIVEN.T_world_camera)


def test_slerp_between_two_poses() -> None:
    middle, third = poses_at(GIVEN, np.array([150_000_000, 175_000_000]), 0.1)
    np.testing.assert_allclose(middle, rigid(turned(np.pi / 4), [0.5, 1, 2]), atol=1e-12)
    np.testing.assert_allclose(third, rigid(turned(np.pi * 3 / 8), [0.75, 1.5, 3]), atol=1e-12)


def test_gaps_are_not_bridged_and_nothing_is_extrapolated() -> None:
    stamps = np.array([10**8 - 1, 10**8, 3 * 10**8, 4 * 10**8, 4 * 10**8 + 1])
    lost = np.isnan(poses_at(GIVEN, stamps, 0.1)).all(axis=(1, 2))
    np.testing.assert_array_equal(lost, [True, False, True, False, True])
    assert np.isfinite(poses_at(GIVEN, stamps[2:3], 0.2)).all()  # a gap as long as allowed is bridged


# --- track


def test_trust_keeps_right_poses_as_they_are(chair: Furniture) -> None:
    for mode in (None, "trust"):
        trajectory = track(chair.sequence, mode, SETTINGS)
        np.testing.assert_array_equal(trajectory.T_world_camera, chair.simulation.T_world_camera)
        assert trajectory.source == "trust"
        health = present(trajectory.health)
        assert health.warnings == () and health.rejected == ()
        assert health.verdict.startswith("good for ground truth")


def test_a_wrong_frame_is_left_out_and_named(chair: Furniture) -> None:
    poses = chair.simulation.T_world_camera.copy()
    poses[WRONG] = displaced(poses[WRONG], (0.05, 0, 0), 3.0)
    trajectory = track(with_poses(chair, poses).sequence, "trust", SETTINGS)
    np.testing.assert_array_equal(trajectory.good_frames, np.delete(np.arange(24), WRONG))
    (rejected,) = present(trajectory.health).rejected
    assert rejected.frame == WRONG
    assert rejected.stamp_ns == chair.sequence.stamps_ns[WRONG]
    assert "disagrees with its pose" in rejected.reason
    assert present(trajectory.health).tracked == 23


def test_a_trajectory_that_is_mostly_wrong_is_refused(chair: Furniture) -> None:
    inverse = np.linalg.inv(chair.simulation.T_world_camera)
    rng = np.random.default_rng(0)
    shaken = np.stack(
        [displaced(T, tuple(rng.normal(0, 0.08, 3)), 0) for T in chair.simulation.T_world_camera]
    )
    with raises(TrackingError, "tracking.given-disagrees", match="camera to world.*ignore"):
        track(with_poses(chair, shaken).sequence, "trust", SETTINGS)
    # World to camera instead of camera to world.
    with raises(TrackingError, "tracking.given-disagrees", match="of 24 frames"):
        track(with_poses(chair, inverse).sequence, "trust", SETTINGS)


def test_trust_without_a_trajectory(chair: Furniture) -> None:
    bare = replace(chair.sequence, given_trajectory=None)
    with raises(TrackingError, "tracking.no-given"):
        track(bare, "trust", SETTINGS)


def test_no_common_time(chair: Furniture) -> None:
    given = present(chair.sequence.given_trajectory)
    late = replace(given, stamps_ns=given.stamps_ns + 10**12)
    with raises(TrackingError, "tracking.no-match", match=r"time.*1400000000\.000.*1400001000\.000.*ignore"):
        track(replace(chair.sequence, given_trajectory=late), "trust", SETTINGS)


def test_poses_that_lie_too_far_apart_in_time_for_every_frame(chair: Furniture) -> None:
    given, half_step_ns = chair.sequence.given_trajectory, 10**7
    stamps_ns = present(given).stamps_ns[[0, -1]] + np.array([half_step_ns, -half_step_ns])
    sparse = GivenTrajectory(stamps_ns, present(given).T_world_camera[[0, -1]])
    with raises(TrackingError, "tracking.no-match", match="frame: frames"):
        track(replace(chair.sequence, given_trajectory=sparse), "trust", SETTINGS)


def test_frames_outside_the_trajectory_are_lost(chair: Furniture) -> None:
    given = present(chair.sequence.given_trajectory)
    part = GivenTrajectory(given.stamps_ns[3:20], given.T_world_camera[3:20])
    trajectory = track(replace(chair.sequence, given_trajectory=part), "trust", SETTINGS)
    assert present(trajectory.health).lost == (0, 1, 2, 20, 21, 22, 23)
    np.testing.assert_array_equal(trajectory.good_frames, np.arange(3, 20))


# --- the folder


def test_folder_round_trip(chair: Furniture, tmp_path: Path) -> None:
    poses = chair.simulation.T_world_camera.copy()
    poses[[2, 9]] = np.nan
    rows = [FrameHealth(frame=f, shift_m=None if f == 9 else 0.00123) for f in range(24)]
    health = health_of(24, source="trust", warnings=("näh",), per_frame=rows)
    coefficients = np.linspace(-0.001, 0.002, len(TERMS))
    kept = Trajectory(
        chair.sequence.stamps_ns,
        poses,
        "trust",
        health.pose_sigma_m(),
        health,
        DepthCalibration(coefficients),
    )
    write_trajectory(kept, tmp_path)
    again = read_trajectory(tmp_path, kept.stamps_ns)
    np.testing.assert_array_equal(again.good_frames, kept.good_frames)
    np.testing.assert_array_equal(again.T_world_camera[:, :3, 3], poses[:, :3, 3])
    assert_same_fields(kept, again, {"T_world_camera": 1e-14})
    before = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    write_trajectory(kept, tmp_path)
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == before


@pytest.mark.parametrize("damage", ["missing", "other frames", "json", "no source", "not a table", "words"])
def test_damaged_folder(chair: Furniture, tmp_path: Path, damage: str) -> None:
    trajectory = replace(chair.trajectory, health=health_of(24))
    write_trajectory(trajectory, tmp_path)
    stamps_ns = trajectory.stamps_ns
    if damage == "missing":
        (tmp_path / "trajectory.txt").unlink()
    elif damage == "other frames":
        stamps_ns = stamps_ns[:10]
    elif damage == "words":
        (tmp_path / "trajectory.txt").write_text("1 2 3\n")
    else:
        text = {"json": "{", "no source": "{}", "not a table": "[]"}[damage]
        (tmp_path / "health.json").write_text(text)
    error = KinectBenchError if damage in ("words", "missing") else StorageError
    with pytest.raises(error, match=str(tmp_path)):
        read_trajectory(tmp_path, stamps_ns)


def test_frames_that_agree_far_worse_than_nearly_all_are_left_out_and_told() -> None:
    """14 frames of a fast turn are 3.6 to 4.5 times as far from the others as the usual one."""
    rng = np.random.default_rng(0)
    residual = rng.normal(1.0, 0.05, 150)
    residual[60:74] = np.linspace(3.6, 4.5, 14)
    judged = np.ones(150, bool)
    judged[70] = False
    odd = find_outliers(residual, judged)
    np.testing.assert_array_equal(np.flatnonzero(odd), [*range(60, 70), *range(71, 74)])
    # Noise that differs stands out nowhere, nor does a little where all else agrees to a hair.
    assert not find_outliers(rng.normal(1.0, 0.2, 150), np.ones(150, bool)).any()
    assert not find_outliers(np.append(np.full(20, 1.0), 1.5), np.ones(21, bool)).any()
    # Three times the usual one, and a half of what noise makes.
    assert not find_outliers(np.append(np.full(20, 0.15), 0.5), np.ones(21, bool)).any()
    assert not find_outliers(np.full(3, np.nan), np.ones(3, bool)).any()
    reasons = dict.fromkeys(np.flatnonzero(odd).tolist(), OUTLIER_REASON) | {80: "another reason"}
    (line,) = outlier_warnings(reasons, "tracked")
    assert line.startswith("left out: 13 frames (60 to 73): its depth lies farther")
    assert outlier_warnings({80: "another reason"}, "trust") == []


def test_an_outlier_that_nothing_else_shows_stays_one(
    chair: Furniture, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is measured again only by reference frames that were compared."""
    checker = _Checker(MapCache(chair.sequence), np.tile(np.eye(4), (24, 1, 1)), SETTINGS, np.arange(24))
    checker.found = dict.fromkeys(set(range(24)) - {9, 10, 13}, Mock())
    checker.residual_m, checker.noise_m = np.ones(24), np.ones(24)
    checker.residual_m[WRONG] = 5.0
    asked = list[int]()

    def nothing_common(frame: int, others: list[int]) -> float:
        asked.extend(others)
        return np.nan

    monkeypatch.setattr(checker, "_residual_m", nothing_common)
    assert np.flatnonzero(checker.outlier(np.zeros(24, bool))).tolist() == [WRONG]
    assert checker.residual_m[WRONG] == 5.0
    assert asked == [6, 7, 8, 12, 14, 15]

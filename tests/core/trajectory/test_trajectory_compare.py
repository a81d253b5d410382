"""Trajectory errors: by hand, by formula, and against the evo package."""

import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from raising import raises
from typed import present

from kinectbench.core.errors import TrackingError
from kinectbench.core.geometry import invert_rigid, rigid, rotation_angle_rad, rotation_from_quaternion_xyzw
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.compare import (
    TrajectoryError,
    align_worlds,
    compare_poses,
    match_stamps,
)
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.stages.track.comparison import compare_with

DATA = Path(os.environ.get("KINECTBENCH_DATA", "missing")) / "evo_trajectories"
OTHER_WORLD = rigid(rotation_from_quaternion_xyzw([0.3, -0.2, 0.5, 0.7]), [1.0, -2.0, 0.5])


def orbit(n: int, seed: int = 0) -> np.ndarray:
    """Cameras (n, 4, 4) on a wavy circle of 1.5 m, each turned anyhow."""
    rng = np.random.default_rng(seed)
    angle = np.linspace(0, 2 * np.pi, n)
    positions = np.stack([1.5 * np.cos(angle), 1.5 * np.sin(angle), 0.9 + 0.2 * np.sin(3 * angle)], axis=1)
    rotations = rotation_from_quaternion_xyzw([0, 0, 0, 1] + 0.3 * rng.normal(size=(n, 4)))
    return np.stack([rigid(R, p) for R, p in zip(rotations, positions, strict=True)])


def disturbed(poses: np.ndarray, sigma_m: float, sigma_rad: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    result = poses.copy()
    result[:, :3, 3] += rng.normal(scale=sigma_m, size=(len(poses), 3))
    turns = np.concatenate(
        [rng.normal(scale=sigma_rad / 2, size=(len(poses), 3)), np.ones((len(poses), 1))], 1
    )
    result[:, :3, :3] = rotation_from_quaternion_xyzw(turns) @ result[:, :3, :3]
    return result


def test_another_world_is_no_error() -> None:
    reference = orbit(50)
    error = compare_poses(OTHER_WORLD @ reference, reference)
    np.testing.assert_allclose(error.T_reference_estimate, invert_rigid(OTHER_WORLD), atol=1e-12)
    for found in (error.ate_m, error.rpe_frame_m, error.rpe_frame_rad, error.rpe_metre_m):
        assert found is not None
        assert found.max < 1e-12


def test_noise_gives_the_expected_ate() -> None:
    # Of 3 n coordinates, six are used up by the alignment.
    n, sigma_m = 300, 0.005
    reference = orbit(n)
    found = [
        compare_poses(disturbed(reference, sigma_m, 0, seed), reference).ate_m.rmse for seed in range(30)
    ]
    expected = sigma_m * np.sqrt(3 - 6 / n)
    # One ATE varies by sigma / sqrt(2 n) = 2 %, the mean of 30 by 0.4 %.
    assert np.sqrt(np.mean(np.square(found))) == pytest.approx(expected, rel=0.015)


def test_by_hand() -> None:
    reference = np.stack([rigid(np.eye(3), p) for p in ([0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0])])
    estimate = reference.copy()
    estimate[2, :3, 3] += [0, 0, 0.4]
    error = compare_poses(estimate, reference)
    # The best plane through heights 0, 0, 0.4, 0 leaves 0.1 at every corner, to first order of the tilt.
    np.testing.assert_allclose(error.position_errors_m, 0.1, atol=0.02)
    # The relative errors do not depend on the alignment: 0, then up by 0.4, then down by 0.4.
    assert error.rpe_frame_m.max == pytest.approx(0.4)
    assert error.rpe_frame_m.mean == pytest.approx(0.8 / 3)
    assert error.rpe_frame_rad.max == 0
    assert error.rpe_metre_m == error.rpe_frame_m  # every step is a metre


def test_a_turn_by_hand() -> None:
    reference = np.stack([rigid(np.eye(3), p) for p in ([0, 0, 0], [0.3, 0, 0], [0.3, 0.3, 0])])
    estimate = reference.copy()
    estimate[1, :3, :3] = rotation_from_quaternion_xyzw([0, 0, np.sin(0.05), np.cos(0.05)])
    error = compare_poses(estimate, reference)
    assert error.ate_m.max < 1e-12
    assert error.rpe_frame_rad.mean == pytest.approx(0.1)
    assert error.rpe_metre_m is None  # the path is 0.6 m long


@pytest.mark.parametrize("n", [0, 1, 2])
def test_too_few_poses(n: int) -> None:
    with raises(TrackingError, "tracking.no-match", match=f"only {n} poses"):
        compare_poses(orbit(5)[:n], orbit(5)[:n])


def test_stamps_match_once_and_exactly_first() -> None:
    reference = np.array([0, 100, 200, 300, 400, 500])
    # 249 is nearest to 200, which has its own frame; 551 is half a frame away from 500 and more.
    estimate = np.array([0, 199, 200, 249, 420, 551])
    i, j = match_stamps(estimate, reference)
    assert [*zip(estimate[i], reference[j], strict=True)] == [(0, 0), (200, 200), (420, 400)]
    i, j = match_stamps(reference[::-1], reference)
    np.testing.assert_array_equal(reference[::-1][i], reference[j])
    assert len(i) == 6
    assert match_stamps(np.array([7]), np.zeros(0, np.int64))[0].shape == (0,)


def test_only_poses_that_both_have_count() -> None:
    poses = orbit(20)
    stamps = np.arange(20) * 10**8
    holes = poses.copy()
    holes[[3, 7]] = np.nan
    had = np.setdiff1d(np.arange(20), [7, 9])
    reference = GivenTrajectory(stamps[had], OTHER_WORLD @ poses[had])
    figures, picture = compare_with(Trajectory(stamps[:15], holes[:15], "tracked"), reference)
    assert (figures.frames, figures.tracked, figures.error.matched) == (15, 13, 12)
    assert figures.error.ate_m.max < 1e-12
    row = replace(figures, error=replace(figures.error, rpe_metre_m=None)).row()
    assert row["ate_max_mm"] == 1000 * figures.error.ate_m.max and row["rpe_metre_mm"] is None
    assert row["rpe_metre_deg"] == np.degrees(present(figures.error.rpe_metre_rad).rmse)
    assert picture.startswith(b"\x89PNG")
    with raises(TrackingError, "tracking.no-match", match="frame's"):
        compare_with(Trajectory(stamps + 10**12, poses, "tracked"), reference)
    with raises(TrackingError, "tracking.no-match", match="one recording"):
        compare_poses(poses[:2], poses[:2])


@pytest.mark.parametrize("n", [1, 2, 30])
def test_worlds_align_by_orientation_where_positions_do_not_tell(n: int) -> None:
    reference = orbit(n, seed=3)
    reference[:, :3, 3] = np.linspace(0, 1, n)[:, None] * [1.0, 0, 0]  # along a line
    estimate = disturbed(OTHER_WORLD @ reference, 0.001, 0.001, seed=4)
    apart = OTHER_WORLD @ align_worlds(estimate, reference)
    assert rotation_angle_rad(apart[:3, :3]) < 0.005
    assert np.linalg.norm(apart[:3, 3]) < 0.02


def test_worlds_align_by_position_where_they_tell() -> None:
    reference = orbit(30)
    estimate = disturbed(OTHER_WORLD @ reference, 0, 0.2, seed=4)  # bad orientations
    np.testing.assert_allclose(align_worlds(estimate, reference), invert_rigid(OTHER_WORLD), atol=1e-12)


def by_evo(estimate: np.ndarray, reference: np.ndarray) -> dict[str, dict[str, float]]:
    from evo.core import metrics
    from evo.core.trajectory import PosePath3D

    found = {}
    relations = {"m": metrics.PoseRelation.translation_part, "rad": metrics.PoseRelation.rotation_angle_rad}
    for name, delta, unit in (("frame", 1, metrics.Unit.frames), ("metre", 1.0, metrics.Unit.meters)):
        for suffix, relation in relations.items():
            rpe = metrics.RPE(relation, delta, unit, all_pairs=True, pairs_from_reference=True)
            rpe.process_data((PosePath3D(poses_se3=[*reference]), PosePath3D(poses_se3=[*estimate])))
            found[f"rpe_{name}_{suffix}"] = rpe.get_all_statistics()
    aligned = PosePath3D(poses_se3=[*estimate])
    aligned.align(PosePath3D(poses_se3=[*reference]))
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((PosePath3D(poses_se3=[*reference]), aligned))
    return found | {"ate_m": ape.get_all_statistics()}


def assert_as_evo(error: TrajectoryError, estimate: np.ndarray, reference: np.ndarray) -> None:
    for name, expected in by_evo(estimate, reference).items():
        for statistic in ("rmse", "mean", "median", "max"):
            assert getattr(getattr(error, name), statistic) == pytest.approx(
                expected[statistic], abs=1e-9, rel=1e-9
            )


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_as_evo_on_synthetic_trajectories(seed: int) -> None:
    reference = orbit(200, seed)
    estimate = disturbed(OTHER_WORLD @ reference, 0.01, 0.02, seed)
    assert_as_evo(compare_poses(estimate, reference), estimate, reference)


@pytest.mark.skipif(not DATA.is_dir(), reason="KINECTBENCH_DATA does not name a folder with evo_trajectories")
@pytest.mark.parametrize("name", ["rgbdslam", "rgbdslam_drift", "ORB_kf_mono"])
def test_as_evo_on_real_trajectories(name: str) -> None:
    from kinectbench.core.trajectory.trajectory_file import read_trajectory_file

    reference, _ = read_trajectory_file(DATA / "freiburg1_xyz-groundtruth.txt")
    estimate, _ = read_trajectory_file(DATA / f"freiburg1_xyz-{name}.txt")
    i, j = match_stamps(estimate.stamps_ns, reference.stamps_ns)
    assert len(i) > 0.9 * len(estimate.stamps_ns)
    assert len(set(j)) == len(j)
    assert np.abs(estimate.stamps_ns[i] - reference.stamps_ns[j]).max() <= 5_500_000  # truth at 100 Hz
    error = compare_poses(estimate.T_world_camera[i], reference.T_world_camera[j])
    assert_as_evo(error, estimate.T_world_camera[i], reference.T_world_camera[j])

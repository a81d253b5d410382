"""Given trajectories of known faults: what disagrees with the depth is found, named, and refined away."""

import re
from dataclasses import replace

import numpy as np
import pytest
from analytic_scenes import displaced
from tracking_scenes import chair_circle, couch, errors_m, with_frames

from kinectbench.config import TrackingSettings
from kinectbench.geometry import invert_rigid
from kinectbench.sequence import GivenTrajectory, Sequence
from kinectbench.tracking import Trajectory, track
from kinectbench.tracking.check_given import check_given, jumps
from kinectbench.tracking.health import GivenCheck
from kinectbench.tracking.tracked import Tracked
from kinectbench.tracking.tracker import track_frames

pytestmark = pytest.mark.xdist_group("tracking")
N = 16
SETTINGS = TrackingSettings()
WRONG = 7


def truth() -> np.ndarray:
    return couch().simulation.T_world_camera[:N].copy()


def recording(T_given: np.ndarray | None = None) -> Sequence:
    """The first frames of a walk, with noise; with poses that are given for them."""
    sequence = with_frames(couch().sequence, range(N))
    if T_given is None:
        return sequence
    return replace(sequence, given_trajectory=GivenTrajectory(sequence.stamps_ns, T_given))


@pytest.fixture(scope="module")
def refined() -> Tracked:
    return track_frames(recording(), truth())


@pytest.fixture(scope="module")
def half_circle() -> tuple[Sequence, Tracked]:
    """A walk long enough that the two ends have nothing in common."""
    sequence = with_frames(chair_circle().sequence, range(24))
    return sequence, track_frames(sequence, chair_circle().simulation.T_world_camera[:24])


def checked(T_given: np.ndarray, refined: Tracked) -> GivenCheck:
    return check_given(recording(), T_given, refined, SETTINGS.check_neighbours, SETTINGS.max_disagreement_m)


def drifting(per_frame_m: float = 0.003, per_frame_deg: float = 0.1) -> np.ndarray:
    """As a phone's: every step is a little too long and turns a little too far."""
    true = truth()
    out = [true[0]]
    for k in range(1, N):
        step = invert_rigid(true[k - 1]) @ true[k]
        out.append(out[-1] @ displaced(step, (per_frame_m, 0.0, 0.0), per_frame_deg))
    return np.stack(out)


# --- compared frame by frame


def test_right_poses_agree(refined):
    check = checked(truth(), refined)
    assert not check.rejected.any() and np.isfinite(check.shift_m).all()
    assert np.median(check.shift_m) < 0.006 and check.shift_m.max() < 0.015
    assert np.degrees(np.median(check.turn_rad)) < 0.4
    assert jumps(truth(), refined, SETTINGS.max_disagreement_m) == []
    # Refined poses fit about as well as true ones, which nothing can beat by much.
    assert check.refined_distant_residual_m == pytest.approx(check.given_distant_residual_m, rel=0.15)


@pytest.mark.parametrize(
    ("shift_m", "turn_deg"),
    [((0.05, 0.0, 0.0), 0.0), ((0.0, 0.0, 0.05), 0.0), ((0.03, 0.03, 0.03), 0.0), ((0.0, 0.0, 0.0), 3.0)],
)
def test_one_wrong_frame_is_found_and_measured(refined, shift_m, turn_deg):
    poses = truth()
    poses[WRONG] = displaced(poses[WRONG], shift_m, turn_deg)
    check = checked(poses, refined)
    np.testing.assert_array_equal(np.flatnonzero(check.rejected), [WRONG])
    if turn_deg:
        assert np.degrees(check.turn_rad[WRONG]) == pytest.approx(turn_deg, rel=0.2)
    else:
        assert check.shift_m[WRONG] == pytest.approx(np.linalg.norm(shift_m), rel=0.2)


def test_wrong_keyframes_do_not_drag_others_along(refined):
    poses = truth()
    wrong = refined.keyframes[1:3].tolist()
    for k in wrong:
        poses[k] = displaced(poses[k], (0.0, 0.07, 0.0), 0.0)
    np.testing.assert_array_equal(np.flatnonzero(checked(poses, refined).rejected), sorted(wrong))


@pytest.mark.parametrize("at", [8, 9])
def test_a_jump_is_found_where_every_frame_sees_it(refined, at):
    """So short a walk that each frame is compared with some of the other side."""
    poses = truth()
    poses[at:] = displaced(np.eye(4), (0.06, 0.0, 0.0), 0.0) @ poses[at:]
    ((frame, by_m),) = jumps(poses, refined, SETTINGS.max_disagreement_m)
    assert frame == at and by_m == pytest.approx(0.06, abs=0.01)


def test_a_wrong_frame_is_no_jump(refined):
    poses = truth()
    poses[WRONG] = displaced(poses[WRONG], (0.06, 0.0, 0.0), 0.0)
    assert jumps(poses, refined, SETTINGS.max_disagreement_m) == []


def test_frames_without_a_pose_are_not_judged(refined):
    poses = truth()
    poses[[4, 11]] = np.nan
    check = checked(poses, refined)
    assert np.isnan(check.shift_m[[4, 11]]).all() and not check.rejected.any()
    assert np.isfinite(np.delete(check.shift_m, [4, 11])).all()


def test_another_world_changes_nothing(refined):
    """Only where frames lie to each other is compared."""
    T_other_world = displaced(np.eye(4), (3.0, -2.0, 1.0), 70.0)
    a, b = checked(truth(), refined), checked(T_other_world @ truth(), refined)
    np.testing.assert_allclose(a.shift_m, b.shift_m, atol=1e-9)
    assert a.given_distant_residual_m == pytest.approx(b.given_distant_residual_m, rel=1e-6)


# --- trust


def test_trust_leaves_a_wrong_frame_out_and_names_it():
    poses = truth()
    poses[WRONG] = displaced(poses[WRONG], (0.06, 0.0, 0.02), 1.0)
    trajectory = track(recording(poses), "trust", SETTINGS)
    np.testing.assert_array_equal(trajectory.good_frames, np.delete(np.arange(N), WRONG))
    np.testing.assert_array_equal(
        trajectory.T_world_camera[trajectory.good_frames], np.delete(truth(), WRONG, axis=0)
    )
    (rejected,) = trajectory.health["rejected"]
    assert rejected["frame"] == WRONG and 20 < rejected["shift_mm"] < 110


@pytest.mark.parametrize("at", [10, 15])
def test_a_jump_costs_few_frames(half_circle, at):
    """Only frames next to it may be left out."""
    sequence, refined = half_circle
    poses = chair_circle().simulation.T_world_camera[:24].copy()
    poses[at:] = displaced(np.eye(4), (0.03, 0.04, 0.0), 0.0) @ poses[at:]
    check = check_given(sequence, poses, refined, SETTINGS.check_neighbours, SETTINGS.max_disagreement_m)
    ((frame, by_m),) = jumps(poses, refined, SETTINGS.max_disagreement_m)
    assert frame == at and by_m == pytest.approx(0.05, abs=0.005)
    assert check.rejected.sum() <= 6


def test_the_warning_of_a_jump_names_frame_time_and_size():
    poses = chair_circle().simulation.T_world_camera[:24].copy()
    poses[10:] = displaced(np.eye(4), (0.03, 0.04, 0.0), 0.0) @ poses[10:]
    sequence = with_frames(chair_circle().sequence, range(24))
    given = replace(sequence, given_trajectory=GivenTrajectory(sequence.stamps_ns, poses))
    (warning,) = track(given, "refine", SETTINGS).health["warnings"]
    found = re.fullmatch(
        r"the given trajectory jumps by (\d+) mm before frame (\d+) \((\d+\.\d{3}) s\)", warning
    )
    assert found and abs(int(found[1]) - 50) <= 5 and int(found[2]) == 10
    assert float(found[3]) == pytest.approx(sequence.stamps_ns[int(found[2])] / 1e9, abs=0.001)


# --- refine


@pytest.fixture(scope="module")
def from_drift() -> Trajectory:
    return track(recording(drifting()), "refine", SETTINGS)


def test_refine_brings_a_drifting_trajectory_closer_to_the_truth(from_drift):
    before, after = errors_m(drifting(), truth()), errors_m(from_drift.T_world_camera, truth())
    assert before.max() > 0.015
    assert np.isfinite(after).all() and after.max() < 0.3 * before.max() and after.max() < 0.006
    assert from_drift.source == from_drift.health["source"] == "refine"


def test_refine_stays_in_the_given_world(from_drift):
    apart_m = np.linalg.norm(from_drift.T_world_camera[:, :3, 3] - drifting()[:, :3, 3], axis=1)
    assert np.median(apart_m) < 2 * errors_m(drifting(), truth()).max()


def test_drift_is_told_and_refining_recommended(from_drift):
    given = from_drift.health["given"]
    assert given["refined_distant_residual_mm"] < 0.85 * given["distant_residual_mm"]
    assert from_drift.health["recommended"] == "refine"


def test_refine_keeps_what_is_right_already():
    trajectory = track(recording(truth()), "refine", SETTINGS)
    assert len(trajectory.good_frames) == N
    assert errors_m(trajectory.T_world_camera, truth()).max() < 0.008
    assert trajectory.health["recommended"] == "trust"


def test_refine_where_the_given_trajectory_says_nothing():
    """Frames without a given pose get one from their neighbours."""
    sequence = recording()
    part = GivenTrajectory(sequence.stamps_ns[4:], truth()[4:])
    trajectory = track(replace(sequence, given_trajectory=part), "refine", SETTINGS)
    assert len(trajectory.good_frames) == N
    assert errors_m(trajectory.T_world_camera, truth()).max() < 0.01


# --- ignore


def test_ignore_ignores():
    """A trajectory that is nonsense leaves no trace."""
    nonsense = np.stack(
        [displaced(np.eye(4), tuple(each), 40.0) for each in np.random.default_rng(0).normal(0, 1, (6, 3))]
    )
    bare = with_frames(couch().sequence, range(6))
    given = replace(bare, given_trajectory=GivenTrajectory(bare.stamps_ns, nonsense))
    a, b = track(given, "ignore", SETTINGS), track(bare, None, SETTINGS)
    assert a.T_world_camera.tobytes() == b.T_world_camera.tobytes()
    assert a.health == b.health and a.source == "tracked" and a.health["given"] is None

"""Given trajectories of known faults: what disagrees with the depth is found, named, and refined away."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from analytic_scenes import displaced
from raising import raises
from read_pictures import read_picture
from tracking_scenes import (
    CORNER_VIEW,
    FLOOR,
    ROOM,
    chair_circle,
    couch,
    errors_m,
    painted,
    waves,
    with_depth,
    with_frames,
)
from typed import present

from kinectbench.core.errors import TrackingError
from kinectbench.core.geometry import invert_rigid, transform_points
from kinectbench.core.sequence import GivenTrajectory, Sequence
from kinectbench.lab.simulate.path import look_at
from kinectbench.settings.models import TrackingSettings
from kinectbench.stages.track import Trajectory, track
from kinectbench.stages.track.check_given import NO_DEPTH, GivenCheck, check_given, warnings_of
from kinectbench.stages.track.disagreement import check_pose, residuals_m
from kinectbench.stages.track.frame_maps import FrameMaps, MapCache
from kinectbench.stages.track.pictures import write_pictures

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


def checked(T_given: np.ndarray, sequence: Sequence | None = None) -> GivenCheck:
    return check_given(sequence or recording(), T_given, SETTINGS)


def drifting(per_frame_m: float = 0.003, per_frame_deg: float = 0.1) -> np.ndarray:
    """As a phone's: every step is a little too long and turns a little too far."""
    true = truth()
    out = [true[0]]
    for k in range(1, N):
        step = invert_rigid(true[k - 1]) @ true[k]
        out.append(out[-1] @ displaced(step, (per_frame_m, 0.0, 0.0), per_frame_deg))
    return np.stack(out)


# --- how far a frame is off


def corner() -> FrameMaps:
    return MapCache(painted(ROOM, CORNER_VIEW[None], texture=waves))[0]


@pytest.mark.parametrize("off", [(0.03, 0.0, 0.0, 0.0), (0.0, -0.02, 0.04, 0.0), (0.0, 0.0, 0.0, 2.0)])
def test_a_known_shift_is_measured(off: tuple[float, float, float, float]) -> None:
    """A frame compared with itself, as if it stood elsewhere."""
    maps = corner()
    T_off = displaced(np.eye(4), off[:3], off[3])
    found = check_pose(maps, [maps], [T_off], 2, 1)
    points = maps[0].points[:, :3].astype(float)
    expected_m = np.median(np.linalg.norm(transform_points(T_off, points) - points, axis=1))
    assert found is not None
    assert found.shift_m == pytest.approx(expected_m, rel=0.03)
    assert 0.9 * found.shift_m < found.certain_shift_m < found.shift_m
    assert np.degrees(found.turn_rad) == pytest.approx(off[3], abs=0.1)


def test_along_a_plane_nothing_is_certain() -> None:
    """Without texture a floor does not say where one stands on it, but how high."""
    down = look_at(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.01, 0.0]))
    maps = MapCache(painted([FLOOR], down[None]))[0]
    along, across = (
        check_pose(maps, [maps], [displaced(np.eye(4), s, 0.0)], 2, 1) for s in ((0.05, 0, 0), (0, 0, 0.05))
    )
    assert along is not None and along.certain_shift_m < 0.005
    assert across is not None and across.certain_shift_m == pytest.approx(0.05, rel=0.05)


def test_frames_that_see_nothing_in_common() -> None:
    maps = corner()
    assert check_pose(maps, [maps], [displaced(np.eye(4), (50.0, 0.0, 0.0), 0.0)], 2, 1) is None


def test_residuals_are_the_distances_to_the_plane() -> None:
    """Every point of a floor 20 mm nearer than it is; plainly, and by another plane's normals."""
    down = look_at(np.array([0.0, 0.0, 1.0]), np.array([0.0, 0.01, 0.0]))
    maps = MapCache(painted([FLOOR], down[None]))[0]
    nearer = displaced(np.eye(4), (0.0, 0.0, -0.02), 0.0)
    found = residuals_m(maps, maps[0], nearer, 1)
    assert len(found) > 5000
    np.testing.assert_allclose(found, 0.02, atol=1e-4)
    beyond = displaced(np.eye(4), (0.0, 0.0, -0.15), 0.0)
    assert len(residuals_m(maps, maps[0], beyond, 1)) == 0


# --- each frame against those around it


def test_right_poses_agree() -> None:
    check = checked(truth())
    assert not check.frames.disagrees.any() and check.frames.jumps == ()
    assert np.isfinite(check.frames.shift_m).all()
    assert np.median(check.frames.shift_m) < 0.002 and check.frames.shift_m.max() < 0.006
    assert np.degrees(np.median(check.frames.turn_rad)) < 0.2
    assert warnings_of(recording(), check) == []


@pytest.mark.parametrize(
    ("shift_m", "turn_deg"),
    [
        ((0.05, 0.0, 0.0), 0.0),
        ((0.0, 0.0, 0.05), 0.0),
        ((0.03, 0.03, 0.03), 0.0),
        ((0.3, 0.0, 0.0), 0.0),
        ((0.0, 0.0, 0.0), 3.0),
        ((0.0, 0.0, 0.0), 15.0),
    ],
)
def test_one_wrong_frame_is_found_and_measured(shift_m: tuple[float, float, float], turn_deg: float) -> None:
    poses = truth()
    poses[WRONG] = displaced(poses[WRONG], shift_m, turn_deg)
    check = checked(poses)
    np.testing.assert_array_equal(np.flatnonzero(check.frames.disagrees), [WRONG])
    if turn_deg:
        assert np.degrees(check.frames.turn_rad[WRONG]) == pytest.approx(turn_deg, rel=0.15)
    else:
        assert check.frames.shift_m[WRONG] == pytest.approx(np.linalg.norm(shift_m), rel=0.15)
    others = np.delete(np.arange(N), WRONG)
    assert check.frames.residual_m[WRONG] > 1.4 * np.median(check.frames.residual_m[others])
    assert check.frames.jumps == ()


def test_wrong_frames_in_a_row_do_not_drag_others_along() -> None:
    poses = truth()
    wrong = [6, 7]
    poses[wrong] = displaced(np.eye(4), (0.0, 0.07, 0.0), 0.0) @ poses[wrong]
    np.testing.assert_array_equal(np.flatnonzero(checked(poses).frames.disagrees), wrong)


def test_frames_that_are_off_by_less_than_disagrees_are_lost_and_told() -> None:
    """30 mm and half a degree in a row, of which a registration finds 4 to 12 mm again."""
    sequence, poses, wrong = couch().sequence, couch().simulation.T_world_camera.copy(), range(10, 14)
    for k in wrong:
        poses[k] = displaced(poses[k], (0.021, 0.015, 0.015), 0.5)
    given = GivenTrajectory(sequence.stamps_ns, poses)
    trajectory = track(replace(sequence, given_trajectory=given), "trust", SETTINGS)
    np.testing.assert_array_equal(trajectory.good_frames, np.delete(np.arange(len(poses)), wrong))
    assert any("left out: 4 frames (10 to 13): " in line for line in present(trajectory.health).warnings)


@pytest.mark.parametrize("at", [8, 9])
def test_a_jump_is_named_and_costs_nothing(at: int) -> None:
    """So short a walk that each frame is compared with some of the other side."""
    poses = truth()
    poses[at:] = displaced(np.eye(4), (0.03, 0.06, 0.0), 0.0) @ poses[at:]
    check = checked(poses)
    ((frame, by_m),) = check.frames.jumps
    assert frame == at and by_m == pytest.approx(np.hypot(0.03, 0.06), rel=0.05)
    assert not check.frames.disagrees.any()
    (warning,) = warnings_of(recording(), check)
    found = re.fullmatch(
        r"the given trajectory jumps by (\d+) mm before frame (\d+) \((\d+\.\d{3}) s\)", warning
    )
    assert found and abs(int(found[1]) - 67) <= 3 and int(found[2]) == at
    assert float(found[3]) == pytest.approx(recording().stamps_ns[at] / 1e9, abs=0.001)
    counting = replace(recording(), stamps_ns=np.arange(len(poses), dtype=np.int64) * 10**9)
    assert warnings_of(counting, check) == [warning.partition(" (")[0]]


def test_frames_without_a_pose_are_not_judged() -> None:
    poses = truth()
    poses[[4, 11]] = np.nan
    check = checked(poses)
    assert np.isnan(check.frames.shift_m[[4, 11]]).all() and not check.frames.disagrees.any()
    assert np.isfinite(np.delete(check.frames.shift_m, [4, 11])).all()


def test_poses_so_far_apart_that_nothing_can_be_checked() -> None:
    poses = truth()
    poses[:, :3, 3] += 50.0 * np.arange(N)[:, None]
    check = checked(poses)
    assert np.isnan(check.frames.shift_m).all() and check.distant == ()
    (warning,) = warnings_of(recording(), check)
    assert warning == (
        "16 of 16 poses could not be checked: too little of the frames overlaps; are the poses in metres?"
    )
    health = present(track(recording(poses), "trust", SETTINGS).health)
    assert health.unchecked == N and "could not be checked" in health.verdict
    assert health.recommended == "ignore"
    # Nobody says that such poses are to be trusted: what follows would take minutes for nothing.
    with raises(TrackingError, "tracking.given-unchecked", match=r"0.*16"):
        track(recording(poses), None, SETTINGS)


def test_a_jump_that_no_registration_bridges_is_named() -> None:
    """0.25 m upwards: from where the given poses put the frames, the floor is beyond any gate."""
    poses = truth()
    poses[9:, 2, 3] += 0.25
    ((frame, by_m),) = checked(poses).frames.jumps
    assert frame == 9 and by_m == pytest.approx(0.25, rel=0.05)
    health = present(track(recording(poses), "trust", SETTINGS).health)
    assert health.recommended == "refine" and health.grade == "not good"
    assert present(health.given).largest_jump_m == pytest.approx(0.25, rel=0.05)


def test_a_frame_that_has_nothing_to_do_with_the_others_is_found() -> None:
    """It is far off by its pose, and right where it follows from the frame before."""
    poses = truth()
    poses[WRONG, :3, 3] += 100.0
    check = checked(poses)
    np.testing.assert_array_equal(np.flatnonzero(check.frames.disagrees), [WRONG])
    assert check.frames.shift_m[WRONG] == pytest.approx(100 * np.sqrt(3), rel=0.01)


def test_another_world_changes_nothing() -> None:
    """Only where frames lie to each other is compared."""
    T_other_world = displaced(np.eye(4), (3.0, -2.0, 1.0), 70.0)
    a, b = checked(truth()), checked(T_other_world @ truth())
    np.testing.assert_allclose(a.frames.shift_m, b.frames.shift_m, atol=1e-5)


def test_the_same_bytes_again() -> None:
    a, b = checked(drifting()), checked(drifting())
    for name in ("shift_m", "turn_rad", "residual_m", "disagrees"):
        assert getattr(a.frames, name).tobytes() == getattr(b.frames, name).tobytes()
    assert a.figures == b.figures and a.figures.distant_shift_m is not None


def test_a_depth_scale_that_is_wrong_is_told() -> None:
    sequence = replace(circle(truth_of_circle()), depth_scale=circle(truth_of_circle()).depth_scale / 1.3)
    with raises(TrackingError, "tracking.given-disagrees"):
        track(sequence, "trust", SETTINGS)


# --- distant frames


def truth_of_circle() -> np.ndarray:
    return chair_circle().simulation.T_world_camera.copy()


def circle(T_given: np.ndarray) -> Sequence:
    sequence = chair_circle().sequence
    return replace(sequence, given_trajectory=GivenTrajectory(sequence.stamps_ns, T_given))


def test_drift_is_measured_where_the_circle_closes_and_costs_no_frame() -> None:
    """60 mm from the first frame to the last; pairs of distant frames are somewhat less apart."""
    poses = truth_of_circle()
    # Along the floor: the median residual, which lies on it, would not tell.
    poses[:, 0, 3] += np.linspace(0, 0.06, len(poses))
    trajectory = track(circle(poses), "trust", SETTINGS)
    health = present(trajectory.health)
    given = present(health.given)
    pairs = [(row.a, row.b) for row in health.loops]
    assert len(pairs) >= 5
    expected_mm = np.median([60 * (b - a) / (len(poses) - 1) for a, b in pairs])
    assert given.distant_shift_m == pytest.approx(expected_mm / 1000, rel=0.15) and expected_mm > 35
    assert health.recommended == "refine" and health.grade == "not good"
    assert len(trajectory.good_frames) == len(poses)


def test_drift_so_large_that_distant_frames_do_not_fit_is_told() -> None:
    poses = truth_of_circle()
    poses[:, 0, 3] += np.linspace(0, 0.25, len(poses))
    health = present(track(circle(poses), "trust", SETTINGS).health)
    assert health.recommended == "refine" and health.grade == "not good"
    given = present(health.given)
    assert present(given.distant_unmatched) > 0.4 or present(given.distant_shift_m) > 0.05


def test_exact_poses_of_a_circle_are_trusted() -> None:
    trajectory = track(circle(truth_of_circle()), "trust", SETTINGS)
    health = present(trajectory.health)
    assert health.recommended == "trust" and health.grade == "good" and health.warnings == ()
    assert (
        present(present(health.given).distant_shift_m) < 0.003 and health.ties.loop == len(health.loops) > 5
    )
    assert present(health.loop_correction_m) < 0.005
    np.testing.assert_array_equal(trajectory.T_world_camera, truth_of_circle())


def test_the_pictures_of_a_trusted_trajectory(tmp_path: Path) -> None:
    poses = truth_of_circle()
    poses[WRONG] = displaced(poses[WRONG], (0.06, 0.0, 0.0), 0.0)
    write_pictures(tmp_path, track(circle(poses), "trust", SETTINGS))
    for name in ("trajectory.png", "health.png", "covisibility.png"):
        image = read_picture(tmp_path / name)
        assert image.shape[1] > 400 and len(np.unique(image.reshape(-1, 3), axis=0)) > 10


# --- trust


def test_trust_leaves_a_wrong_frame_out_and_names_it() -> None:
    poses = truth()
    poses[WRONG] = displaced(poses[WRONG], (0.06, 0.0, 0.02), 1.0)
    trajectory = track(recording(poses), "trust", SETTINGS)
    np.testing.assert_array_equal(trajectory.good_frames, np.delete(np.arange(N), WRONG))
    np.testing.assert_array_equal(
        trajectory.T_world_camera[trajectory.good_frames], np.delete(truth(), WRONG, axis=0)
    )
    health = present(trajectory.health)
    (rejected,) = health.rejected
    assert rejected.frame == WRONG and 0.03 < present(rejected.shift_m) < 0.11
    keys = {"frame", "stamp_ns", "residual_mm", "shift_mm", "turn_deg", "reason"}
    assert set(rejected.json_value()) == keys
    assert present(health.given).disagreeing == (WRONG,) and health.tracked == N - 1
    assert [row.state for row in health.per_frame].count("rejected") == 1


def test_trust_leaves_frames_without_depth_out() -> None:
    empty = [4, 9]
    sequence = recording(truth())
    nothing = np.zeros_like(sequence.frames.depth_native(0))
    made = with_depth(sequence, dict.fromkeys(empty, nothing))
    trajectory = track(replace(made, given_trajectory=sequence.given_trajectory), "trust", SETTINGS)
    np.testing.assert_array_equal(trajectory.good_frames, np.setdiff1d(np.arange(N), empty))
    stretches = present(trajectory.health).lost_stretches
    assert [(each.first_frame, each.reason) for each in stretches] == [(4, NO_DEPTH), (9, NO_DEPTH)]


# --- refine


@pytest.fixture(scope="module")
def from_drift() -> Trajectory:
    return track(recording(drifting()), "refine", SETTINGS)


def test_refine_brings_a_drifting_trajectory_closer_to_the_truth(from_drift: Trajectory) -> None:
    before, after = errors_m(drifting(), truth()), errors_m(from_drift.T_world_camera, truth())
    assert before.max() > 0.015
    assert np.isfinite(after).all() and after.max() < 0.3 * before.max() and after.max() < 0.006
    assert from_drift.source == present(from_drift.health).source == "refine"


def test_refine_stays_in_the_given_world(from_drift: Trajectory) -> None:
    apart_m = np.linalg.norm(from_drift.T_world_camera[:, :3, 3] - drifting()[:, :3, 3], axis=1)
    assert np.median(apart_m) < 2 * errors_m(drifting(), truth()).max()


def test_drift_is_told_and_refining_recommended(from_drift: Trajectory) -> None:
    given = present(present(from_drift.health).given)
    assert present(given.refined_distant_residual_m) < 0.85 * present(given.distant_residual_m)
    assert present(given.distant_shift_m) > 3 * present(given.median_shift_m)
    assert present(from_drift.health).recommended == "refine"


def test_refine_keeps_what_is_right_already() -> None:
    trajectory = track(recording(truth()), "refine", SETTINGS)
    assert len(trajectory.good_frames) == N
    assert errors_m(trajectory.T_world_camera, truth()).max() < 0.008
    assert present(trajectory.health).recommended == "trust"


def test_refine_where_the_given_trajectory_says_nothing() -> None:
    """Frames without a given pose get one from their neighbours."""
    sequence = recording()
    part = GivenTrajectory(sequence.stamps_ns[4:], truth()[4:])
    trajectory = track(replace(sequence, given_trajectory=part), "refine", SETTINGS)
    assert len(trajectory.good_frames) == N
    assert errors_m(trajectory.T_world_camera, truth()).max() < 0.01


# --- ignore


def test_ignore_ignores() -> None:
    """A trajectory that is nonsense leaves no trace."""
    nonsense = np.stack(
        [displaced(np.eye(4), tuple(each), 40.0) for each in np.random.default_rng(0).normal(0, 1, (6, 3))]
    )
    bare = with_frames(couch().sequence, range(6))
    given = replace(bare, given_trajectory=GivenTrajectory(bare.stamps_ns, nonsense))
    a, b = track(given, "ignore", SETTINGS), track(bare, None, SETTINGS)
    assert a.T_world_camera.tobytes() == b.T_world_camera.tobytes()
    assert a.health == b.health and a.source == "tracked" and present(a.health).given is None

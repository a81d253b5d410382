"""The whole tracker on recordings of known paths: right, or lost and said to be lost."""

from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from analytic_scenes import Furniture, box, displaced, sphere
from raising import raises
from slow import slow
from tracking_scenes import (
    CORNER_VIEW,
    FLOOR,
    ROOM,
    TINY,
    chair_circle,
    couch,
    errors_m,
    made_of,
    orbit,
    painted,
    spliced,
    stored,
    walk,
    waves,
    with_blank_color,
    with_depth,
    with_frames,
    without_color,
)
from typed import present

from kinectbench.core.errors import TrackingError
from kinectbench.core.geometry import invert_rigid
from kinectbench.lab.simulate.path import look_at
from kinectbench.settings.models import TrackingSettings
from kinectbench.stages.track import track
from kinectbench.stages.track.tracked import Tracked
from kinectbench.stages.track.tracker import DISAGREES, UNSUPPORTED, _FirstTry, _Placed, _Placer, track_frames

pytestmark = pytest.mark.xdist_group("tracking")
# Wrong is what no reconstruction survives; a good trajectory is far better.
WRONG_M = 0.02
COUCH = range(24)


def posed(tracked: Tracked) -> np.ndarray:
    return np.flatnonzero(np.isfinite(tracked.T_world_camera).all(axis=(1, 2)))


def couch_poses(order: Iterable[int]) -> np.ndarray:
    return couch().simulation.T_world_camera[[int(i) for i in order]]


def check_consistent(tracked: Tracked, n: int) -> None:
    """What is lost has no pose and a reason, what is not has a pose, and keyframes are posed."""
    assert len(tracked.states) == len(tracked.T_world_camera) == n
    good = set(posed(tracked).tolist())
    assert good == {i for i, state in enumerate(tracked.states) if state != "lost"}
    assert set(tracked.reasons) == set(range(n)) - good
    assert all(tracked.reasons.values())
    rotations = tracked.T_world_camera[sorted(good), :3, :3]
    np.testing.assert_allclose(
        rotations @ np.swapaxes(rotations, 1, 2), np.eye(3)[None] + 0 * rotations, atol=1e-9
    )
    constraints = (*tracked.constraints, *tracked.refused)
    assert {constraint.a for constraint in constraints} | {constraint.b for constraint in constraints} <= set(
        range(n)
    )


# --- right


def test_a_walk_with_colour() -> None:
    tracked = track_frames(couch().sequence)
    check_consistent(tracked, 24)
    assert tracked.states == ("tracked",) * 24 and tracked.reasons == {}
    assert errors_m(tracked.T_world_camera, couch_poses(COUCH)).max() < 0.006
    assert np.nanmedian(tracked.residual_m) < 0.006 and np.nanmin(tracked.inlier_share) > 0.9
    assert not tracked.degenerate.any()
    # The world is the first camera's.
    np.testing.assert_allclose(tracked.T_world_camera[0], np.eye(4), atol=0.01)


def test_without_colour() -> None:
    tracked = track_frames(without_color(with_frames(couch().sequence, range(12))))
    assert tracked.states == ("tracked",) * 12
    assert errors_m(tracked.T_world_camera, couch_poses(range(12))).max() < 0.01


def test_the_same_bytes_again() -> None:
    """Also after another recording has been tracked in between."""
    sequence = with_frames(couch().sequence, range(8))
    first = track_frames(sequence)
    track_frames(painted(ROOM, walk(4, 0.2)))
    again = track_frames(sequence)
    for name in ("T_world_camera", "residual_m", "inlier_share", "degenerate", "keyframes"):
        assert getattr(again, name).tobytes() == getattr(first, name).tobytes()
    assert (again.states, again.reasons) == (first.states, first.reasons)
    for kind in ("constraints", "refused"):
        for a, b in zip(getattr(first, kind), getattr(again, kind), strict=True):
            assert (a.a, a.b, a.kind, a.weight) == (b.a, b.b, b.kind, b.weight)
            assert a.T_a_b.tobytes() == b.T_a_b.tobytes()


def test_the_recording_is_left_alone_and_progress_told() -> None:
    sequence = painted(ROOM, walk(5, 0.3), texture=waves)
    before = [stored(sequence, i)[0].copy() for i in range(5)]
    told: list[tuple[int, int]] = []
    track_frames(sequence, None, lambda done, total: told.append((done, total)))
    for i, depth in enumerate(before):
        np.testing.assert_array_equal(stored(sequence, i)[0], depth)
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    assert told[-1][0] == told[-1][1]


@pytest.mark.parametrize("change", ["exposure", "unregistered", "wide", "pause and jolt"])
def test_recordings_of_many_kinds(change: str) -> None:
    kinds: dict[str, tuple[dict[str, dict[str, Any]], int, float]] = {
        "exposure": ({"sensor": {"exposure_drift": 0.6}}, 8, 0.4),
        "unregistered": ({"sensor": {"color_registered": False}}, 8, 0.4),
        "wide": (
            {"sensor": {"width": 1280, "height": 720}, "path": {"swing_rad": 0.0}},
            5,
            0.1,
        ),
        "pause and jolt": ({"path": {"pause_s": 0.6, "jolt_m": 0.05, "jolt_rad": 0.05}}, 12, 0.6),
    }
    changed, frames, arc_rad = kinds[change]
    recorded = orbit("couch:seed=4", frames, arc_rad, seed=0, **changed)
    tracked = track_frames(recorded.sequence)
    check_consistent(tracked, frames)
    assert len(posed(tracked)) == frames
    assert errors_m(tracked.T_world_camera, recorded.simulation.T_world_camera).max() < 0.01


def test_colour_of_another_size_is_left_out() -> None:
    """Exactly as if there were none: photometry needs colour on depth's pixels."""
    sequence = couch().sequence
    small = orbit("couch:seed=4", 6, 1.2, sensor=TINY).sequence
    mixed = made_of(sequence, [(stored(sequence, i)[0], stored(small, i)[1]) for i in range(6)])
    a, b = track_frames(mixed), track_frames(without_color(with_frames(sequence, range(6))))
    assert a.T_world_camera.tobytes() == b.T_world_camera.tobytes()
    assert errors_m(a.T_world_camera, couch_poses(range(6))).max() < 0.01


def test_unregistered_colour_is_not_looked_at() -> None:
    """Other pictures, the same poses."""
    sequence = without_color(with_frames(couch().sequence, range(6)))
    mixed = made_of(sequence, [(stored(sequence, i)[0], stored(sequence, 5 - i)[1]) for i in range(6)])
    a, b = track_frames(mixed), track_frames(sequence)
    assert a.T_world_camera.tobytes() == b.T_world_camera.tobytes()


def test_a_pause() -> None:
    """Frames that are the same stay where they are, and what follows is not worse for it."""
    order = [*[0] * 4, *range(8), *[7] * 6, *range(8, 12)]
    tracked = track_frames(with_frames(couch().sequence, order))
    assert tracked.states == ("tracked",) * len(order)
    assert errors_m(tracked.T_world_camera, couch_poses(order)).max() < 0.008
    for same in (range(5), range(11, 18)):
        places = tracked.T_world_camera[list(same), :3, 3]
        assert np.linalg.norm(places - places[0], axis=1).max() < 0.001


def test_something_moves_half_way() -> None:
    """A box is pushed by 0.3 m between two frames: the room says where the camera is."""
    pushed = [*ROOM[:3], box((0.0, -0.1, 0.0), (0.5, 0.25, 0.35)), ROOM[4]]
    poses, rng = walk(14, 0.7), np.random.default_rng(0)
    before, after = (painted(each, poses, texture=waves, noise=rng) for each in (ROOM, pushed))
    tracked = track_frames(spliced((before, range(7)), (after, range(7, 14))))
    check_consistent(tracked, 14)
    assert len(posed(tracked)) >= 12
    assert np.nanmax(errors_m(tracked.T_world_camera, poses)) < 0.005


# --- disorder


def test_stamps_swapped_between_neighbours() -> None:
    order = np.array([0, 1, 3, 2, 4, 5, 6, 8, 7, 9, 10, 11])
    tracked = track_frames(with_frames(couch().sequence, order))
    check_consistent(tracked, 12)
    assert len(posed(tracked)) == 12
    assert errors_m(tracked.T_world_camera, couch_poses(order)).max() < 0.01


def test_frames_in_any_order() -> None:
    """No frame follows the one before; still no pose is wrong."""
    order = np.random.default_rng(0).permutation(10)
    tracked = track_frames(with_frames(couch().sequence, order))
    check_consistent(tracked, 10)
    assert len(posed(tracked)) >= 6
    assert np.nanmax(errors_m(tracked.T_world_camera, couch_poses(order))) < 0.01


@cache
def foreign_couch() -> Furniture:
    return orbit("couch:seed=4", 14, 0.6, faults={"foreign_frames": 3})


@pytest.mark.parametrize("color", [True, slow(False)])
def test_frames_of_another_scene_are_left_out(color: bool) -> None:
    recorded = foreign_couch()
    foreign = {i for i, frame in enumerate(recorded.simulation.frames) if frame.foreign}
    tracked = track_frames(recorded.sequence if color else without_color(recorded.sequence))
    check_consistent(tracked, 14)
    assert len(foreign) == 3 and set(tracked.reasons) >= foreign
    assert len(posed(tracked)) >= 9
    assert np.nanmax(errors_m(tracked.T_world_camera, recorded.simulation.T_world_camera)) < 0.01


def test_the_lost_stretch_is_reported_with_its_times() -> None:
    blank = dict.fromkeys(range(4, 7), np.zeros((240, 320), np.uint16))
    sequence = with_depth(with_frames(couch().sequence, range(10)), blank)
    trajectory = track(sequence, "ignore", TrackingSettings())
    assert present(trajectory.health).lost == (4, 5, 6)
    (stretch,) = present(trajectory.health).lost_stretches
    assert (stretch.first_frame, stretch.last_frame) == (4, 6)
    assert stretch.from_s == pytest.approx(4 * 0.2) and stretch.to_s == pytest.approx(6 * 0.2)
    assert stretch.reason == "too little depth to register"
    assert np.nanmax(errors_m(trajectory.T_world_camera, couch_poses(range(10)))) < 0.01


@pytest.mark.parametrize("missing", [[0], [9], range(0, 24, 3)])
def test_frames_whose_colour_is_missing_are_tracked_by_their_depth(missing: list[int] | range) -> None:
    tracked = track_frames(with_blank_color(couch().sequence, missing))
    check_consistent(tracked, 24)
    assert len(posed(tracked)) == 24
    assert errors_m(tracked.T_world_camera, couch_poses(range(24))).max() < 0.01


# --- gaps


@pytest.mark.parametrize("missing", [4, 8])
def test_after_a_gap_frames_are_right_or_lost(missing: int) -> None:
    """The camera is carried on while nothing is recorded: 14 and 27 degrees."""
    order = [*range(6), *range(6 + missing, 20)]
    tracked = track_frames(with_frames(couch().sequence, order))
    check_consistent(tracked, len(order))
    assert len(posed(tracked)) >= 6
    assert np.nanmax(errors_m(tracked.T_world_camera, couch_poses(order))) < 0.01


@pytest.mark.parametrize("color", [True, slow(False)])
def test_after_a_long_gap_the_circle_joins_again(color: bool) -> None:
    """A quarter of the circle is missing: what follows comes back to the beginning and is joined there."""
    order = [*range(12), *range(24, 48)]
    sequence = with_frames(chair_circle().sequence, order)
    tracked = track_frames(sequence if color else without_color(sequence))
    check_consistent(tracked, len(order))
    assert len(posed(tracked)) >= 12
    poses = chair_circle().simulation.T_world_camera[order]
    assert np.nanmax(errors_m(tracked.T_world_camera, poses)) < WRONG_M
    assert len(posed(tracked)) == len(order) or not color


def test_a_frame_has_no_pose_if_its_keyframe_cannot_be_placed(monkeypatch: pytest.MonkeyPatch) -> None:
    """A passer-by fills the view of a keyframe, and frames fit that keyframe alone."""
    sequence, place = couch().sequence, _Placer.place
    keyframe = int(track_frames(sequence).keyframes[1])

    def disturbed(placer: _Placer, index: int, first: _Placed | _FirstTry) -> _Placed:
        placed = place(placer, index, first)
        return replace(placed, reason=DISAGREES) if index == keyframe else placed

    monkeypatch.setattr(_Placer, "place", disturbed)
    tracked = track_frames(sequence)
    check_consistent(tracked, len(sequence))
    lost = {index for index, reason in tracked.reasons.items() if reason == UNSUPPORTED}
    assert lost and keyframe not in lost and tracked.reasons[keyframe] == DISAGREES
    assert lost == set(range(keyframe + 1, keyframe + 1 + len(lost)))
    assert len(posed(tracked)) == len(sequence) - 1 - len(lost)


def test_after_blank_frames_the_circle_joins_again() -> None:
    """A fifth of the circle is blank; one place seen again is enough, for those beside it confirm it."""
    blank = np.zeros((120, 160), np.uint16)
    sequence = with_depth(chair_circle().sequence, dict.fromkeys(range(14, 24), blank))
    tracked = track_frames(sequence)
    check_consistent(tracked, 48)
    assert len(posed(tracked)) == 38 and tracked.states.count("relocalised") >= 20
    assert np.nanmax(errors_m(tracked.T_world_camera, chair_circle().simulation.T_world_camera)) < WRONG_M


def test_two_rooms_in_one_recording() -> None:
    """Cut together from two scenes: the longer one is the world, of the other nothing is claimed."""
    other = [FLOOR, box((-0.1, -0.6, 0.0), (0.6, -0.4, 0.9)), sphere((-0.3, 0.1, 0.3), 0.3)]
    here = painted(ROOM, walk(12, 0.8), texture=waves)
    there = painted(other, walk(6, 0.3), texture=lambda p: waves(3 - p))
    tracked = track_frames(spliced((there, range(6)), (here, range(12))))
    check_consistent(tracked, 18)
    assert set(posed(tracked)) == set(range(6, 18))
    assert errors_m(tracked.T_world_camera[6:], walk(12, 0.8)).max() < 0.002


# --- too plain to tell


def across_the_floor(x: np.ndarray) -> np.ndarray:
    """Cameras that look steeply at a floor, side by side."""
    return np.stack([look_at(np.array([each, 0.4, 1.2]), np.array([each, 0.0, 0.0])) for each in x])


def test_a_floor_alone_is_not_tracked() -> None:
    """Nothing tells how far the camera went: lost, for that reason, and an error in one line."""
    sequence = painted([FLOOR], across_the_floor(np.linspace(0, 0.2, 10)), noise=np.random.default_rng(0))
    tracked = track_frames(sequence)
    check_consistent(tracked, 10)
    assert len(posed(tracked)) <= 1 and tracked.degenerate.sum() >= 8
    assert all("plane" in reason for reason in tracked.reasons.values())
    with raises(TrackingError, "tracking.too-few-poses", match="[01] of 10") as error:
        track(sequence, "ignore", TrackingSettings())
    assert "\n" not in str(error.value)


def test_with_texture_a_floor_is_enough() -> None:
    poses = across_the_floor(np.linspace(0, 0.3, 10))
    tracked = track_frames(painted([FLOOR], poses, texture=waves, noise=np.random.default_rng(0)))
    assert tracked.states == ("tracked",) * 10 and not tracked.degenerate.any()
    assert errors_m(tracked.T_world_camera, poses).max() < 0.003


THINGS = [
    FLOOR,
    box((-0.3, -0.2, 0.0), (0.2, 0.15, 0.35)),
    sphere((0.45, 0.3, 0.18), 0.18),
    box((-0.6, 0.1, 0.0), (-0.45, 0.3, 0.2)),
]


def test_across_a_bare_floor_and_back() -> None:
    """Two metres away from the things, with only the floor in view, and back: right, or lost."""
    x = np.concatenate([np.linspace(0, 2.0, 12), np.linspace(1.9, 0, 12)])
    poses = np.stack([look_at(np.array([each, 0.9, 1.1]), np.array([each, 0.0, 0.0])) for each in x])
    tracked = track_frames(painted(THINGS, poses, noise=np.random.default_rng(0)))
    check_consistent(tracked, 24)
    assert len(posed(tracked)) >= 6
    assert np.nanmax(errors_m(tracked.T_world_camera, poses)) < WRONG_M


def test_a_floor_seen_at_an_angle_is_not_tracked_either() -> None:
    poses = np.stack([displaced(CORNER_VIEW, (0.01 * k, 0.0, 0.0), 0.0) for k in range(10)])
    tracked = track_frames(painted([FLOOR], poses, noise=np.random.default_rng(0)))
    found = posed(tracked)
    assert len(found) < 3 or np.nanmax(errors_m(tracked.T_world_camera, poses)) < WRONG_M


# --- hardly anything


def test_nothing_but_blank_frames() -> None:
    sequence = with_depth(couch().sequence, dict.fromkeys(COUCH, np.zeros((240, 320), np.uint16)))
    tracked = track_frames(sequence)
    check_consistent(tracked, 24)
    assert len(posed(tracked)) == 0 and len(tracked.keyframes) == 0
    with raises(TrackingError, "tracking.too-few-poses", match="0 of 24") as error:
        track(sequence, "ignore", TrackingSettings())
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("n", [1, 2])
def test_recordings_of_one_and_two_frames(n: int) -> None:
    """Tracked as far as they go, and refused in one line: three poses are the least."""
    sequence = with_frames(couch().sequence, range(n))
    tracked = track_frames(sequence)
    check_consistent(tracked, n)
    assert tracked.states == ("tracked",) * n
    true = invert_rigid(couch_poses([0])[0]) @ couch_poses(range(n))
    error = invert_rigid(true) @ invert_rigid(tracked.T_world_camera[0]) @ tracked.T_world_camera
    assert np.linalg.norm(error[:, :3, 3], axis=1).max() < 0.01
    with raises(TrackingError, "tracking.too-few-poses", match=rf"{n}.*{n}.*3") as raised:
        track(sequence, "ignore", TrackingSettings())
    assert "\n" not in str(raised.value)


def test_three_frames_are_enough() -> None:
    trajectory = track(with_frames(couch().sequence, range(3)), "ignore", TrackingSettings())
    assert len(trajectory.good_frames) == 3 and trajectory.source == "tracked"


def test_stamps_that_say_nothing() -> None:
    """A recording without stamps counts its frames in seconds."""
    sequence = with_frames(couch().sequence, range(10))
    counted = replace(sequence, stamps_ns=np.arange(10, dtype=np.int64) * 10**9)
    tracked = track_frames(counted)
    assert errors_m(tracked.T_world_camera, couch_poses(range(10))).max() < 0.006

"""Following a camera from frame to frame along known paths, and where it is lost."""

import itertools
import threading
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from analytic_scenes import box, displaced, sphere
from tracking_scenes import (
    CORNER_VIEW,
    FLOOR,
    ROOM,
    SMALL,
    PaintedFrames,
    couch,
    errors_m,
    native,
    painted,
    spliced,
    walk,
    waves,
    with_depth,
    with_frames,
    without_color,
)

from kinectbench.core.geometry import invert_rigid, rotation_angle_rad
from kinectbench.core.sequence import Sequence
from kinectbench.core.threads import using_threads
from kinectbench.lab.simulate.path import look_at
from kinectbench.stages.track.features import FeatureCache
from kinectbench.stages.track.frame_maps import FrameMaps, MapCache
from kinectbench.stages.track.odometry import NO_DEPTH, Follower, Odometry, follow, is_accepted
from kinectbench.stages.track.registration import measure

pytestmark = pytest.mark.xdist_group("tracking")


def followed(sequence: Sequence, T_given: np.ndarray | None = None) -> Odometry:
    maps = MapCache(sequence)
    return follow(maps, FeatureCache(maps), T_given)


def poses_of(odometry: Odometry, segment: int = 0) -> np.ndarray:
    """(n, 4, 4) in the world of one segment, NaN elsewhere."""
    lost = np.full((4, 4), np.nan)
    return np.stack(
        [lost if f is None or f.segment != segment else f.T_segment_camera for f in odometry.frames]
    )


def segments_of(odometry: Odometry) -> list[int | None]:
    return [None if frame is None else frame.segment for frame in odometry.frames]


# --- known paths


@pytest.mark.parametrize("color", [True, False])
def test_a_walk_in_a_room(color: bool) -> None:
    """Exact depth: within a millimetre over half a metre, in the world of the first camera."""
    poses = walk(10, 0.5)
    odometry = followed(painted(ROOM, poses, texture=waves if color else None))
    found = poses_of(odometry)
    np.testing.assert_array_equal(found[0], np.eye(4))
    error = invert_rigid(invert_rigid(poses[0]) @ poses) @ found
    assert np.linalg.norm(error[:, :3, 3], axis=1).max() < 0.001
    assert np.degrees(rotation_angle_rad(error[:, :3, :3])).max() < 0.1


@pytest.mark.parametrize("color", [True, False])
def test_a_walk_around_furniture_with_noise(color: bool) -> None:
    sequence = couch().sequence if color else without_color(couch().sequence)
    odometry = followed(sequence)
    assert segments_of(odometry) == [0] * 24
    assert errors_m(poses_of(odometry), couch().simulation.T_world_camera).max() < 0.02


def test_keyframes_and_their_ties() -> None:
    """Keyframes are their own; each constraint is right, and joins consecutive keyframes."""
    odometry = followed(couch().sequence)
    poses = couch().simulation.T_world_camera
    keyframes = odometry.keyframes
    assert keyframes[0] == 0 and list(keyframes) == sorted(keyframes) and 4 <= len(keyframes) <= 20
    for index, frame in enumerate(odometry.frames):
        assert frame is not None and (frame.keyframe == index) == (index in keyframes)
        assert frame.keyframe in keyframes and frame.keyframe <= index
    assert [(constraint.a, constraint.b) for constraint in odometry.constraints] == list(
        itertools.pairwise(keyframes)
    )
    for constraint in odometry.constraints:
        error = invert_rigid(invert_rigid(poses[constraint.a]) @ poses[constraint.b]) @ constraint.T_a_b
        assert np.linalg.norm(error[:3, 3]) < 0.01
        assert constraint.kind == "odometry" and constraint.registration.inlier_share > 0.9
        assert constraint.registration.overlap > 0.25
        assert np.linalg.eigvalsh(constraint.registration.information).min() > 0


def test_a_pause_moves_nothing() -> None:
    """The same frame ten times: at most the noise of nothing, one keyframe."""
    odometry = followed(with_frames(couch().sequence, [5] * 10))
    found = poses_of(odometry)
    assert np.linalg.norm(found[:, :3, 3], axis=1).max() < 0.0005
    assert odometry.keyframes == (0,) and odometry.constraints == ()


def test_a_pause_with_noise_moves_nothing() -> None:
    """One place recorded ten times, with new noise: within 1 mm."""
    sequence = painted(ROOM, np.stack([CORNER_VIEW] * 10), noise=np.random.default_rng(0))
    odometry = followed(sequence)
    assert np.linalg.norm(poses_of(odometry)[:, :3, 3], axis=1).max() < 0.001
    assert odometry.keyframes == (0,)


def test_given_poses_lead_through_a_leap() -> None:
    """Eight frames are missing, some 25 degrees; given poses tell where to look."""
    order = [*range(6), *range(14, 20)]
    poses = couch().simulation.T_world_camera[order]
    sequence = with_frames(couch().sequence, order)
    odometry = followed(sequence, poses)
    assert set(segments_of(odometry)) == {0}
    assert errors_m(poses_of(odometry), poses).max() < 0.015


# --- where it is lost


def test_frames_without_depth_are_nothing() -> None:
    blank = {i: np.zeros((240, 320), np.uint16) for i in (0, 8, 9)}
    odometry = followed(with_depth(couch().sequence, blank))
    assert [i for i, frame in enumerate(odometry.frames) if frame is None] == [0, 8, 9]
    found = poses_of(odometry)
    good = np.isfinite(found[:, 0, 0])
    assert good.sum() == 21 and odometry.keyframes[0] == 1
    assert np.nanmax(errors_m(found, couch().simulation.T_world_camera)) < 0.02
    nothing = followed(with_depth(couch().sequence, dict.fromkeys(range(24), blank[0])))
    assert nothing == Odometry((None,) * 24, dict.fromkeys(range(24), NO_DEPTH), (), ())


@pytest.mark.parametrize(("rate_hz", "between"), [(30.0, 8), (1.0, 3), (1.0, 8)])
def test_another_scene_is_another_segment(rate_hz: float, between: int) -> None:
    """Frames of something else between: the rest goes on; after many, seconds later, it is a third world."""
    poses = walk(10, 0.5)
    other = [FLOOR, box((-0.1, -0.6, 0.0), (0.6, -0.4, 0.9)), sphere((-0.3, 0.1, 0.3), 0.3)]
    elsewhere = np.stack([displaced(CORNER_VIEW, (0.01 * k, 0.0, 0.0), 0.0) for k in range(between)])
    sequence = spliced(
        (painted(ROOM, poses), range(5)),
        (painted(other, elsewhere), range(between)),
        (painted(ROOM, poses), range(5, 10)),
    )
    stamps_ns = np.arange(len(sequence)) * int(1e9 / rate_hz)
    odometry = followed(replace(sequence, stamps_ns=stamps_ns))
    segments = segments_of(odometry)
    after = segments[5 + between]
    assert segments[:5] == [0] * 5 and 0 not in segments[5 : 5 + between]
    assert segments[5 + between :] == [after] * 5
    assert (after != 0) == (between > 5 and rate_hz < 2)
    if after == 0:
        true = np.concatenate([poses[:5], elsewhere, poses[5:]])
        assert np.nanmax(errors_m(poses_of(odometry), true)) < 0.001


def test_nothing_is_believed_that_does_not_fit() -> None:
    maps = MapCache(
        painted(ROOM, np.stack([CORNER_VIEW, displaced(CORNER_VIEW, (0.05, 0.0, 0.0), 0.0)]), texture=waves)
    )
    right = invert_rigid(CORNER_VIEW) @ displaced(CORNER_VIEW, (0.05, 0.0, 0.0), 0.0)
    assert is_accepted(measure(maps[1], [maps[0]], [right]))
    for shift_m in ((0.1, 0.0, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.1)):
        assert not is_accepted(measure(maps[1], [maps[0]], [displaced(right, shift_m, 0.0)]))
    assert not is_accepted(measure(maps[1], [maps[0]], [displaced(right, (0.0, 0.0, 0.0), 6.0)]))
    # Same shapes, another picture on them: another place.
    other = MapCache(painted(ROOM, CORNER_VIEW[None], texture=lambda p: 255 - waves(p)))
    registration = measure(maps[1], [other[0]], [right])
    assert registration.inlier_share > 0.95 and not is_accepted(registration)


@pytest.mark.parametrize("threads", [1, 3])
def test_progress_and_the_same_bytes(threads: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """Threads prepare the maps of the next frames; however many there are, the result is the same."""
    makers, made, own = set[int](), MapCache._made, threading.get_ident()

    def watched(maps: MapCache, *frame: Any) -> FrameMaps:
        makers.add(threading.get_ident())
        return made(maps, *frame)

    done: list[int] = []
    sequence = painted(ROOM, walk(8, 0.6), noise=np.random.default_rng(1))
    b = followed(sequence)
    monkeypatch.setattr(MapCache, "_made", watched)
    maps = MapCache(sequence)
    with using_threads(threads):
        a = Follower(maps, FeatureCache(maps)).to_the_end(done.append)
    assert done == list(range(1, 9)) and (makers == {own} if threads == 1 else makers - {own})
    assert poses_of(a).tobytes() == poses_of(b).tobytes() and a.keyframes == b.keyframes
    assert len(a.keyframes) > 1 and all(maps.averaged[frame].any() for frame in a.keyframes)


def test_uneven_stamps_change_no_pose() -> None:
    """Times only say where to look first."""
    sequence = painted(ROOM, walk(8, 0.4))
    rng = np.random.default_rng(0)
    uneven = replace(sequence, stamps_ns=np.cumsum(rng.integers(10**6, 10**9, 8)))
    a, b = (poses_of(followed(each)) for each in (sequence, uneven))
    np.testing.assert_allclose(a, b, atol=0.0007)


def test_one_and_two_frames() -> None:
    for n in (1, 2):
        odometry = followed(painted(ROOM, walk(2, 0.1)[:n]) if n == 2 else with_frames_of_one())
        assert segments_of(odometry) == [0] * n and odometry.keyframes[0] == 0


def with_frames_of_one() -> Sequence:
    sequence = painted(ROOM, walk(2, 0.1))
    assert isinstance(sequence.frames, PaintedFrames)
    frames = replace(sequence.frames, depth=sequence.frames.depth[:1], color=[None])
    return replace(sequence, stamps_ns=sequence.stamps_ns[:1], frames=frames)


def test_a_view_of_noise_is_no_place() -> None:
    """Depth without any surface: registration finds nothing to hold on to."""
    rng = np.random.default_rng(2)
    noise = native(rng.uniform(0.5, 3.0, (SMALL.height, SMALL.width)))
    sequence = with_depth(painted(ROOM, walk(6, 0.3)), {3: noise})
    odometry = followed(sequence)
    assert odometry.frames[3] is None or odometry.frames[3].segment != 0
    error = errors_m(poses_of(odometry), walk(6, 0.3))
    assert np.isfinite(error[[0, 1, 2, 4, 5]]).all() and np.nanmax(error) < 0.001


def test_a_view_straight_at_the_ceiling_and_back() -> None:
    """A quick turn away and back within a second: lost in between, right again after it."""
    poses = walk(8, 0.4)
    away = look_at(poses[3][:3, 3], poses[3][:3, 3] + np.array([1.0, 1.0, 0.4]))
    poses[4] = away  # sees nothing: the room is open there
    odometry = followed(painted(ROOM, poses))
    assert odometry.frames[4] is None
    assert np.nanmax(errors_m(poses_of(odometry), poses)) < 0.001

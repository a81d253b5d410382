"""Known motions recovered by registration, and what a view leaves open."""

import numpy as np
import pytest
from analytic_scenes import depth_of, displaced, plane
from numpy.typing import NDArray
from tracking_scenes import (
    CORNER_VIEW,
    FLOOR,
    MOVED,
    ROOM,
    SMALL,
    frame_maps,
    levels,
    moved_pair,
    painted,
    waves,
)

from kinectbench.core.geometry import invert_rigid, rigid, rotation_angle_rad, transform_points
from kinectbench.core.geometry.rigid import on_so3, rigid_from_twist, twist_from_rigid
from kinectbench.lab.simulate.path import look_at
from kinectbench.stages.track.frame_maps import FrameMaps
from kinectbench.stages.track.linearise import LinearTerms, linearise
from kinectbench.stages.track.registration import measure, register, search

pytestmark = pytest.mark.xdist_group("tracking")

GATE_M = 0.06
STEEP = look_at(np.array([0.3, 0.2, 1.2]), np.array([0.0, 0.05, 0.0]))
GRAZING = look_at(np.array([1.5, 1.2, 0.7]), np.array([0.0, 0.0, 0.0]))


@pytest.fixture(scope="module")
def pair() -> tuple[FrameMaps, FrameMaps]:
    return moved_pair()


# --- known motions


def off(T: np.ndarray, T_true: np.ndarray) -> tuple[float, float]:
    """Millimetres and degrees."""
    error = invert_rigid(T_true) @ T
    return float(np.linalg.norm(error[:3, 3])) * 1000, float(np.degrees(rotation_angle_rad(error[:3, :3])))


MOTIONS = [
    ((0.0, 0.0, 0.0), 0.0),
    ((0.03, 0.0, 0.0), 0.0),
    ((0.0, 0.0, 0.05), 0.0),
    ((-0.02, 0.03, 0.02), 3.0),
    ((0.06, -0.02, 0.03), -5.0),
]


@pytest.mark.parametrize(("shift_m", "turn_deg"), MOTIONS)
@pytest.mark.parametrize("color", [False, True])
def test_a_known_motion_is_recovered(
    shift_m: tuple[float, float, float], turn_deg: float, color: bool
) -> None:
    moved = displaced(CORNER_VIEW, shift_m, turn_deg)
    sequence = painted(ROOM, np.stack([CORNER_VIEW, moved]), texture=waves if color else None)
    target, source = frame_maps(sequence, 0), frame_maps(sequence, 1)
    found = register(source, [target], [np.eye(4)])
    off_mm, off_deg = off(found.T_target_source, invert_rigid(CORNER_VIEW) @ moved)
    assert off_mm < 1.0 and off_deg < 0.08
    assert found.inlier_share > 0.97 and found.residual_m < 0.002 and not found.degenerate
    assert np.isnan(found.intensity_correlation) != color


@pytest.mark.parametrize(("gain", "offset"), [(1.0, 0.0), (0.8, 15.0), (1.2, -20.0)])
def test_colour_fixes_what_a_plane_leaves_open_whatever_the_exposure(gain: float, offset: float) -> None:
    """A textured floor alone: depth says nothing of the walk across it, and colour does."""
    moved = displaced(STEEP, (0.02, -0.015, 0.0), 1.0)
    sequence = painted(
        [FLOOR], np.stack([STEEP, moved]), texture=waves, exposures=[(1.0, 0.0), (gain, offset)]
    )
    found = register(frame_maps(sequence, 1), [frame_maps(sequence, 0)], [np.eye(4)])
    off_mm, off_deg = off(found.T_target_source, invert_rigid(STEEP) @ moved)
    assert off_mm < 1.0 and off_deg < 0.05
    assert found.intensity_correlation > 0.98 and not found.degenerate


def test_two_targets_agree_on_one_pose() -> None:
    poses = np.stack(
        [
            CORNER_VIEW,
            displaced(CORNER_VIEW, (0.1, 0.0, 0.0), -4.0),
            displaced(CORNER_VIEW, (0.05, 0.01, 0.0), -2.0),
        ]
    )
    maps = [frame_maps(painted(ROOM, poses, noise=np.random.default_rng(5)), i) for i in range(3)]
    true = [invert_rigid(T) @ poses[2] for T in poses[:2]]
    start = [T @ rigid_from_twist(np.array([0.01, 0, 0.01, 0.01, -0.01, 0.0])) for T in true]
    found = register(maps[2], maps[:2], start, coarsest=0)
    assert off(found.T_target_source, true[0])[0] < 3.0


def test_a_strong_prior_keeps_the_start(pair: tuple[FrameMaps, FrameMaps]) -> None:
    start = rigid_from_twist(np.array([0.004, 0.0, 0.0, 0.01, 0.0, 0.0]))
    kept = register(pair[1], [pair[0]], [start], prior=1e12 * np.eye(6))
    np.testing.assert_allclose(kept.T_target_source, start, atol=1e-5)
    free = register(pair[1], [pair[0]], [start])
    assert off(free.T_target_source, invert_rigid(CORNER_VIEW) @ MOVED)[0] < 3.0


def test_the_search_finds_what_registration_misses() -> None:
    """Turned by 25 degrees and moved by 0.3 m: too far for registration from standing still."""
    moved = displaced(CORNER_VIEW, (0.25, 0.05, 0.1), -18.0)
    sequence = painted(ROOM, np.stack([CORNER_VIEW, moved]))
    target, source = frame_maps(sequence, 0), frame_maps(sequence, 1)
    found = search(source, target, np.eye(4))
    assert off(found.T_target_source, invert_rigid(CORNER_VIEW) @ moved)[0] < 5.0


# --- what is left open


def floor_pair(noise: bool) -> tuple[FrameMaps, FrameMaps]:
    moved = displaced(STEEP, (0.02, 0.0, 0.0), 0.0)
    rng = np.random.default_rng(1) if noise else None
    sequence = painted([FLOOR], np.stack([STEEP, moved]), noise=rng)
    return frame_maps(sequence, 1), frame_maps(sequence, 0)


@pytest.mark.parametrize("noise", [False, True])
def test_a_plane_is_seen_to_leave_motions_open(noise: bool) -> None:
    source, target = floor_pair(noise)
    found = register(source, [target], [np.eye(4)])
    assert found.degenerate and found.sigma_m == np.inf
    # Along the floor, and around its normal, nothing is known: shown by the information.
    normal = STEEP[:3, :3].T @ np.array([0.0, 0.0, 1.0])
    right = np.cross(normal, [0.0, 0.0, 1.0])
    for along in (right, np.cross(normal, right)):
        along = along / np.linalg.norm(along)
        twist = np.concatenate([np.zeros(3), along])
        across = np.concatenate([np.zeros(3), normal])
        assert twist @ found.information @ twist < 1e-3 * (across @ found.information @ across)
    # And noise does not drive the camera there: what it sees is not moved along the floor.
    points = source[0].points[:, :3].astype(np.float64)
    moved = transform_points(found.T_target_source, points) - points
    along_m = moved - (moved @ normal)[:, None] * normal
    assert np.linalg.norm(along_m.mean(axis=0)) < 0.01


def test_a_corner_leaves_nothing_open(pair: tuple[FrameMaps, FrameMaps]) -> None:
    found = measure(pair[1], [pair[0]], [invert_rigid(CORNER_VIEW) @ MOVED])
    assert not found.degenerate and found.sigma_m < 0.005
    assert np.linalg.eigvalsh(found.information).min() > 0


PLANES = [FLOOR, plane((1.0, 0.0, 0.0), -0.3), plane((0.0, 1.0, 0.0), -0.3)]


@pytest.mark.parametrize(
    ("view", "walls"),
    [
        (STEEP, 1),
        (STEEP, 3),
        (CORNER_VIEW, 3),
        (GRAZING, 3),
        (CORNER_VIEW, 1),
        (CORNER_VIEW, 2),
        (GRAZING, 1),
        (GRAZING, 2),
    ],
)
def test_it_takes_three_planes_to_fix_a_camera(view: NDArray[np.float64], walls: int) -> None:
    moved = displaced(view, (0.01, 0.01, 0.0), 0.5)
    sequence = painted(PLANES[:walls], np.stack([view, moved]), noise=np.random.default_rng(2))
    found = register(frame_maps(sequence, 1), [frame_maps(sequence, 0)], [np.eye(4)])
    # A narrow view of two walls leaves little room to tell noise from a third.
    assert found.degenerate or (walls == 3) == (found.sigma_m < 0.002)
    if walls < 3:
        assert found.sigma_m > 0.008
    else:
        assert not found.degenerate
        assert off(found.T_target_source, invert_rigid(view) @ moved)[0] < 2.0


# --- figures


def test_figures_of_a_wrong_pose_do_not_convince(pair: tuple[FrameMaps, FrameMaps]) -> None:
    right = measure(pair[1], [pair[0]], [invert_rigid(CORNER_VIEW) @ MOVED])
    wrong = measure(
        pair[1], [pair[0]], [displaced(invert_rigid(CORNER_VIEW) @ MOVED, (0.03, 0.02, 0.03), 2.0)]
    )
    assert right.inlier_share > 0.97 and wrong.inlier_share < 0.85
    assert wrong.residual_m > right.residual_m
    assert right.intensity_correlation > 0.95 > wrong.intensity_correlation


def test_what_is_hidden_is_no_contradiction_and_what_is_seen_through_is() -> None:
    """A box between camera and wall: the wall behind it is hidden, but the box is missed where it is gone."""
    sequence_with = painted(ROOM, CORNER_VIEW[None])
    sequence_without = painted(ROOM[:3] + ROOM[4:], CORNER_VIEW[None])
    with_box, without_box = frame_maps(sequence_with, 0), frame_maps(sequence_without, 0)
    hidden = measure(without_box, [with_box], [np.eye(4)])
    seen_through = measure(with_box, [without_box], [np.eye(4)])
    assert hidden.inlier_share > 0.97
    on_box = (
        np.abs(depth_of(ROOM, SMALL, CORNER_VIEW) - depth_of(ROOM[:3] + ROOM[4:], SMALL, CORNER_VIEW)) > 0.1
    )
    assert on_box.mean() > 0.05
    assert seen_through.inlier_share < 1 - 0.5 * on_box.mean()
    assert hidden.overlap < 1 - 0.5 * on_box.mean()


def test_nothing_in_common_is_told_as_such(pair: tuple[FrameMaps, FrameMaps]) -> None:
    away = rigid(np.diag([-1.0, 1.0, -1.0]), [0.0, 0.0, 0.0])  # looks backwards
    found = measure(pair[1], [pair[0]], [away])
    assert found.overlap < 0.02 and found.degenerate and found.signal_to_noise == 0
    found = register(pair[1], [pair[0]], [away])
    assert np.isfinite(found.T_target_source).all()


def test_twists_there_and_back() -> None:
    for twist in np.random.default_rng(0).normal(0, 0.5, (20, 6)):
        T = rigid_from_twist(twist)
        np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
        np.testing.assert_allclose(twist_from_rigid(T), twist, atol=1e-9)
    np.testing.assert_array_equal(rigid_from_twist(np.zeros(6)), np.eye(4))
    drifted = rigid(np.array(rigid_from_twist(twist)[:3, :3]) * 1.001, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(on_so3(drifted), rigid(rigid_from_twist(twist)[:3, :3], [1, 2, 3]), atol=1e-12)


def test_the_inputs_stay_as_they_are_and_the_bytes_are_the_same(pair: tuple[FrameMaps, FrameMaps]) -> None:
    before = [level.points.tobytes() + level.depth_m.tobytes() for maps in pair for level in levels(maps)]
    a, b = (register(pair[1], [pair[0]], [np.eye(4)]) for _ in range(2))
    assert a.T_target_source.tobytes() == b.T_target_source.tobytes()
    assert a.information.tobytes() == b.information.tobytes()
    assert before == [
        level.points.tobytes() + level.depth_m.tobytes() for maps in pair for level in levels(maps)
    ]


def test_exposure_follows_from_the_step(pair: tuple[FrameMaps, FrameMaps]) -> None:
    """The second image is 0.9 of the first and 12 brighter: so is what registration ends with."""
    T, exposure = invert_rigid(CORNER_VIEW) @ MOVED, np.array([1.0, 0.0])
    for _ in range(10):
        terms: LinearTerms = linearise(pair[1][0], pair[0][0], T, GATE_M, exposure)
        exposure = terms.exposure_after(np.zeros(6))
    assert exposure[0] == pytest.approx(1 / 0.9, abs=0.02)
    assert exposure[1] == pytest.approx(-12 / 0.9, abs=3)

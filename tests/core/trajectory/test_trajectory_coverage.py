"""Where cameras look, how far around, and what they share: circles of cameras with known answers."""

import numpy as np
import pytest
from analytic_scenes import CAMERA, depth_of, plane, ring, sequence_of, sphere
from health_scenes import DISTANCE_M
from typed import present

from kinectbench.core.geometry import rigid
from kinectbench.core.trajectory.coverage import (
    convergence_point,
    covered_arc_rad,
    covisibility,
    from_above,
    looked_at,
    middle_depth_m,
)


def test_axes_meet_where_the_cameras_look() -> None:
    poses = ring(9, 2.0, target=(0.4, -0.2, 0.7), elevations_rad=(0.2, 0.6))
    np.testing.assert_allclose(convergence_point(poses), [0.4, -0.2, 0.7], atol=2e-3)
    # One camera leaves the distance open: 1.5 m ahead.
    np.testing.assert_allclose(
        convergence_point(poses[:1]), poses[0, :3, 3] + 1.5 * poses[0, :3, 2], atol=1e-9
    )


@pytest.mark.parametrize("degrees", [60.0, 120.0, 200.0, 300.0])
def test_arc_of_a_part_of_a_circle(degrees: float) -> None:
    poses = ring(361, DISTANCE_M)[: round(degrees) + 1]
    assert np.degrees(present(covered_arc_rad(poses, None))) == pytest.approx(degrees * 360 / 361, rel=0.015)


def test_arc_of_a_full_circle_and_of_few_cameras() -> None:
    arc_rad = present(covered_arc_rad(ring(360, DISTANCE_M), DISTANCE_M))
    assert np.degrees(arc_rad) == pytest.approx(359, abs=0.01)
    assert covered_arc_rad(ring(5, 1.0)[:1], None) == 0
    assert covered_arc_rad(np.zeros((0, 4, 4)), None) is None


def test_someone_who_turns_about_walks_around_nothing() -> None:
    outward = ring(36, 0.3)
    outward[:, :3, :3] = outward[:, :3, :3] @ np.diag([-1.0, 1, -1])  # away from the middle
    assert covered_arc_rad(outward, None) is None


def test_axes_that_cross_by_chance_are_no_arc() -> None:
    """A camera that is shifted by 0.25 m and turned by 12 degrees, while it sees a desk 1.1 m away.

    Its axes cross 0.3 m before it, where nothing is.
    """
    turns = np.radians(np.linspace(-6, 6, 30))
    poses = np.tile(np.eye(4), (30, 1, 1))
    poses[:, 0, 0] = poses[:, 2, 2] = np.cos(turns)
    poses[:, 0, 2], poses[:, 2, 0] = np.sin(turns), -np.sin(turns)
    rng = np.random.default_rng(0)
    poses[:, :3, 3] = rng.uniform(-0.5, 0.5, (30, 3)) * [0.15, 0.15, 0.25]
    assert np.linalg.norm(convergence_point(poses)) < 0.4
    by_chance, seen = (np.degrees(present(covered_arc_rad(poses, depth_m))) for depth_m in (None, 1.1))
    assert seen < 20 < by_chance
    assert looked_at(poses, 1.1)[2] == pytest.approx(1.1, abs=0.05)


@pytest.mark.parametrize("seen_m", [0.7, 1.0, 1.9])
def test_a_thing_that_is_looked_at_is_where_the_axes_meet(seen_m: float) -> None:
    """Its front is nearer, and what is seen beside it or through it farther."""
    poses = ring(24, 1.2, target=(0.4, -0.2, 0.7))
    np.testing.assert_array_equal(looked_at(poses, seen_m), convergence_point(poses))


@pytest.mark.parametrize("degrees", [30, 90, 180, 270])
@pytest.mark.parametrize("wall_m", [0.2, 1.5, 2.0, 4.0, 9.0])
def test_the_wall_behind_a_slender_thing_takes_nothing_of_its_arc(degrees: int, wall_m: float) -> None:
    """Someone walks around a lamp 0.8 m away, and aims by hand: within 5 degrees of it."""
    poses = ring(361, 0.8)[: degrees + 1]
    aims_rad = np.radians(np.random.default_rng(1).uniform(-5, 5, (len(poses), 2)))
    for pose, (yaw, pitch) in zip(poses, aims_rad, strict=True):
        yawed = [[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]]
        pitched = [[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]]
        pose[:3, :3] = pose[:3, :3] @ np.array(yawed) @ np.array(pitched)
    assert np.degrees(present(covered_arc_rad(poses, wall_m))) == pytest.approx(degrees, abs=5)


def test_the_depth_in_the_middle() -> None:
    one = np.zeros((9, 9), np.float32)
    one[4, 4], one[0, 0] = 1.5, 9.0
    assert middle_depth_m([one, np.zeros_like(one)]) == pytest.approx(1.5)
    assert middle_depth_m([np.zeros_like(one)]) is None


def test_from_above_the_first_camera_looks_up_the_page() -> None:
    for poses in (ring(7, 2.0), ring(1, 2.0), ring(5, 1.0, elevations_rad=(np.pi / 2 - 1e-3,))):
        R = from_above(poses)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        assert np.linalg.det(R) == pytest.approx(1)
        first_ahead = R @ poses[0, :3, 2]
        assert abs(first_ahead[0]) < 1e-9 and first_ahead[1] > 0
    # Level cameras say where the vertical is, though all of them look down.
    np.testing.assert_allclose(from_above(ring(8, 2.0))[2], [0, 0, 1], atol=1e-9)
    assert from_above(ring(36, 2.0)[:12])[2, 2] > np.cos(np.radians(1))


def test_covisibility_of_a_plane() -> None:
    """Cameras look straight down at a floor 1 m below; the second stands a quarter of the image aside."""
    down = rigid(np.diag([1.0, -1, -1]), [0, 0, 1])
    width_m = CAMERA.width / CAMERA.fx
    aside, away, blind = (rigid(down[:3, :3], [x * width_m, 0, 1]) for x in (0.25, 1.5, 0.0))
    poses = np.stack([down, aside, away, blind])
    depths = [depth_of([plane((0, 0, 1), 0)], CAMERA, T) for T in poses]
    depths[3] = 0 * depths[3]
    shares = covisibility(sequence_of(depths, CAMERA), poses, np.arange(4))
    expected = np.array([[1, 0.75, 0, 0], [0.75, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 0]])
    np.testing.assert_allclose(shares, expected, atol=0.04)


def test_what_is_hidden_is_not_seen() -> None:
    """Two cameras see opposite sides of a ball."""
    poses = ring(2, DISTANCE_M)
    ball = [sphere((0, 0, 0), 0.45)]
    alone = sequence_of([depth_of(ball, CAMERA, T) for T in poses], CAMERA)
    shares = covisibility(alone, poses, np.arange(2))
    np.testing.assert_allclose(np.diag(shares), 1)
    assert shares[0, 1] < 0.02 and shares[1, 0] < 0.02

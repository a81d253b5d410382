"""The floor however cameras look: steeply down, on their side, near, by gravity, by a given plane."""

from dataclasses import replace

import numpy as np
import pytest
from analytic_scenes import CAMERA, ring, sequence_of
from bounds import within
from numpy.typing import NDArray
from raising import raises
from typed import present

from kinectbench.core.errors import SegmentationError
from kinectbench.core.geometry import invert_rigid, rigid, rotation_from_quaternion_xyzw, transform_points
from kinectbench.core.sequence import GivenTrajectory, Sequence, UpSample
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.stages.segment.find.floor import Floor, find_floor
from kinectbench.stages.segment.find.hints import FloorHint, facings, floor_hint

WORLD = rigid(rotation_from_quaternion_xyzw([0.4, -0.5, 0.2, 0.7]), [1.0, -2.0, 0.7])
UP = WORLD[:3, :3] @ [0, 0, 1]


def arc(
    elevation_deg: float, roll_deg: float = 0.0, distance_m: float = 1.5, count: int = 12, share: float = 0.15
) -> NDArray[np.float64]:
    """Some cameras of a ring, an arc of 54 degrees, each turned about its axis; world frame."""
    poses = ring(round(count / share), distance_m, (0, 0, 0.1), (np.radians(elevation_deg),))[:count]
    turn = np.radians(roll_deg)
    roll = np.eye(4)
    roll[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    return WORLD @ poses @ roll


def patch(
    center: NDArray[np.float64] | tuple[float, float, float],
    u: NDArray[np.float64] | tuple[float, float, float],
    v: tuple[float, float, float],
    noise_m: float = 0.002,
    step_m: float = 0.02,
    seed: int = 0,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points on a rectangle about a centre, spanned by two half edges (3,), and normals; world frame."""
    rng = np.random.default_rng(seed)
    along, across = np.array(u, float), np.array(v, float)
    a, b = (np.arange(-np.linalg.norm(w), np.linalg.norm(w), step_m) for w in (along, across))
    a, b = (each.ravel() for each in np.meshgrid(a, b))
    normal = np.cross(along, across) / np.linalg.norm(np.cross(along, across))
    points = np.array(center) + np.outer(a, along / np.linalg.norm(along))
    points = points + np.outer(b, across / np.linalg.norm(across))
    points += rng.normal(0, noise_m, (len(a), 1)) * normal
    normals = normal + rng.normal(0, 0.02, points.shape)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return transform_points(WORLD, points), normals @ WORLD[:3, :3].T


def joined(
    *patches: tuple[NDArray[np.float64], NDArray[np.float64]],
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    points, normals = (np.concatenate([each[k] for each in patches]) for k in (0, 1))
    return points, normals


FLOOR = patch((0, 0, 0), (0.8, 0, 0), (0, 0.8, 0))
FOCUS = transform_points(WORLD, np.array([0, 0, 0.1]))


def off(floor: Floor) -> tuple[float, float]:
    """Angle to the true floor, degrees, and height of the true origin above the plane, metres."""
    angle = np.degrees(np.arccos(min(1.0, float(floor.plane_world[:3] @ UP))))
    return angle, floor.plane_world[:3] @ WORLD[:3, 3] + floor.plane_world[3]


@pytest.mark.parametrize("elevation_deg", [20, 45, 60, 70, 80])
@pytest.mark.parametrize("roll_deg", [0, 90, -90, 20])
@pytest.mark.parametrize("distance_m", [0.5, 1.5])
def test_the_floor_is_found_whichever_way_the_cameras_look(
    elevation_deg: float, roll_deg: float, distance_m: float
) -> None:
    cameras = arc(elevation_deg, roll_deg, distance_m)
    angle_deg, height_m = off(find_floor(*FLOOR, cameras, FOCUS, 0))
    assert angle_deg < 0.3 and abs(height_m) < 0.002


@pytest.mark.parametrize("elevation_deg", [0, 10, 25])
@pytest.mark.parametrize("roll_deg", [0, 5])
def test_a_wall_that_is_looked_at_straight_on_is_no_floor(elevation_deg: float, roll_deg: float) -> None:
    cameras = arc(elevation_deg, roll_deg, share=0.05)
    toward = (WORLD[:3, :3].T @ -cameras[:, :3, 2].mean(axis=0)) * [1, 1, 0]
    toward /= np.linalg.norm(toward)
    wall = patch(-0.3 * toward, 0.8 * np.cross([0, 0, 1], toward), (0, 0, 0.8))
    assert wall[1].mean(axis=0) @ (WORLD[:3, :3] @ toward) > 0.9
    with raises(SegmentationError, "segmentation.no-floor"):
        find_floor(*wall, cameras, FOCUS, 0)


def test_cameras_held_upside_down_are_told_by_gravity_and_doubted_without_it() -> None:
    cameras = arc(40, 180)
    for hint, doubted in ((FloorHint(), True), (FloorHint(up_world=UP), False)):
        floor = find_floor(*FLOOR, cameras, FOCUS, 0, hint)
        angle_deg, height_m = off(floor)
        assert angle_deg < 0.3 and abs(height_m) < 0.002
        assert any("held upside down" in line for line in floor.warnings) == doubted
        # `inspect` says it, too, before there is such a file.
        assert all("`kinectbench build` writes the numbers to build/" in line for line in floor.warnings)


def test_gravity_keeps_a_slanted_board_from_being_the_floor() -> None:
    # Larger than the floor, it faces the cameras more squarely.
    slant = np.radians(50)
    board = patch((0, 0, 0.9), (1.2, 0, 0), (0, 1.2 * np.cos(slant), 1.2 * np.sin(slant)), seed=1)
    cameras = arc(50)
    points, normals = joined(FLOOR, board)
    angle_deg, height_m = off(find_floor(points, normals, cameras, FOCUS, 0, FloorHint(up_world=UP)))
    assert angle_deg < 0.3 and abs(height_m) < 0.002


@pytest.mark.parametrize("share", [0.3, 0.5])
def test_near_a_board_on_the_floor_is_not_taken_for_floor(share: float) -> None:
    side = 0.4 * np.sqrt(share)
    board = patch((0, 0, 0.02), (side, 0, 0), (0, side, 0), 0.001, 0.01, seed=1)
    around = patch((0, 0, 0), (0.4, 0, 0), (0, 0.4, 0), 0.001, 0.01)
    local = transform_points(invert_rigid(WORLD), around[0])
    seen = np.abs(local[:, :2]).max(axis=1) > side
    floor = find_floor(*joined(board, (around[0][seen], around[1][seen])), arc(70, distance_m=0.5), FOCUS, 0)
    assert abs(off(floor)[1]) < 0.002 and floor.noise_m < 0.002
    assert floor.scale == pytest.approx(0.5, abs=0.01)


def test_cuts_shrink_with_the_cameras_distance() -> None:
    from kinectbench.settings.models import SegmentationSettings

    settings = SegmentationSettings()
    far, near = (find_floor(*FLOOR, arc(45, distance_m=d), FOCUS, 0) for d in (1.5, 0.5))
    assert far.scale == 1 and far.cut_m(settings) == settings.floor_cut_m
    assert near.cut_m(settings) == pytest.approx(0.01, abs=1e-4)
    assert replace(near, noise_m=0.0).low_cut_m(settings) == pytest.approx(0.005, abs=1e-4)
    assert replace(near, noise_m=0.1).low_cut_m(settings) == near.cut_m(settings)


def test_a_persons_plane_is_taken_as_it_is() -> None:
    plane = np.append(UP, 0.123)
    floor = find_floor(*FLOOR, arc(45), FOCUS, 0, FloorHint(plane_world=plane))
    np.testing.assert_array_equal(floor.plane_world, plane)
    assert floor.found and np.isfinite(floor.noise_m)
    with raises(SegmentationError, "segmentation.bad-plane"):
        find_floor(*FLOOR, arc(45), FOCUS, 0, FloorHint(plane_world=-np.append(UP, -UP @ WORLD[:3, 3])))


@pytest.mark.parametrize(("turn_deg", "told"), [(0, 0), (20, 0), (40, 1), (90, 1)])
def test_a_persons_plane_off_gravity_is_told(turn_deg: float, told: int) -> None:
    """By the tolerance of the planes that are found, and not where gravity is not known."""
    right = np.cross(UP, [1.0, 0, 0]) / np.linalg.norm(np.cross(UP, [1.0, 0, 0]))
    normal = np.cos(np.radians(turn_deg)) * UP + np.sin(np.radians(turn_deg)) * right
    cameras = arc(45)
    plane = np.append(normal, 5.0)  # far below, so that no surface lies beside it
    floor = find_floor(*FLOOR, cameras, FOCUS, 0, FloorHint(UP, plane))
    assert floor.tilt_rad == pytest.approx(np.radians(turn_deg), abs=1e-6)
    assert len(floor.against) == told
    assert all(f"as `floor` is turned by {turn_deg} degrees" in line for line in floor.warnings)
    assert find_floor(*FLOOR, cameras, FOCUS, 0, FloorHint(None, plane)).against == ()


def of_a_wall(
    given: GivenTrajectory | None,
    up_world: NDArray[np.float64] | None,
    up_cameras: tuple[UpSample, ...] = (),
) -> Sequence:
    sequence = sequence_of([np.full((CAMERA.height, CAMERA.width), 1.2, np.float32)] * 12)
    return replace(sequence, given_trajectory=given, up_world=up_world, up_cameras=up_cameras)


def test_gravity_is_taken_over_into_the_world_of_the_poses_that_are_used() -> None:
    cameras, other = arc(45), invert_rigid(arc(45)[0])
    given = GivenTrajectory(np.arange(12, dtype=np.int64) * 10**8, cameras)
    used = Trajectory(given.stamps_ns, other @ cameras, "tracked")
    hint = floor_hint(of_a_wall(given, UP), used, (0, 0, 2, 1))
    np.testing.assert_allclose(present(hint.up_world), other[:3, :3] @ UP, atol=1e-9)
    np.testing.assert_allclose(present(hint.plane_world), [0, 0, 1, 0.5])
    assert floor_hint(of_a_wall(given, None), used).up_world is None
    assert floor_hint(of_a_wall(None, UP), used).up_world is None


def test_up_by_an_accelerometer_needs_no_given_poses() -> None:
    cameras = arc(45)
    stamps_ns = np.arange(12, dtype=np.int64) * 10**8
    used = Trajectory(stamps_ns, cameras, "tracked")
    ups = [UpSample(int(stamps_ns[k]), tuple(cameras[k, :3, :3].T @ UP)) for k in (1, 5, 9)]
    # One of a frame that is not there.
    ups.append(UpSample(7, (1.0, 0.0, 0.0)))
    hint = floor_hint(of_a_wall(None, None, tuple(ups)), used)
    np.testing.assert_allclose(present(hint.up_world), UP, atol=1e-9)
    other_sign = tuple(UpSample(each.stamp_ns, tuple(-np.array(each.up_camera))) for each in ups[:3])
    assert floor_hint(of_a_wall(None, None, other_sign), used).up_world is None
    # Poses of an object that is turned about agree on no direction.
    turned = Trajectory(stamps_ns, np.stack([arc(45, 120 * k)[k] for k in range(12)]), "tracked")
    assert floor_hint(of_a_wall(None, None, tuple(ups[:3])), turned).up_world is None


def test_many_frames_over_a_large_scene_take_little_memory() -> None:
    """4,000 frames that look straight down on 4,000 points: all cosines at once are 128 MB."""
    normals = np.random.default_rng(0).normal(size=(4000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    poses = np.tile(np.diag([1.0, -1, -1, 1]), (4000, 1, 1))
    steep = facings(poses, None)[-1]
    with within(20, megabytes=100):
        seen = steep(normals)
    right, ahead, up = normals.T
    np.testing.assert_array_equal(seen, (up > 0.8) & (np.maximum(np.abs(right), ahead) > 0.1))

"""Camera paths: what they look at, how fast they go, and the events on the way."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from typed import present

from kinectbench.core.geometry import Camera, OrientedBox, invert_rigid, transform_points
from kinectbench.core.geometry.mesh import TriangleMesh, box_mesh
from kinectbench.lab.simulate.path import (
    REACH_HZ,
    REACH_PEAK,
    SHAKE_HZ,
    CameraPath,
    draw_path,
    draw_waves,
    look_at,
)
from kinectbench.lab.simulate.presets import preset_spec
from kinectbench.lab.simulate.spec import PathSettings

CAMERA = Camera(640, 480, 525.0, 525.0, 319.5, 239.5)
BOX = box_mesh(OrientedBox((0, 0, 0.4), (0.6, 0.6, 0.8)))
STEADY: dict[str, Any] = {"shake_m": 0.0, "shake_rad": 0.0}


def path_of(seed: int = 0, **changes: Any) -> CameraPath:
    return draw_path(PathSettings(**changes), BOX, CAMERA, np.random.default_rng(seed))


def times(path: CameraPath) -> NDArray[np.float64]:
    return np.arange(path.settings.frames) / path.settings.rate_hz


def turns(poses: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.unwrap(np.arctan2(poses[:, 1, 3], poses[:, 0, 3]))


def test_the_camera_goes_round_and_looks_at_the_target() -> None:
    path = path_of(frames=60, arc_rad=2.2 * np.pi)
    poses = path.poses(times(path))
    rotations = poses[:, :3, :3]
    assert np.allclose(rotations @ rotations.transpose(0, 2, 1), np.eye(3), atol=1e-12)
    assert np.allclose(np.linalg.det(rotations), 1)
    for T in poses:
        at = CAMERA.project(transform_points(invert_rigid(T), path.target_room))
        assert np.linalg.norm(at - [CAMERA.cx, CAMERA.cy]) < 40
        assert T[2, 1] < -0.5  # image down is down in the room
    assert turns(poses)[-1] - turns(poses)[0] == pytest.approx(2.2 * np.pi, abs=0.1)
    assert poses[:, 2, 3].min() > 0.3


def test_without_a_distance_the_whole_subject_is_in_the_image() -> None:
    for elevation_rad in (0.1, 0.8):
        path = path_of(frames=40, elevation_rad=elevation_rad, swing_rad=0.0, **STEADY)
        for T in path.poses(times(path)):
            pixels = CAMERA.project(transform_points(invert_rigid(T), BOX.vertices))
            assert (pixels > 0).all()
            assert (pixels < [640, 480]).all()
    near = path_of(frames=10, distance_m=1.0, swing_rad=0.0, **STEADY).poses(np.zeros(1))[0]
    assert np.linalg.norm(near[:3, 3] - [0, 0, 0.4]) == pytest.approx(1.0, rel=0.15)


def test_the_camera_stays_above_the_floor() -> None:
    path = path_of(frames=200, elevation_rad=-0.2, swing_rad=1.0, swings=3.0)
    heights_m = path.poses(times(path))[:, 2, 3]
    assert 0.15 < heights_m.min() < 0.3
    assert heights_m.max() > 1.0


def test_a_path_is_smooth_in_time() -> None:
    path = path_of(frames=300)
    fine = path.poses(np.arange(0, path.duration_s, 0.002))
    steps_m = np.linalg.norm(np.diff(fine[:, :3, 3], axis=0), axis=1)
    # About 10 m in 10 s; no sample is farther than three times the mean step from the next.
    assert steps_m.max() < 3 * steps_m.mean()
    assert np.array_equal(path.poses(np.array([1.0, 2.0]))[1], path.poses(np.array([2.0]))[0])


def test_shake_has_the_stated_standard_deviation() -> None:
    waves = draw_waves(SHAKE_HZ, 6, np.random.default_rng(1))
    long = waves.at(np.arange(0, 400, 0.01))
    assert long.std(axis=0) == pytest.approx(np.ones(6), rel=0.05)
    still = path_of(frames=300, arc_rad=0.0, swing_rad=0.0, shake_m=0.02, shake_rad=0.0)
    poses = still.poses(np.arange(0, 200, 0.02))
    across = poses[:, :3, 3] @ poses[0, :3, 0]  # sideways, where the changing distance does not show
    assert across.std() == pytest.approx(0.02, rel=0.2)


def test_a_pause_stops_the_walk_and_a_steady_pace_keeps_it() -> None:
    path = path_of(frames=101, rate_hz=10.0, arc_rad=4.0, pause_s=4.0, speed_variation=0.0, **STEADY)
    turned = turns(path.poses(times(path)))
    steps = np.diff(turned)
    assert np.abs(steps[31:69]).max() < 1e-6  # from 3 s to 7 s
    assert steps[5:25] == pytest.approx(4.0 / 60, rel=0.03)
    assert turned[-1] - turned[0] == pytest.approx(4.0, rel=1e-6)


def test_a_jolt_is_sudden_and_passes() -> None:
    plain, knocked = path_of(frames=150), path_of(frames=150, jolt_m=0.08, jolt_rad=0.14)
    moved = np.linalg.norm((knocked.poses(times(knocked)) - plain.poses(times(plain)))[:, :3, 3], axis=1)
    assert moved[:100].max() == 0
    assert moved[100:110].max() == pytest.approx(0.08, rel=0.3)
    assert moved[-15:].max() < 1e-3


def seen_from(path: CameraPath) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
    """Distances and elevations (degrees) from the target, and turns, of every frame."""
    offsets = path.poses(times(path))[:, :3, 3] - path.target_room
    distances_m = np.linalg.norm(offsets, axis=1)
    rises_deg = np.degrees(np.arcsin(offsets[:, 2] / distances_m))
    return distances_m, rises_deg, np.arctan2(offsets[:, 1], offsets[:, 0])


def preset_path(name: str, subject: TriangleMesh = BOX, seed: int = 0) -> CameraPath:
    settings = preset_spec(name, {}).path
    return draw_path(settings, subject, CAMERA, np.random.default_rng(seed), min_range_m=0.4)


@pytest.mark.parametrize("seed", range(4))
def test_presets_stay_within_the_elevations_they_name(seed: int) -> None:
    for name, low, high in (("steep-v1", 55, 75), ("known-v1", 10, 45), ("hemisphere-v1", 2, 78)):
        rises_deg = seen_from(preset_path(name, seed=seed))[1]
        # A degree for the hand's shake.
        assert low - 1 < rises_deg.min() < low + 4
        assert high - 4 < rises_deg.max() < high + 1


@pytest.mark.parametrize("seed", range(2))
def test_a_low_pass_is_a_second_time_around_near_the_floor(seed: int) -> None:
    path = preset_path("known-low-v1", seed=seed)
    heights_m = path.poses(times(path))[:, 2, 3]
    first, second = heights_m[: len(heights_m) // 3], heights_m[len(heights_m) * 2 // 3 :]
    # The hand's shake, too.
    assert second.min() > 0.17 and second.max() < 0.33
    assert first.mean() > second.max()
    turns_rad = np.unwrap(seen_from(path)[2])
    low = heights_m < 0.33
    assert np.ptp(turns_rad[low]) > 1.8 * np.pi
    # Nobody drops a camera: no step is longer than what a walker does in a tenth of a second.
    assert np.linalg.norm(np.diff(path.poses(times(path))[:, :3, 3], axis=0), axis=1).max() < 0.25


@pytest.mark.parametrize(("elevation_rad", "swing_rad"), [(1.3, 0.6), (1.4, 1.0)])
def test_a_walk_rises_to_the_pole_and_not_over_it(elevation_rad: float, swing_rad: float) -> None:
    """Beyond it, what is level flips: the camera would turn half around within a frame."""
    path = path_of(frames=200, elevation_rad=elevation_rad, swing_rad=swing_rad, **STEADY)
    rotations = Rotation.from_matrix(path.poses(times(path))[:, :3, :3])
    steps_rad = (rotations[:-1].inv() * rotations[1:]).magnitude()
    assert steps_rad.max() < 0.2 and seen_from(path)[1].max() > 80


def test_a_hemisphere_is_covered_evenly_and_in_no_order() -> None:
    path = preset_path("hemisphere-v1")
    _, rises_deg, turns_rad = seen_from(path)
    # Even by area: a quarter of the views in each quarter of the height of the band, and of the circle.
    for values in (np.sin(np.radians(rises_deg)), np.mod(turns_rad, 2 * np.pi)):
        counts = np.histogram(values, 4)[0]
        assert counts.sum() == 150
        assert counts.min() > 150 / 4 * 0.8
    # The next frame is anywhere: on average 90 degrees away around the vertical, not 3 as on a walk.
    steps = np.abs(np.angle(np.exp(1j * np.diff(turns_rad))))
    assert steps.mean() == pytest.approx(np.pi / 2, rel=0.15)
    again, other = preset_path("hemisphere-v1"), preset_path("hemisphere-v1", seed=1)
    own, others = present(path.stations_rad), present(other.stations_rad)
    assert np.array_equal(own, present(again.stations_rad))
    assert not np.array_equal(own[:, 1], others[:, 1])
    assert sorted(own[:, 1]) == sorted(others[:, 1])
    # A frame that is taken a little late is of the same view.
    late = path.poses(times(path) + 0.016)[:, :3, 3]
    assert np.linalg.norm(late - path.poses(times(path))[:, :3, 3], axis=1).max() < 0.03


def test_far_is_far_and_distances_vary_by_the_share() -> None:
    distances_m = np.concatenate([seen_from(preset_path("far-v1", seed=seed))[0] for seed in range(8)])
    assert 2.4 < distances_m.min() < 2.7
    assert 3.7 < distances_m.max() < 4.1
    reach = draw_waves(REACH_HZ, 40, np.random.default_rng(2)).at(np.arange(0, 300, 0.1))
    assert 1.8 < np.abs(reach).max() < REACH_PEAK


@pytest.mark.parametrize("height_m", [0.1, 0.2, 0.3, 0.4])
def test_small_things_are_recorded_from_beyond_the_least_range(height_m: float) -> None:
    # A cube's corner is half its diagonal from its centre; the camera must see the nearest one.
    cube = box_mesh(OrientedBox((0, 0, height_m / 2), (height_m,) * 3))
    nearest_m = []
    for name in ("near-v1", "orbit-v1", "steep-v1"):
        for T in preset_path(name, cube).poses(np.arange(0, 20, 0.5)):
            points = transform_points(invert_rigid(T), cube.vertices)
            nearest_m.append(points[:, 2].min())
            pixels = CAMERA.project(points)
            # But for the tip of a corner, where the hand is nearest.
            assert (pixels > -15).all()
            assert (pixels < [655, 495]).all()
    assert min(nearest_m) > 0.38
    distances_m = seen_from(preset_path("near-v1", cube))[0]
    assert distances_m.min() > 0.45
    assert distances_m.max() < 1.05


def test_the_camera_may_be_held_lower_beside_a_table() -> None:
    for lowest_m in (0.25, 0.1):
        path = path_of(frames=200, elevation_rad=-0.2, lowest_m=lowest_m, distance_m=1.5, **STEADY)
        assert path.poses(times(path))[:, 2, 3].min() == pytest.approx(lowest_m, abs=0.06)


def test_a_single_frame_and_the_seed() -> None:
    assert path_of(frames=1).poses(np.zeros(1)).shape == (1, 4, 4)
    first, again, other = (path_of(seed=s, frames=5).poses(np.arange(5) / 30) for s in (3, 3, 4))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_look_at_is_level() -> None:
    T = look_at(np.array([0.0, -2.0, 1.0]), np.zeros(3))
    assert np.allclose(T[:3, 0], [1, 0, 0])
    assert np.allclose(transform_points(invert_rigid(T), np.zeros(3)), [0, 0, np.sqrt(5)])


def test_turns_there_and_back_are_as_fast_as_asked() -> None:
    """150 degrees a second at most, 34 degrees to either side about one axis after the other."""
    still: dict[str, Any] = {
        "arc_rad": 0.0,
        "swing_rad": 0.0,
        "shake_m": 0.0,
        "shake_rad": 0.0,
        "reach_share": 0.0,
    }
    path = path_of(frames=400, rate_hz=100.0, turn_rad=0.6, turn_rad_per_s=2.618, **still)
    turned = path.poses(np.array([0.0]))[0, :3, :3].T @ path.poses(np.arange(400) / 100)[:, :3, :3]
    vectors = Rotation.from_matrix(turned).as_rotvec()
    speeds = np.linalg.norm(Rotation.from_matrix(turned[:-1].swapaxes(1, 2) @ turned[1:]).as_rotvec(), axis=1)
    assert 100 * speeds.max() == pytest.approx(2.618, rel=0.01)
    # Roll is about z, pitch about x, yaw about y, each to either side in pi * 0.6 / 2.618 = 0.72 seconds.
    for axis, first in ((2, 0), (0, 144), (1, 288)):
        assert vectors[first : first + 72, axis].max() == pytest.approx(0.6, rel=0.01)
    assert vectors[72:144, 2].min() == pytest.approx(-0.6, rel=0.01)
    assert np.abs(vectors[144:288, 1:]).max() < 0.03

"""How badly poses fit pairs of frames: all poses at once against one point after the other."""

import numpy as np

from kinectbench.core.geometry import Camera, invert_rigid, rigid, rotation_from_quaternion_xyzw
from kinectbench.core.types import Float64
from kinectbench.doctor.fit import FramePair, disagreements

CAMERA = Camera(16, 12, 14.0, 15.0, 7.4, 5.8)
RNG = np.random.default_rng(0)


def some_poses(count: int, spread: float) -> Float64:
    turns = rotation_from_quaternion_xyzw([0, 0, 0, 1] + spread * RNG.normal(size=(count, 4)))
    return np.stack([rigid(turn, spread * RNG.normal(size=3)) for turn in turns])


def some_pair(first: int, second: int) -> FramePair:
    depth_m = RNG.uniform(1.0, 1.1, (12, 16)).astype(np.float32) * (RNG.random((12, 16)) > 0.2)
    points = CAMERA.rays().reshape(-1, 3) * RNG.uniform(1.0, 1.1, (192, 1))
    return FramePair(first, second, points, depth_m, CAMERA)


def plain(pair: FramePair, T_world_camera: Float64) -> float:
    """Point after point."""
    T_second_first = invert_rigid(T_world_camera[pair.second]) @ T_world_camera[pair.first]
    wrong, counted = 0.0, 0
    for point in pair.points:
        x, y, z = T_second_first[:3, :3] @ point + T_second_first[:3, 3]
        u, v = CAMERA.fx * x / z + CAMERA.cx, CAMERA.fy * y / z + CAMERA.cy
        if z <= 0.001 or not (0 <= u < CAMERA.width - 1 and 0 <= v < CAMERA.height - 1):
            wrong, counted = wrong + 1, counted + 1
        elif (measured_m := float(pair.depth_m[round(v), round(u)])) > 0:
            wrong, counted = wrong + min(abs(measured_m - z) / (0.1 * z), 1), counted + 1
    return wrong / max(counted, 1)


def test_all_poses_at_once_are_point_after_point() -> None:
    pairs = [some_pair(0, 2), some_pair(2, 1), some_pair(1, 3)]
    poses = np.stack([some_poses(4, spread) for spread in (0.0, 0.01, 0.05, 0.3, 2.0)])
    found = disagreements(pairs, poses)
    expected = np.array([[plain(pair, each) for pair in pairs] for each in poses])
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9)
    assert expected.min() < 0.6 and expected.max() == 1.0 and len(np.unique(expected)) >= 10


def test_what_nothing_was_measured_of_says_nothing() -> None:
    pair = some_pair(0, 1)
    blind = FramePair(0, 1, pair.points, np.zeros_like(pair.depth_m), CAMERA)
    poses = np.stack([np.tile(np.eye(4), (2, 1, 1)), some_poses(2, 0.3)])
    inside, outside = disagreements([blind], poses)[:, 0]
    assert inside == plain(blind, poses[0]) and outside == plain(blind, poses[1]) == 1.0

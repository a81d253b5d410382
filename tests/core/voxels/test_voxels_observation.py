"""Votes are believed as far as rays are narrower than voxels."""

import numpy as np
import pytest

from kinectbench.core.geometry import Camera
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.voxels.observation import (
    ray_width_m,
    seen_through_share,
    trust_in_votes,
    without_fringe,
)


@pytest.mark.parametrize(
    ("width_voxels", "expected"),
    [(0.0, 1.0), (0.8, 1.0), (0.9, 0.725), (1.0, 0.45), (1.2, 0.225), (2.0, 0.0)],
)
def test_by_the_width_of_a_ray(width_voxels: float, expected: float) -> None:
    assert trust_in_votes(width_voxels * 0.004, 0.004) == pytest.approx(expected, abs=1e-9)


def test_a_ray_is_as_wide_as_its_pixel_and_what_its_pose_is_off() -> None:
    camera = Camera(fx=500.0, fy=400.0, cx=160.0, cy=120.0, width=320, height=240)
    poses = np.tile(np.eye(4), (3, 1, 1))
    trajectory = Trajectory(np.arange(3), poses, "tracked", np.array([0.001, 0.009, np.nan]))
    # 2 m / 500 px = 4 mm, and three times the median of 1 and 9 mm; a pose that nobody checked has no part.
    assert ray_width_m(camera, trajectory.usual_pose_sigma_m, 2.0) == pytest.approx(np.hypot(0.004, 0.015))
    assert ray_width_m(camera, None, 2.0) == pytest.approx(0.004)


def test_share_of_the_frames_with_a_vote() -> None:
    free, surface = np.array([0, 3, 0], np.uint16), np.array([0, 1, 7], np.uint16)
    np.testing.assert_allclose(seen_through_share(free, surface), [0.0, 0.75, 0.0])


@pytest.mark.parametrize("trust", [1.0, 0.4])
def test_what_frames_saw_through_moves_the_surface_inward(trust):
    """By hand, 5 mm voxels: 200 mm for each share of free votes above 0.1, and 2 a voxel in front."""
    free, surface = np.array([0, 1, 6, 6, 10, 0], np.uint32), np.array([10, 9, 4, 4, 0, 0], np.uint32)
    tsdf = np.array([-0.004, -0.004, -0.004, 0.001, 0.012, 0.0], np.float32)
    raised = without_fringe(tsdf, free, surface, 0.005, trust) - tsdf
    assert raised == pytest.approx(trust * np.array([0, 0, 0.1, 0.02, 0, 0]), abs=1e-6)

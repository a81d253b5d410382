"""Votes are believed as far as rays are narrower than voxels."""

import numpy as np
import pytest

from kinectbench.core.geometry import Camera, Grid
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.core.voxels.observation import (
    Observation,
    evident_weight,
    merge,
    ray_width_m,
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
    assert ray_width_m(camera, trajectory.median_pose_sigma_m, 2.0) == pytest.approx(np.hypot(0.004, 0.015))
    assert ray_width_m(camera, None, 2.0) == pytest.approx(0.004)


@pytest.mark.parametrize("trust", [1.0, 0.4])
def test_what_frames_saw_through_moves_the_surface_inward(trust: float) -> None:
    """By hand, 5 mm voxels: 200 mm for each share of free votes above 0.15, which grows from -5 mm on."""
    free, surface = np.array([0, 1, 6, 6, 10, 0], np.uint32), np.array([10, 9, 4, 4, 0, 0], np.uint32)
    tsdf = np.array([-0.008, -0.008, -0.008, -0.0045, 0.0, -0.02], np.float32)
    raised = without_fringe(tsdf, free, surface, 0.005, trust) - tsdf
    assert raised == pytest.approx(trust * np.array([0, 0, 0.09, 0.08, 0.07, 0]), abs=1e-6)


def test_evidence_is_what_weights_were_before_they_faded() -> None:
    """By hand, 5 mm voxels: in full to 4.35 mm behind the surface, half 1.25 mm on, then a thousandth."""
    tsdf = np.array([0.02, 0.0, -0.0043, -0.0056, -0.0069, -0.02], np.float32)
    weight = np.array([3.0, 2.0, 1.0, 0.5, 0.002, 0.002], np.float32)
    assert evident_weight(tsdf, weight, 0.005) == pytest.approx(np.array([3, 2, 1, 1, 2, 2]), rel=1e-4)


def test_a_frame_that_looks_from_elsewhere_outweighs_those_that_see_it_hidden() -> None:
    """A voxel 15 mm behind what fifty say, and 2 mm before what one measures."""
    grid = Grid((1, 1, 1), 0.005, np.eye(4))

    def seen(tsdf_m: float, weight: float) -> Observation:
        votes = np.zeros((1, 1, 1), np.uint16)
        tsdf, weights = (np.full((1, 1, 1), value, np.float32) for value in (tsdf_m, weight))
        return Observation(grid, tsdf, weights, votes, votes)

    both = merge(seen(-0.015, 50.0), seen(0.002, 1.0))
    assert both.tsdf.item() == pytest.approx((-0.015 * 0.05 + 0.002) / 1.05, abs=1e-7)
    assert both.weight.item() == pytest.approx(1.05, rel=1e-5)


def test_votes_of_two_halves_stop_at_what_they_can_hold() -> None:
    """As 16-bit sums they would wrap: 40000 + 30000 to 4464."""
    grid, ones = Grid((1, 1, 3), 0.005, np.eye(4)), np.ones((1, 1, 3), np.float32)
    halves = [
        Observation(grid, ones, ones, votes, votes[..., ::-1])
        for votes in np.array([[[[40_000, 5, 65_535]]], [[[30_000, 6, 65_535]]]], np.uint16)
    ]
    both = merge(*halves)
    assert both.free.tolist() == [[[65_535, 11, 65_535]]]
    assert both.surface.tolist() == [[[65_535, 11, 65_535]]]
    assert both.free.dtype == both.surface.dtype == np.uint16

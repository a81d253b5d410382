"""Views that follow each other are told from views in no order of time."""

import numpy as np
import pytest

from kinectbench.core.trajectory.coverage import in_order_of_time
from kinectbench.lab.simulate.path import look_at


def ring(frames: int, turns: float = 1.0) -> np.ndarray:
    angles = np.linspace(0, 2 * np.pi * turns, frames, endpoint=False)
    eyes = [np.array([2 * np.cos(a), 2 * np.sin(a), 1.2]) for a in angles]
    return np.array([look_at(eye, np.zeros(3)) for eye in eyes])


@pytest.mark.parametrize("frames", [24, 40, 300])
def test_a_walk_is_in_order_and_its_shuffled_frames_are_not(frames: int) -> None:
    T = ring(frames)
    assert in_order_of_time(T)
    for seed in range(5):
        assert not in_order_of_time(T[np.random.default_rng(seed).permutation(frames)])


def test_frames_without_poses_do_not_count() -> None:
    T = ring(60)
    T[::3] = np.nan
    assert in_order_of_time(T)
    shuffled = ring(60)[np.random.default_rng(0).permutation(60)]
    shuffled[::3] = np.nan
    assert not in_order_of_time(shuffled)


def test_a_jump_and_a_camera_that_stands_still_are_in_order() -> None:
    jumping = ring(60)
    jumping[30:, :3, 3] += 1.0
    still = ring(600)[:60].copy()
    still[:, :3, 3] = still[0, :3, 3] + np.random.default_rng(0).normal(0, 0.005, (60, 3))
    assert in_order_of_time(jumping) and in_order_of_time(still) and in_order_of_time(still[:2])

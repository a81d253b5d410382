"""The offset of a trajectory's clock: known on an analytic path, and not offered where it cannot be told."""

import numpy as np
import pytest
from numpy.typing import NDArray

from kinectbench.core.geometry import rigid
from kinectbench.core.sequence import GivenTrajectory
from kinectbench.core.trajectory.clock_offset import clock_offset
from kinectbench.core.trajectory.trajectory import Trajectory
from kinectbench.stages.track.comparison import compare_with

START_NS = 1_305_031_106_000_000_000
OTHER_WORLD = rigid(np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]), np.array([1.0, 2.0, 3.0]))


def path(times_s: NDArray[np.float64], seed: int | None = None, sigma_m: float = 0.0) -> NDArray[np.float64]:
    """How a hand moves a camera about: (n, 4, 4)."""
    x = 0.3 * np.sin(2.1 * times_s) + 0.1 * np.sin(5.3 * times_s + 1)
    y = 0.2 * np.sin(3.3 * times_s + 0.5)
    points = np.stack([x, y, 0.1 * np.cos(1.7 * times_s)], axis=1)
    if seed is not None:
        points += sigma_m * np.random.default_rng(seed).standard_normal(points.shape)
    return np.stack([rigid(np.eye(3), point) for point in points])


def frames(count: int = 90, sigma_m: float = 0.002) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    times_s = 1 + np.arange(count) / 30
    return START_NS + np.rint(1e9 * times_s).astype(np.int64), OTHER_WORLD @ path(times_s, 1, sigma_m)


def reference(late_s: float, rate_hz: float = 100.0) -> GivenTrajectory:
    times_s = np.arange(0, 6, 1 / rate_hz)
    return GivenTrajectory(START_NS + np.rint(1e9 * (times_s + late_s)).astype(np.int64), path(times_s))


@pytest.mark.parametrize("late_ms", [-150, -28, 12, 28, 90])
@pytest.mark.parametrize("rate_hz", [30.0, 100.0])
def test_a_known_offset_is_found(late_ms: int, rate_hz: float) -> None:
    found = clock_offset(*frames(), reference(late_ms / 1000, rate_hz))
    assert found is not None and 1000 * found.late_s == pytest.approx(late_ms, abs=2)
    assert found.ate_moved_m == pytest.approx(0.002 * np.sqrt(3), rel=0.2)
    assert found.ate_m > found.ate_moved_m / 0.9


def test_poses_of_frames_that_were_lost_are_left_out() -> None:
    stamps_ns, poses = frames()
    poses[20:40] = np.nan
    found = clock_offset(stamps_ns, poses, reference(0.03))
    assert found is not None and found.late_s == pytest.approx(0.03, abs=0.002)


@pytest.mark.parametrize(
    ("stamps", "poses", "given"),
    [
        (*frames(), reference(0.0)),  # none
        (*frames(8), reference(0.03)),  # few frames
        (np.arange(90) * 10**9, frames()[1], reference(0.03)),  # they are counted
        (frames()[0], np.tile(np.eye(4), (90, 1, 1)), reference(0.03)),  # nothing in common
        (*frames(sigma_m=0.3), reference(0.02)),  # noise is the most of it
        (*frames(), GivenTrajectory(reference(0.0).stamps_ns[:1], reference(0.0).T_world_camera[:1])),
        (*frames(), reference(5.0)),  # another time
    ],
)
def test_nothing_is_offered_where_it_cannot_be_told(
    stamps: NDArray[np.int64], poses: NDArray[np.float64], given: GivenTrajectory
) -> None:
    assert clock_offset(stamps, poses, given) is None


def test_a_comparison_states_it() -> None:
    stamps_ns, poses = frames()
    compared, _ = compare_with(Trajectory(stamps_ns, poses, "tracked", None), reference(0.028))
    row = compared.row()
    assert row["clock_late_ms"] == pytest.approx(28, abs=2)
    moved_mm, as_it_is_mm = row["ate_rmse_moved_mm"], row["ate_rmse_mm"]
    assert moved_mm is not None and as_it_is_mm is not None and moved_mm < 0.7 * as_it_is_mm
    right, _ = compare_with(Trajectory(stamps_ns, poses, "tracked", None), reference(0.0))
    assert right.row()["clock_late_ms"] is None and right.row()["ate_rmse_moved_mm"] is None

"""The best assignment of two sets beside an exact one, and where its mean is known by a bound."""

import numpy as np
import pytest
from bounds import within
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist

from kinectbench.core.types import Float64
from kinectbench.scoring.camera import bounds
from kinectbench.scoring.camera.bounds import WITHIN, assigned_mean_m

MANY = 16_384


def shell(count: int, seed: int) -> Float64:
    points: Float64 = np.random.default_rng(seed).normal(size=(count, 3))
    shell: Float64 = points / np.linalg.norm(points, axis=1, keepdims=True)
    return shell


@pytest.mark.parametrize("shift_m", [0.0, 0.05, 3.0])
def test_it_is_the_exact_one(shift_m: float) -> None:
    one, other = shell(1500, 0), shell(1500, 1) * [1.0, 0.5, 0.2] + [shift_m, 0.0, 0.0]
    far_m = cdist(one, other)
    exact_m = far_m[linear_sum_assignment(far_m)].mean()
    found_m = assigned_mean_m(one, other)
    assert found_m is not None and exact_m * (1 - 1e-9) <= found_m <= exact_m * (1 + WITHIN)


def test_the_number_of_points_that_papers_compare() -> None:
    """No assignment to a ball 1.1 times as large is shorter than the difference of the radii."""
    points = shell(MANY, 0)
    with within(60):
        found_m = assigned_mean_m(points, 1.1 * np.random.default_rng(1).permutation(points))
    assert found_m is not None and 0.1 - 1e-9 <= found_m <= 0.1 * (1 + WITHIN)


def test_sets_that_are_equal_or_one_place() -> None:
    points = shell(500, 0)
    assert assigned_mean_m(points, points[::-1]) == pytest.approx(0.0, abs=1e-6)
    assert assigned_mean_m(points[:1].repeat(500, 0), points[:1].repeat(500, 0)) == 0.0
    # Of a ball and its middle each assignment has the same mean.
    assert assigned_mean_m(points, np.zeros((500, 3))) == pytest.approx(1.0)


def test_without_an_end_there_is_no_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bounds, "MOST_BIDS", 1)
    assert assigned_mean_m(shell(500, 0), shell(500, 1)) is None

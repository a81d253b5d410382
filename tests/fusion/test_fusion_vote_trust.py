"""Votes are believed as far as well measured surface is not seen through."""

import numpy as np
import pytest

from kinectbench.fusion.vote_trust import trust_in_votes


@pytest.mark.parametrize(
    ("usual", "expected"), [(0.05, 1.0), (0.095, 0.725), (0.11, 0.45), (0.14, 0.225), (0.3, 0.0)]
)
def test_by_what_is_usually_seen_through(usual: float, expected: float) -> None:
    tsdf = np.array([0.0, 0.002, -0.002, 0.001, 0.004, 0.0], np.float32)
    weight = np.array([4, 4, 4, 1, 4, 0], np.float32)
    # Little weight, off the surface, no weight: what frames saw through there says nothing.
    seen_through = np.array([usual, usual, usual, 0.9, 0.9, 0.9], np.float32)
    assert trust_in_votes(tsdf, weight, seen_through, 0.005) == pytest.approx(expected, abs=1e-6)


def test_without_a_surface_nothing_is_believed() -> None:
    nothing = np.zeros(3, np.float32)
    assert trust_in_votes(nothing, nothing, nothing, 0.005) == 0.0

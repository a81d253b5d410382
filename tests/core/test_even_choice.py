"""Some of many, evenly spread."""

import numpy as np
import pytest

from kinectbench.core.even_choice import evenly


@pytest.mark.parametrize("count", [0, 1, 2, 3, 7, 40, 41, 799, 12_345])
@pytest.mark.parametrize("most", [1, 2, 3, 24, 40, 1000])
def test_indices_are_spread_evenly_and_hold_both_ends(count: int, most: int) -> None:
    found = evenly(count, most)
    assert len(found) == min(most, count) and found.dtype == np.int64
    if count > 1 and most > 1:
        assert found[0] == 0 and found[-1] == count - 1
        steps = np.diff(found)
        assert steps.min() >= 1 and steps.max() - steps.min() <= 1

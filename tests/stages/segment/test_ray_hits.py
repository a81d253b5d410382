"""What 26 directions first meet, against a plain walk."""

import itertools

import numpy as np
import pytest

from kinectbench.stages.segment.solid.guess import INSIDE, NEUTRAL, OUTSIDE, UNSEEN, cast_26_rays

ALL = [way for way in itertools.product((-1, 0, 1), repeat=3) if way != (0, 0, 0)]


def walked(state: np.ndarray) -> np.ndarray:
    """How often each state is met: (3, 4, *shape), down, level and up."""
    votes = np.zeros((3, 4, *state.shape), int)
    for cell in np.ndindex(*state.shape):
        if state[cell] != UNSEEN:
            continue
        for way in ALL:
            at, met = np.array(cell), UNSEEN
            while met == UNSEEN:
                at = at + way
                within = np.all((at >= 0) & (at < state.shape))
                met = int(state[tuple(at)]) if within else OUTSIDE
            votes[(way[2] + 1, met, *cell)] += 1
    return votes


def sky_of(state: np.ndarray) -> np.ndarray:
    """Whether straight up one first meets OUTSIDE, from each UNSEEN voxel."""
    found = np.zeros(state.shape, int)
    for i, j, k in np.argwhere(state == UNSEEN):
        above = [int(each) for each in state[i, j, k + 1 :] if each != UNSEEN]
        found[i, j, k] = (above or [OUTSIDE])[0] == OUTSIDE
    return found


def grid_of(seed: int, shape: tuple[int, int, int] = (9, 11, 7)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    of = [UNSEEN, OUTSIDE, INSIDE, NEUTRAL]
    return rng.choice(of, shape, p=[0.7, 0.13, 0.12, 0.05]).astype(np.uint8)


@pytest.mark.parametrize(
    ("seed", "shape"), [(0, (9, 11, 7)), (1, (4, 3, 12)), (2, (1, 5, 6)), (3, (6, 7, 1))]
)
def test_against_a_walk(seed: int, shape: tuple[int, int, int]) -> None:
    state = grid_of(seed, shape)
    before = state.copy()
    met, votes = cast_26_rays(state), walked(state)
    assert votes[:, INSIDE].any() and votes[:, OUTSIDE].any()
    inside, outside = votes[:, INSIDE].sum(axis=0), votes[:, OUTSIDE].sum(axis=0)
    np.testing.assert_array_equal(met.inside, inside)
    np.testing.assert_array_equal(met.outside, outside)
    np.testing.assert_array_equal(met.level_outside, votes[1, OUTSIDE])
    np.testing.assert_array_equal(met.sky, sky_of(state))
    np.testing.assert_allclose(met.enclosed, inside / np.maximum(inside + outside, 1), atol=1e-6)
    assert met.enclosed.dtype == np.float32
    np.testing.assert_array_equal(state, before)


def test_by_hand() -> None:
    state = np.full((5, 5, 5), INSIDE, np.uint8)
    state[1:4, 1:4, 1:4] = UNSEEN
    np.testing.assert_array_equal(cast_26_rays(state).enclosed[1:4, 1:4, 1:4], 1.0)
    # From beside an open side nine of the 26 directions lead there, three of them level.
    state[4] = OUTSIDE
    met = cast_26_rays(state)
    assert met.enclosed[3, 2, 2] == np.float32(17 / 26)
    assert met.level_outside[3, 2, 2] == 3
    # Directions that end in what is neutral do not count.
    state[4] = NEUTRAL
    assert cast_26_rays(state).enclosed[3, 2, 2] == 1


def test_where_nothing_is_met_nothing_is_enclosed() -> None:
    met = cast_26_rays(np.full((3, 3, 3), UNSEEN, np.uint8))
    assert not met.enclosed.any() and (met.outside == len(ALL)).all()
    nothing = cast_26_rays(np.full((3, 3, 3), NEUTRAL, np.uint8))
    assert not nothing.inside.any() and not nothing.outside.any()

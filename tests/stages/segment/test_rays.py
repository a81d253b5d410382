"""What 26 directions first meet, against a plain walk."""

import itertools

import numpy as np
import pytest

from kinectbench.stages.segment.rays import (
    BEYOND,
    DIRECTIONS,
    INSIDE,
    NEUTRAL,
    OUTSIDE,
    SEALED,
    UNSEEN,
    tally_rays,
)

COUNTED = (INSIDE, OUTSIDE, SEALED, BEYOND)
ALL = [way for way in itertools.product((-1, 0, 1), repeat=3) if way != (0, 0, 0)]


def walked(state: np.ndarray) -> np.ndarray:
    """How often each state is met: (3, 6, *shape), down, level and up."""
    votes = np.zeros((3, 6, *state.shape), int)
    for cell in np.ndindex(*state.shape):
        if state[cell] != UNSEEN:
            continue
        for way in ALL:
            at, met = np.array(cell), UNSEEN
            while met == UNSEEN:
                at = at + way
                within = np.all((at >= 0) & (at < state.shape))
                met = int(state[tuple(at)]) if within else BEYOND
            votes[(way[2] + 1, met, *cell)] += 1
    return votes


def grid_of(seed: int, shape: tuple[int, int, int] = (9, 11, 7)) -> np.ndarray:
    rng = np.random.default_rng(seed)
    of = [UNSEEN, OUTSIDE, INSIDE, NEUTRAL, SEALED]
    return rng.choice(of, shape, p=[0.7, 0.08, 0.12, 0.05, 0.05]).astype(np.uint8)


@pytest.mark.parametrize(
    ("seed", "shape"), [(0, (9, 11, 7)), (1, (4, 3, 12)), (2, (1, 5, 6)), (3, (6, 7, 1))]
)
def test_against_a_walk(seed: int, shape: tuple[int, int, int]):
    state = grid_of(seed, shape)
    tally, votes = tally_rays(state), walked(state)
    for met in COUNTED:
        assert votes[:, met].any()
        np.testing.assert_array_equal(tally.down(met), votes[0, met])
        np.testing.assert_array_equal(tally.level(met), votes[1, met])
        np.testing.assert_array_equal(tally.up(met), votes[2, met])
        np.testing.assert_array_equal(tally.all(met), votes[:, met].sum(axis=0))
    np.testing.assert_array_equal(tally.up(OUTSIDE, BEYOND), votes[2, [OUTSIDE, BEYOND]].sum(axis=0))
    np.testing.assert_array_equal(tally.all(*COUNTED), votes[:, COUNTED].sum(axis=(0, 1)))
    inside, counted = votes[:, INSIDE].sum(axis=0), votes[:, COUNTED].sum(axis=(0, 1))
    np.testing.assert_allclose(tally.enclosed, inside / np.maximum(counted, 1), atol=1e-6)
    assert tally.enclosed.dtype == np.float32 and tally.all(INSIDE).dtype == np.uint8


def test_every_direction_of_an_unseen_voxel_ends_and_none_of_another():
    state = np.where(np.isin(grid_of(4), [NEUTRAL]), UNSEEN, grid_of(4)).astype(np.uint8)
    np.testing.assert_array_equal(tally_rays(state).all(*COUNTED), np.where(state == UNSEEN, DIRECTIONS, 0))


def test_by_hand():
    state = np.full((5, 5, 5), INSIDE, np.uint8)
    state[1:4, 1:4, 1:4] = UNSEEN
    np.testing.assert_array_equal(tally_rays(state).enclosed[1:4, 1:4, 1:4], 1.0)
    # From beside an open side nine of the 26 directions lead there, three of each slope.
    state[4] = OUTSIDE
    tally = tally_rays(state)
    assert tally.enclosed[3, 2, 2] == np.float32(17 / 26)
    assert [int(way(OUTSIDE)[3, 2, 2]) for way in (tally.down, tally.level, tally.up)] == [3, 3, 3]
    # A narrow opening counts as any for what is enclosed, but is told apart.
    state[4] = SEALED
    tally = tally_rays(state)
    assert tally.enclosed[3, 2, 2] == np.float32(17 / 26)
    assert tally.all(SEALED)[3, 2, 2] == 9 and tally.all(OUTSIDE)[3, 2, 2] == 0
    # Directions that end in what is neutral do not count.
    state[4] = NEUTRAL
    assert tally_rays(state).enclosed[3, 2, 2] == 1


def test_where_nothing_is_met_nothing_is_enclosed():
    tally = tally_rays(np.full((3, 3, 3), UNSEEN, np.uint8))
    assert not tally.enclosed.any() and (tally.all(BEYOND) == DIRECTIONS).all()
    assert not tally_rays(np.full((3, 3, 3), NEUTRAL, np.uint8)).by_slope.any()


def test_input_is_left_alone():
    state = np.asfortranarray(grid_of(5, (6, 5, 4)))
    before = state.copy()
    np.testing.assert_array_equal(tally_rays(state).all(INSIDE), walked(before)[:, INSIDE].sum(axis=0))
    np.testing.assert_array_equal(state, before)

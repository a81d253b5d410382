"""What a top hides: hollows behind aprons, and shadows under the object."""

import numpy as np
import pytest

from kinectbench.stages.segment.enclosure import Hollows, Shadow, _open_beneath, hollows, shadow
from kinectbench.stages.segment.rays import INSIDE, OUTSIDE, UNSEEN, tally_rays


def seat(*, apron_inset: int | None, thick: int = 3) -> np.ndarray:
    """A top of 40 x 40 voxels seen from above and from the sides, open below: the state of each voxel.

    The top is `thick` voxels high with an apron of 12 that many voxels farther in; None: it is a block of
    both heights. Only their outer two voxels were measured.
    """
    state = np.full((60, 60, 40), OUTSIDE, np.uint8)
    for low, high, inset in ((18, 30, apron_inset or 0), (30, 30 + thick, 0)):
        a, b = 10 + inset, 50 - inset
        state[a:b, a:b, low:high] = INSIDE
        top = high - 2 if high > 30 else high
        state[a + 2 : b - 2, a + 2 : b - 2, low:top] = UNSEEN
    return state


def shadow_of(state: np.ndarray) -> Shadow:
    return shadow(state, tally_rays(state))


def hollows_of(state: np.ndarray, voxel_size_m: float) -> Hollows:
    return hollows(state, tally_rays(state), voxel_size_m)


@pytest.mark.parametrize("inset", [1, 2, 4])
def test_behind_an_apron_is_hollow(inset):
    found = hollows_of(seat(apron_inset=inset), 0.005).sure
    inner = np.zeros_like(found)
    inner[10 + inset + 2 : 50 - inset - 2, 10 + inset + 2 : 50 - inset - 2, 18:30] = True
    # Not in the corners, which two aprons enclose.
    assert found[26:34, 26:34, 18:30].all() and found[inner].mean() > 0.8 and not found[~inner].any()


def test_a_frayed_edge_of_the_top_is_no_hollow():
    """Noise took two voxels off the lower edge of the top: its lowest layer is solid all the same."""
    state = seat(apron_inset=6, thick=6)
    state[10:50, 10:50, 30] = OUTSIDE
    state[12:48, 12:48, 30] = INSIDE
    state[14:46, 14:46, 30] = UNSEEN
    found = hollows_of(state, 0.005).sure
    assert not found[:, :, 30:].any() and found[26:34, 26:34, 18:30].all()


@pytest.mark.parametrize(("lean", "is_hollow"), [(0.0, True), (0.1, True), (0.5, False), (1.0, False)])
def test_a_body_that_leans_in_is_not_hollow(lean: float, is_hollow: bool):
    """Below a top that juts out by two voxels the sides step in by so many voxels with each layer."""
    state = seat(apron_inset=2)
    state[:, :, 18:30] = OUTSIDE
    for layer in range(18, 30):
        a = 12 + int(lean * (29 - layer))
        state[a : 60 - a, a : 60 - a, layer] = INSIDE
        state[a + 2 : 58 - a, a + 2 : 58 - a, layer] = UNSEEN
    assert hollows_of(state, 0.005).sure.any() == is_hollow


def test_a_flush_block_is_not_hollow():
    found = hollows_of(seat(apron_inset=None), 0.005)
    assert not found.sure.any()
    # It could be one all the same: from above nobody can tell.
    assert found.doubtful.sum() > 100


def test_a_cushion_rounded_below_is_solid_to_its_underside():
    """Its lowest two layers step in, and no camera saw what is under it."""
    state = np.full((60, 60, 60), OUTSIDE, np.uint8)
    for low, high, inset in ((30, 32, 2), (32, 46, 0)):
        a, b = 10 + inset, 50 - inset
        state[a:b, a:b, low:high] = INSIDE
        state[a + 2 : b - 2, a + 2 : b - 2, low : min(high, 44)] = UNSEEN
    state[14:46, 14:46, 18:30] = UNSEEN
    assert not hollows_of(state, 0.005).sure[:, :, 30:].any()
    state[12:48, 12:48, 26:30] = state[12:48, 12:48, 31, None]  # an apron six layers high, 30 mm
    assert hollows_of(state, 0.005).sure[26:34, 26:34, 26:32].all()


def test_a_deep_body_under_a_top_is_not_hollow():
    # Twelve voxels of 20 mm are more than an apron's height: only the upper part may be hollow.
    assert not hollows_of(seat(apron_inset=2), 0.02).sure[:, :, 18:24].any()


@pytest.mark.parametrize(("state_beneath", "directions", "kept"), [
    (UNSEEN, 9, True), (UNSEEN, 14, False), (UNSEEN, 17, True), (INSIDE, 0, False), (OUTSIDE, 0, True),
])  # fmt: skip
def test_what_lies_beneath_a_hollow(state_beneath: int, directions: int, kept: bool):
    """By hand: under most of a piece it is open, or the apron goes on; the other piece is open below."""
    hollow = np.zeros((12, 6, 8), bool)
    hollow[1:5, 1:5, 4:7] = hollow[7:11, 1:5, 4:7] = True
    state, enclosed = np.full(hollow.shape, UNSEEN, np.uint8), np.full(hollow.shape, 9 / 26, np.float32)
    state[1:4, 1:5, 3], enclosed[1:4, 1:5, 3] = state_beneath, directions / 26
    found = _open_beneath(hollow, state, enclosed)
    assert (found[:6] == (hollow[:6] & kept)).all() and (found[6:] == hollow[6:]).all()


def test_a_deep_flush_block_is_not_even_doubted():
    assert not hollows_of(seat(apron_inset=None), 0.02).doubtful.any()


def test_closed_below_is_not_hollow():
    state = seat(apron_inset=2)
    state[12:48, 12:48, 17] = INSIDE
    found = hollows_of(state, 0.005)
    assert not found.sure.any() and not found.doubtful.any()


def under_a_top(*level: tuple[int, int]) -> np.ndarray:
    """A top over unseen voxels in a seen room, and INSIDE columns beside the middle one at (4, 4)."""
    state = np.full((9, 9, 6), OUTSIDE, np.uint8)
    state[1:8, 1:8, 1:] = UNSEEN
    state[1:8, 1:8, 4:] = INSIDE
    for i, j in level:
        state[i, j, 1:4] = INSIDE
    return state


FOUR = ((4, 6), (4, 2), (6, 4), (2, 4))
CORNERS = ((2, 2), (2, 6), (6, 2), (6, 6))


@pytest.mark.parametrize(
    ("level", "under", "empty"),
    [
        ((), True, True),
        (FOUR[:2], True, True),
        (FOUR[:3], True, False),
        (FOUR, True, False),
        ((*FOUR, CORNERS[0]), False, False),  # five of eight: as enclosed as a solid
        (((4, 4),), False, False),
    ],
)
def test_what_is_only_under_a_top_is_in_its_shadow(level, under, empty):
    state = under_a_top(*level)
    found = shadow_of(state)
    assert found.under[4, 4, 1] == under and found.empty[4, 4, 1] == empty
    assert not (found.under | found.empty)[:, :, 4:].any()


def test_a_corner_that_only_two_sides_enclose_is_in_the_object():
    """Seen from one corner only: no camera looked at the other sides; nothing says one can pass there."""
    state = np.full((9, 9, 6), UNSEEN, np.uint8)
    state[:, :, 4:], state[0], state[:, 0] = INSIDE, INSIDE, INSIDE
    assert not shadow_of(state).under[1:5, 1:5].any()
    state[:, 0] = UNSEEN
    assert shadow_of(state).under[4, 4, 1]


def test_what_stands_under_a_top_is_not_in_its_shadow():
    """A leg was seen but for its upper end: what goes on above it is no shadow."""
    state = under_a_top()
    state[4, 4, 1:3] = INSIDE
    assert not shadow_of(state).under[4, 4, 3]
    assert shadow_of(state).under[4, 5, 3]


def test_what_little_encloses_is_in_a_shadow():
    state = np.full((9, 9, 9), OUTSIDE, np.uint8)
    state[1:8, 1:8, 1:8] = UNSEEN
    state[6, 2:7, 4] = INSIDE  # 3 of 26 directions from two voxels beside it
    found = shadow_of(state)
    assert found.empty[4, 4, 4] and not found.empty[0].any() and not found.empty[6, 4, 4]
    assert not found.under[4, 4, 4]
    thicker = state.copy()
    thicker[6, 2:7, 2:7] = INSIDE  # 9 of 26
    assert not shadow_of(thicker).empty[4, 4, 4]


def test_what_lies_beyond_the_frames_is_in_no_shadow():
    """The same, but on one side nothing was ever seen: the object may go on there."""
    state = np.full((9, 9, 9), OUTSIDE, np.uint8)
    state[1:8, 1:8, :8] = UNSEEN
    state[6, 2:7, 4] = INSIDE
    assert not shadow_of(state).empty[4, 4, 4]
    table = under_a_top()
    assert shadow_of(table).empty[4, 4, 1]
    table[4, 0] = UNSEEN
    assert not shadow_of(table).empty[4, 4, 1]

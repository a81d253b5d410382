"""Lines of sight against plain walks, line by line."""

from dataclasses import replace
from functools import reduce

import numpy as np
import pytest

from kinectbench.core.voxels import lines_of_sight
from kinectbench.core.voxels.line_kernels import (
    BLOCKED,
    FROM_ABOVE,
    FROM_BELOW,
    ONE_WAY,
    PASSABLE,
    PLACE,
    SEEN,
)
from kinectbench.core.voxels.lines_of_sight import (
    FEWER,
    Space,
    _joined,
    _swept_along,
    count_seen,
    directions,
    seen_along,
    seen_outwards,
    ways_along,
)
from kinectbench.core.voxels.seeable import seen_around_corners
from kinectbench.core.voxels.sight import FINER, further_directions

VOXEL_M, NEAR_M, LEAST_M = 0.1, 0.25, 0.15


def scene(seed: int, shape: tuple[int, int, int] = (9, 8, 7)) -> tuple[np.ndarray, np.ndarray]:
    """Random states, and heights of their layers; the lowest are below the plane."""
    rng = np.random.default_rng(seed)
    state = rng.choice(np.array([PASSABLE, PLACE, BLOCKED], np.uint8), shape, p=[0.62, 0.03, 0.35])
    return state, ((np.arange(shape[2]) - 0.5) * VOXEL_M).astype(np.float32)


def beyond_m(height_m: float, up: float) -> float:
    """How far the farthest camera in the open is."""
    if up > 1e-9:
        return np.inf
    if up > -1e-9:
        return np.inf if height_m >= LEAST_M else -np.inf
    return (height_m - LEAST_M) / -up if height_m >= LEAST_M else -np.inf


def walked(
    state: np.ndarray, heights_m: np.ndarray, cell: tuple[int, ...], way: np.ndarray, slices: bool
) -> bool:
    """Whether a voxel is seen along one direction: the same steps, voxel by voxel, in plain Python.

    Args:
        state: of the voxels.
        heights_m: of the layers.
        cell: the voxel.
        way: unit vector to the camera.
        slices: the line is rounded as one of those through a whole slice, else from the voxel's middle.
    """
    main = int(np.argmax(np.abs(way)))
    slope = way / abs(way[main])
    # A sweep counts slices from the cameras' end.
    end = state.shape[main] - 1 if way[main] > 0 else 0
    start = abs(end - cell[main]) if slices else 0
    far_m, seen, last = 0.0, False, cell
    for count in range(max(state.shape) + 1):
        shift = (
            np.rint(-slope * (start - count)) - np.rint(-slope * start) if slices else np.rint(slope * count)
        )
        shift[main] = np.sign(way[main]) * count
        at = tuple((np.array(cell) + shift).astype(int))
        far_m = count * VOXEL_M / abs(way[main])
        if not all(0 <= a < n for a, n in zip(at, state.shape, strict=True)):
            before_m = (count - 1) * VOXEL_M / abs(way[main])
            return seen or before_m + beyond_m(heights_m[last[2]], way[2]) >= NEAR_M
        if state[at] == BLOCKED:
            return seen
        seen = seen or bool(state[at] == PLACE and far_m >= NEAR_M - 1e-6)
        last = at
    return seen


def plainly(state: np.ndarray, heights_m: np.ndarray, ways: np.ndarray, slices: bool) -> np.ndarray:
    seen = np.zeros(state.shape, np.uint8)
    for cell in np.ndindex(state.shape):
        for way in ways:
            if walked(state, heights_m, cell, way, slices):
                seen[cell] |= FROM_BELOW if way[2] < -1e-9 else FROM_ABOVE
    return seen


@pytest.mark.parametrize("seed", range(3))
def test_sweeps_see_what_walks_see(seed: int) -> None:
    state, heights_m = scene(seed)
    ways = directions(30)
    seen = seen_along(Space(state, heights_m, VOXEL_M, NEAR_M, LEAST_M), ways)
    np.testing.assert_array_equal(seen, plainly(state, heights_m, ways, slices=True))
    assert {0, FROM_ABOVE, FROM_ABOVE | FROM_BELOW} <= {*np.unique(seen).tolist()}


def test_a_camera_may_have_to_be_more_steps_away_than_fit_in_eight_bits() -> None:
    state = np.full((400, 1, 1), PASSABLE, np.uint8)
    state[-2:, 0, 0] = PLACE, BLOCKED
    space = Space(state, np.ones(1, np.float32), VOXEL_M, 25.25, LEAST_M)  # from 253 voxels on
    seen = seen_along(space, np.array([[1.0, 0.0, 0.0]]))
    assert np.flatnonzero(seen[:, 0, 0]).tolist() == list(range(398 - 253 + 1))


def test_pieces_are_counted_direction_by_direction() -> None:
    state, heights_m = scene(7)
    space = Space(state, heights_m, VOXEL_M, NEAR_M, LEAST_M)
    ways = directions(40)
    pieces = np.random.default_rng(7).integers(0, 4, state.shape).astype(np.int32)
    counted = count_seen(space, ways, pieces)
    assert counted[:, 1:].any()
    for way, counts in zip(ways, counted, strict=True):
        seen = seen_along(space, way[None]) > 0
        assert counts[1:].tolist() == [np.count_nonzero(seen & (pieces == piece)) for piece in (1, 2, 3)]


def test_what_is_seen_grows_until_no_neighbour_sees() -> None:
    state, heights_m = scene(5)
    few, many = directions(8), directions(60)
    space = Space(state, heights_m, VOXEL_M, NEAR_M, LEAST_M)
    first = seen_along(space, few)
    grown = seen_around_corners(space, first, many)
    possible = plainly(state, heights_m, many, slices=False)
    added = (grown > 0) & (first == 0)
    assert added.any() and not (added & (possible == 0)).any()
    for axis in range(3):
        for step in (-1, 1):
            beside = np.roll(grown > 0, step, axis)
            edge: list[slice | int] = [slice(None)] * 3
            edge[axis] = 0 if step == 1 else -1
            beside[tuple(edge)] = False
            missed = beside & (state != BLOCKED) & (grown == 0) & (possible > 0)
            assert not missed.any()


def test_directions_are_counted_up_to_three() -> None:
    state, heights_m = scene(3)
    space, ways = Space(state, heights_m, VOXEL_M, NEAR_M, LEAST_M), directions(12)
    counted = ways_along(space, ways) // ONE_WAY
    plain = sum((seen_along(space, way[None]) > 0).astype(int) for way in ways)
    np.testing.assert_array_equal(counted, np.minimum(plain, 3))
    assert {0, 1, 2, 3} == {*np.unique(counted).tolist()}


@pytest.mark.parametrize("up", [False, True])
def test_more_directions_are_tried_behind_a_gap(up: bool) -> None:
    """A box with a slot in its top or floor: deep in it 400 directions see only single voxels."""
    state = np.full((60, 60, 60), PASSABLE, np.uint8)
    state[5:55, 5:55, 5:50], state[6:54, 6:54, 6:49] = BLOCKED, PASSABLE
    state[27:31, 10:50, 49 if up else 5] = PASSABLE
    wide = state.copy()
    wide[27, 10:50, 49 if up else 5] = BLOCKED
    narrow, wider = (
        Space(each, np.full(60, np.inf, np.float32), VOXEL_M, NEAR_M, LEAST_M) for each in (state, wide)
    )
    ways, many = (each[(each[:, 2] >= 0) == up] for each in (directions(400), directions(25600)))
    nothing, spacing_rad = np.zeros_like(state), np.sqrt(4 * np.pi / 400)
    marks = ways_along(narrow, ways)
    first = marks & np.uint8(SEEN)
    np.testing.assert_array_equal(first, seen_along(narrow, ways))
    added = further_directions(narrow, marks, ways, spacing_rad, nothing)
    further = seen_along(wider, added)
    inside = np.zeros(state.shape, bool)
    inside[6:54, 6:54, 6:49] = True
    all_of_them = seen_along(wider, many)
    missed = [int((inside & (seen == 0) & (all_of_them > 0)).sum()) for seen in (first, first | further)]
    assert missed[1] < 0.05 * missed[0] and missed[0] > 1000
    # Nothing is seen along a line that something stops.
    lattice = directions(FINER)
    assert not (further & ~seen_along(wider, lattice[(lattice[:, 2] >= 0) == up])).any()
    # The search outwards finds what a search everywhere finds, and of the wanted voxels alone.
    outwards = seen_outwards(wider, added, None)
    lost = inside & (further > 0) & (outwards == 0)
    assert not (outwards & ~further).any() and lost.sum() < 0.001 * (inside & (further > 0)).sum()
    swept = seen_along(wider, added[::FEWER])
    assert ((outwards > 0) & (swept == 0) & inside).sum() > 1000
    np.testing.assert_array_equal(seen_outwards(wider, added, np.zeros_like(inside)), swept)
    # Nothing is searched for that was seen before.
    assert not len(further_directions(narrow, marks, ways, spacing_rad, nothing + 1))


@pytest.mark.parametrize("voxels", [0, 1.6, 10**9])
@pytest.mark.parametrize("seed", range(3))
def test_few_voxels_are_walked_from_with_the_same_result(
    monkeypatch: pytest.MonkeyPatch, seed: int, voxels: float
) -> None:
    """Voxels that some directions left are walked from or swept over: marks are as of one by one."""
    state, heights_m = scene(seed, (11, 9, 10))
    space = Space(state, heights_m, VOXEL_M, NEAR_M, LEAST_M)
    rng = np.random.default_rng(seed)
    wanted = rng.random(state.shape) < 0.3
    fewer = replace(
        space, state=np.where((state == PLACE) & (rng.random(state.shape) < 0.5), PASSABLE, state)
    )
    ways, differ = directions(60), 0
    for to_camera in (ways, ways[ways[:, 2] >= -1e-9], ways[ways[:, 2] < -1e-9]):
        one_by_one = [_swept_along(space, way[None]) for way in to_camera]
        plain = reduce(_joined, one_by_one)
        monkeypatch.setattr(lines_of_sight, "VOXELS_A_WALK", voxels)
        less = ways_along(fewer, to_camera)
        np.testing.assert_array_equal(ways_along(space, to_camera), plain)
        np.testing.assert_array_equal(ways_along(space, to_camera, less=less), plain)
        np.testing.assert_array_equal(ways_along(space, to_camera, wanted=wanted)[wanted], plain[wanted])
        assert not (ways_along(space, to_camera, ONE_WAY, wanted) & np.uint8(SEEN) & ~plain).any()
        differ += int(np.count_nonzero(less != plain))
    assert differ


def test_directions_are_spread_over_the_sphere() -> None:
    ways = directions(400)
    np.testing.assert_allclose(np.linalg.norm(ways, axis=1), 1)
    anywhere = np.random.default_rng(0).normal(size=(500, 3))
    anywhere /= np.linalg.norm(anywhere, axis=1, keepdims=True)
    # Of 400 even caps each reaches 5.7 degrees; a lattice leaves holes up to twice as wide.
    assert np.degrees(np.arccos((anywhere @ ways.T).max(axis=1).clip(-1, 1))).max() < 9
    assert {(0.0, 0.0, 1.0), (0.0, 0.0, -1.0)} <= {tuple(way) for way in ways.tolist()}

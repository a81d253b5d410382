"""Voxels of an upright grid that a camera sees along a straight line: sweeps over sampled directions.

A sweep follows all lines of one direction at once, slice by slice from the cameras' end. For each line it
keeps the distance of the farthest camera from which nothing hides the line's current voxel. A direction thus
visits each voxel once.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce
from typing import Final

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.threads import ahead
from kinectbench.core.types import Float32, Float64

# The state of a voxel: a line passes; it passes, and a camera can be here; no line passes.
PASSABLE: Final = 0
PLACE: Final = 1
BLOCKED: Final = 2
# How a voxel is seen; a bit each: by a camera that is as high as it or higher, and by a lower one.
FROM_ABOVE: Final = 1
FROM_BELOW: Final = 2
SEEN: Final = FROM_ABOVE | FROM_BELOW
# Beside these bits: along how many directions a voxel is seen, in steps of `ONE_WAY`, up to three.
ONE_WAY: Final = 4
MOST_WAYS: Final = 3 * ONE_WAY
# Distances that stand for "there is none" and for "at any distance".
_NONE, _FAR = np.float32(-1e9), np.float32(1e9)
# A direction whose vertical part is smaller is level.
LEVEL: Final = 1e-9
# One thread marks the voxels of this many directions: to join the marks then takes no 1 % of the time.
AT_ONCE = 32
# The lines of this many directions through a slice of a chair's grid lie in a core's cache.
IN_CACHE = 8


@dataclass(frozen=True)
class Space:
    """Where lines of sight pass and cameras can be, on an upright grid.

    Attributes:
        state: (nx, ny, nz) uint8, its last axis up: PASSABLE, PLACE (passable, and a camera can be there) or
            BLOCKED.
        heights_m: (nz,) float32, heights of the layers' middles above the floor, metres; infinite without
            a floor.
        voxel_size_m: edge of a voxel, metres.
        near_m: smallest distance from a camera at which it sees, metres.
        least_height_m: smallest height above the floor of a camera outside the grid, metres.
    """

    state: NDArray[np.uint8]
    heights_m: Float32
    voxel_size_m: float
    near_m: float
    least_height_m: float

    @property
    def lengths_m(self) -> tuple[np.float32, np.float32, np.float32]:
        """`voxel_size_m`, `near_m` and `least_height_m` as float32 for the kernels."""
        return np.float32(self.voxel_size_m), np.float32(self.near_m), np.float32(self.least_height_m)


def directions(count: int) -> Float64:
    """Return unit vectors (n, 3) from a point to cameras: a Fibonacci lattice, level directions, up, down.

    Level and vertical directions are added because the narrow gaps of objects on a floor run along them.

    Args:
        count: number of directions of the lattice; the added level directions have the same spacing.
    """
    at = np.arange(count) + 0.5
    z = 1 - 2 * at / count
    turn = np.pi * (1 + np.sqrt(5)) * at
    ball = np.stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z], axis=1)
    level = 2 * np.pi * np.arange(round(np.sqrt(np.pi * count))) / round(np.sqrt(np.pi * count))
    ring = np.stack([np.cos(level), np.sin(level), np.zeros(len(level))], axis=1)
    return np.concatenate([ball, ring, [[0, 0, 1], [0, 0, -1]]])


def seen_along(space: Space, to_camera: Float64) -> NDArray[np.uint8]:
    """Return the marks of `ways_along` without the number of directions: FROM_ABOVE, FROM_BELOW, both, 0."""
    return ways_along(space, to_camera) & np.uint8(SEEN)


def ways_along(space: Space, to_camera: Float64) -> NDArray[np.uint8]:
    """Find the voxels that cameras see along some directions, from a PLACE or from outside the grid.

    Outside the grid nothing blocks a line, and a camera can be anywhere at or above `least_height_m`. Lines
    are followed slice by slice along the axis of their largest component.

    Args:
        space: the voxels.
        to_camera: (n, 3) unit vectors, from a point to a camera.

    Returns:
        (nx, ny, nz) uint8: FROM_ABOVE (by a camera as high as the voxel or higher), FROM_BELOW, or both (3),
        plus ONE_WAY times the number of these directions, at most 3; 0 if not seen.
    """
    seen = np.zeros(space.state.shape, np.uint8)
    for turned in _turned_along(space, to_camera):
        groups = np.split(turned.ways, range(AT_ONCE, len(turned.ways), AT_ONCE))
        marks = reduce(_joined, ahead(turned.ways_along, (to_camera[ways] for ways in groups)))
        seen = _joined(seen, np.ascontiguousarray(marks.transpose(np.argsort(turned.order))))
    return seen


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _joined(ours, theirs):  # type: ignore[no-untyped-def]
    """Join two results of `ways_along` for different directions: all bits, and the sum of both numbers."""
    joined, a, b = np.empty_like(ours), ours.reshape(-1), theirs.reshape(-1)
    flat = joined.reshape(-1)
    for n in range(len(flat)):
        ways = min(np.uint8((a[n] & MOST_WAYS) + (b[n] & MOST_WAYS)), np.uint8(MOST_WAYS))
        flat[n] = ((a[n] | b[n]) & SEEN) | ways
    return joined


def count_seen(space: Space, to_camera: Float64, pieces: NDArray[np.int32]) -> NDArray[np.int64]:
    """Count the voxels of each labelled piece that are seen along each direction.

    Args:
        space: the voxels.
        to_camera: (n, 3) unit vectors, from a point to a camera.
        pieces: (nx, ny, nz), each voxel's label, from 1 to k; 0: part of no piece.

    Returns:
        (n, k + 1): [i, p] is the number of seen voxels of piece p along direction i; column 0 is 0.
    """
    count = int(pieces.max()) + 1
    seen = np.zeros((len(to_camera), count), np.int64)
    if count == 1:
        return seen
    for turned in _turned_along(space, to_camera):
        flat = pieces.transpose(turned.order).reshape(-1)
        at = np.flatnonzero(flat)
        along_each = ahead(turned.ways_along, (to_camera[[index]] for index in turned.ways))
        for index, marked in zip(turned.ways, along_each, strict=True):
            seen[index] = np.bincount(flat[at[marked.reshape(-1)[at] > 0]], minlength=count)
    return seen


@dataclass(frozen=True)
class _Turned:
    """A space with one axis moved to the front, for the directions along which that axis dominates.

    Attributes:
        space: the space, its axes in the usual order.
        state: its `state`, transposed.
        order: the axes of `space` in the order of `state`.
        ways: indices of the directions whose largest component is along the first of these axes.
    """

    space: Space
    state: NDArray[np.uint8]
    order: tuple[int, ...]
    ways: NDArray[np.int64]

    def ways_along(self, to_camera: Float64) -> NDArray[np.uint8]:
        """Return the marks of `ways_along` for directions (n, 3) among `ways`, in the axes of `state`."""
        seen = np.zeros(self.state.shape, np.uint8)
        flat, up_axis = (self.state.reshape(-1), seen.reshape(-1), seen.shape), self.order.index(2)
        n0, n1, n2 = self.state.shape
        # Numbers count steps: at most as many as there are slices, or as make a camera far enough.
        enough = 4 + min(n0, int(self.space.near_m / self.space.voxel_size_m))
        lines = np.empty((IN_CACHE, (n1 + n0) * n2 + n0), np.uint8 if enough < 256 else np.uint16)
        for first in range(0, len(to_camera), IN_CACHE):
            ways = to_camera[first : first + IN_CACHE, list(self.order)]
            _sweep(*flat, ways, up_axis, self.space.heights_m, lines, *self.space.lengths_m)
        return seen


def _turned_along(space: Space, to_camera: Float64) -> Iterator[_Turned]:
    """Yield the space, turned, for each axis that has the largest component of some directions (n, 3)."""
    main = np.argmax(np.abs(to_camera), axis=1)
    for axis in np.unique(main).tolist():
        # So that a slice lies in one piece, with the axis that varies fastest at its end.
        order = (axis, *(other for other in range(3) if other != axis))
        turned = np.ascontiguousarray(space.state.transpose(order))
        yield _Turned(space, turned, order, np.flatnonzero(main == axis))


@numba.njit(cache=True, nogil=True, error_model="numpy", inline="always")
def beyond_grid_m(height, up, least):  # type: ignore[no-untyped-def]
    """Return the distance, metres, to the farthest camera outside the grid; negative: there is none.

    The line starts at `height`; `up` is the vertical component of the unit vector to the camera, and `least`
    the smallest height of a camera, metres.
    """
    if up > LEVEL:
        return _FAR
    if up > -LEVEL:
        return _FAR if height >= least else _NONE
    farthest = (height - least) / np.float32(-up)
    return farthest if farthest >= 0 else _NONE


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sweep(state, seen, shape, ways, up_axis, heights_m, lines, voxel_m, near_m, least_m):  # type: ignore[no-untyped-def]
    """Mark in `seen` the voxels seen along the directions `ways` (n, 3), largest along the first axis.

    Args:
        state: flat, the state of each voxel.
        seen: flat, receives what `ways_along` returns.
        shape: number of voxels along each axis, (n0, n1, n2).
        ways: (n, 3) unit vectors, from a point to a camera.
        up_axis: the axis that is vertical.
        heights_m: heights of the layers along `up_axis`, metres.
        lines: (n or more, (n0 + n1) n2 + n0), overwritten: a counter for each line of each direction. It is 0
            if no camera sees along the line, 2 at a camera, and grows by 1 a voxel until the camera is
            `near_m` away.
        voxel_m: edge of a voxel, metres.
        near_m: smallest distance from a camera at which it sees, metres.
        least_m: smallest height of a camera outside the grid, metres.
    """
    n0, n1, n2 = shape
    entering, enough = np.empty((len(ways), len(heights_m)), lines.dtype), np.empty(len(ways), lines.dtype)
    slopes, at = np.empty((len(ways), 2)), np.zeros((len(ways), 2), np.int64)
    for n in range(len(ways)):
        along = abs(ways[n, 0])
        step_m = np.float32(voxel_m / along)
        enough[n] = _set_entering(entering[n], ways[n, up_axis], step_m, n0, heights_m, near_m, least_m)
        # From slice to slice a line moves away from the camera.
        slopes[n] = -ways[n, 1] / along, -ways[n, 2] / along
    for count in range(n0):
        # All directions look at a slice while it lies in the cache.
        for n in range(len(ways)):
            i = n0 - 1 - count if ways[n, 0] > 0 else count
            bit = np.uint8(FROM_BELOW if ways[n, up_axis] < -LEVEL else FROM_ABOVE)
            # A line keeps its place: the slice moves over them, from the first or from the last place.
            end = np.maximum(np.rint(slopes[n] * (n0 - 1)), 0)
            moved = np.rint(slopes[n] * count)
            move1, move2 = int(moved[0]) - at[n, 0], int(moved[1]) - at[n, 1]
            at[n] = moved
            begin = int((end[0] - moved[0]) * n2 + end[1] - moved[1])
            for j in range(n1):
                low, high = n2, n2
                if count > 0 and 0 <= j - move1 < n1:
                    low, high = max(0, move2), min(n2, n2 + move2)
                # Lines that come in through the grid's side.
                for k in range(low):
                    lines[n, begin + j * n2 + k] = entering[n, i if up_axis == 0 else k]
                for k in range(high, n2):
                    lines[n, begin + j * n2 + k] = entering[n, i if up_axis == 0 else k]
            _look(state, seen, i * n1 * n2, lines[n], begin, n1 * n2, enough[n], bit)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _set_entering(entering, up, step_m, slices, heights_m, near_m, least_m):  # type: ignore[no-untyped-def]
    """Set in `entering` the counter of a line one step before it enters the grid, for each layer.

    Return the counter at which a camera is `near_m` away. `up` is the vertical component of the direction,
    `step_m` the length of a step, and `slices` the largest number of steps. `heights_m` are the layers'
    heights. Cameras are at least `least_m` high.
    """
    enough = 2 + _steps(np.float32(0), step_m, near_m, slices)
    for layer in range(len(heights_m)):
        far_m = beyond_grid_m(heights_m[layer], up, least_m)
        steps = _steps(far_m, step_m, near_m, slices)
        entering[layer] = 0 if far_m < 0 else enough if steps == 0 else max(1, enough - steps - 1)
    return enough


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _steps(far_m, step_m, near_m, most):  # type: ignore[no-untyped-def]
    """Return how many steps of `step_m` increase a distance `far_m` to `near_m` or more; at most `most`."""
    steps = 0
    while far_m < near_m and steps < most:
        far_m += step_m
        steps += 1
    return steps


# Runs on 32 voxels at once, if indices cannot be negative and no number is wider than in `lines`.
@numba.njit(cache=True, nogil=True, error_model="numpy")
def _look(state, seen, begin, lines, to, count, enough, bit):  # type: ignore[no-untyped-def]
    """Advance the lines of a slice by one step: update their counters, and mark the visible voxels.

    Args:
        state: flat, the state of each voxel.
        seen: flat, gets `bit` at visible voxels, and one more direction.
        begin: index of the slice's first voxel.
        lines: the lines' counters.
        to: index in `lines` of the line through the first voxel.
        count: number of voxels.
        enough: the counter from which on a voxel is visible.
        bit: FROM_ABOVE or FROM_BELOW.
    """
    own, first, kind = np.uintp(begin), np.uintp(to), lines.dtype.type
    for n in range(count):
        at, line = own + np.uintp(n), first + np.uintp(n)
        number = lines[line]
        number = kind(number + ((number != 0) & (number != enough)))
        number = max(number, kind(2)) if state[at] == PLACE else number
        number = kind(0) if state[at] == BLOCKED else number
        lines[line] = number
        mark = seen[at]
        marked = np.uint8((mark | bit) + (np.uint8(ONE_WAY) if mark < MOST_WAYS else np.uint8(0)))
        seen[at] = marked if number == enough else mark

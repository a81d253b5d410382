"""Voxels of an upright grid that a camera sees along a straight line: sweeps over sampled directions.

A sweep follows all lines of one direction at once, slice by slice from the cameras' end. For each line it
keeps the distance of the farthest camera from which nothing hides the line's current voxel. A direction thus
visits each voxel once.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import reduce

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.threads import ahead, in_parts
from kinectbench.core.types import Bools, Float32, Float64
from kinectbench.core.voxels.line_kernels import (
    BLOCKED,
    FROM_ABOVE,
    FROM_BELOW,
    LEVEL,
    MOST_WAYS,
    ONE_WAY,
    OUTSIDE,
    SEEN,
    sweep_slices,
    walk_back,
)
from kinectbench.core.voxels.morphology import dilated

# One thread marks the voxels of this many directions: to join the marks then takes no 1 % of the time.
AT_ONCE = 32
# The lines of this many directions through a slice of a chair's grid lie in a core's cache.
IN_CACHE = 8
# To follow a line back from one voxel takes as long as to sweep over this many (measured in a room of 35 M
# voxels: 43 ns, and 0.6 ns a voxel).
VOXELS_A_WALK = 75
# First, every 16th direction is swept along.
FEWER = 16
# Behind a gap, lines are tried from voxels this near to those seen before. Of a wardrobe with a slot (voxels
# of 5 mm) the same voxels are closed as by a search everywhere, in half of the time.
BESIDE = 2


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
    return ways_along(space, to_camera, ONE_WAY) & np.uint8(SEEN)


def seen_outwards(space: Space, to_camera: Float64, wanted: Bools | None) -> NDArray[np.uint8]:
    """Return the marks of `seen_along`, but search only beside voxels that were found before.

    First every 16th direction is followed everywhere. Behind a gap, voxels that other directions see are next
    to these; far from them, all directions would be tried in vain. Single voxels may be missed.

    Args:
        space: the voxels.
        to_camera: (n, 3) unit vectors, from a point to a camera; all level or up, or all down.
        wanted: (nx, ny, nz) bool, voxels to search for; None: all.
    """
    marks = _swept_along(space, to_camera[::FEWER])
    left = (space.state != BLOCKED) & (marks == 0)
    if wanted is not None:
        left &= wanted
    others = np.delete(to_camera, np.s_[::FEWER], 0)
    while True:
        beside = left & dilated(marks > 0, (BESIDE,) * 3)
        cells = np.flatnonzero(beside)
        if not len(cells):
            return marks & np.uint8(SEEN)
        _walk_back(space, marks, cells, others, ONE_WAY)
        left &= ~beside


def ways_along(
    space: Space,
    to_camera: Float64,
    most: int = MOST_WAYS,
    wanted: Bools | None = None,
    less: NDArray[np.uint8] | None = None,
) -> NDArray[np.uint8]:
    """Find the voxels that cameras see along some directions, from a PLACE or from outside the grid.

    Outside the grid nothing blocks a line, and a camera can be anywhere at or above `least_height_m`. Lines
    are followed slice by slice along the axis of their largest component. Most voxels are marked after a few
    of the directions; if few are left, the other directions are followed from these alone.

    Args:
        space: the voxels.
        to_camera: (n, 3) unit vectors, from a point to a camera.
        most: ONE_WAY times the number of directions to count at least, from 1 to 3.
        wanted: (nx, ny, nz) bool, voxels whose marks matter; of others, marks may be missing. None: all.
        less: the result in a space with fewer camera positions, if known; its marks are all true here.

    Returns:
        (nx, ny, nz) uint8: FROM_ABOVE (by a camera as high as the voxel or higher), FROM_BELOW, or both (3),
        plus ONE_WAY times the number of these directions, at most 3, or less if `most` is less; 0 if not
        seen.
    """
    marks = np.zeros(space.state.shape, np.uint8)
    up = to_camera[:, 2] >= -LEVEL
    bits = (FROM_ABOVE if up.any() else 0) | (FROM_BELOW if not up.all() else 0)
    asked = space.state != BLOCKED
    for known in (wanted, None if less is None else _unfinished(less, bits, most)):
        asked = asked if known is None else asked & known
    cells = np.flatnonzero(asked)
    if len(cells) * VOXELS_A_WALK > marks.size:
        marks, to_camera = _swept_along(space, to_camera[::FEWER]), np.delete(to_camera, np.s_[::FEWER], 0)
        cells = np.flatnonzero(asked & _unfinished(marks, bits, most))
    if len(cells) * VOXELS_A_WALK > marks.size:
        marks = _joined(marks, _swept_along(space, to_camera))
    else:
        _walk_back(space, marks, cells, to_camera, most)
    return marks if less is None else np.where(asked, marks, less)


def _unfinished(marks: NDArray[np.uint8], bits: int, most: int) -> Bools:
    """Return which voxels lack one of `bits` in `marks`, or ONE_WAY times fewer directions than `most`."""
    return np.asarray((marks & np.uint8(bits) != bits) | (marks & np.uint8(MOST_WAYS) < most))


def _swept_along(space: Space, to_camera: Float64) -> NDArray[np.uint8]:
    """Return the marks of `ways_along` by sweeps over all voxels."""
    seen = np.zeros(space.state.shape, np.uint8)
    for turned in _turned_along(space, to_camera):
        groups = np.split(turned.ways, range(AT_ONCE, len(turned.ways), AT_ONCE))
        marks = reduce(_joined, ahead(turned.ways_along, (to_camera[ways] for ways in groups)))
        seen = _joined(seen, np.ascontiguousarray(marks.transpose(np.argsort(turned.order))))
    return seen


def _walk_back(
    space: Space, marks: NDArray[np.uint8], cells: NDArray[np.int64], to_camera: Float64, most: int
) -> None:
    """Add the marks of `ways_along` for the voxels `cells`, flat indices, to `marks`."""
    padded = np.pad(space.state, 1, constant_values=OUTSIDE)
    ways, bounds = np.ascontiguousarray(to_camera), (space.heights_m, *space.lengths_m)
    in_parts(lambda start, stop: walk_back(padded, marks, cells[start:stop], ways, most, *bounds), len(cells))


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
            sweep_slices(*flat, ways, up_axis, self.space.heights_m, lines, *self.space.lengths_m)
        return seen


def _turned_along(space: Space, to_camera: Float64) -> Iterator[_Turned]:
    """Yield the space, turned, for each axis that has the largest component of some directions (n, 3)."""
    main = np.argmax(np.abs(to_camera), axis=1)
    for axis in np.unique(main).tolist():
        # So that a slice lies in one piece, with the axis that varies fastest at its end.
        order = (axis, *(other for other in range(3) if other != axis))
        turned = np.ascontiguousarray(space.state.transpose(order))
        yield _Turned(space, turned, order, np.flatnonzero(main == axis))

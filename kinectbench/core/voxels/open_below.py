"""Open space below an object: where cameras rise into it from below, and its underside over open space."""

from dataclasses import replace

import numba
import numpy as np

from kinectbench.core.types import Bools
from kinectbench.core.voxels.line_kernels import BLOCKED, PASSABLE, PLACE
from kinectbench.core.voxels.lines_of_sight import Space
from kinectbench.core.voxels.morphology import dilated, reached_from_beyond

# Below an object on legs, this many of eight level rays lead out. Behind a door or a front, and under a desk
# with a back and two sides, at most three do.
OPEN_WAYS = 5
# Beside a leg of an object, one fewer of them leads out.
WAYS_BESIDE_LEG = 4
# By the bits of the rays that lead out: their number, and whether two opposite rays do, as between side
# panels that stand on the floor. Through one door, none are opposite.
NUMBER = np.array([bits.bit_count() for bits in range(256)], np.uint8)
OPPOSITE = np.array([any(bits >> ray & bits >> (7 - ray) & 1 for ray in range(4)) for bits in range(256)])
# Within this distance of a camera position there is one whose ways out no leg blocks: legs are thinner.
BESIDE_M = 0.3


def without_rising(space: Space, empty: Bools) -> Space:
    """Return the space without camera positions that are reached only by rising into an object from below.

    A camera below an object on legs could otherwise rise through its unseen underside. Where walls surround
    a camera, it came in through a side, and may rise: a cabinet is higher than its door.

    Args:
        space: where lines pass and cameras can be.
        empty: bool of the same shape, voxels that were seen to be empty; all others count as unseen.
    """
    place = space.state == PLACE
    reached = reached_from_beyond(place, empty)
    if np.array_equal(reached, place):
        return space
    ways = NUMBER[_level_ways_out(space.state, reached & ~empty)]
    # Beside a leg few ways lead out, a little farther away more.
    beside = round(BESIDE_M / space.voxel_size_m)
    below = _open_below(space.state, dilated(ways >= OPEN_WAYS, (beside, beside, 0)))
    may_enter = empty.copy()
    may_enter[:, :, 1:] |= ~below[:, :, :-1]
    reached = reached_from_beyond(place, may_enter)
    return replace(space, state=np.where(place & ~reached, np.uint8(PASSABLE), space.state))


def underside_over_open_space(
    part: Bools, body: Bools, free: Bools, obstacle: Bools, *, height: int, beside: int, line: int
) -> Bools:
    """Return the underside of a part: its voxels beside open space below the object.

    Space is open where `OPEN_WAYS` of eight level rays lead out of the grid. Below the part that must be so
    over the height of a camera, not only over that of a slot in the sides; or two opposite rays lead
    out from there down to the bottom layer, as between side panels. Between open space and the part there may
    be unseen voxels, but no free ones above these, as of a room inside the object. Where the part itself
    reaches down to the bottom layer, it has no underside: cameras look in through a side.

    Args:
        part: bool (nx, ny, nz), its last axis up, its bottom layer that above the floor; unseen voxels that
            cameras see only from below.
        body: bool of the same shape, voxels of the object.
        free: bool of the same shape, voxels seen to be empty.
        obstacle: bool of the same shape, voxels that level rays do not cross.
        height: of a camera, in voxels.
        beside: within so many voxels of open space, `WAYS_BESIDE_LEG` rays are enough.
        line: half the width of a line of sight, in voxels: narrower gaps of the underside are closed.
    """
    filled = part | body
    state = np.where(obstacle, np.uint8(BLOCKED), np.uint8(PASSABLE))
    asked = ~filled & np.logical_or.accumulate(filled[:, :, ::-1], axis=2)[:, :, ::-1]
    rays = _level_ways_out(state, asked)
    around = ~filled & dilated(part, (1, 1, 1))
    opened, at_legs = (
        around & _over_open(filled, free, NUMBER[rays] >= least, OPPOSITE[rays], height)
        for least in (OPEN_WAYS, WAYS_BESIDE_LEG)
    )
    opened |= at_legs & dilated(opened, (beside, beside, 0))
    return np.asarray(part & dilated(opened, (line, line, 1)))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _level_ways_out(state, asked):  # type: ignore[no-untyped-def]
    """For each `asked` voxel, find which of 8 level rays reach the grid's border.

    `state` is as in `Space`: BLOCKED voxels stop a ray. The result is (nx, ny, nz) uint8, 0 where not
    `asked`: a bit for each ray, where opposite rays have bits n and 7 - n.
    """
    nx, ny, nz = state.shape
    ways = np.zeros(state.shape, np.uint8)
    # Which rays of a slice lead out; the first and the last row lie outside the grid.
    here, onward = np.ones((ny + 2, nz), np.bool_), np.ones((ny + 2, nz), np.bool_)
    for way in range(9):
        dx, dy = way // 3 - 1, way % 3 - 1
        if dx == 0 and dy == 0:
            continue
        onward[:] = True
        # A ray leads out if its next voxel does, so that is visited before.
        for i in range(nx - 1, -1, -1) if dx > 0 else range(nx):
            for j in range(ny - 1, -1, -1) if dy > 0 else range(ny):
                following = (here if dx == 0 else onward)[j + 1 + dy]
                for k in range(nz):
                    leads_out = state[i, j, k] != BLOCKED and following[k]
                    here[j + 1, k] = leads_out
                    ways[i, j, k] |= (leads_out and asked[i, j, k]) << (way if way < 4 else way - 1)
            here, onward = onward, here
    return ways


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _open_below(state, open_here):  # type: ignore[no-untyped-def]
    """Return a mask of voxels that are open below.

    A voxel is open below if it, or a voxel straight below it with no BLOCKED voxel between, is `open_here`.
    """
    nx, ny, nz = state.shape
    below = np.zeros(state.shape, np.bool_)
    for i in range(nx):
        for j in range(ny):
            is_open = False
            for k in range(nz):
                is_open = state[i, j, k] != BLOCKED and (is_open or open_here[i, j, k])
                below[i, j, k] = is_open
    return below


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _over_open(filled, free, wide, through, height):  # type: ignore[no-untyped-def]
    """Return which voxels are open space below an object, or unseen voxels above it.

    Space is open where it is `wide` over a `height` in voxels, or leads `through` from the bottom layer up.
    `filled` voxels are of the object, or of its part above the space.
    """
    nx, ny, nz = filled.shape
    opened = np.zeros(filled.shape, np.bool_)
    for i in range(nx):
        for j in range(ny):
            high, low, is_open, was_free = 0, True, False, False
            for k in range(nz):
                into_room = was_free and free[i, j, k] and not free[i, j, k - 1]
                if filled[i, j, k] or into_room:
                    high, low, is_open = 0, False, False
                was_free = (was_free or free[i, j, k]) and not filled[i, j, k]
                low &= through[i, j, k]
                high = high + 1 if wide[i, j, k] else 0
                is_open |= low or high >= height
                opened[i, j, k] = is_open and not filled[i, j, k]
    return opened

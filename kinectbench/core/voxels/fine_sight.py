"""Voxels behind narrow gaps, which sampled lines of sight miss: more directions, where they are needed."""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.even_choice import evenly
from kinectbench.core.types import Float64
from kinectbench.core.voxels.line_kernels import (
    BLOCKED,
    FROM_ABOVE,
    FROM_BELOW,
    LEVEL,
    MOST_WAYS,
    PLACE,
    SEEN,
    beyond_grid_m,
)
from kinectbench.core.voxels.lines_of_sight import Space, directions

# This many directions, 1.8 degrees apart, are tried behind gaps. 1,600 narrow lines miss 1.6 % (.5 %) of the
# volume of a crate with a hole of 5 cm (7 cm) in its top. 6,400 wide lines miss .6 % (.2 %), and 12,800 or
# 25,600 wide lines .3 % (.1 %).
FINER = 12_800
# Voxels that few directions see lie behind few gaps: at most this many of them are asked for the directions
# that see them.
MOST_ASKED = 1000
# Fewer of them, of all voxels, lead to nothing: a chair's 37 to 22 others, a desk's 139 to 84.
LEAST_ASKED_SHARE = 5e-5


def further_directions(
    space: Space, marks: NDArray[np.uint8], to_camera: Float64, spacing_rad: float, already: NDArray[np.uint8]
) -> Float64:
    """Return the directions of a finer lattice along which more may be seen behind gaps.

    Deep behind a gap, a voxel is seen along few directions. Its neighbour may be seen along none of
    `to_camera`, but along a direction between them. So directions of a finer lattice are added, near those
    that see such voxels.

    Args:
        space: the voxels.
        marks: what `ways_along` returns for `to_camera`, wherever `already` is 0, and in voxels beside these.
        to_camera: (n, 3) unit vectors, from a point to a camera; all level or up, or all down.
        spacing_rad: angle between neighbouring directions of `to_camera`, radians.
        already: (nx, ny, nz), not 0 where a voxel was seen before; these are not searched for.

    Returns:
        (m, 3) unit vectors, all level or up, or all down, as `to_camera`.
    """
    edge = _rarely_seen_beside_unseen(marks, (marks & np.uint8(SEEN)) | already, space.state)
    if len(edge) <= LEAST_ASKED_SHARE * marks.size:
        return np.zeros((0, 3))
    cells = edge[evenly(len(edge), MOST_ASKED)]
    seeing = _some_see(space.state, cells, to_camera, space.heights_m, *space.lengths_m)
    if not seeing.any():
        return np.zeros((0, 3))
    finer = directions(FINER)
    finer = finer[(finer[:, 2] >= -LEVEL) == (to_camera[0, 2] >= -LEVEL)]
    near = (finer @ to_camera[seeing].T).max(axis=1) > np.cos(spacing_rad)
    return np.asarray(finer[near])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _rarely_seen_beside_unseen(marks, seen, state):  # type: ignore[no-untyped-def]
    """Return flat indices of voxels seen along one or two directions that have an unseen neighbour (of 26).

    `marks` is the result of `ways_along`. `seen` is 0 at unseen voxels; BLOCKED voxels of `state` do not
    count.
    """
    nx, ny, nz = marks.shape
    found = []
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if not 0 < marks[i, j, k] & MOST_WAYS < MOST_WAYS:
                    continue
                beside = False
                for a in range(max(i - 1, 0), min(i + 2, nx)):
                    for b in range(max(j - 1, 0), min(j + 2, ny)):
                        for c in range(max(k - 1, 0), min(k + 2, nz)):
                            beside |= seen[a, b, c] == 0 and state[a, b, c] != BLOCKED
                if beside:
                    found.append((i * ny + j) * nz + k)
    return np.array(found, np.int64)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _some_see(state, cells, ways, heights_m, voxel_m, near_m, least_m):  # type: ignore[no-untyped-def]
    """Return for each direction in `ways` (n, 3) whether a camera sees one of the cells (flat indices).

    The other arguments are those of `_sees`.
    """
    _, ny, nz = state.shape
    seeing = np.zeros(len(ways), np.bool_)
    for n in range(len(ways)):
        for cell in cells:
            i, j, k = cell // (ny * nz), cell // nz % ny, cell % nz
            if _sees(state, i, j, k, ways[n], heights_m, voxel_m, near_m, least_m):
                seeing[n] = True
                break
    return seeing


def seen_around_corners(space: Space, seen: NDArray[np.uint8], to_camera: Float64) -> NDArray[np.uint8]:
    """Find more visible voxels along additional directions, outwards from the edge of the visible region.

    Few directions pass through a narrow gap. If a voxel is seen, so are all points between it and the camera;
    newly seen voxels are therefore next to voxels seen before.

    Args:
        space: the voxels.
        seen: result of `seen_along`.
        to_camera: (n, 3) unit vectors, from a point to a camera: the additional directions.

    Returns:
        `seen` with more bits set.
    """
    state = space.state
    more = seen.copy()
    up = to_camera[:, 2] >= -LEVEL
    # Whether a voxel that is seen from above is seen from below as well decides nothing.
    for bit, enough, ways in (
        (FROM_ABOVE, FROM_ABOVE, to_camera[up]),
        (FROM_BELOW, FROM_ABOVE | FROM_BELOW, to_camera[~up]),
    ):
        # Each is asked once at most.
        stack = np.empty(np.count_nonzero((state != BLOCKED) & (more & enough == 0)), np.int64)
        bits = np.uint8(bit), np.uint8(enough)
        _grow(more, state, bits, np.ascontiguousarray(ways), stack, space.heights_m, *space.lengths_m)
    return more


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _grow(seen, state, bits, ways, stack, heights_m, voxel_m, near_m, least_m):  # type: ignore[no-untyped-def]
    nx, ny, nz = state.shape
    bit, enough = bits
    asked = np.zeros(state.shape, np.bool_)
    count = 0
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if seen[i, j, k] & enough:
                    count = _push_around(seen, state, asked, enough, stack, count, i, j, k)
    last = 0
    while count > 0:
        count -= 1
        cell = stack[count]
        i, j, k = cell // (ny * nz), cell // nz % ny, cell % nz
        for turn in range(len(ways)):
            # Neighbours are mostly seen along the same direction.
            way = (last + turn) % len(ways)
            if _sees(state, i, j, k, ways[way], heights_m, voxel_m, near_m, least_m):
                last = way
                seen[i, j, k] |= bit
                count = _push_around(seen, state, asked, enough, stack, count, i, j, k)
                break


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _push_around(seen, state, asked, enough, stack, count, i, j, k):  # type: ignore[no-untyped-def]
    """Push the 6 neighbours of (i, j, k) that must be tested onto the stack; return its new length.

    These are not BLOCKED (`state`), have none of the bits `enough` in `seen`, and are not marked in `asked`.
    `count` is the stack's length before.
    """
    nx, ny, nz = state.shape
    for side in range(6):
        step = 1 if side % 2 else -1
        a = i + step if side // 2 == 0 else i
        b = j + step if side // 2 == 1 else j
        c = k + step if side // 2 == 2 else k
        if a < 0 or a >= nx or b < 0 or b >= ny or c < 0 or c >= nz:
            continue
        if state[a, b, c] != BLOCKED and not seen[a, b, c] & enough and not asked[a, b, c]:
            asked[a, b, c] = True
            stack[count] = (a * ny + b) * nz + c
            count += 1
    return count


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _sees(state, i, j, k, way, heights_m, voxel_m, near_m, least_m):  # type: ignore[no-untyped-def]
    """Return whether some camera sees the voxel (i, j, k); `way` (3,) is the direction from it to the camera.

    The camera is in a PLACE at least `near_m` away, or outside the grid and at least `least_m` high. `state`,
    `heights_m` and the lengths are as in `Space`.
    """
    nx, ny, nz = state.shape
    along = max(abs(way[0]), abs(way[1]), abs(way[2]))
    dx, dy, dz = way[0] / along, way[1] / along, way[2] / along
    step = np.float32(voxel_m / along)
    distance_m = np.float32(0)
    last_k = k
    count = 0
    while True:
        a, b, c = (i + int(np.rint(dx * count)), j + int(np.rint(dy * count)), k + int(np.rint(dz * count)))
        if a < 0 or a >= nx or b < 0 or b >= ny or c < 0 or c >= nz:
            return distance_m - step + beyond_grid_m(heights_m[last_k], way[2], least_m) >= near_m
        if state[a, b, c] == BLOCKED:
            return False
        if state[a, b, c] == PLACE and distance_m >= near_m:
            return True
        last_k = c
        distance_m += step
        count += 1

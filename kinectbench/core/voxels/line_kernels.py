"""Kernels that follow lines of sight through a grid of voxels: slice by slice, or back from single voxels."""

from typing import Final

import numba
import numpy as np

# The state of a voxel: a line passes; it passes, and a camera can be here; no line passes.
PASSABLE: Final = 0
PLACE: Final = 1
BLOCKED: Final = 2
# The border that `walk_back` needs around the voxels.
OUTSIDE: Final = 3
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
def sweep_slices(state, seen, shape, ways, up_axis, heights_m, lines, voxel_m, near_m, least_m):  # type: ignore[no-untyped-def]
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
        enough[n] = set_entering(entering[n], ways[n, up_axis], step_m, n0, heights_m, near_m, least_m)
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
def set_entering(entering, up, step_m, slices, heights_m, near_m, least_m):  # type: ignore[no-untyped-def]
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


@numba.njit(cache=True, nogil=True, error_model="numpy")
def walk_back(padded, marks, cells, ways, most, heights_m, voxel_m, near_m, least_m):  # type: ignore[no-untyped-def]
    """Mark those of some voxels that are seen along directions: walk back to the cameras.

    A line has the same voxels as in `sweep_slices`, so both mark the same ones.

    Args:
        padded: (nx + 2, ny + 2, nz + 2), the state of each voxel, with a border of `OUTSIDE`.
        marks: (nx, ny, nz), receives what `ways_along` returns, at `cells` only.
        cells: (m,) flat indices into `marks`.
        ways: (n, 3) unit vectors, from a point to a camera.
        most: a voxel is asked until it has its bit, and this number of directions times `ONE_WAY`.
        heights_m: heights of the layers, metres.
        voxel_m: edge of a voxel, metres.
        near_m: smallest distance from a camera at which it sees, metres.
        least_m: smallest height of a camera outside the grid, metres.
    """
    nx, ny, nz = marks.shape
    state, seen = padded.reshape(-1), marks.reshape(-1)
    sizes, strides = (nx, ny, nz), ((ny + 2) * (nz + 2), nz + 2, 1)
    shifts, entering = np.empty(max(sizes) + 1, np.int64), np.empty(nz, np.int64)
    places, at = np.empty(len(cells), np.int64), np.empty((3, len(cells)), np.int64)
    for m in range(len(cells)):
        at[0, m], at[1, m], at[2, m] = cells[m] // (ny * nz), cells[m] // nz % ny, cells[m] % nz
        places[m] = (at[0, m] + 1) * strides[0] + (at[1, m] + 1) * strides[1] + at[2, m] + 1
    for n in range(len(ways)):
        way = ways[n]
        main = np.argmax(np.abs(way))
        slices = sizes[main]
        step_m = np.float32(voxel_m / abs(way[main]))
        enough = set_entering(entering, way[2], step_m, slices, heights_m, near_m, least_m)
        _set_shifts(shifts, way, main, slices, strides)
        bit = np.uint8(FROM_BELOW if way[2] < -LEVEL else FROM_ABOVE)
        for m in range(len(cells)):
            mark = seen[cells[m]]
            if mark & bit and mark & MOST_WAYS >= most:
                continue
            count = slices - 1 - at[main, m] if way[main] > 0 else at[main, m]
            if _is_seen(state, places[m] - shifts[count + 1], shifts, count, enough, entering, nz):
                seen[cells[m]] = (mark | bit) + (np.uint8(ONE_WAY) if mark < MOST_WAYS else np.uint8(0))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _set_shifts(shifts, way, main, slices, strides):  # type: ignore[no-untyped-def]
    """Set in `shifts` by how many places in memory a line's voxel in each slice lies from the grid's corner.

    The first entry is the place before the first slice, as the camera looks. `strides` (3,) are the distances
    in memory from voxel to voxel, along each axis, and `main` is the axis along which `slices` are counted.
    """
    for at in range(slices + 1):
        count = at - 1
        shifts[at] = strides[main] * (slices - 1 - count if way[main] > 0 else count)
        for axis in range(3):
            if axis != main:
                shifts[at] += strides[axis] * int(np.rint(-way[axis] / abs(way[main]) * max(count, 0)))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _is_seen(state, start, shifts, count, enough, entering, layers):  # type: ignore[no-untyped-def]
    """Return whether a line's voxel in the slice `count` is seen: by a camera in the grid, or outside of it.

    `start + shifts[n + 1]` is the place in `state` of the line's voxel in slice n. The other arguments are as
    in `sweep_slices`; `layers` is the number of layers of the grid.
    """
    steps = 0
    while True:
        here = state[start + shifts[count + 1 - steps]]
        if here == OUTSIDE:
            before = start + shifts[count + 2 - steps]
            number = entering[before % (layers + 2) - 1]
            return number != 0 and number + steps >= enough
        if here == BLOCKED:
            return False
        if here == PLACE and steps >= enough - 2:
            return True
        steps += 1


@numba.njit(cache=True, nogil=True, error_model="numpy")
def sees(state, i, j, k, way, heights_m, voxel_m, near_m, least_m):  # type: ignore[no-untyped-def]
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

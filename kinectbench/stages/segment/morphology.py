"""Morphology on large grids, and legs whose upper end was hidden from every camera."""

from collections.abc import Sequence

import numpy as np

from kinectbench.core.types import Bools

# A lower piece on the floor may be noise; one that ends farther below the object carries something else.
MIN_HEIGHT_M, MAX_GAP_M = 0.05, 0.1
# A piece's upper end: its columns in so many layers below its highest cell.
END_LAYERS = 3
# Of these columns, so many must find the object above them.
MIN_SHARE = 0.5


def opened(mask: Bools, size: Sequence[int]) -> Bools:
    """Binary opening by a box: what some box of set cells covers.

    As `scipy.ndimage.binary_opening` with a structure of ones, several times as fast: a box is a run along
    each axis, and a long run is two shorter ones.

    Args:
        mask: bool; what lies outside of it is not set.
        size: cells of the box along each axis, at least 1.
    """
    if any(length > n for length, n in zip(size, mask.shape, strict=True)):
        return np.zeros_like(mask)
    fits = mask
    for axis, length in enumerate(size):
        fits = _runs(fits, axis, length)
    # The last cell of a box that begins at one place is the first of one that begins length - 1 before it.
    apart = ~np.pad(fits, [(length - 1, length - 1) for length in size])
    for axis, length in enumerate(size):
        apart = _runs(apart, axis, length)
    return ~apart


def broad(mask: Bools, cells: int) -> Bools:
    """What a cube of so many cells covers of a mask, and the corners that the cube does not reach."""
    from scipy import ndimage

    covered = opened(mask, (cells, cells, cells))
    reached: Bools = ndimage.binary_dilation(covered, iterations=max(1, cells // 2)) & mask
    return reached


def _runs(mask: Bools, axis: int, length: int) -> Bools:
    """Where a run of so many set cells along an axis begins."""
    runs, done = np.moveaxis(mask, axis, 0), 1
    while done < length:
        step = min(done, length - done)
        runs = runs[:-step] & runs[step:]
        done += step
    return np.moveaxis(runs, 0, axis)


def carried_up(solid: Bools, seen_empty: Bools, floor_layer: int, voxel_size_m: float) -> Bools:
    """Legs that end in the unseen below the largest piece, carried on straight up to it (own rule).

    From above, a seat hides the upper end of a leg that stands back from its edge: what was measured is a
    seat in the air, and sticks on the floor.

    Args:
        solid: bool (nx, ny, nz), upright; extruded down to the floor.
        seen_empty: bool, cells that cannot be filled.
        floor_layer: the lowest layer above the floor in which pieces are told apart.
        voxel_size_m: edge of a cell.

    Returns:
        `solid` with the cells between such legs and the largest piece.
    """
    from scipy import ndimage

    pieces, count = ndimage.label(solid)
    if count < 2:
        return solid
    sizes = np.bincount(pieces.reshape(-1))
    sizes[0] = 0
    main = int(np.argmax(sizes))
    largest = pieces == main
    reach = round(MAX_GAP_M / voxel_size_m)
    filled = solid.copy()
    for piece, (x, y, z) in enumerate(ndimage.find_objects(pieces), start=1):
        stands = z.start <= floor_layer and (z.stop - floor_layer) * voxel_size_m >= MIN_HEIGHT_M
        if piece == main or not stands:
            continue
        end = slice(z.stop - END_LAYERS, z.stop)
        columns = (pieces[x, y, end] == piece).any(axis=2)
        gap = slice(end.start, z.stop + reach)
        above = np.logical_or.accumulate(largest[x, y, gap], axis=2)
        open_below = ~np.logical_or.accumulate(seen_empty[x, y, gap] & (pieces[x, y, gap] != piece), axis=2)
        carried = columns & (above & open_below).any(axis=2)
        if carried.sum() >= MIN_SHARE * columns.sum():
            filled[x, y, gap] |= carried[:, :, None] & ~above
    return filled

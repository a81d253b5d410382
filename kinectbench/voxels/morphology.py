"""Boundaries and blocks of boolean grids."""

import numba
import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]


def shell_of(solid: Bools) -> NDArray[np.uint8]:
    """The surface of a solid: occupied cells with an empty 6-neighbour; outside the grid is empty.

    Args:
        solid: (nx, ny, nz) bool, nz a multiple of 8.

    Returns:
        (nx, ny, nz / 8) uint8, packed along z.
    """
    return np.asarray(_shell(solid))


@numba.njit(cache=True, error_model="numpy")
def _shell(solid):  # type: ignore[no-untyped-def]
    nx, ny, nz = solid.shape
    packed = np.zeros((nx, ny, nz // 8), np.uint8)
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if not solid[i, j, k]:
                    continue
                border = i == 0 or j == 0 or k == 0 or i == nx - 1 or j == ny - 1 or k == nz - 1
                if border or not (
                    solid[i - 1, j, k] and solid[i + 1, j, k] and solid[i, j - 1, k]
                    and solid[i, j + 1, k] and solid[i, j, k - 1] and solid[i, j, k + 1]
                ):  # fmt: skip
                    packed[i, j, k >> 3] |= 128 >> (k & 7)
    return packed


def blocks_touched(occupied: Bools, block: int) -> Bools:
    """Blocks of `block`^3 cells that hold a cell of `occupied` dilated once (26 neighbours).

    Args:
        occupied: (n, n, n) bool, n a multiple of block.
        block: cells along a block's edge.

    Returns:
        (n / block,) * 3 bool.
    """
    result = occupied
    for axis in range(3):
        blocks = np.moveaxis(result, axis, 0)
        blocks = blocks.reshape(-1, block, *blocks.shape[1:])
        touched: Bools = np.any(blocks, axis=1)
        touched[1:] |= blocks[:-1, -1]
        touched[:-1] |= blocks[1:, 0]
        result = np.moveaxis(touched, 0, axis)
    return result


def containment_of_cells(cells: NDArray[np.int64], full: Bools, block: int) -> float:
    """Share of a partial view's cells that lie in the full shape, dilated by one of its own cells.

    Args:
        cells: (n, 3) int64, coarse cells of the partial, in any number each, also out of bounds.
        full: (m, m, m) bool over the same box.
        block: cells of `full` along a coarse cell's edge.

    Returns:
        In [0, 1]; 1 without any cells. Cells out of bounds are outside.
    """
    if len(cells) == 0:
        return 1.0
    distinct = np.unique(cells, axis=0)
    inside = distinct[np.all((distinct >= 0) & (distinct < full.shape[0] // block), axis=1)]
    return int(blocks_touched(full, block)[tuple(inside.T)].sum()) / len(distinct)


def containment(partial: Bools, full: Bools) -> float:
    """`containment_of_cells` of a partial grid (m, m, m) and a full one (n, n, n) over the same box."""
    return containment_of_cells(np.argwhere(partial), full, full.shape[0] // partial.shape[0])

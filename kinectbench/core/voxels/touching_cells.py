"""Find cells that touch, and the connected pieces that they form, without a dense grid.

The memory grows with the number of cells and not with their extent: one pose half a kilometre off would make
a dense grid of a scene too large.
"""

from itertools import product

import numpy as np

from kinectbench.core.types import Bools, Float64, Int32, Int64


def connected(points: Float64, cell_m: float, through_faces: bool = False) -> Int32:
    """Label each point with the connected piece of cells that it belongs to.

    Args:
        points: (n, 3), metres, n > 0.
        cell_m: edge of the cubic cells, metres; touching cells with points in them are connected.
        through_faces: whether touching cells must share a face; else a corner suffices.

    Returns:
        (n,) int32, the piece's number, from 1; pieces are in the order of their first cell by x, then y, z.
    """
    which, pairs = touching_cells(points, cell_m, through_faces)
    labels: Int32 = pieces_of_cells(pairs, int(which.max()) + 1) + np.int32(1)
    return labels[which]


def touching_cells(points: Float64, cell_m: float, through_faces: bool = False) -> tuple[Int64, Int64]:
    """Return the cell of each point, and the pairs of cells with points that touch.

    Args:
        points: (n, 3), metres, n > 0; their bounding box holds fewer than 2^63 cells.
        cell_m: edge of the cells, metres.
        through_faces: whether cells must share a face to touch; else an edge or a corner suffices.

    Returns:
        (n,) index of each point's cell among the cells with points, sorted by x, then y, then z; and (k, 2)
        indices of touching cells.
    """
    cells = np.floor(points / cell_m).astype(np.int64)
    cells -= cells.min(axis=0)
    # An empty cell at the end of each row: the first of one row does not touch the last of the row before.
    _, rows, columns = (cells.max(axis=0) + 2).tolist()
    strides = np.array([rows * columns, columns, 1])
    found, which = np.unique(cells @ strides, return_inverse=True)
    pairs = []
    for step in product((-1, 0, 1), repeat=3):
        if step <= (0, 0, 0) or (through_faces and sum(map(abs, step)) > 1):
            continue
        wanted = found + np.array(step) @ strides
        at = np.minimum(np.searchsorted(found, wanted), len(found) - 1)
        (here,) = np.nonzero(found[at] == wanted)
        pairs.append(np.stack([here, at[here]], axis=-1))
    return which.reshape(-1), np.concatenate(pairs)


def pieces_of_cells(pairs: Int64, count: int) -> Int32:
    """Label each cell with its connected piece: (count,), from 0, in the order of the pieces' first cells.

    Args:
        pairs: (k, 2) indices of cells that touch.
        count: number of cells.
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    joins = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    return np.asarray(connected_components(joins, directed=False)[1], np.int32)


def far_apart(points: Float64, most_m: float) -> Bools:
    """Return which points (n, 3), n > 0, are not in the largest group; groups are over `most_m` apart."""
    label = connected(points, most_m)
    return np.asarray(label != np.argmax(np.bincount(label)))

"""The connected pieces of the fused surface above the floor."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import TriangleMesh

# A piece whose lowest point is higher hangs in the air, and something not too far away holds it.
GROUNDED_M = 0.12
MAX_HANGING_GAP_M = 0.3
MIN_HANGING_CELLS = 10
JUDGED_FACES = 20_000


def label_pieces(
    points_floor: NDArray[np.float64], cell_m: float, through_faces: bool = False
) -> NDArray[np.int32]:
    """Label each point with the connected piece of surface that it belongs to.

    One that hangs in the air, such as a table top whose underside nobody saw, belongs to the nearest one
    that stands on the floor.

    Args:
        points_floor: (n, 3) points above the floor, at least one a cell, floor frame, metres; n > 0.
        cell_m: cells of this edge that touch are connected.
        through_faces: they must share a face; else a corner will do.

    Returns:
        (n,) int32, from 1; not every number need occur.
    """
    from scipy import ndimage

    cells = np.floor(points_floor / cell_m).astype(np.int64)
    cells -= cells.min(axis=0)
    occupied = np.zeros(cells.max(axis=0) + 1, dtype=bool)
    occupied[tuple(cells.T)] = True
    labels, _ = ndimage.label(occupied, structure=None if through_faces else np.ones((3, 3, 3)))
    return _with_hanging(labels[tuple(cells.T)], points_floor)


def spacing_m(mesh: TriangleMesh) -> float:
    """How far apart a mesh's neighbouring vertices are, metres: 95 % of its edges are shorter.

    Smaller cells would not touch, though the surface goes on.
    """
    corners = mesh.vertices[mesh.faces[:: max(1, len(mesh.faces) // JUDGED_FACES)]]
    edges_m = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
    return float(np.quantile(edges_m, 0.95)) if edges_m.size else 0.0


def standing(label: NDArray[np.int32], points_floor: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which labels reach down to the floor: (largest label + 1,) bool."""
    lowest_m = np.full(int(label.max()) + 1, np.inf)
    np.minimum.at(lowest_m, label, points_floor[:, 2])
    stands: NDArray[np.bool_] = lowest_m <= GROUNDED_M
    return stands


def _with_hanging(label: NDArray[np.int32], points_floor: NDArray[np.float64]) -> NDArray[np.int32]:
    """Labels (n,) in which pieces that do not reach down to the floor have the label of what holds them."""
    from scipy.spatial import cKDTree

    stands = standing(label, points_floor)
    sizes = np.bincount(label)
    if not stands[label].any():
        return label
    on_floor = np.flatnonzero(stands[label])
    tree = cKDTree(points_floor[on_floor])
    holder = np.arange(len(sizes), dtype=label.dtype)
    for piece in np.flatnonzero(~stands & (sizes >= MIN_HANGING_CELLS)):
        distance_m, nearest = tree.query(points_floor[label == piece])
        closest = int(np.argmin(distance_m))
        if distance_m[closest] <= MAX_HANGING_GAP_M:
            holder[piece] = label[on_floor[nearest[closest]]]
    return holder[label]

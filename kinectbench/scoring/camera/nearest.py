"""Find the nearest samples of points, also of points that move step by step during a registration.

If a point's nearest sample is at distance d1 and the second nearest at d2, the nearest sample stays the same
while the point moves less than (d2 - d1) / 2. So a search is repeated only for points that moved farther; the
result is still exact.
"""

import numpy as np

from kinectbench.core.types import Bools, Float64, Int64
from kinectbench.scoring.camera.box_tree import (
    boxes_of,
    mean_offsets,
    near_together,
    nearest_of_moving,
    two_nearest,
)


class Samples:
    """Samples of a surface in a search tree.

    If several samples are equally near, which one is found does not depend on earlier searches.

    Args:
        points_m: (n, 3), at least one.
    """

    def __init__(self, points_m: Float64) -> None:
        order = near_together(points_m)
        self.points_m, self.boxes = points_m, (order, *boxes_of(points_m, order))
        self._places: dict[int, Int64] = {}

    def nearest(self, points: Float64) -> tuple[Float64, Int64]:
        """Return each point's distance to its nearest sample, and that sample's index: (n,) each."""
        order, *boxes = self.boxes
        # If there are as many points as in an earlier call, they are mostly the same ones, moved a little: so
        # the search starts at the samples found then.
        places = self._places.setdefault(len(points), np.full((len(points), 2), -1))
        which, distances = near_together(points), np.empty(len(points))
        distances[which] = two_nearest(points, which, places, False, *boxes)[:, 0]
        return distances, order[places[:, 0]]

    def offsets(self, points: Float64, normals: Float64, radius_m: float) -> Float64:
        """Return each point's mean offset, along its normal, to the samples within a radius: (n,), metres.

        Args:
            points: (n, 3).
            normals: (n, 3) unit normals of the points.
            radius_m: the radius; a point without a sample within it gets 0.
        """
        return np.asarray(mean_offsets(points, normals, radius_m, *self.boxes[1:]))


class NearestOfMoving:
    """Finds the nearest samples of points that move a little between calls.

    Args:
        samples: the samples to search.
        count: number of points.
    """

    def __init__(self, samples: Samples, count: int) -> None:
        self._samples = samples
        # For each point: its position at the last search, how far it may move from there, and the samples
        # found.
        self._state = np.zeros((count, 3)), np.full(count, -1.0), np.full((count, 2), -1)

    def of(self, points: Float64, asked: Bools) -> tuple[Float64, Int64]:
        """Return the nearest samples of the selected points.

        Args:
            points: (n, 3) current positions of all points.
            asked: (n,) which points are selected.

        Returns:
            Distances (m,) and indices (m,) of the nearest samples, for the m selected points in order.
        """
        of = self._samples
        found: tuple[Float64, Int64] = nearest_of_moving(points, asked, *self._state, of.points_m, *of.boxes)
        return found

"""The nearest samples of points that move little by little, as the steps of a registration move them.

A point whose nearest sample is d1 away, and the next one d2, keeps the nearest while it is less than
(d2 - d1) / 2 from where it was: no other one can have come nearer. So only those that went farther are looked
for again, and what is found is exact.
"""

import numpy as np
from scipy.spatial import cKDTree

from kinectbench.core.types import Bools, Float64, Int64

# Of half a gap, what is trusted; and of a distance, up to which a gap is none. Rounding may not decide.
SURE, EVEN = 1 - 1e-9, 1e-12


class NearestOfMoving:
    """The nearest samples of a tree to points that are asked again and again.

    Args:
        tree: of the samples; not empty.
        count: number of points.
    """

    def __init__(self, tree: cKDTree, count: int) -> None:
        self._tree = tree
        self._samples = np.ascontiguousarray(tree.data)
        self._base, self._leeway = np.zeros((count, 3)), np.full(count, -1.0)
        self._found = np.zeros(count, np.int64)

    def of(self, points: Float64, asked: Bools) -> tuple[Float64, Int64]:
        """What `query` of the tree finds of the points that are asked.

        Args:
            points: (n, 3) all of them, where they are now.
            asked: (n,).

        Returns:
            (m,) distances, and (m,) indices of samples, of those asked.
        """
        from kinectbench.scoring.camera.kernels import distances_to, strayed

        again = strayed(points, asked, self._base, self._leeway)
        if len(again):
            places = points[again]
            far, found = self._tree.query(places, k=2)
            gap = far[:, 1] - far[:, 0]
            even = np.flatnonzero(gap <= EVEN * far[:, 1])
            self._found[again] = found[:, 0]
            if len(even):  # of two that are equally near it is up to the search
                self._found[again[even]] = self._tree.query(places[even])[1]
            self._base[again], self._leeway[again] = places, SURE * gap / 2
        found = self._found[asked]
        distances: Float64 = distances_to(points[asked], self._samples, found)
        return distances, found

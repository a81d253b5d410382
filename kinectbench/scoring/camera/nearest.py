"""The nearest samples of points: of many once, and of points that move as a registration moves them.

A point whose nearest sample is d1 away, and the next one d2, keeps the nearest while it is less than
(d2 - d1) / 2 from where it was: no other one can have come nearer. So only those that went farther are looked
for again, and what is found is exact.
"""

import numpy as np
from scipy.spatial import cKDTree

from kinectbench.core.types import Bools, Float64, Int64

# Of half a gap, what is trusted; and of a distance, up to which a gap is none. Rounding may not decide.
SURE, EVEN = 1 - 1e-9, 1e-12


class Samples:
    """Samples of a surface, among which the nearest are looked for.

    Args:
        tree: of the samples; not empty. Of two that are equally near it decides.
    """

    def __init__(self, tree: cKDTree) -> None:
        from kinectbench.scoring.camera.boxes import boxes_of

        self._tree = tree
        self.points: Float64 = np.ascontiguousarray(tree.data)
        self._boxes = boxes_of(self.points, tree.indices)

    def nearest(
        self, points: Float64, which: Int64, places: Int64, both: bool = True
    ) -> tuple[Float64, Int64]:
        """The two nearest samples of some points.

        Args:
            points: (n, 3).
            which: (m,) indices of those that are asked.
            places: (n, 2) where the search begins, see `two_nearest`; changed.
            both: whether the distance of the second is asked.

        Returns:
            (m, 2) distances, and (m,) the index of the nearest sample.
        """
        from kinectbench.scoring.camera.boxes import two_nearest

        far = two_nearest(points, which, places, both, *self._boxes)
        found: Int64 = self._tree.indices[places[which, 0]]
        even = np.flatnonzero((1 - EVEN) * far[:, 1] <= far[:, 0])
        if len(even):
            found[even] = self._tree.query(points[which[even]])[1]
        return far, found

    def nearest_of_all(self, points: Float64) -> tuple[Float64, Int64]:
        """The distances of points (n, 3), (n,), and the index of the nearest sample to each, (n,)."""
        from kinectbench.scoring.camera.boxes import near_together

        distances, found = np.empty(len(points)), np.empty(len(points), np.int64)
        order, places = near_together(points), np.full((len(points), 2), -1)
        far, found[order] = self.nearest(points, order, places, both=False)
        distances[order] = far[:, 0]
        return distances, found


class NearestOfMoving:
    """The nearest samples to points that are asked again and again.

    Args:
        samples: those.
        count: number of points.
    """

    def __init__(self, samples: Samples, count: int) -> None:
        self._samples = samples
        self._base, self._leeway = np.zeros((count, 3)), np.full(count, -1.0)
        self._found, self._places = np.zeros(count, np.int64), np.full((count, 2), -1)

    def of(self, points: Float64, asked: Bools) -> tuple[Float64, Int64]:
        """The nearest sample of the points that are asked.

        Args:
            points: (n, 3) all of them, where they are now.
            asked: (n,).

        Returns:
            (m,) distances, and (m,) indices of samples, of those asked.
        """
        from kinectbench.scoring.camera.boxes import distances_to, strayed

        again = strayed(points, asked, self._base, self._leeway)
        if len(again):
            far, self._found[again] = self._samples.nearest(points, again, self._places)
            self._base[again], self._leeway[again] = points[again], SURE * (far[:, 1] - far[:, 0]) / 2
        found = self._found[asked]
        distances: Float64 = distances_to(points[asked], self._samples.points, found)
        return distances, found

"""The nearest samples of points: of many once, and of points that move as a registration moves them.

A point whose nearest sample is d1 away, and the next one d2, keeps the nearest while it is less than
(d2 - d1) / 2 from where it was: no other one can have come nearer. So only those that went farther are looked
for again, and what is found is exact.
"""

import numpy as np

from kinectbench.core.types import Bools, Float64, Int64


class Samples:
    """Samples of a surface, among which the nearest are looked for.

    Of samples that are equally near, no earlier search decides which is found.

    Args:
        points_m: (n, 3), at least one.
    """

    def __init__(self, points_m: Float64) -> None:
        from kinectbench.scoring.camera.boxes import boxes_of, near_together

        order = near_together(points_m)
        self.points_m, self.boxes = points_m, (order, *boxes_of(points_m, order))
        self._places: dict[int, Int64] = {}

    def nearest(self, points: Float64) -> tuple[Float64, Int64]:
        """The distances of points (n, 3), (n,), and the index of the nearest sample to each, (n,)."""
        from kinectbench.scoring.camera.boxes import near_together, two_nearest

        order, *boxes = self.boxes
        # As many points are mostly the same ones a little farther on: the search begins where it ended.
        places = self._places.setdefault(len(points), np.full((len(points), 2), -1))
        which, distances = near_together(points), np.empty(len(points))
        distances[which] = two_nearest(points, which, places, False, *boxes)[:, 0]
        return distances, order[places[:, 0]]

    def offsets(self, points: Float64, normals: Float64, radius_m: float) -> Float64:
        """(n,) the mean offset of the samples within a radius of points (n, 3), along normals (n, 3)."""
        from kinectbench.scoring.camera.boxes import mean_offsets

        return np.asarray(mean_offsets(points, normals, radius_m, *self.boxes[1:]))


class NearestOfMoving:
    """The nearest samples to points that are asked again and again.

    Args:
        samples: those.
        count: number of points.
    """

    def __init__(self, samples: Samples, count: int) -> None:
        self._samples = samples
        # Where each was looked for last, how far from there it may be, and what was found.
        self._state = np.zeros((count, 3)), np.full(count, -1.0), np.full((count, 2), -1)

    def of(self, points: Float64, asked: Bools) -> tuple[Float64, Int64]:
        """The nearest sample of the points that are asked.

        Args:
            points: (n, 3) all of them, where they are now.
            asked: (n,).

        Returns:
            (m,) distances, and (m,) indices of samples, of those asked.
        """
        from kinectbench.scoring.camera.boxes import nearest_of_moving

        of = self._samples
        found: tuple[Float64, Int64] = nearest_of_moving(points, asked, *self._state, of.points_m, *of.boxes)
        return found

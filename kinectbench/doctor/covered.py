"""Compare sets of poses over the points that each of them projects into the other frame.

The disagreement of poses and depth counts a point outside the image as wrong. So if the camera turns far
between frames, it favours poses with little motion, even a static camera. The comparison here leaves such
points out.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinectbench.core.types import Float64
from kinectbench.doctor.fit import FramePair, point_errors

# Poses refute others if at least this share of all points is covered by both, their error is at most RIGHT
# over all points that they cover, and at most this ratio of the others' over those that both cover. Measured:
# correct poses of four real recordings have errors of 0.07 to 0.10 (a fifth, about an object, 0.31), and over
# the points that both cover 0.14 to 0.5 times those of wrong conventions, units and a static camera.
LEAST_SHARE, RIGHT, MUCH_BETTER = 0.1, 0.15, 0.5


@dataclass(frozen=True)
class Covered:
    """The errors of points under several sets of poses.

    Attributes:
        errors: (k, m), error of each of the pairs' m points under each of k sets of poses (`point_errors`);
            NaN if the point is outside the image, or if its pixel has no measurement.
    """

    errors: Float64

    def over_both(self, one: int, other: int) -> tuple[float, float]:
        """Return the mean errors of two sets of poses over the points that both cover.

        Both are NaN if these are fewer than a tenth of all points.
        """
        both = np.isfinite(self.errors[one]) & np.isfinite(self.errors[other])
        if not both.sum() >= max(LEAST_SHARE * both.size, 1):
            return float("nan"), float("nan")
        return float(self.errors[one, both].mean()), float(self.errors[other, both].mean())

    def refutes(self, one: int, other: int) -> bool:
        """Whether set `one` is right by itself, and far better than set `other` where both cover points."""
        mine, theirs = self.over_both(one, other)
        return mine < MUCH_BETTER * theirs and bool(np.nanmean(self.errors[one]) < RIGHT)


def covered(pairs: Sequence[FramePair], T_world_camera: Float64) -> Covered:
    """Return the errors of the pairs' points under k sets of poses (k, n, 4, 4) of the probe's n frames."""
    errors = [np.zeros((len(T_world_camera), 0))]
    for pair in pairs:
        off, inside = point_errors(pair, T_world_camera)
        errors.append(np.where(inside, off, np.nan))
    return Covered(np.concatenate(errors, axis=1))

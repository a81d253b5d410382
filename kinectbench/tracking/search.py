"""A coarse search for where a frame lies to another when registration from the prediction does not convince.

Registration settles at once whatever the surfaces hold (a floor: two turns and a height), so only the motions
they leave open need a search: a grid along the three weakest ones, judged at the coarsest level.
"""

import itertools

import numpy as np
from numpy.typing import NDArray

from kinectbench.tracking.frame_maps import FrameMaps, Level
from kinectbench.tracking.linearise import NO_EXPOSURE_CHANGE, LinearTerms, linearise
from kinectbench.tracking.registration import DAMPING, Registration, openness, register
from kinectbench.tracking.twist import rigid_from_twist

Float64 = NDArray[np.float64]

COARSEST = 2
# The points move by so much from one start to the next, root mean square.
SPACING_M = 0.12
STARTS = np.array([k for k in itertools.product((-2, -1, 0, 1, 2), repeat=3) if any(k)])
SETTLED, REGISTERED = 8, 2
SEARCH_GATE_M, SETTLE_GATE_M = 0.1, 0.2
SETTLE_ITERATIONS = 10
ENOUGH_OVERLAP = 0.5


def score(registration: Registration) -> float:
    """How convincing a registration is: 1.25 at most, 1 without intensity."""
    return _score(registration.inlier_share, registration.overlap, registration.intensity_correlation)


def search(source: FrameMaps, target: FrameMaps, T_start: Float64) -> Registration:
    """The most convincing registration of a frame to another around `T_start` (4, 4)."""
    points, maps = source.levels[COARSEST], target.levels[COARSEST]
    T_settled, _ = _settle(points, maps, T_start)
    terms = linearise(points, maps, T_settled, SEARCH_GATE_M, with_shares=True)
    weakest = openness([terms], points, [maps]).motions[:, :3]
    starts = [np.asarray(T_settled @ rigid_from_twist(weakest @ (SPACING_M * k))) for k in STARTS]
    starts.sort(key=lambda T: -_score_at(linearise(points, maps, T, SEARCH_GATE_M), points))
    settled = [_settle(points, maps, T) for T in [T_settled, *starts[:SETTLED]]]
    settled.sort(key=lambda found: -_score_at(found[1], points))
    return max((register(source, [target], [T], coarsest=1) for T, _ in settled[:REGISTERED]), key=score)


def _settle(points: Level, maps: Level, T: Float64) -> tuple[Float64, LinearTerms]:
    exposure = NO_EXPOSURE_CHANGE
    for _ in range(SETTLE_ITERATIONS):
        terms = linearise(points, maps, T, SETTLE_GATE_M, exposure)
        step = np.linalg.solve(terms.geometric + terms.photometric + DAMPING, terms.gradient)
        T, exposure = T @ rigid_from_twist(step), terms.exposure_after(step)
        if np.abs(step).max() < 3e-4:
            break
    return T, linearise(points, maps, T, SEARCH_GATE_M, exposure)


def _score_at(terms: LinearTerms, points: Level) -> float:
    compared = terms.inliers + terms.violations
    share, overlap = terms.inliers / max(1, compared), compared / max(1, len(points.points))
    return _score(share, overlap, terms.intensity_correlation)


def _score(inlier_share: float, overlap: float, correlation: float) -> float:
    agreement = 0.0 if np.isnan(correlation) else 0.25 * max(correlation, 0.0)
    return inlier_share * min(1.0, overlap / ENOUGH_OVERLAP) + agreement

"""Best scores that the truth's uncertainty allows, and metrics as the code of other papers computes them.

The best one-to-one assignment of two point sets. Source: the auction algorithm with decreasing eps of D. P.
Bertsekas, "The auction algorithm: a distributed relaxation method for the assignment problem" (1988). The
points of one set bid for those of the other, the "places". The cost of a place is its distance plus its
price; a point bids for the place of least cost. Each point keeps a short list of its cheapest places. Prices
only rise, so a list stays valid until its second-lowest cost exceeds what the cheapest place outside the list
cost when the list was made.
"""

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinectbench.core.artefacts.score_figures import AsPapers, Ceiling
from kinectbench.core.types import MM_PER_M, Float64
from kinectbench.scoring.camera.nearest import Samples
from kinectbench.scoring.camera.surface import Surface

# The returned mean is too large by at most this share.
WITHIN = 0.005
# Number of places in a list; first eps, as a share of the diagonal of both sets; factor by which eps is
# divided each round. Of 16, 32, 64 and 100 places, and of first shares from 1/8 to 1/300, these were the
# fastest: 5 to 7 s for 16,384 points.
NEAR, FIRST, FALL = 32, 1 / 8, 5.0
# Maximum mean number of bids per point in a round of one eps; at most 16 were needed.
MOST_BIDS = 100
# Distances below this share of the diagonal do not matter.
LEAST = 1e-6


def assigned_mean_m(points_m: Float64, others_m: Float64) -> float | None:
    """Return the mean distance, metres, of the best one-to-one assignment of two point sets, to within 0.5 %.

    Args:
        points_m: (n, 3), n above `NEAR`.
        others_m: (n, 3), as many points.

    Returns:
        The mean; it is never too small, and too large by at most 0.5 % or, if that is more, by 1e-6 of the
        diagonal of both sets. None if the auction does not end within a bounded number of bids.
    """
    n = len(points_m)
    size_m = float(np.linalg.norm(np.ptp(np.concatenate([points_m, others_m]), axis=0)))
    if not size_m > 0:
        return 0.0
    prices, near, beyond = np.zeros(n), np.zeros((n, NEAR), np.int64), np.full(n, -np.inf)
    columns = [np.ascontiguousarray(each.T, dtype=np.float64) for each in (points_m, others_m)]
    eps = FIRST * size_m
    while True:
        owner = np.full(n, -1)
        if not _round(*columns, prices, near, beyond, owner, eps, MOST_BIDS * n):
            return None
        mean_m = float(np.linalg.norm(points_m[owner] - others_m, axis=1).mean())
        # With this eps, the sum of distances is too large by at most n eps.
        if eps <= max(WITHIN * (mean_m - eps), LEAST * size_m):
            return mean_m
        eps /= FALL


@njit(cache=True, error_model="numpy", nogil=True)
def _round(  # type: ignore[no-untyped-def]
    points, places, prices, near, beyond, owner, eps: float, most: int
) -> bool:
    """Run the auction with one eps until every place has an owner.

    Args:
        points: (3, n) the points that bid.
        places: (3, n) the points that are bid for.
        prices: (n,) price of each place; updated.
        near: (n, k) each point's list of its cheapest places, as indices; updated.
        beyond: (n,) cost of the cheapest place outside the list when the list was made; -inf if there is no
            list yet; updated.
        owner: (n,) the point that owns each place, initially -1; updated.
        eps: the minimum amount by which a bid raises a price, metres.
        most: maximum number of bids.

    Returns:
        Whether every place has an owner after at most `most` bids.
    """
    n = len(prices)
    costs, queue = np.empty(n), np.arange(n)
    head, waiting = 0, n
    for _ in range(most):
        i = queue[head]
        head, waiting = (head + 1) % n, waiting - 1
        best, second, place = _best(points[:, i], places, prices, near[i])
        if not second <= beyond[i]:
            beyond[i] = _list(points[:, i], places, prices, near[i], costs)
            best, second, place = _best(points[:, i], places, prices, near[i])
        prices[place] += second - best + eps
        if owner[place] >= 0:
            queue[(head + waiting) % n] = owner[place]
            waiting += 1
        owner[place] = i
        if waiting == 0:
            return True
    return False


@njit(cache=True, error_model="numpy", nogil=True)
def _best(  # type: ignore[no-untyped-def]
    point, places, prices, listed: NDArray[np.int64]
) -> tuple[float, float, int]:
    """Return a point's lowest and second-lowest cost among `listed` places, and the cheapest place.

    `point` is (3,); `places` and `prices` are as in `_round`.
    """
    best, second, place = np.inf, np.inf, -1
    for j in listed:
        x, y, z = places[0, j] - point[0], places[1, j] - point[1], places[2, j] - point[2]
        cost = np.sqrt(x * x + y * y + z * z) + prices[j]
        if cost < best:
            best, second, place = cost, best, j
        elif cost < second:
            second = cost
    return best, second, place


@njit(cache=True, error_model="numpy", nogil=True)
def _list(point, places, prices, listed: NDArray[np.int64], costs) -> float:  # type: ignore[no-untyped-def]
    """Fill `listed` with a point's cheapest places, `costs` with all costs; return the lowest of the rest.

    `point` is (3,); `places` and `prices` are as in `_round`.
    """
    for j in range(len(prices)):
        x, y, z = places[0, j] - point[0], places[1, j] - point[1], places[2, j] - point[2]
        costs[j] = np.sqrt(x * x + y * y + z * z) + prices[j]
    many = len(listed) + 1
    least, which, most = np.full(many, np.inf), np.zeros(many, np.int64), np.inf
    for j in range(len(prices)):
        if costs[j] < most:
            k = many - 1
            while k > 0 and least[k - 1] > costs[j]:
                least[k], which[k] = least[k - 1], which[k - 1]
                k -= 1
            least[k], which[k] = costs[j], j
            most = least[many - 1]
    listed[:] = which[:-1]
    return most


# Number of points of each surface that AdaPoinTr on PCN (2e53e72) and LaS-Comp (2301d7b) compare.
POINTS, SEED = 16_384, 0
# PCN and AdaPoinTr multiply distances by 1000; the tolerance of their F-score is 0.01 normalised units.
PCN_FACTOR, PCN_TOLERANCE = 1000.0, 0.01


def ceiling(
    sigma_m: float, tolerances_m: dict[str, float], area_m2: float, volume_m3: float
) -> Ceiling | None:
    """Return the best scores that a truth with surface error `sigma_m` allows; None if `sigma_m` is 0.

    These are the scores of a prediction that equals the real surface. The truth deviates from that surface
    along the normal by a distance d, which is normally distributed with standard deviation sigma. So the mean
    of |d| is sigma sqrt(2 / pi), the mean of d^2 is sigma^2, and the share of the surface within a tolerance
    tau is erf(tau / (sigma sqrt 2)). The truth lacks a volume of area x mean |d| / 2, and has the same volume
    in excess.

    Args:
        sigma_m: standard deviation of the truth's surface, metres.
        tolerances_m: {name of an F-score: its tolerance}, metres.
        area_m2: area of the known true surface of the scored part.
        volume_m3: volume of the known true cells of the part; if it is 0, the best IoU is None.
    """
    if not sigma_m > 0:
        return None
    mean_m = sigma_m * math.sqrt(2 / math.pi)
    off_m3 = area_m2 * mean_m / 2
    return Ceiling(
        chamfer_l1_m=mean_m,
        chamfer_l2_m2=sigma_m**2,
        iou=max(volume_m3 - off_m3, 0.0) / (volume_m3 + off_m3) if volume_m3 else None,
        **{name: math.erf(far / (sigma_m * math.sqrt(2))) for name, far in tolerances_m.items()},
    )


def as_papers(
    octmae: dict[str, float], ours: Surface, theirs: Surface, size_m: float, emd: bool = False
) -> AsPapers:
    """Return metrics as the code of OctMAE, PCN and SDS-Complete computes them.

    Args:
        octmae: OctMAE's metrics, computed by the caller: {field of `AsPapers`: value}.
        ours: the part of the predicted surface in known space, not empty.
        theirs: the known true surface, not empty.
        size_m: diagonal of the truth's bounding box, metres; PCN's distances are in thousandths of this
            diagonal.
        emd: whether to compute the earth mover's distance, which takes seven seconds.
    """
    one, other = points_by_area(ours), points_by_area(theirs)
    emd_m = None
    if emd:
        emd_m = assigned_mean_m(one, other)
    ways = [_nearest_distances(one, other), _nearest_distances(other, one)]
    l1_m, l2_m2 = sum(way.mean() for way in ways), sum((way**2).mean() for way in ways)
    near = [float((way < PCN_TOLERANCE * size_m).mean()) for way in ways]
    return AsPapers(
        **octmae,
        pcn_chamfer_l1=float(l1_m / 2 / size_m * PCN_FACTOR),
        pcn_chamfer_l2=float(l2_m2 / size_m**2 * PCN_FACTOR),
        pcn_f=2 * near[0] * near[1] / sum(near) if sum(near) else 0.0,
        sds_chamfer_l1_mm=float(l1_m / 2 * MM_PER_M),
        sds_chamfer_l2_mm2=float(l2_m2 * MM_PER_M**2),
        sds_emd_mm=None if emd_m is None else emd_m * MM_PER_M,
    )


def points_by_area(surface: Surface) -> Float64:
    """Draw 16,384 samples of a surface by area, with replacement and a fixed seed: (16384, 3), metres."""
    area = np.cumsum(surface.areas)
    places = np.sort(np.random.default_rng(SEED).random(POINTS)) * area[-1]
    found: Float64 = surface.points_m[np.minimum(np.searchsorted(area, places), len(area) - 1)]
    return found


def _nearest_distances(points_m: Float64, others_m: Float64) -> Float64:
    return Samples(others_m).nearest(points_m)[0]

"""The best one-to-one assignment between two point sets.

Source: the auction algorithm with decreasing eps of D. P. Bertsekas, "The auction algorithm: a distributed
relaxation method for the assignment problem" (1988). The points of one set bid for those of the other, the
"places". The cost of a place is its distance plus its price; a point bids for the place of least cost. Each
point keeps a short list of its cheapest places. Prices only rise, so a list stays valid until its
second-lowest cost exceeds what the cheapest place outside the list cost when the list was made.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from kinectbench.core.types import Float64

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

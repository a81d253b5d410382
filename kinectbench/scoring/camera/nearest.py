"""Find the nearest samples of points, also of points that move step by step during a registration.

If a point's nearest sample is at distance d1 and the second nearest at d2, the nearest sample stays the same
while the point moves less than (d2 - d1) / 2. So a search is repeated only for points that moved farther; the
result is still exact.

SciPy's tree gives the same result, but takes two to four times as long to build (measured with 80,000 and
190,000 samples), and examines one sample and one box at a time. Here, samples are sorted along a Z curve. All
samples of a leaf, or all boxes of a node, are examined together. A search starts at the samples that the
previous search found.
"""

import numpy as np
from numba import njit

from kinectbench.core.types import Bools, Float64, Int64

# Number of samples in a leaf, and of boxes in a node. Of leaves of 8, 16, 24 and nodes of 4, 8, no
# combination was faster.
LEAF, BOXES = 16, 8
# Factor on a squared distance, and an addend: samples beyond the result are farther, whatever the rounding.
NEARLY, TINY = 1 + 1e-11, 1e-300
# Share of half a gap that is used, so that rounding decides nothing.
SURE = 1 - 1e-9


@njit(cache=True, error_model="numpy", nogil=True)
def boxes_of(samples, order):  # type: ignore[no-untyped-def]
    """Build a tree of boxes over samples.

    Args:
        samples: (n, 3), not empty.
        order: (n,) indices that sort the samples so that neighbours in space are close in the order
            (`near_together`).

    Returns:
        groups: (leaves, 3, LEAF), the sorted samples, padded with infinity.
        boxes: (nodes, 6, BOXES), the lowest and highest corners of each node's boxes, padded with empty
            boxes.
        first: (nodes,), index of each node's first child. Leaves and nodes share one numbering: index i is
            leaf i if i < leaves, otherwise node i - leaves. The last node is the root.
    """
    leaves = -(-len(samples) // LEAF)
    groups = np.full((leaves, 3, LEAF), np.inf)
    for n in range(len(samples)):
        for axis in range(3):
            groups[n // LEAF, axis, n % LEAF] = samples[order[n], axis]
    count = nodes = -(-leaves // BOXES)
    while count > 1:
        count = -(-count // BOXES)
        nodes += count
    boxes, first = np.empty((nodes, 6, BOXES)), np.empty(nodes, np.int64)
    boxes[:, :3], boxes[:, 3:] = np.inf, -np.inf
    for leaf in range(leaves):
        for n in range(min(LEAF, len(samples) - leaf * LEAF)):
            for axis in range(3):
                _widen(boxes[leaf // BOXES], axis, leaf % BOXES, groups[leaf, axis, n], groups[leaf, axis, n])
    begin, below, count = 0, 0, leaves
    while True:
        parents = -(-count // BOXES)
        for n in range(parents):
            first[begin + n] = below + n * BOXES
        if parents == 1:
            return groups, boxes, first
        for n in range(parents):
            for axis in range(3):
                for box in range(BOXES):
                    low, high = boxes[begin + n, axis, box], boxes[begin + n, 3 + axis, box]
                    _widen(boxes[begin + parents + n // BOXES], axis, n % BOXES, low, high)
        begin, below, count = begin + parents, leaves + begin, parents


@njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _widen(node, axis, box, low, high):  # type: ignore[no-untyped-def]
    node[axis, box] = min(node[axis, box], low)
    node[3 + axis, box] = max(node[3 + axis, box], high)


@njit(cache=True, error_model="numpy", nogil=True)
def two_nearest(points, which, places, both, groups, boxes, first):  # type: ignore[no-untyped-def]
    """Return the distances of points from their two nearest samples: (m, 2); infinity if there is only one.

    Args:
        points: (n, 3).
        which: (m,) indices of the points to search for.
        places: (n, 2) for each point, positions in the tree's order of two samples from which its search
            starts; -1 if unknown. The rows `which` are replaced by the samples found.
        both: whether the second nearest sample is needed. If not, the second result may be any farther
            sample, unless two samples are equally near.
        groups: the first result of `boxes_of`.
        boxes: the second result.
        first: the third result.
    """
    far, here = np.empty((len(which), 2)), np.empty(LEAF)
    stack, away, gaps = np.empty(128, np.int64), np.empty(128), np.empty(BOXES)
    one, two, leaves = 0, 1, len(groups)
    for m in range(len(which)):
        n, again = which[m], False
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if places[n, 0] >= 0:
            one, two = places[n, 0], places[n, 1]
        while True:
            least, second = np.inf, np.inf
            for place in (one, two):
                g, s = place // LEAF, place % LEAF
                p, q, r = groups[g, 0, s] - x, groups[g, 1, s] - y, groups[g, 2, s] - z
                least, second = second, p * p + q * q + r * r
            if second < least:
                one, two, least, second = two, one, second, least
            limit = second if both else min(second, least * NEARLY + TINY)
            stack[0], away[0], top = leaves + len(boxes) - 1, 0.0, 1
            # Everything is inlined in this loop: calls and array slices count references, which is slower.
            while top:
                top -= 1
                node = stack[top]
                if away[top] >= limit:
                    continue
                if node < leaves:
                    for s in range(LEAF):
                        p, q, r = groups[node, 0, s] - x, groups[node, 1, s] - y, groups[node, 2, s] - z
                        here[s] = p * p + q * q + r * r
                    for s in range(LEAF):
                        place = node * LEAF + s
                        if here[s] < limit and place != one and place != two:
                            if here[s] < least:
                                one, two, least, second = place, one, here[s], least
                            else:
                                two, second = place, here[s]
                            limit = second if both else min(second, least * NEARLY + TINY)
                    continue
                node -= leaves
                for box in range(BOXES):
                    p = max(max(boxes[node, 0, box] - x, x - boxes[node, 3, box]), 0.0)
                    q = max(max(boxes[node, 1, box] - y, y - boxes[node, 4, box]), 0.0)
                    r = max(max(boxes[node, 2, box] - z, z - boxes[node, 5, box]), 0.0)
                    gaps[box] = p * p + q * q + r * r
                begin = nearest = top
                for box in range(BOXES):
                    if gaps[box] < limit:
                        stack[top], away[top] = first[node] + box, gaps[box]
                        nearest = top if gaps[box] < away[nearest] else nearest
                        top += 1
                if top > begin:  # the nearest box is searched next
                    stack[nearest], stack[top - 1] = stack[top - 1], stack[nearest]
                    away[nearest], away[top - 1] = away[top - 1], away[nearest]
            if again or least < second:
                break
            # Of equally near samples, the first found is taken. So the search is repeated from a fixed start.
            one, two, again = 0, 1, True
        places[n, 0], places[n, 1] = one, two
        far[m, 0], far[m, 1] = np.sqrt(least), np.sqrt(second)
    return far


@njit(cache=True, error_model="numpy", nogil=True)
def near_together(points: Float64) -> Int64:
    """Return an order of points (n, 3) in which neighbours in space are mostly close: (n,) int64 indices.

    The bounding cube of the points is divided into 2^20 cells a side. Points are sorted by cell along a Z
    curve (Morton, 1966), and by index within a cell.
    """
    low, high = points[0].copy(), points[0].copy()
    for n in range(len(points)):
        for axis in range(3):
            low[axis], high[axis] = min(low[axis], points[n, axis]), max(high[axis], points[n, axis])
    scale = 1048575.0 / max((high - low).max(), 1e-30)
    codes, order = np.empty(len(points), np.int64), np.arange(len(points))
    for n in range(len(points)):
        codes[n] = 0
        for axis in range(3):
            codes[n] |= _spread(np.int64((points[n, axis] - low[axis]) * scale)) << axis
    for shift in range(0, 60, 15):  # a stable radix sort, 15 bits at a time
        begin, places = np.zeros((1 << 15) + 1, np.int64), np.empty(len(points), np.int64)
        for n in range(len(codes)):
            begin[(codes[n] >> shift & 32767) + 1] += 1
        begin = np.cumsum(begin)
        for n in range(len(codes)):
            bits = codes[n] >> shift & 32767
            places[n] = begin[bits]
            begin[bits] += 1
        before, ordered = codes, order
        codes, order = np.empty_like(codes), np.empty_like(order)
        for n in range(len(codes)):
            codes[places[n]], order[places[n]] = before[n], ordered[n]
    return order


@njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _spread(cell):  # type: ignore[no-untyped-def]
    """Return a 20-bit number with two zero bits inserted after each bit."""
    cell = (cell | cell << 32) & 0x1F00000000FFFF
    cell = (cell | cell << 16) & 0x1F0000FF0000FF
    cell = (cell | cell << 8) & 0x100F00F00F00F00F
    cell = (cell | cell << 4) & 0x10C30C30C30C30C3
    return (cell | cell << 2) & 0x1249249249249249


@njit(cache=True, error_model="numpy", nogil=True)
def mean_offsets(points, normals, radius, groups, boxes, first):  # type: ignore[no-untyped-def]
    """Return each point's mean offset (n,), along its normal, to the samples within a radius; 0 if none is.

    Args:
        points: (n, 3).
        normals: (n, 3) unit normals of the points.
        radius: the radius, in the unit of the points.
        groups: the first result of `boxes_of`.
        boxes: the second result.
        first: the third result.
    """
    offsets, stack, leaves, limit = (
        np.zeros(len(points)),
        np.empty(128, np.int64),
        len(groups),
        radius * radius,
    )
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        stack[0], top, count = leaves + len(boxes) - 1, 1, 0
        while top:
            top -= 1
            node = stack[top] - leaves
            if node < 0:
                for s in range(LEAF):
                    p = groups[node + leaves, 0, s] - x
                    q, r = groups[node + leaves, 1, s] - y, groups[node + leaves, 2, s] - z
                    if p * p + q * q + r * r < limit:
                        offsets[n] += p * normals[n, 0] + q * normals[n, 1] + r * normals[n, 2]
                        count += 1
                continue
            for box in range(BOXES):
                p = max(max(boxes[node, 0, box] - x, x - boxes[node, 3, box]), 0.0)
                q = max(max(boxes[node, 1, box] - y, y - boxes[node, 4, box]), 0.0)
                r = max(max(boxes[node, 2, box] - z, z - boxes[node, 5, box]), 0.0)
                if p * p + q * q + r * r < limit:
                    stack[top] = first[node] + box
                    top += 1
        offsets[n] /= max(count, 1)
    return offsets


@njit(cache=True, error_model="numpy", nogil=True)
def nearest_of_moving(points, asked, base, leeway, places, samples, order, groups, boxes, first):  # type: ignore[no-untyped-def]
    """Return the selected points' distances to their nearest samples (m,), and these samples' indices (m,).

    Args:
        points: (n, 3) current positions.
        asked: (n,) bool, which points are selected.
        base: (n, 3) each point's position at its last search; updated.
        leeway: (n,) how far a point may move from `base` before its nearest sample must be searched again; -1
            before the first search; updated.
        places: (n, 2) as in `two_nearest`; updated.
        samples: (s, 3).
        order: (s,) the samples' order in the tree.
        groups: the first result of `boxes_of`.
        boxes: the second result.
        first: the third result.
    """
    again, count, m = np.empty(len(points), np.int64), 0, 0
    for n in range(len(points)):
        x, y, z = points[n, 0] - base[n, 0], points[n, 1] - base[n, 1], points[n, 2] - base[n, 2]
        if asked[n] and not np.sqrt(x * x + y * y + z * z) < leeway[n]:
            again[count] = n
            count += 1
    far = two_nearest(points, again[:count], places, True, groups, boxes, first)
    for k in range(count):
        n = again[k]
        base[n], leeway[n] = points[n], SURE * (far[k, 1] - far[k, 0]) / 2
    distances, found = np.empty(len(points)), np.empty(len(points), np.int64)
    for n in range(len(points)):
        if asked[n]:
            f = order[places[n, 0]]
            x, y, z = points[n, 0] - samples[f, 0], points[n, 1] - samples[f, 1], points[n, 2] - samples[f, 2]
            distances[m], found[m] = np.sqrt(x * x + y * y + z * z), f
            m += 1
    return distances[:m], found[:m]


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
    """Finds the nearest of `samples` for `count` points that move a little between calls."""

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

"""The two nearest samples of points, by a tree of boxes. Import late: numba is slow to load.

A tree of SciPy finds them too, in twice the time: it has one point and one box at a time. Here a leaf and a
node are looked at as a whole, and a search begins at the samples that were the nearest last.
"""

import numpy as np
from numba import njit

from kinectbench.core.types import Float64, Int64

# Samples of a leaf, and boxes of a node. Of leaves of 8, 16, 24 and nodes of 4, 8 these are as fast as any.
LEAF, BOXES = 16, 8
# Of a squared distance: what is farther is not equally near, whatever is rounded.
NEARLY = 1 + 1e-11


@njit(cache=True, error_model="numpy", nogil=True)
def boxes_of(samples, order):  # type: ignore[no-untyped-def]
    """A tree over samples.

    Args:
        samples: (n, 3), not empty.
        order: (n,) their order; that of the leaves of a tree has near ones together.

    Returns:
        (leaves, 3, LEAF) the samples in this order, filled up with infinity; (nodes, 6, BOXES) the lowest and
        highest corners of the boxes in a node, filled up with boxes that hold nothing; (nodes,) the first
        child of each, a leaf if it is below the number of leaves, else that number and a node's. The last
        node is the root.
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
    """(m, 2) float64: the distances of points (n, 3) from the two nearest samples; infinity if there is one.

    Args:
        points: (n, 3).
        which: (m,) indices of those that are asked.
        places: (n, 2) places in the tree's order where the search begins, -1 where nothing is known of a
            point; those that are asked become the places of what is found.
        both: whether the second is asked. If not it is one that is farther, unless both are equally near.
        groups: of `boxes_of`, as are those that follow.
        boxes: those.
        first: those.
    """
    far, here = np.empty((len(which), 2)), np.empty(groups.shape[2])
    stack, away, gaps = np.empty(128, np.int64), np.empty(128), np.empty(boxes.shape[2])
    one, two, leaves, size = 0, 1, len(groups), groups.shape[2]
    for m in range(len(which)):
        n = which[m]
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if places[n, 0] >= 0:
            one, two = places[n, 0], places[n, 1]
        least, second = np.inf, np.inf
        for place in (one, two):
            g, s = place // size, place % size
            p, q, r = groups[g, 0, s] - x, groups[g, 1, s] - y, groups[g, 2, s] - z
            least, second = second, p * p + q * q + r * r
        if second < least:
            one, two, least, second = two, one, second, least
        limit = second if both else min(second, least * NEARLY)
        stack[0], away[0], top = leaves + len(boxes) - 1, 0.0, 1
        # Everything is in this loop: a call, or a part of an array, counts references, which takes longer.
        while top:
            top -= 1
            node = stack[top]
            if away[top] >= limit:
                continue
            if node < leaves:
                for s in range(size):
                    p, q, r = groups[node, 0, s] - x, groups[node, 1, s] - y, groups[node, 2, s] - z
                    here[s] = p * p + q * q + r * r
                for s in range(size):
                    place = node * size + s
                    if here[s] < limit and place != one and place != two:
                        if here[s] < least:
                            one, two, least, second = place, one, here[s], least
                        else:
                            two, second = place, here[s]
                        limit = second if both else min(second, least * NEARLY)
                continue
            node -= leaves
            for box in range(len(gaps)):
                p = max(max(boxes[node, 0, box] - x, x - boxes[node, 3, box]), 0.0)
                q = max(max(boxes[node, 1, box] - y, y - boxes[node, 4, box]), 0.0)
                r = max(max(boxes[node, 2, box] - z, z - boxes[node, 5, box]), 0.0)
                gaps[box] = p * p + q * q + r * r
            begin = nearest = top
            for box in range(len(gaps)):
                if gaps[box] < limit:
                    stack[top], away[top] = first[node] + box, gaps[box]
                    nearest = top if gaps[box] < away[nearest] else nearest
                    top += 1
            if top > begin:  # the nearest is the next
                stack[nearest], stack[top - 1] = stack[top - 1], stack[nearest]
                away[nearest], away[top - 1] = away[top - 1], away[nearest]
        places[n, 0], places[n, 1] = one, two
        far[m, 0], far[m, 1] = np.sqrt(least), np.sqrt(second)
    return far


@njit(cache=True, error_model="numpy", nogil=True)
def near_together(points: Float64) -> Int64:
    """(n,) int64: indices of points (n, 3) in an order in which near ones follow each other.

    That of a Z curve (Morton, 1966) through 32 cells a side of their box. Far ones cost time, nothing else.
    """
    low, high = points[0].copy(), points[0].copy()
    for n in range(len(points)):
        for axis in range(3):
            low[axis], high[axis] = min(low[axis], points[n, axis]), max(high[axis], points[n, axis])
    size = max((high - low).max(), 1e-30)
    codes, begin = np.empty(len(points), np.int64), np.zeros((1 << 15) + 1, np.int64)
    for n in range(len(points)):
        code = 0
        for axis in range(3):
            cell = int((points[n, axis] - low[axis]) / size * 31.999)
            for bit in range(5):
                code |= (cell >> bit & 1) << (3 * bit + axis)
        codes[n] = code
        begin[code + 1] += 1
    begin = np.cumsum(begin)
    order = np.empty(len(points), np.int64)
    for n in range(len(points)):
        order[begin[codes[n]]] = n
        begin[codes[n]] += 1
    return order


@njit(cache=True, error_model="numpy", nogil=True)
def strayed(points, asked, base, leeway):  # type: ignore[no-untyped-def]
    """(m,) int64: of points (n, 3) that are asked (n,), those not within `leeway` (n,) of `base` (n, 3)."""
    found, count = np.empty(len(points), np.int64), 0
    for n in range(len(points)):
        x, y, z = points[n, 0] - base[n, 0], points[n, 1] - base[n, 1], points[n, 2] - base[n, 2]
        if asked[n] and not np.sqrt(x * x + y * y + z * z) < leeway[n]:
            found[count] = n
            count += 1
    return found[:count]


@njit(cache=True, error_model="numpy", nogil=True)
def distances_to(points, samples, found):  # type: ignore[no-untyped-def]
    """(n,) float64: of points (n, 3) to the samples (m, 3) with the indices `found` (n,)."""
    distances = np.empty(len(points))
    for n in range(len(points)):
        f = found[n]
        x, y, z = points[n, 0] - samples[f, 0], points[n, 1] - samples[f, 1], points[n, 2] - samples[f, 2]
        distances[n] = np.sqrt(x * x + y * y + z * z)
    return distances

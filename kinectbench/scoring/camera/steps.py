"""Numba kernels for one step of the registration in `align`. Import late: numba is slow to load."""

import numpy as np
from numba import njit


@njit(cache=True, error_model="numpy", nogil=True)
def drawn_together(ours, theirs, normals, asked, found, nearest, affine):  # type: ignore[no-untyped-def]
    """Collect a registration step's matches: first from prediction to truth, then from truth to prediction.

    Args:
        ours: (n, 3) samples of the prediction.
        theirs: (m, 3) samples of the truth.
        normals: (m, 3) normals of the truth's samples.
        asked: (n,) bool, which predicted samples are matched; k of them are.
        found: (k,) index of each matched predicted sample's nearest true sample.
        nearest: (m,) index of each true sample's nearest predicted sample.
        affine: (3, 4) transform of the predicted samples.

    Returns:
        Three arrays (k + m, 3) float64: the transformed predicted samples, the true samples that they match,
        and the normals of these true samples. And the mean (3,) of the first array.
    """
    count, k = len(found), 0
    places, middle = np.empty((count + len(theirs), 3)), np.zeros(3)
    targets, across = np.empty_like(places), np.empty_like(places)
    for n in range(len(ours) + len(theirs)):
        if n < len(ours) and not asked[n]:
            continue
        one = n if n < len(ours) else nearest[n - len(ours)]
        other = found[k] if n < len(ours) else n - len(ours)
        x, y, z = ours[one]
        for axis in range(3):
            a, b, c, d = affine[axis]
            places[k, axis] = a * x + b * y + c * z + d
            targets[k, axis], across[k, axis] = theirs[other, axis], normals[other, axis]
            middle[axis] += places[k, axis]
        k += 1
    return places, targets, across, middle / k


@njit(cache=True, error_model="numpy", nogil=True)
def step_equations(places, targets, normals, weights, middle, along, free):  # type: ignore[no-untyped-def]
    """Return the normal equations of a registration step, and the sum of squared distances along the normals.

    The equations are H (free, free) and the gradient (free,); the sum is weighted. A step is a translation
    (3), the logarithm of a scale (1) and a rotation vector (3); scale and rotation are about `middle`. The
    cost is the weighted sum of squared point-to-plane distances, plus `along` times the weighted sum of
    squared point-to-point distances.

    Args:
        places: (n, 3) points of the prediction.
        targets: (n, 3) the matched points of the truth.
        normals: (n, 3) normals of the targets.
        weights: (n,) weight of each match.
        middle: (3,) the centre of scaling and rotation.
        along: weight of the point-to-point distances.
        free: number of free parameters, 3, 4 or 7: the first parameters of a step.
    """
    H, g, squares = np.zeros((free, free)), np.zeros(free), 0.0
    row, whole = np.empty(7), np.empty(7)
    # Products of the columns of the Jacobian: (1 0 0), (0 1 0), (0 0 1), p, and the unit axes x p.
    of = np.zeros((7, 7))
    of[0, 0] = of[1, 1] = of[2, 2] = 1.0
    for n in range(len(places)):
        x, y, z = places[n, 0] - middle[0], places[n, 1] - middle[1], places[n, 2] - middle[2]
        a, b, c = places[n, 0] - targets[n, 0], places[n, 1] - targets[n, 1], places[n, 2] - targets[n, 2]
        p, q, r = normals[n]
        across, weight = a * p + b * q + c * r, weights[n]
        row[0], row[1], row[2], row[3] = p, q, r, x * p + y * q + z * r
        row[4], row[5], row[6] = -z * q + y * r, z * p + -x * r, -y * p + x * q
        whole[0], whole[1], whole[2], whole[3] = a, b, c, x * a + y * b + z * c
        whole[4], whole[5], whole[6] = -z * b + y * c, z * a + -x * c, -y * a + x * b
        of[3, 0], of[3, 1], of[3, 2], of[3, 3] = x, y, z, x * x + y * y + z * z
        of[4, 1], of[4, 2], of[5, 0], of[5, 2], of[6, 0], of[6, 1] = -z, y, z, -x, -y, x
        of[4, 4], of[5, 5], of[6, 6] = z * z + y * y, z * z + x * x, y * y + x * x
        of[5, 4], of[6, 4], of[6, 5] = -x * y, -z * x, -y * z
        squares += weight * across * across
        for i in range(free):
            g[i] += weight * (row[i] * across + along * whole[i])
            for j in range(i + 1):
                H[i, j] += weight * (row[i] * row[j] + along * of[i, j])
    for i in range(free):
        for j in range(i):
            H[j, i] = H[i, j]
    return H, g, squares


@njit(cache=True, error_model="numpy", nogil=True)
def similarity_about(step, middle):  # type: ignore[no-untyped-def]
    """Return the similarity (4, 4) of a registration step (7,) about `middle` (3,).

    The step is a translation (3), the logarithm of a scale (1) and a rotation vector (3). Rodrigues' formula
    is used here because SciPy takes 17 times as long for a single rotation (measured).
    """
    T, scale = np.eye(4), np.exp(step[3])
    x, y, z = step[4], step[5], step[6]
    angle = np.sqrt(x * x + y * y + z * z)
    along = np.sin(angle) / angle if angle > 0 else 1.0
    # (1 - cos a) / a^2, written without the difference, which would lose digits.
    across = 0.5 * (np.sin(angle / 2) / (angle / 2)) ** 2 if angle > 0 else 0.5
    T[0, 0], T[0, 1], T[0, 2] = (
        1 - across * (y * y + z * z),
        across * x * y - along * z,
        across * x * z + along * y,
    )
    T[1, 0], T[1, 1], T[1, 2] = (
        across * x * y + along * z,
        1 - across * (x * x + z * z),
        across * y * z - along * x,
    )
    T[2, 0], T[2, 1], T[2, 2] = (
        across * x * z - along * y,
        across * y * z + along * x,
        1 - across * (x * x + y * y),
    )
    for i in range(3):
        T[i, 3] = middle[i] + step[i]
        for j in range(3):
            T[i, j] *= scale
            T[i, 3] -= T[i, j] * middle[j]
    return T

"""The loops over pixels of `frame_maps`: depth at lower resolutions, normals, and points of all directions.

Images are (height, width), depth in metres along z, 0 = none; intrinsics are fx, fy, cx, cy in pixels.
"""

import numba
import numpy as np

from kinectbench.geometry.depth_noise import SIGMA_GROWTH_PER_M, SIGMA_NEAR_DEPTH_M, SIGMA_NEAR_M

MIN_DEPTH_M, MAX_DEPTH_M = 0.3, 4.5
# Normals are told apart on a grid of this many cells each way over the half sphere that faces the camera.
NORMAL_CELLS = 12
# Columns of the points: position (3), normal (3), standard deviation of depth, intensity.
POINT_COLUMNS = 8


@numba.njit(cache=True, error_model="numpy")
def reduced_depth(native, depth_scale, factor, stored_per_m):  # type: ignore[no-untyped-def]
    """Mean of each block's measurements that lie on its nearest surface: edges stay sharp."""
    height, width = native.shape[0] // factor, native.shape[1] // factor
    out = np.zeros((height, width), np.uint16)
    low, high = MIN_DEPTH_M * depth_scale, MAX_DEPTH_M * depth_scale
    for v in range(height):
        for u in range(width):
            nearest = np.inf
            for dv in range(factor):
                for du in range(factor):
                    d = native[v * factor + dv, u * factor + du]
                    if low < d < high and d < nearest:
                        nearest = float(d)
            if nearest == np.inf:
                continue
            total, count = 0.0, 0
            for dv in range(factor):
                for du in range(factor):
                    d = native[v * factor + dv, u * factor + du]
                    if low < d <= nearest * 1.02:
                        total += d
                        count += 1
            out[v, u] = np.uint16(total / (count * depth_scale) * stored_per_m + 0.5)
    return out


@numba.njit(cache=True, error_model="numpy")
def halved(depth_m):  # type: ignore[no-untyped-def]
    """Depth at half the resolution: the mean of each 2 x 2 block's nearest surface."""
    height, width = depth_m.shape[0] // 2, depth_m.shape[1] // 2
    out = np.zeros((height, width), np.float32)
    for v in range(height):
        for u in range(width):
            nearest = np.float32(np.inf)
            for dv in range(2):
                for du in range(2):
                    d = depth_m[2 * v + dv, 2 * u + du]
                    if d > 0 and d < nearest:
                        nearest = d
            total, count = 0.0, 0
            for dv in range(2):
                for du in range(2):
                    d = depth_m[2 * v + dv, 2 * u + du]
                    if d > 0 and d <= nearest * np.float32(1.03):
                        total += d
                        count += 1
            if count:
                out[v, u] = total / count
    return out


@numba.njit(cache=True, error_model="numpy")
def smoothed(depth_m, gate):  # type: ignore[no-untyped-def]
    """Mean over 5 x 5 pixels of the same surface: for normals only."""
    height, width = depth_m.shape
    out = np.zeros((height, width), np.float32)
    total, count = np.empty(width, np.float32), np.empty(width, np.float32)
    for v in range(height):
        total[:], count[:] = 0, 0
        centre = depth_m[v]
        for y in range(max(v - 2, 0), min(v + 3, height)):
            row = depth_m[y]
            for shift in range(-2, 3):
                # One shift of a whole row at a time, so that the loop runs on vectors.
                for u in range(max(0, -shift), min(width, width - shift)):
                    d = row[u + shift]
                    same = np.float32(abs(d - centre[u]) < gate * centre[u])
                    total[u] += same * d
                    count[u] += same
        for u in range(width):
            out[v, u] = total[u] / max(count[u], np.float32(1))
    return out


@numba.njit(cache=True, error_model="numpy")
def normals_of(depth_m, intrinsics, gate):  # type: ignore[no-untyped-def]
    """Normals by central differences over two pixels either way, where these lie on one surface."""
    height, width = depth_m.shape
    fx, fy, cx, cy = intrinsics
    out = np.zeros((height, width, 3), np.float32)
    reach = 2
    # Near the border smoothing is one-sided, and what it smooths would seem flatter.
    for v in range(2 * reach, height - 2 * reach):
        for u in range(2 * reach, width - 2 * reach):
            z = depth_m[v, u]
            left, right = depth_m[v, u - reach], depth_m[v, u + reach]
            above, below = depth_m[v - reach, u], depth_m[v + reach, u]
            if z <= 0 or left <= 0 or right <= 0 or above <= 0 or below <= 0:
                continue
            limit = gate * z
            if (
                abs(left - z) > limit
                or abs(right - z) > limit
                or abs(above - z) > limit
                or abs(below - z) > limit
            ):
                continue
            # Differences of the points to the right and to the left, below and above.
            ax = ((u + reach - cx) * right - (u - reach - cx) * left) / fx
            ay = (v - cy) * (right - left) / fy
            az = right - left
            bx = (u - cx) * (below - above) / fx
            by = ((v + reach - cy) * below - (v - reach - cy) * above) / fy
            bz = below - above
            nx, ny, nz = by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            if length > 0:
                out[v, u, 0], out[v, u, 1], out[v, u, 2] = nx / length, ny / length, nz / length
    return out


@numba.njit(cache=True, error_model="numpy")
def chosen_points(depth_m, normals, intensity, intrinsics, n_points):  # type: ignore[no-untyped-def]
    """Points chosen so that rare normals count (normal-space sampling: Rusinkiewicz & Levoy 2001).

    A floor is most of the image and says nothing of how far one has walked on it; the noise of its normals
    only blurs what the legs of a table say.
    """
    height, width = depth_m.shape
    fx, fy, cx, cy = intrinsics
    counts = np.zeros(NORMAL_CELLS * NORMAL_CELLS, np.int64)
    for v in range(height):
        for u in range(width):
            if normals[v, u, 2] != 0:
                counts[_cell(normals[v, u])] += 1
    cap = _cap(counts, n_points)
    credit = np.full(len(counts), 0.5)
    out = np.empty((n_points + len(counts), POINT_COLUMNS), np.float32)
    n = 0
    for v in range(height):
        for u in range(width):
            if normals[v, u, 2] == 0:
                continue
            cell = _cell(normals[v, u])
            credit[cell] += min(1.0, cap / counts[cell])
            if credit[cell] < 1:
                continue
            credit[cell] -= 1
            z = depth_m[v, u]
            point = out[n]
            point[0], point[1], point[2] = (u - cx) / fx * z, (v - cy) / fy * z, z
            point[3], point[4], point[5] = normals[v, u, 0], normals[v, u, 1], normals[v, u, 2]
            point[6] = SIGMA_NEAR_M + SIGMA_GROWTH_PER_M * (z - SIGMA_NEAR_DEPTH_M) ** 2
            point[7] = intensity[v, u] if intensity.size else 0.0
            n += 1
    return out[:n].copy()


@numba.njit(cache=True, error_model="numpy")
def _cell(normal):  # type: ignore[no-untyped-def]
    """Which cell of the half sphere a normal falls in: its x and y, evenly divided."""
    i = min(NORMAL_CELLS - 1, int((normal[0] + 1) * 0.5 * NORMAL_CELLS))
    j = min(NORMAL_CELLS - 1, int((normal[1] + 1) * 0.5 * NORMAL_CELLS))
    return i * NORMAL_CELLS + j


@numba.njit(cache=True, error_model="numpy")
def _cap(counts, total):  # type: ignore[no-untyped-def]
    """The cap c for which the sum of min(count, c) is `total`, or infinity if there are no more than that."""
    if counts.sum() <= total:
        return np.inf
    ascending = np.sort(counts)
    below = 0.0
    for k in range(len(ascending)):
        cap = (total - below) / (len(ascending) - k)
        if ascending[k] >= cap:
            return cap
        below += ascending[k]
    return np.inf

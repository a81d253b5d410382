"""Pixel kernels of `frame_maps`: reduced depth, normals, and points with evenly spread normals.

Images are (height, width). Depth is along z, 0 = none, in metres unless the name says native. Intrinsics are
fx, fy, cx, cy in pixels.
"""

import numba
import numpy as np

from kinectbench.core.geometry import SIGMA_GROWTH_PER_M, SIGMA_NEAR_DEPTH_M, SIGMA_NEAR_M

# A Kinect measures nothing nearer; farther its noise exceeds 33 mm.
MIN_DEPTH_M, MAX_DEPTH_M = 0.3, 4.5
# Points nearer to a camera are not projected into it: their pixels move without bound.
PROJECTED_FROM_M = 0.1
# Depths within this ratio of the nearest one are averaged with it when an image is reduced: by blocks of the
# sensor's pixels, and from level to level.
SAME_DEPTH, SAME_DEPTH_OF_LEVELS = 1.02, 1.03
# Normals are binned on a grid of this many cells each way over the half sphere that faces the camera.
NORMAL_CELLS = 12
# Marks a pixel without cell; the 12 x 12 cells have smaller numbers.
NO_CELL = 255
# Lower bound of the cosine of the angle between normal and viewing ray, in the model of normal noise.
MIN_COSINE = 0.3
# Columns of the points: position (3), normal (3), standard deviation of depth, intensity.
POINT_COLUMNS = 8


@numba.njit(cache=True, error_model="numpy", nogil=True)
def reduced_depth(native, depth_scale, factor, stored_per_m):  # type: ignore[no-untyped-def]
    """Reduce blocks of native depth to uint16: the mean of the nearest surface only, to keep edges sharp.

    Args:
        native: (height, width) depth; only 0.3 to 4.5 m counts.
        depth_scale: native units per metre.
        factor: a block has `factor` x `factor` pixels.
        stored_per_m: units of the result per metre.
    """
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
                    if low < d <= nearest * SAME_DEPTH:
                        total += d
                        count += 1
            out[v, u] = np.uint16(total / (count * depth_scale) * stored_per_m + 0.5)
    return out


@numba.njit(cache=True, error_model="numpy", nogil=True)
def halved(depth_m):  # type: ignore[no-untyped-def]
    """Halve the resolution of `depth_m`, 0 = none: the mean of the nearest surface in each 2 x 2 block."""
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
                    if d > 0 and d <= nearest * np.float32(SAME_DEPTH_OF_LEVELS):
                        total += d
                        count += 1
            if count:
                out[v, u] = total / count
    return out


@numba.njit(cache=True, error_model="numpy", nogil=True)
def smoothed_depth(depth_m, gate):  # type: ignore[no-untyped-def]
    """Average depth over 5 x 5 pixels, except pixels that differ by `gate` times depth or more."""
    height, width = depth_m.shape
    out = np.zeros((height, width), np.float32)
    total, count = np.empty(width, np.float32), np.empty(width, np.float32)
    for v in range(height):
        total[:], count[:] = 0, 0
        for y in range(max(v - 2, 0), min(v + 3, height)):
            for shift in range(-2, 3):
                # One shift for a whole row at a time, with slices without negative indices, so that the loop
                # is vectorised.
                first, end = max(0, -shift), min(width, width - shift)
                near, centre = depth_m[y, first + shift : end + shift], depth_m[v, first:end]
                sums, counts = total[first:end], count[first:end]
                for u in range(end - first):
                    same = np.float32(abs(near[u] - centre[u]) < gate * centre[u])
                    sums[u] += same * near[u]
                    counts[u] += same
        for u in range(width):
            out[v, u] = total[u] / max(count[u], np.float32(1))
    return out


@numba.njit(cache=True, error_model="numpy", nogil=True)
def normals_of(depth_m, intrinsics, gate):  # type: ignore[no-untyped-def]
    """Return normals (height, width, 3), each from the pixels two to the left, right, above and below.

    A normal is 0 if one of these pixels differs from the centre by more than `gate` times the depth, because
    they do not show one surface. It is also 0 at the image border.
    """
    height, width = depth_m.shape
    fx, fy, cx, cy = intrinsics
    over_fx, over_fy = 1 / fx, 1 / fy
    out = np.zeros((height, width, 3), np.float32)
    reach = 2
    # Near the border smoothing is one-sided, which would flatten the surface.
    border = 2 * reach
    n = width - 2 * border
    if n <= 0:
        return out
    normal = np.empty((3, n), np.float32)
    for v in range(border, height - border):
        row = depth_m[v]
        centre, left, right = row[border:], row[border - reach :], row[border + reach :]
        above, below = depth_m[v - reach, border:], depth_m[v + reach, border:]
        for i in range(n):
            # No early exit, so that the loop is vectorised.
            z, zl, zr, za, zb = centre[i], left[i], right[i], above[i], below[i]
            limit = gate * z
            valid = (z > 0) & (zl > 0) & (zr > 0) & (za > 0) & (zb > 0)
            valid &= (abs(zl - z) <= limit) & (abs(zr - z) <= limit)
            valid &= (abs(za - z) <= limit) & (abs(zb - z) <= limit)
            u = i + border
            # Differences between the points to the right and left, and below and above.
            ax = ((u + reach - cx) * zr - (u - reach - cx) * zl) * over_fx
            ay = (v - cy) * (zr - zl) * over_fy
            az = zr - zl
            bx = (u - cx) * (zb - za) * over_fx
            by = ((v + reach - cy) * zb - (v - reach - cy) * za) * over_fy
            bz = zb - za
            nx, ny, nz = by * az - bz * ay, bz * ax - bx * az, bx * ay - by * ax
            length = np.sqrt(nx * nx + ny * ny + nz * nz)
            valid &= length > 0
            over_length = 1 / length if valid else 0.0
            normal[0, i] = nx * over_length
            normal[1, i] = ny * over_length
            normal[2, i] = nz * over_length
        inner = out[v, border : width - border]
        for i in range(n):
            inner[i, 0], inner[i, 1], inner[i, 2] = normal[0, i], normal[1, i], normal[2, i]
    return out


@numba.njit(cache=True, error_model="numpy", nogil=True)
def chosen_points(depth_m, normals, intensity, intrinsics, n_points):  # type: ignore[no-untyped-def]
    """Sample about `n_points` points with evenly distributed normals; return (m, 8), as `Level.points`.

    Normal-space sampling: Rusinkiewicz & Levoy 2001. The maps are as in `Level`.

    A floor fills most of the image but does not constrain motion along it. With uniform sampling, the noise
    of its normals would outweigh the few points that constrain that motion, such as those on table legs.
    """
    height, width = depth_m.shape
    fx, fy, cx, cy = intrinsics
    counts = np.zeros(NORMAL_CELLS * NORMAL_CELLS, np.int64)
    cells = np.empty((height, width), np.uint8)
    for v in range(height):
        row, cell = normals[v], cells[v]
        for u in range(width):
            cell[u] = _cell(row[u, 0], row[u, 1]) if row[u, 2] != 0 else NO_CELL
            if cell[u] != NO_CELL:
                counts[cell[u]] += 1
    cap = _cap(counts, n_points)
    share = np.minimum(1.0, cap / counts)
    credit = np.full(len(counts), 0.5)
    out = np.empty((n_points + len(counts), POINT_COLUMNS), np.float32)
    n = 0
    for v in range(height):
        cell, row = cells[v], normals[v]
        for u in range(width):
            c = cell[u]
            if c == NO_CELL:
                continue
            credit[c] += share[c]
            if credit[c] < 1:
                continue
            credit[c] -= 1
            z = depth_m[v, u]
            point = out[n]
            point[0], point[1], point[2] = (u - cx) / fx * z, (v - cy) / fy * z, z
            point[3], point[4], point[5] = row[u, 0], row[u, 1], row[u, 2]
            point[6] = SIGMA_NEAR_M + SIGMA_GROWTH_PER_M * (z - SIGMA_NEAR_DEPTH_M) ** 2
            point[7] = intensity[v, u] if intensity.size else 0.0
            n += 1
    return out[:n].copy()


@numba.njit(cache=True, error_model="numpy", nogil=True)
def normal_differences(normals, depth_m, intrinsics):  # type: ignore[no-untyped-def]
    """Return squared differences (m,) of normals nine pixels apart, divided by (sigma * cosine / depth)^2.

    The noise of a normal is proportional to sigma / depth * cosine, where sigma is the standard deviation of
    depth and cosine that of the angle between normal and viewing ray: a pixel covers more of a surface that
    is farther away or more oblique.
    """
    height, width = depth_m.shape
    fx, fy, cx, cy = intrinsics
    out = np.empty(((height + 3) // 4) * ((width + 3) // 4))
    m = 0
    for v in range(0, height, 4):
        for u in range(0, width - 9, 4):
            this, other = normals[v, u], normals[v, u + 9]
            if this[2] == 0 or other[2] == 0:
                continue
            x, y, z = (u - cx) / fx, (v - cy) / fy, np.float64(depth_m[v, u])
            cosine = abs(x * this[0] + y * this[1] + this[2]) / np.sqrt(x * x + y * y + 1)
            sigma = SIGMA_NEAR_M + SIGMA_GROWTH_PER_M * (z - SIGMA_NEAR_DEPTH_M) ** 2
            inverse_noise = z / (sigma * max(cosine, MIN_COSINE))
            dx, dy, dz = this[0] - other[0], this[1] - other[1], this[2] - other[2]
            out[m] = (dx * dx + dy * dy + dz * dz) * inverse_noise**2
            m += 1
    return out[:m].copy()


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _cell(nx, ny):  # type: ignore[no-untyped-def]
    """Return the index of a normal's cell in an even grid over its x and y."""
    i = min(NORMAL_CELLS - 1, int((nx + 1) * 0.5 * NORMAL_CELLS))
    j = min(NORMAL_CELLS - 1, int((ny + 1) * 0.5 * NORMAL_CELLS))
    return i * NORMAL_CELLS + j


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _cap(counts, total):  # type: ignore[no-untyped-def]
    """Return the cap c for which the sum of min(count, c) is `total`; infinity if the counts sum to less."""
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

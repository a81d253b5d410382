"""Loops over cells and surface patches."""

import numpy as np
from numba import njit

# A surface cell's normal is computed from the cells within this many cells along each axis, as in the grid
# protocols (`surface_kernels`).
RADIUS_CELLS = 3


@njit(cache=True, error_model="numpy", nogil=True)
def faces_of_cells(packed):  # type: ignore[no-untyped-def]
    """Return every face between an occupied cell and a free one.

    Args:
        packed: (i + 2, j + 2, b) uint8: the grid with a border of free cells, packed along k by `pack`.

    Returns:
        (n, 3) int32, the occupied cell of each face, in C order, with indices that do not count the border;
        (n,) int8, the axis normal to the face; (n,) int8, 1 if the free cell has the larger index along that
        axis, else -1.
    """
    count = _faces(packed, np.empty((0, 3), np.int32), np.empty(0, np.int8), np.empty(0, np.int8))
    inside = np.empty((count, 3), np.int32)
    axes, signs = np.empty(count, np.int8), np.empty(count, np.int8)
    _faces(packed, inside, axes, signs)
    return inside, axes, signs


@njit(cache=True, error_model="numpy", nogil=True)
def _faces(packed, inside, axes, signs):  # type: ignore[no-untyped-def]
    """Write the faces between occupied and free cells into the arrays; return how many faces there are.

    Faces that do not fit into the arrays are only counted. Eight cells are tested at once.

    Args:
        packed: as in `faces_of_cells`.
        inside: output, the first result of `faces_of_cells`; may be empty, to count only, like the other two.
        axes: output, the second result.
        signs: output, the third result.
    """
    count, last = 0, packed.shape[2] - 1
    free = np.empty(6, np.int64)
    for i in range(1, packed.shape[0] - 1):
        for j in range(1, packed.shape[1] - 1):
            for b in range(last + 1):
                cells = np.int64(packed[i, j, b])
                if not cells:
                    continue
                before = np.int64(packed[i, j, b - 1]) if b else 0
                after = np.int64(packed[i, j, b + 1]) if b < last else 0
                free[0], free[1] = ~packed[i - 1, j, b], ~packed[i + 1, j, b]
                free[2], free[3] = ~packed[i, j - 1, b], ~packed[i, j + 1, b]
                free[4], free[5] = ~(cells >> 1 | before << 7), ~(cells << 1 | after >> 7)
                if not cells & (free[0] | free[1] | free[2] | free[3] | free[4] | free[5]):
                    continue
                for bit in range(7, -1, -1):
                    if not cells >> bit & 1:
                        continue
                    for side in range(6):
                        if free[side] >> bit & 1:
                            if count < len(inside):
                                inside[count, 0], inside[count, 1] = i - 1, j - 1
                                inside[count, 2] = 8 * b + 6 - bit
                                axes[count], signs[count] = side // 2, 2 * (side % 2) - 1
                            count += 1
    return count


@njit(cache=True, error_model="numpy", nogil=True)
def outward(packed, inside):  # type: ignore[no-untyped-def]
    """Return each cell's outward normal: (n, 3) float64, unit length, or 0 if it is undefined.

    It points away from the centroid of the occupied cells among the 7^3 cells around the cell. It is
    undefined if the centroid is the cell's own centre.

    Args:
        packed: as in `faces_of_cells`.
        inside: (n, 3) cells, the first result of `faces_of_cells`.
    """
    normals = np.zeros((len(inside), 3))
    rows, columns, last = packed.shape[0], packed.shape[1], packed.shape[2] - 1
    # For each pattern of seven cells along k (as bits, the last cell lowest): the number of occupied cells,
    # and minus the sum of their offsets.
    counts, moments = np.zeros(128, np.int64), np.zeros(128, np.int64)
    for code in range(128):
        for bit in range(7):
            if code >> bit & 1:
                counts[code] += 1
                moments[code] += bit - RADIUS_CELLS
    for n in range(len(inside)):
        i, j, k = inside[n]
        if n and inside[n - 1, 0] == i and inside[n - 1, 1] == j and inside[n - 1, 2] == k:
            normals[n] = normals[n - 1]
            continue
        i, j, k = i + 1, j + 1, k + 1
        byte, shift = k >> 3, 12 - (k & 7)
        x = y = z = 0
        for a in range(max(i - RADIUS_CELLS, 0), min(i + RADIUS_CELLS + 1, rows)):
            for b in range(max(j - RADIUS_CELLS, 0), min(j + RADIUS_CELLS + 1, columns)):
                three = np.int64(packed[a, b, byte]) << 8
                if byte:
                    three |= np.int64(packed[a, b, byte - 1]) << 16
                if byte < last:
                    three |= np.int64(packed[a, b, byte + 1])
                code = three >> shift & 127
                x += (i - a) * counts[code]
                y += (j - b) * counts[code]
                z += moments[code]
        length = np.sqrt(np.float64(x * x + y * y + z * z))
        if length > 0:
            normals[n, 0], normals[n, 1], normals[n, 2] = x / length, y / length, z / length
    return normals


@njit(cache=True, error_model="numpy", nogil=True)
def zero_crossings(cells, axis):  # type: ignore[no-untyped-def]
    """Find the sign changes of signed distances between neighbours along one axis.

    Args:
        cells: (i, j, k) float32, negative inside.
        axis: 0, 1 or 2.

    Returns:
        (n, 3) float64, the positions of the crossings in cells, with cell centres at integers; (n, 3)
        float64, the direction of the gradient there: unit length, or 0 if the gradient is 0.
    """
    ni, nj, nk = cells.shape
    si, sj, sk = 1 if axis == 0 else 0, 1 if axis == 1 else 0, 1 if axis == 2 else 0
    count = 0
    for i in range(ni - si):
        for j in range(nj - sj):
            for k in range(nk - sk):
                count += (cells[i, j, k] < 0) != (cells[i + si, j + sj, k + sk] < 0)
    points, normals = np.empty((count, 3)), np.zeros((count, 3))
    n = 0
    for i in range(ni - si):
        for j in range(nj - sj):
            for k in range(nk - sk):
                one, other = np.float64(cells[i, j, k]), np.float64(cells[i + si, j + sj, k + sk])
                if (one < 0) == (other < 0):
                    continue
                t = one / (one - other)
                points[n, 0], points[n, 1], points[n, 2] = i + t * si, j + t * sj, k + t * sk
                for end in range(2):
                    a, b, c = i + end * si, j + end * sj, k + end * sk
                    part = t if end else 1 - t
                    low, high = max(a - 1, 0), min(a + 1, ni - 1)
                    normals[n, 0] += part * (cells[high, b, c] - cells[low, b, c]) / max(high - low, 1)
                    low, high = max(b - 1, 0), min(b + 1, nj - 1)
                    normals[n, 1] += part * (cells[a, high, c] - cells[a, low, c]) / max(high - low, 1)
                    low, high = max(c - 1, 0), min(c + 1, nk - 1)
                    normals[n, 2] += part * (cells[a, b, high] - cells[a, b, low]) / max(high - low, 1)
                length = np.sqrt((normals[n] ** 2).sum())
                if length > 0:
                    normals[n] /= length
                n += 1
    return points, normals


@njit(cache=True, error_model="numpy", nogil=True)
def to_patches(points, found, corner, first, second, is_triangle):  # type: ignore[no-untyped-def]
    """Return each point's distance to a patch of its own, a triangle or a rectangle: (n,) float64.

    Args:
        points: (n, 3).
        found: (n,) index of each point's patch.
        corner: (m, 3), one corner of each patch.
        first: (m, 3), the edge from that corner to the next one.
        second: (m, 3), the edge from that corner to the previous one.
        is_triangle: whether patches are triangles; otherwise they are rectangles.
    """
    distances = np.empty(len(points))
    for n in range(len(points)):
        f = found[n]
        x, y, z = points[n, 0] - corner[f, 0], points[n, 1] - corner[f, 1], points[n, 2] - corner[f, 2]
        a, b, c = first[f]
        d, e, g = second[f]
        uu, uv, vv = a * a + b * b + c * c, a * d + b * e + c * g, d * d + e * e + g * g
        pu, pv = x * a + y * b + z * c, x * d + y * e + z * g
        if is_triangle:
            u, v = _in_triangle(uu, uv, vv, pu, pv)
        else:
            u = min(max(pu / uu, 0.0), 1.0) if uu > 0 else 0.0
            v = min(max(pv / vv, 0.0), 1.0) if vv > 0 else 0.0
        x, y, z = x - u * a - v * d, y - u * b - v * e, z - u * c - v * g
        distances[n] = np.sqrt(x * x + y * y + z * z)
    return distances


@njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _in_triangle(uu, uv, vv, pu, pv):  # type: ignore[no-untyped-def]
    """Return the coordinates (u, v) of the point u U + v V of a triangle that is nearest to the point p.

    The triangle is spanned by edges U and V from the origin. `uu`, `uv`, `vv`, `pu` and `pv` are the dot
    products U . U, U . V, V . V, p . U and p . V.
    """
    determinant = uu * vv - uv * uv
    if determinant > 0:
        u, v = (vv * pu - uv * pv) / determinant, (uu * pv - uv * pu) / determinant
        if u >= 0 and v >= 0 and u + v <= 1:
            return u, v
    # The nearest point is on an edge: compare the three edges by |uU + vV - p|^2 - p^2.
    best_u = min(max(pu / uu, 0.0), 1.0) if uu > 0 else 0.0
    best_v = 0.0
    least = best_u * best_u * uu - 2 * best_u * pu
    v = min(max(pv / vv, 0.0), 1.0) if vv > 0 else 0.0
    value = v * v * vv - 2 * v * pv
    if value < least:
        least, best_u, best_v = value, 0.0, v
    across = uu - 2 * uv + vv
    v = min(max((pv - pu + uu - uv) / across, 0.0), 1.0) if across > 0 else 0.0
    u = 1 - v
    value = u * u * uu + 2 * u * v * uv + v * v * vv - 2 * u * pu - 2 * v * pv
    if value < least:
        best_u, best_v = u, v
    return best_u, best_v


@njit(cache=True, error_model="numpy", nogil=True)
def mapped(points, affine):  # type: ignore[no-untyped-def]
    """Return points (n, 3) mapped by a (3, 4) matrix; numpy's product would start threads on all cores."""
    found = np.empty(points.shape, np.float64)
    for n in range(len(points)):
        x, y, z = points[n]
        for axis in range(3):
            a, b, c, d = affine[axis]
            found[n, axis] = a * x + b * y + c * z + d
    return found


@njit(cache=True, error_model="numpy", nogil=True)
def known_and_seen(points, voxel_size, known, seen):  # type: ignore[no-untyped-def]
    """Return which points lie in known cells, and which lie in seen cells: (n,) bool each.

    Points outside the grid count as known and not seen.

    Args:
        points: (n, 3), in the unit of `voxel_size`, from the grid's corner.
        voxel_size: edge of a cell.
        known: (i, j, k / 8) uint8, packed.
        seen: (i, j, k / 8) uint8, packed.
    """
    is_known, is_seen = np.ones(len(points), np.bool_), np.zeros(len(points), np.bool_)
    ni, nj, nk = known.shape[0], known.shape[1], 8 * known.shape[2]
    for n in range(len(points)):
        a = np.floor(points[n, 0] / voxel_size)
        b = np.floor(points[n, 1] / voxel_size)
        c = np.floor(points[n, 2] / voxel_size)
        if 0 <= a < ni and 0 <= b < nj and 0 <= c < nk:
            i, j, k = np.int64(a), np.int64(b), np.int64(c)
            bit = 7 - (k & 7)
            is_known[n] = known[i, j, k >> 3] >> bit & 1 == 1
            is_seen[n] = seen[i, j, k >> 3] >> bit & 1 == 1
    return is_known, is_seen


@njit(cache=True, error_model="numpy", nogil=True)
def inside_cells(cells, affine, side):  # type: ignore[no-untyped-def]
    """Return which cells of the truth's grid have their centre in an occupied cell of the prediction.

    The result is (side, side, side) bool.

    Args:
        cells: (i, j, k) bool, the prediction; space outside its grid is free.
        affine: (3, 4), from the truth's cell coordinates to the prediction's.
        side: number of the truth's cells along each axis.
    """
    found = np.zeros((side, side, side), np.bool_)
    for i in range(side):
        for j in range(side):
            x, y, z = _place(affine, i, j)
            for k in range(side):
                a = np.int64(np.floor(x + affine[0, 2] * (k + 0.5)))
                b = np.int64(np.floor(y + affine[1, 2] * (k + 0.5)))
                c = np.int64(np.floor(z + affine[2, 2] * (k + 0.5)))
                if 0 <= a < cells.shape[0] and 0 <= b < cells.shape[1] and 0 <= c < cells.shape[2]:
                    found[i, j, k] = cells[a, b, c]
    return found


@njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _place(affine, i, j):  # type: ignore[no-untyped-def]
    """Return (i + 0.5, j + 0.5, 0), the start of a line of cells, transformed by `affine` (3, 4)."""
    x = affine[0, 0] * (i + 0.5) + affine[0, 1] * (j + 0.5) + affine[0, 3]
    y = affine[1, 0] * (i + 0.5) + affine[1, 1] * (j + 0.5) + affine[1, 3]
    return x, y, affine[2, 0] * (i + 0.5) + affine[2, 1] * (j + 0.5) + affine[2, 3]


@njit(cache=True, error_model="numpy", nogil=True)
def inside_distances(cells, affine, side):  # type: ignore[no-untyped-def]
    """Return which cells of the truth's grid have their centre at a negative distance (inside).

    Arguments as in `inside_cells`, but `cells` are float32 signed distances. They are interpolated
    trilinearly between cell centres, and constant from the outermost centres to the grid's border. Space
    outside the grid is free.
    """
    found = np.zeros((side, side, side), np.bool_)
    ni, nj, nk = cells.shape
    for i in range(side):
        for j in range(side):
            x, y, z = _place(affine, i, j)
            for k in range(side):
                a = x + affine[0, 2] * (k + 0.5)
                b = y + affine[1, 2] * (k + 0.5)
                c = z + affine[2, 2] * (k + 0.5)
                if not (0 <= a < ni and 0 <= b < nj and 0 <= c < nk):
                    continue
                a, b, c = _within(a, ni), _within(b, nj), _within(c, nk)
                a0, b0, c0 = np.int64(a), np.int64(b), np.int64(c)
                a1, b1, c1 = min(a0 + 1, ni - 1), min(b0 + 1, nj - 1), min(c0 + 1, nk - 1)
                u, v, w = a - a0, b - b0, c - c0
                low = (1 - v) * _mixed(cells[a0, b0, c0], cells[a0, b0, c1], w)
                low += v * _mixed(cells[a0, b1, c0], cells[a0, b1, c1], w)
                high = (1 - v) * _mixed(cells[a1, b0, c0], cells[a1, b0, c1], w)
                high += v * _mixed(cells[a1, b1, c0], cells[a1, b1, c1], w)
                found[i, j, k] = (1 - u) * low + u * high < 0
    return found


@njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _within(place, count):  # type: ignore[no-untyped-def]
    return min(max(place - 0.5, 0.0), count - 1.0)


@njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _mixed(one, other, part):  # type: ignore[no-untyped-def]
    return (1 - part) * one + part * other

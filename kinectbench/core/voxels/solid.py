"""Convert a closed triangle mesh to a solid voxel grid by signed-winding scanlines; find a solid's shell.

`open_mesh` uses the same crossings of scanlines with triangles.
"""

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Grid
from kinectbench.core.types import Float64, Int32, Int64
from kinectbench.core.voxels.pair_file import Packed

# Vertices are snapped to 2^-16 of a cell, so that the tests on shared edges are exact integers.
SUBCELL_BITS = 16
SUBCELL = 1 << SUBCELL_BITS
# Four times the need of the finest mesh: a sphere of a million triangles has 2.3 million. 26 bytes each.
MAX_CROSSINGS = 1 << 23
# Faces whose boxes lie over one column of cells: 16 for each cell of a cube of 256. Chosen by hand.
MAX_IN_A_COLUMN = 4096


def snapped_cells(vertices_world: Float64, grid: Grid) -> Int64:
    """Return vertices (n, 3), metres, as int64 multiples of 2^-16 cell from the grid's corner."""
    subcells = grid.T_grid_world[:3] * (SUBCELL / grid.voxel_size_m)
    return np.asarray(_snap(np.ascontiguousarray(vertices_world, dtype=np.float64), subcells))


@numba.njit(cache=True, nogil=True)
def _snap(vertices, affine):  # type: ignore[no-untyped-def]
    # Not a matrix product: a library would wake all cores for it.
    fixed = np.empty(vertices.shape, np.int64)
    for n in range(len(vertices)):
        x, y, z = vertices[n]
        for axis in range(3):
            a, b, c, d = affine[axis]
            fixed[n, axis] = np.int64(np.floor(a * x + b * y + c * z + d + 0.5))
    return fixed


@numba.njit(cache=True, error_model="numpy", nogil=True)
def crossings(fixed, faces, axes, start, shape, touching):  # type: ignore[no-untyped-def]
    """Find all crossings of a mesh with parallel lines, which form a square lattice.

    A face that is seen edge-on along the lines crosses none.

    Args:
        fixed: (n, 3) int64, vertices from `snapped_cells`.
        faces: (m, 3) int32.
        axes: (u, v, w), a permutation of (0, 1, 2): the lines run along w.
        start: where line (0, 0) passes, in both u and v, int in multiples of 2^-16 cell; lines are one cell
            apart.
        shape: (nu, nv), number of lines along u and v.
        touching: whether a face also crosses lines through its border. If not, it owns its left and top
            edges only, so that a line through an edge crosses one of the two faces that share it.

    Returns:
        lines (k,) int64, i nv + j for line (i, j); heights (k,) float64 along w, in cells; signs (k,) int8,
        1 where the face looks down w (a solid begins), -1 where it looks up (it ends).
    """
    nu, nv = shape
    count, capacity = 0, 4096
    lines = np.empty(capacity, np.int64)
    heights = np.empty(capacity, np.float64)
    signs = np.empty(capacity, np.int8)
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        i0, i1 = _span(fixed, a, b, c, axes[0], start, nu)
        j0, j1 = _span(fixed, a, b, c, axes[1], start, nv)
        if i1 < i0 or j1 < j0:
            continue
        if count + (i1 - i0 + 1) * (j1 - j0 + 1) > capacity:
            capacity = 2 * (count + (i1 - i0 + 1) * (j1 - j0 + 1))
            lines = _longer(lines, count, capacity)
            heights = _longer(heights, count, capacity)
            signs = _longer(signs, count, capacity)
        corners = _upward(fixed, a, b, c, axes, start)
        count = _cross(corners, i0, i1, j0, j1, nv, touching, count, lines, heights, signs)
    return lines[:count], heights[:count], signs[:count]


@numba.njit(cache=True, nogil=True, inline="always")
def _span(fixed, a, b, c, u, start, count):  # type: ignore[no-untyped-def]
    """Return the indices of the first and the last line that may cross a triangle.

    The `count` lines are numbered in direction u; line 0 passes at `start`. `a`, `b`, `c` are indices of the
    triangle's vertices in `fixed`.
    """
    low = min(fixed[a, u], fixed[b, u], fixed[c, u]) - start
    high = max(fixed[a, u], fixed[b, u], fixed[c, u]) - start
    # Shifts, because a signed division is ten times as slow; both round down.
    return max(0, -((-low) >> SUBCELL_BITS)), min(count - 1, high >> SUBCELL_BITS)


@numba.njit(cache=True, nogil=True, inline="always")
def _upward(fixed, a, b, c, axes, start):  # type: ignore[no-untyped-def]
    """Return a triangle's nine coordinates, twice its area projected along w, and its sign in `crossings`.

    The corners (u, v, w) are in counter-clockwise order seen from w; u and v count from `start`. `a`, `b` and
    `c` are the vertices' indices in `fixed`.
    """
    u, v, w = axes
    ax, ay, az = fixed[a, u] - start, fixed[a, v] - start, fixed[a, w]
    bx, by, bz = fixed[b, u] - start, fixed[b, v] - start, fixed[b, w]
    cx, cy, cz = fixed[c, u] - start, fixed[c, v] - start, fixed[c, w]
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    if area < 0:
        return ax, ay, az, cx, cy, cz, bx, by, bz, -area, 1
    return ax, ay, az, bx, by, bz, cx, cy, cz, area, -1


# Inlined, because a call counts references to its arrays, which takes longer than the work.
@numba.njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _cross(corners, i0, i1, j0, j1, nv, touching, count, lines, heights, signs):  # type: ignore[no-untyped-def]
    """Write one triangle's crossings with the lines (i, j), i from i0 to i1, j from j0 to j1, both inclusive.

    The lines run along w; i counts them in direction u, j in direction v. Return the number of crossings
    written so far.

    Args:
        corners: the result of `_upward`.
        i0: the first i.
        i1: the last i.
        j0: the first j.
        j1: the last j.
        nv: number of lines in direction v. Line (i, j) is written as i nv + j.
        touching: whether a face also crosses lines through its border, as in `crossings`.
        count: number of crossings already in the arrays. New ones are written from this index on.
        lines: the array of lines to write to, as `crossings` returns it, but longer.
        heights: the array of heights to write to.
        signs: the array of signs to write to.
    """
    ax, ay, az, bx, by, bz, cx, cy, cz, area, sign = corners
    if area == 0:
        return count
    # An edge function of a line on the edge is zero; without `touching` only own edges may be.
    low_a = 0 if touching or cy < by or (cy == by and cx > bx) else 1
    low_b = 0 if touching or ay < cy or (ay == cy and ax > cx) else 1
    low_c = 0 if touching or by < ay or (by == ay and bx > ax) else 1
    # Exactly zero on a face across the lines, whose crossings are then all at one height.
    slope_b = (bz - az) / (SUBCELL * float(area))
    slope_c = (cz - az) / (SUBCELL * float(area))
    for i in range(i0, i1 + 1):
        px = i * SUBCELL
        for j in range(j0, j1 + 1):
            py = j * SUBCELL
            wa = (cx - bx) * (py - by) - (cy - by) * (px - bx)
            wb = (ax - cx) * (py - cy) - (ay - cy) * (px - cx)
            wc = area - wa - wb
            if wa >= low_a and wb >= low_b and wc >= low_c:
                lines[count] = i * nv + j
                heights[count] = az / SUBCELL + (wb * slope_b + wc * slope_c)
                signs[count] = sign
                count += 1
    return count


@numba.njit(cache=True, nogil=True)
def _longer(values, count, capacity):  # type: ignore[no-untyped-def]
    longer = np.empty(capacity, values.dtype)
    longer[:count] = values[:count]
    return longer


def costs_too_much(vertices_cells: Float64, faces: Int32, shape: tuple[int, int]) -> bool:
    """Return whether an untrusted mesh may cross more lines of a grid than any mesh of a real object does.

    A face is counted at all lines through its bounding rectangle.

    Args:
        vertices_cells: (n, 2) float64, finite, along the two axes across the lines, in cells from the corner.
        faces: (m, 3) int32.
        shape: number of lines along each of these axes.
    """
    total, most = _crossable(np.ascontiguousarray(vertices_cells), faces, shape)
    return bool(total > MAX_CROSSINGS or most > MAX_IN_A_COLUMN)


@numba.njit(cache=True, nogil=True)
def _crossable(vertices, faces, shape):  # type: ignore[no-untyped-def]
    """Return upper bounds: how often faces cross lines in all, and how many faces cross one line.

    Arguments as in `costs_too_much`.
    """
    nu, nv = shape
    # How many more rectangles cover a column than the one before, along both sides.
    steps = np.zeros((nu + 3, nv + 3), np.int64)
    total = 0
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        u0, u1 = _columns(vertices[a, 0], vertices[b, 0], vertices[c, 0], nu)
        v0, v1 = _columns(vertices[a, 1], vertices[b, 1], vertices[c, 1], nv)
        if u1 < 0 or v1 < 0 or u0 >= nu or v0 >= nv:
            continue
        total += (u1 - u0 + 1) * (v1 - v0 + 1)
        steps[u0 + 1, v0 + 1] += 1
        steps[u1 + 2, v1 + 2] += 1
        steps[u0 + 1, v1 + 2] -= 1
        steps[u1 + 2, v0 + 1] -= 1
    most = 0
    for i in range(nu + 3):
        row = 0
        for j in range(nv + 3):
            row += steps[i, j]
            steps[i, j] = row + (steps[i - 1, j] if i else 0)
            if steps[i, j] > most:
                most = steps[i, j]
    return total, most


@numba.njit(cache=True, nogil=True)
def _columns(a, b, c, most):  # type: ignore[no-untyped-def]
    """Return the smallest and the largest of three coordinates as cells, at least -1 and at most `most`."""
    low, high = np.floor(min(a, b, c)), np.floor(max(a, b, c))
    return np.int64(min(max(low, -1.0), most)), np.int64(min(max(high, -1.0), most))


def voxelize_solid(vertices_world: Float64, faces: Int32, grid: Grid) -> NDArray[np.uint8]:
    """Return the cells of a grid that have their centre inside a closed mesh.

    Every column of cells along z is crossed by the triangles above and below it; a cell is inside
    where the signed crossings below its centre do not cancel (non-zero winding number). Defined here;
    exact for closed, outward-oriented meshes up to the snapping of 2^-16 cell.

    Args:
        vertices_world: (n, 3) float64, metres, world frame.
        faces: (m, 3) int32, counter-clockwise seen from outside.
        grid: where to voxelise; its last side must be a multiple of 8.

    Returns:
        (nx, ny, nz / 8) uint8: bits packed along z, most significant first.
    """
    fixed = snapped_cells(vertices_world, grid)
    return np.asarray(_fill(fixed, np.ascontiguousarray(faces, dtype=np.int32), *grid.shape))


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _fill(fixed, faces, nx, ny, nz):  # type: ignore[no-untyped-def]
    lines, heights, signs = crossings(fixed, faces, (0, 1, 2), SUBCELL // 2, (nx, ny), False)
    first = np.zeros(nx * ny + 1, np.int64)
    for line in lines:
        first[line + 1] += 1
    first = np.cumsum(first)
    # The crossings of each column, sorted: each begins at the first centre on or above it.
    cells = np.empty(len(lines), np.int64)
    steps = np.empty(len(lines), np.int8)
    filled = first[:-1].copy()
    for n in range(len(lines)):
        cell = min(nz, max(0, int(np.ceil(heights[n] - 0.5))))
        at = filled[lines[n]]
        filled[lines[n]] += 1
        while at > first[lines[n]] and cells[at - 1] > cell:
            cells[at], steps[at] = cells[at - 1], steps[at - 1]
            at -= 1
        cells[at], steps[at] = cell, signs[n]
    packed = np.zeros((nx, ny, nz // 8), np.uint8)
    for column in range(nx * ny):
        winding = 0
        for n in range(first[column], first[column + 1] - 1):
            winding += steps[n]
            if winding != 0:
                _set(packed[column // ny, column % ny], cells[n], cells[n + 1])
        # In an open mesh the solid continues to the end of the column.
        if first[column + 1] > first[column] and winding + steps[first[column + 1] - 1] != 0:
            _set(packed[column // ny, column % ny], cells[first[column + 1] - 1], nz)
    return packed


@numba.njit(cache=True, nogil=True, inline="always")
def _set(row, begin, end):  # type: ignore[no-untyped-def]
    """Set the bits [begin, end) of a packed row."""
    while begin < end and begin & 7:
        row[begin >> 3] |= 128 >> (begin & 7)
        begin += 1
    while begin + 8 <= end:
        row[begin >> 3] = 255
        begin += 8
    while begin < end:
        row[begin >> 3] |= 128 >> (begin & 7)
        begin += 1


def packed_shell(full: Packed) -> Packed:
    """Return the occupied cells with an empty 6-neighbour; outside the grid is empty.

    Args:
        full: (nx, ny, nz / 8) uint8, a solid packed along z, most significant bit first.

    Returns:
        The same shape, packed the same way.
    """
    return np.asarray(_shell(np.ascontiguousarray(full)))


@numba.njit(cache=True, nogil=True)
def _shell(full):  # type: ignore[no-untyped-def]
    nx, ny, nb = full.shape
    shell = np.zeros_like(full)
    none = np.zeros(nb, np.uint8)
    for i in range(nx):
        for j in range(ny):
            here = full[i, j]
            left = full[i - 1, j] if i > 0 else none
            right = full[i + 1, j] if i < nx - 1 else none
            above = full[i, j - 1] if j > 0 else none
            below = full[i, j + 1] if j < ny - 1 else none
            for b in range(nb):
                bits = np.int64(here[b])
                if bits == 0:
                    continue
                before, after = bits >> 1, bits << 1
                if b > 0:
                    before |= (np.int64(here[b - 1]) & 1) << 7
                if b < nb - 1:
                    after |= np.int64(here[b + 1]) >> 7
                inner = left[b] & right[b] & above[b] & below[b] & before & after
                shell[i, j, b] = bits & ~inner
    return shell

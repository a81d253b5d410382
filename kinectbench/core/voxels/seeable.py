"""Air is the space around an object that some camera could see; the rest is the object.

A point is air if a straight line of the sensor's width reaches it, without crossing the object, from a
possible camera position. No ray can distinguish a hollow shell that stands on its rim from a solid dome.
Where no camera could see, space is object by this definition, in recordings, simulations and CAD models.
"""

from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core import ShapeError
from kinectbench.core.geometry import Grid, TriangleMesh, invert_rigid, rigid, transform_points
from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.types import Bools, Float32, Float64
from kinectbench.core.voxels.distance import distance_within_m
from kinectbench.core.voxels.fine_sight import seen_around_corners, seen_closely
from kinectbench.core.voxels.lines_of_sight import (
    BLOCKED,
    LEVEL,
    PASSABLE,
    PLACE,
    Space,
    directions,
    seen_along,
)
from kinectbench.core.voxels.morphology import from_beyond
from kinectbench.core.voxels.pair_file import unpack

# Directions of the sweeps over all voxels, and of those asked at the edge of what these found: 2.5 degrees
# apart. With 200 for 60 what is closed moved by 0.1 % of the volume at most (eight families); with 1,600 for
# 6,400 twice as much of a helmet with slits was closed (voxels of 10 mm).
COARSE_DIRECTIONS, FINE_DIRECTIONS = 60, 6400
# Distances from voxel to voxel are exact except for rounding.
ROUNDING_M = 1e-6
# Below an object on legs so many of eight level rays lead out; behind a door or a front three at most do, and
# of a desk with a back and two sides as many.
OPEN_WAYS = 5
# So near to a camera position lies one that no leg hides from the ways out: legs are thinner.
BESIDE_M = 0.3
# Voxels of an exact solid: half a line is three wide, unless the object has more than so many along its edge.
VOXELS_PER_LINE, MOST_VOXELS_LONG = 6, 320


def seen_from_outside(
    obstacle: Bools,
    heights_m: Float32 | None,
    voxel_size_m: float,
    limits: SensorLimits,
    seen: NDArray[np.uint8] | None = None,
) -> NDArray[np.uint8]:
    """Find the voxels that a camera outside an obstacle could see, and whether from above or from below.

    Axes of lines of sight keep half a width from the obstacle and the plane; the space that they reach is
    dilated by that, not into the obstacle. Cameras can be where balls of their size reach from outside.

    Args:
        obstacle: bool (nx, ny, nz), what lines and cameras do not cross; its last axis points up.
        heights_m: (nz,) float32, heights of the layers' middles above the obstacle's plane, metres; or None.
        voxel_size_m: edge of a voxel, metres.
        limits: width of lines of sight, and size, least height and least distance of cameras.
        seen: the result for wider lines, if known: narrower lines reach those voxels, too.

    Returns:
        uint8 of the same shape: FROM_ABOVE (by a camera as high or higher), FROM_BELOW, both, or 0 if not
        seen; 0 in the obstacle. A voxel seen FROM_ABOVE may lack the bit FROM_BELOW. The result is exact to
        a voxel: a gap up to one voxel wider than a line may count as closed.
    """
    space = line_space(obstacle, heights_m, voxel_size_m, limits)
    if seen is None:
        first = seen_along(space, directions(COARSE_DIRECTIONS))
    else:
        first = seen * (space.state != BLOCKED)
    reached = seen_around_corners(space, first, directions(FINE_DIRECTIONS))
    grown = _grown(reached, obstacle, voxel_size_m, limits)
    return grown if seen is None else grown | seen


@dataclass(frozen=True)
class Sight:
    """From where cameras could see each voxel.

    Attributes:
        any_way: (nx, ny, nz) uint8: FROM_ABOVE, FROM_BELOW, both, or 0 if no camera could see the voxel.
        from_above: (nx, ny, nz) bool, seen level or from above by a camera in a position of `lower`.
        space: where lines pass and cameras can be.
        lower: `space` without the camera positions reached only by rising into an object from below.
    """

    any_way: NDArray[np.uint8]
    from_above: Bools
    space: Space
    lower: Space

    @property
    def only_from_below(self) -> Bools:
        """Mask of voxels seen only from below, or only from camera positions that `lower` excludes."""
        below: Bools = (self.any_way > 0) & ~self.from_above
        return below


def swept_from_outside(
    obstacle: Bools,
    empty: Bools,
    heights_m: Float32 | None,
    voxel_size_m: float,
    limits: SensorLimits,
    count: int,
    closer: SensorLimits | None = None,
) -> Sight:
    """Find visible voxels as `seen_from_outside` does, along some directions only: fast, but may miss gaps.

    Args:
        obstacle: bool (nx, ny, nz), as for `seen_from_outside`.
        empty: bool (nx, ny, nz), voxels that the recording saw to be empty; all others count as unseen.
        heights_m: as for `seen_from_outside`.
        voxel_size_m: edge of a voxel, metres.
        limits: as for `seen_from_outside`.
        count: number of directions, evenly spread.
        closer: limits of the lines that are tried along more directions behind gaps; None: none are.
    """
    to_camera, spacing_rad = directions(count), float(np.sqrt(4 * np.pi / count))
    level_or_up = to_camera[:, 2] >= -LEVEL

    def seen(space: Space, ways: Float64, already: NDArray[np.uint8]) -> NDArray[np.uint8]:
        if closer is None:
            return _grown(seen_along(space, ways), obstacle, voxel_size_m, limits)
        blocked = line_space(obstacle, heights_m, voxel_size_m, closer).state == BLOCKED
        wide = replace(space, state=np.where(blocked, np.uint8(BLOCKED), space.state))
        found, further = seen_closely(space, wide, ways, spacing_rad, already)
        return _grown(found, obstacle, voxel_size_m, limits) | _grown(further, obstacle, voxel_size_m, closer)

    space = line_space(obstacle, heights_m, voxel_size_m, limits)
    lower, none = without_rising(space, empty), np.zeros_like(space.state)
    from_above = seen(space, to_camera[level_or_up], none)
    any_way = from_above | seen(space, to_camera[~level_or_up], from_above)
    if lower is not space:
        from_above = seen(lower, to_camera[level_or_up], none)
    return Sight(any_way, from_above > 0, space, lower)


def without_rising(space: Space, empty: Bools) -> Space:
    """Return the space without camera positions that are reached only by rising into an object from below.

    A camera below an object on legs could otherwise rise through its unseen underside. Where walls surround
    a camera, it came in through a side, and may rise: a cabinet is higher than its door.

    Args:
        space: where lines pass and cameras can be.
        empty: bool of the same shape, voxels that were seen to be empty; all others count as unseen.
    """
    from scipy import ndimage

    place = space.state == PLACE
    reached = _reached_without_rising(place, empty)
    if np.array_equal(reached, place):
        return space
    ways = _level_ways_out(space.state, reached & ~empty)
    # Beside a leg few ways lead out, a little farther away more.
    cells = 2 * round(BESIDE_M / space.voxel_size_m) + 1
    below = _open_below(space.state, ndimage.maximum_filter(ways, (cells, cells, 1)))
    may_enter = empty.copy()
    may_enter[:, :, 1:] |= ~below[:, :, :-1]
    reached = _reached_without_rising(place, may_enter)
    return replace(space, state=np.where(place & ~reached, np.uint8(PASSABLE), space.state))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _reached_without_rising(place, may_enter):  # type: ignore[no-untyped-def]
    """Return the camera positions, of `place`, that a camera reaches from outside the grid voxel by voxel.

    It moves to any of 6 neighbours, but upwards only into voxels where `may_enter` is set. It enters
    the grid through the lowest layer only at such voxels, and through the other sides anywhere.
    """
    nx, ny, nz = place.shape
    reached = np.zeros(place.shape, np.bool_)
    stack = np.empty(np.count_nonzero(place), np.int64)
    count = 0
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                edge = i == 0 or i == nx - 1 or j == 0 or j == ny - 1 or k == nz - 1
                if place[i, j, k] and (edge or (k == 0 and may_enter[i, j, k])):
                    reached[i, j, k] = True
                    stack[count] = (i * ny + j) * nz + k
                    count += 1
    while count > 0:
        count -= 1
        i, j, k = stack[count] // (ny * nz), stack[count] // nz % ny, stack[count] % nz
        for step in range(6):
            a = i + (step == 1) - (step == 0)
            b = j + (step == 3) - (step == 2)
            c = k + (step == 5) - (step == 4)
            if a < 0 or a >= nx or b < 0 or b >= ny or c < 0 or c >= nz:
                continue
            if place[a, b, c] and not reached[a, b, c] and (c <= k or may_enter[a, b, c]):
                reached[a, b, c] = True
                stack[count] = (a * ny + b) * nz + c
                count += 1
    return reached


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _level_ways_out(state, asked):  # type: ignore[no-untyped-def]
    """Count the level rays of each `asked` voxel, 8 along axes and diagonals, that no BLOCKED voxel stops."""
    nx, ny, nz = state.shape
    ways = np.zeros(state.shape, np.uint8)
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if not asked[i, j, k]:
                    continue
                for way in range(9):
                    dx, dy = way // 3 - 1, way % 3 - 1
                    if dx == 0 and dy == 0:
                        continue
                    a, b = i, j
                    while 0 <= a < nx and 0 <= b < ny and state[a, b, k] != BLOCKED:
                        a, b = a + dx, b + dy
                    ways[i, j, k] += not (0 <= a < nx and 0 <= b < ny)
    return ways


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _open_below(state, ways):  # type: ignore[no-untyped-def]
    """Return a mask of voxels that are open below.

    A voxel is open below if it, or a voxel straight below it with no BLOCKED voxel between, has at least
    `OPEN_WAYS` in `ways`, the result of `_level_ways_out`.
    """
    nx, ny, nz = state.shape
    below = np.zeros(state.shape, np.bool_)
    for i in range(nx):
        for j in range(ny):
            is_open = False
            for k in range(nz):
                is_open = state[i, j, k] != BLOCKED and (is_open or ways[i, j, k] >= OPEN_WAYS)
                below[i, j, k] = is_open
    return below


def line_space(
    obstacle: Bools, heights_m: Float32 | None, voxel_size_m: float, limits: SensorLimits
) -> Space:
    """Find where axes of lines of sight pass and cameras can be; arguments as in `seen_from_outside`."""
    heights = np.full(obstacle.shape[2], np.inf, np.float32) if heights_m is None else heights_m
    half_m = limits.line_width_m / 2
    farthest_m = max(half_m, limits.camera_size_m / 2) + voxel_size_m
    gap_m = distance_within_m(obstacle, voxel_size_m, farthest_m) - np.float32(voxel_size_m / 2)
    place = from_beyond((gap_m >= limits.camera_size_m / 2) & (heights >= limits.camera_height_m))
    blocked = (gap_m < half_m - ROUNDING_M) | (heights < half_m - ROUNDING_M)
    state = np.where(blocked, np.uint8(BLOCKED), np.where(place, np.uint8(PLACE), np.uint8(PASSABLE)))
    return Space(state, heights, voxel_size_m, limits.near_m, limits.camera_height_m)


def _grown(
    reached: NDArray[np.uint8], obstacle: Bools, voxel_size_m: float, limits: SensorLimits
) -> NDArray[np.uint8]:
    """Dilate `reached`, voxels on axes of lines of sight, by half a line's width, not into the obstacle."""
    # Half a voxel more, or layers right at the obstacle would be missed by rounding.
    return np.asarray(_grown_back(reached, obstacle, limits.line_width_m / 2 / voxel_size_m + 0.5))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _grown_back(reached, obstacle, radius):  # type: ignore[no-untyped-def]
    """Dilate `reached` (bits) by a ball of `radius` voxels, but not into the obstacle."""
    nx, ny, nz = reached.shape
    most = int(radius)
    grown = reached.copy()
    for i in range(nx):
        for j in range(ny):
            own = grown[i, j]
            for a in range(max(-most, -i), min(most + 1, nx - i)):
                for b in range(max(-most, -j), min(most + 1, ny - j)):
                    for c in range(-most, most + 1):
                        if a * a + b * b + c * c <= radius * radius and abs(c) < nz:
                            source = reached[i + a, j + b, max(c, 0) : nz + min(c, 0)]
                            target = own[max(-c, 0) : nz - max(c, 0)]
                            for k in range(len(target)):
                                target[k] |= source[k]
            for k in range(nz):
                own[k] = reached[i, j, k] if obstacle[i, j, k] else own[k]
    return grown


@dataclass(frozen=True)
class SeeableSolid:
    """A mesh's solid, and the space that counts as object because no camera could see it; (nx, ny, nz) masks.

    Attributes:
        limits: line width and camera limits that decide what a camera could see.
        grid: the masks' grid, z up; it begins at the plane that the object stands on, if there is one.
        exact_m3: volume inside the mesh, cubic metres.
        solid: voxels whose centre lies inside the mesh.
        closed: voxels whose centre lies outside the mesh, but that no camera could see.
        slit: the `closed` voxels that are not scored: lines of sight of half the width reach them, or they
            are on a wall thinner than a voxel.
    """

    limits: SensorLimits
    grid: Grid
    exact_m3: float
    solid: Bools
    closed: Bools
    slit: Bools

    @property
    def closed_share(self) -> float:
        """Volume of the `closed` voxels that are scored, relative to `exact_m3`."""
        return self._over_exact(self.closed & ~self.slit)

    @property
    def slit_share(self) -> float:
        """Volume of the `slit` voxels, relative to `exact_m3`."""
        return self._over_exact(self.slit)

    def _over_exact(self, voxels: Bools) -> float:
        return float(voxels.sum()) * self.grid.voxel_size_m**3 / self.exact_m3

    def on(self, grid: Grid, which: Bools) -> Bools:
        """Resample `which`, one of the masks, to another grid by the nearest voxel; False outside."""
        if not which.any():
            return np.zeros(grid.shape, bool)
        T = self.grid.T_grid_world @ grid.T_world_grid
        scale = grid.voxel_size_m / self.grid.voxel_size_m
        T_cells = np.concatenate([T[:3, :3] * scale, T[:3, 3:] / self.grid.voxel_size_m], axis=1)
        return np.asarray(_nearest(which, T_cells, *grid.shape))


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _nearest(which, T_cells, nx, ny, nz):  # type: ignore[no-untyped-def]
    """Return the nearest value of `which` for each cell of a grid; `T_cells` (3, 4) maps to its voxels."""
    result = np.zeros((nx, ny, nz), np.bool_)
    mx, my, mz = which.shape
    for i in range(nx):
        for j in range(ny):
            x, y, z = T_cells[:, 0] * (i + 0.5) + T_cells[:, 1] * (j + 0.5) + T_cells[:, 3]
            for k in range(nz):
                a = int(np.floor(x + T_cells[0, 2] * (k + 0.5)))
                b = int(np.floor(y + T_cells[1, 2] * (k + 0.5)))
                c = int(np.floor(z + T_cells[2, 2] * (k + 0.5)))
                if 0 <= a < mx and 0 <= b < my and 0 <= c < mz:
                    result[i, j, k] = which[a, b, c]
    return result


def seeable_solid(
    mesh_world: TriangleMesh, T_world_upright: Float64, limits: SensorLimits, *, stands: bool = True
) -> SeeableSolid:
    """Find the solid inside a closed mesh, and the space around it that no camera could see.

    Walls thinner than a voxel, which contain no voxel's centre, occlude like thick ones.

    Args:
        mesh_world: closed mesh, world frame, metres.
        T_world_upright: (4, 4), from the upright frame to the world: z is up, the object stands on z = 0.
        limits: width of lines of sight, and size, least height and least distance of cameras.
        stands: whether the object stands on a plane; if not, cameras may be anywhere around it.

    Raises:
        ShapeError: the mesh is empty, or lies below the plane.
    """
    from kinectbench.core.voxels.open_mesh import voxelize_surface
    from kinectbench.core.voxels.solid import voxelize_solid

    if not len(mesh_world.faces):
        raise ShapeError("no seeable solid: the mesh has no faces")
    upright = transform_points(invert_rigid(T_world_upright), mesh_world.vertices)
    low, high = upright.min(axis=0), upright.max(axis=0)
    voxel_m = max(limits.line_width_m / VOXELS_PER_LINE, float((high - low).max()) / MOST_VOXELS_LONG)
    margin_m = limits.camera_size_m / 2 + limits.line_width_m
    low, high = low - margin_m, high + margin_m
    if stands:
        if high[2] - margin_m <= 0:
            raise ShapeError("no seeable solid: the mesh lies below the plane that it is said to stand on")
        low[2] = 0.0
    shape = np.ceil((high - low) / voxel_m).astype(int)
    shape[2] = -(-shape[2] // 8) * 8  # of packed grids
    nx, ny, nz = (int(n) for n in shape)
    grid = Grid((nx, ny, nz), voxel_m, T_world_upright @ rigid(np.eye(3), low))
    solid = unpack(voxelize_solid(mesh_world.vertices, mesh_world.faces, grid))
    heights_m = ((np.arange(nz) + 0.5) * voxel_m).astype(np.float32) if stands else None
    thin = _thin(unpack(voxelize_surface(mesh_world.vertices, mesh_world.faces, grid)), solid)
    obstacle = solid | thin
    seen = seen_from_outside(obstacle, heights_m, voxel_m, limits)
    narrow = replace(limits, line_width_m=limits.line_width_m / 2)
    through_less = seen_from_outside(obstacle, heights_m, voxel_m, narrow, seen)
    hidden = ~solid & (seen == 0)
    slit = hidden & ((through_less > 0) | thin)
    return SeeableSolid(limits, grid, mesh_world.volume_m3, solid, hidden, slit)


def _thin(surface: Bools, solid: Bools) -> Bools:
    """Return the surface voxels that neither are solid nor have a solid neighbour (26): very thin walls."""
    from scipy import ndimage

    thin: Bools = surface & ~ndimage.binary_dilation(solid, np.ones((3, 3, 3)))
    return thin

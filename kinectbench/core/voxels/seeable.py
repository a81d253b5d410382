"""Air is the space around an object that some camera could see; the rest is the object.

    Air is what some camera could see: a point is air if a straight line of the sensor's width reaches it,
    without crossing the object, from a place that a camera can be brought to.

No ray can distinguish a hollow shell that stands on its rim from a solid dome. Where no camera could see,
space is object by this definition, in recordings, simulations and CAD models.
"""

from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core import ShapeError
from kinectbench.core.geometry import Grid, TriangleMesh, invert_rigid, rigid, transform_points
from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.types import Bools, Float32, Float64
from kinectbench.core.voxels.line_kernels import BLOCKED, FROM_ABOVE, FROM_BELOW, LEVEL, sees
from kinectbench.core.voxels.lines_of_sight import Space, directions, seen_along
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.core.voxels.sight import grown, line_space

# Number of directions of the sweeps over all voxels, and of the lines at the edge of what these found (2.5
# degrees apart). 200 instead of 60 changed the closed volume by at most 0.1 % (eight families). With 1,600
# instead of 6,400, twice as much of a helmet with slits was closed (voxels of 10 mm).
COARSE_DIRECTIONS, FINE_DIRECTIONS = 60, 6400
# Voxels of an exact solid: half a line is three wide, unless the object has more than this many along its
# edge.
VOXELS_PER_LINE, MOST_VOXELS_LONG = 6, 320


def seen_from_outside(
    obstacle: Bools,
    heights_m: Float32 | None,
    voxel_size_m: float,
    limits: SensorLimits,
    seen: NDArray[np.uint8] | None = None,
) -> NDArray[np.uint8]:
    """Find the voxels that a camera outside an obstacle could see, and whether from above or from below.

    The axis of a line of sight keeps half the line's width from the obstacle and the plane. The voxels that
    axes reach are dilated by half the width, but not into the obstacle. A camera can be wherever a ball of
    its size can be moved from outside.

    Args:
        obstacle: bool (nx, ny, nz), what lines and cameras do not cross; its last axis points up.
        heights_m: (nz,) float32, heights of the layers' middles above the obstacle's plane, metres; or None.
        voxel_size_m: edge of a voxel, metres.
        limits: width of lines of sight, and size, smallest height and smallest distance of cameras.
        seen: the result for wider lines, if known: narrower lines reach those voxels, too.

    Returns:
        uint8 of the same shape: FROM_ABOVE (by a camera as high or higher), FROM_BELOW, both, or 0 if not
        seen; 0 in the obstacle. A voxel seen FROM_ABOVE may lack the bit FROM_BELOW. The result is exact to a
        voxel: a gap up to one voxel wider than a line may count as closed.
    """
    space = line_space(obstacle, heights_m, voxel_size_m, limits)
    if seen is None:
        first = seen_along(space, directions(COARSE_DIRECTIONS))
    else:
        first = seen * (space.state != BLOCKED)
    reached = seen_around_corners(space, first, directions(FINE_DIRECTIONS))
    dilated = grown(reached, obstacle, voxel_size_m, limits)
    return dilated if seen is None else dilated | seen


def seen_around_corners(space: Space, seen: NDArray[np.uint8], to_camera: Float64) -> NDArray[np.uint8]:
    """Find more visible voxels along additional directions, outwards from the edge of the visible region.

    Few directions pass through a narrow gap. If a voxel is seen, so are all points between it and the camera;
    newly seen voxels are therefore next to voxels seen before.

    Args:
        space: the voxels.
        seen: result of `seen_along`.
        to_camera: (n, 3) unit vectors, from a point to a camera: the additional directions.

    Returns:
        `seen` with more bits set.
    """
    state = space.state
    more = seen.copy()
    up = to_camera[:, 2] >= -LEVEL
    # Whether a voxel that is seen from above is seen from below as well decides nothing.
    for bit, enough, ways in (
        (FROM_ABOVE, FROM_ABOVE, to_camera[up]),
        (FROM_BELOW, FROM_ABOVE | FROM_BELOW, to_camera[~up]),
    ):
        # Each is asked once at most.
        stack = np.empty(np.count_nonzero((state != BLOCKED) & (more & enough == 0)), np.int64)
        bits = np.uint8(bit), np.uint8(enough)
        _grow(more, state, bits, np.ascontiguousarray(ways), stack, space.heights_m, *space.lengths_m)
    return more


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _grow(seen, state, bits, ways, stack, heights_m, voxel_m, near_m, least_m):  # type: ignore[no-untyped-def]
    nx, ny, nz = state.shape
    bit, enough = bits
    asked = np.zeros(state.shape, np.bool_)
    count = 0
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if seen[i, j, k] & enough:
                    count = _push_around(seen, state, asked, enough, stack, count, i, j, k)
    last = 0
    while count > 0:
        count -= 1
        cell = stack[count]
        i, j, k = cell // (ny * nz), cell // nz % ny, cell % nz
        for turn in range(len(ways)):
            # Neighbours are mostly seen along the same direction.
            way = (last + turn) % len(ways)
            if sees(state, i, j, k, ways[way], heights_m, voxel_m, near_m, least_m):
                last = way
                seen[i, j, k] |= bit
                count = _push_around(seen, state, asked, enough, stack, count, i, j, k)
                break


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _push_around(seen, state, asked, enough, stack, count, i, j, k):  # type: ignore[no-untyped-def]
    """Push the 6 neighbours of (i, j, k) that must be tested onto the stack; return its new length.

    These are not BLOCKED (`state`), have none of the bits `enough` in `seen`, and are not marked in `asked`.
    `count` is the stack's length before.
    """
    nx, ny, nz = state.shape
    for side in range(6):
        step = 1 if side % 2 else -1
        a = i + step if side // 2 == 0 else i
        b = j + step if side // 2 == 1 else j
        c = k + step if side // 2 == 2 else k
        if a < 0 or a >= nx or b < 0 or b >= ny or c < 0 or c >= nz:
            continue
        if state[a, b, c] != BLOCKED and not seen[a, b, c] & enough and not asked[a, b, c]:
            asked[a, b, c] = True
            stack[count] = (a * ny + b) * nz + c
            count += 1
    return count


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
    """Return the nearest value of `which` for each cell of a grid; `T_cells` (3, 4) maps cells to voxels."""
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

    Walls thinner than a voxel, which contain no voxel's centre, occlude like thick walls.

    Args:
        mesh_world: closed mesh, world frame, metres.
        T_world_upright: (4, 4), from the upright frame to the world: z is up, the object stands on z = 0.
        limits: width of lines of sight, and size, smallest height and smallest distance of cameras.
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
    """Return the surface voxels of very thin walls: not solid, and without a solid one of 26 neighbours."""
    from scipy import ndimage

    thin: Bools = surface & ~ndimage.binary_dilation(solid, np.ones((3, 3, 3)))
    return thin

"""From where cameras could see each voxel around a measured surface: sweeps, and camera positions."""

from dataclasses import dataclass, replace

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.even_choice import evenly
from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.types import Bools, Float32, Float64
from kinectbench.core.voxels.line_kernels import (
    BLOCKED,
    LEVEL,
    MOST_WAYS,
    ONE_WAY,
    PASSABLE,
    PLACE,
    SEEN,
    sees,
)
from kinectbench.core.voxels.lines_of_sight import Space, directions, seen_outwards, ways_along
from kinectbench.core.voxels.morphology import dilated, distance_within_m, from_beyond
from kinectbench.core.voxels.open_below import without_rising

# Distances from voxel to voxel are exact except for rounding.
ROUNDING_M = 1e-6
# This many directions, 1.8 degrees apart, are tried behind gaps. 1,600 narrow lines miss 1.6 % (.5 %) of the
# volume of a crate with a hole of 5 cm (7 cm) in its top. 6,400 wide lines miss .6 % (.2 %), and 12,800 or
# 25,600 wide lines .3 % (.1 %).
FINER = 12_800
# Voxels that few directions see lie behind few gaps: at most this many of them are asked for the directions
# that see them.
MOST_ASKED = 1000
# Fewer of them, of all voxels, lead to nothing: a chair's 37 to 22 others, a desk's 139 to 84.
LEAST_ASKED_SHARE = 5e-5


@dataclass(frozen=True)
class Sight:
    """From where cameras could see each voxel.

    Attributes:
        any_way: (nx, ny, nz) uint8: FROM_ABOVE, FROM_BELOW, both, or 0 if no camera could see the voxel. A
            voxel seen FROM_ABOVE may lack the bit FROM_BELOW.
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
    """Find the voxels that a camera outside an obstacle could see along some directions.

    It is much faster than `seeable.seen_from_outside`, but may miss narrow gaps.

    Args:
        obstacle: bool (nx, ny, nz), voxels that lines and cameras do not cross; its last axis points up.
        empty: bool (nx, ny, nz), voxels that the recording saw to be empty; all others count as unseen.
        heights_m: (nz,) float32, heights of the layers' middles above the plane that the obstacle stands on,
            metres; None: no plane.
        voxel_size_m: edge of a voxel, metres.
        limits: width of lines of sight, and size, smallest height and smallest distance of cameras.
        count: number of directions, evenly spread.
        closer: limits of the lines that are tried along more directions behind gaps; None: none are.
    """
    up, down = _up_and_down(count)
    space = line_space(obstacle, heights_m, voxel_size_m, limits)
    lines = _Lines.around(obstacle, space, limits, closer, count)
    lower, nothing = without_rising(space, empty), np.zeros_like(space.state)
    in_lower = lines.marks(lower, up, nothing)
    ways = in_lower if lower is space else lines.marks(space, up, nothing, in_lower)
    of_lower = from_above = lines.seen(space, up, ways, nothing)
    if lower is not space:  # what cameras in no position see, they do not see in fewer positions either
        of_lower = lines.seen(lower, up, in_lower, (from_above == 0).astype(np.uint8))
    ways = lines.marks(space, down, from_above)
    any_way = from_above | lines.seen(space, down, ways, from_above)
    return Sight(any_way, of_lower > 0, space, lower)


def seen_past(
    wall: Bools,
    obstacle: Bools,
    among: Bools,
    heights_m: Float32 | None,
    voxel_size_m: float,
    limits: SensorLimits,
    count: int,
    closer: SensorLimits | None = None,
) -> Bools:
    """Return which voxels `among` others a camera could still see past a wall; True for the others.

    Neither lines nor cameras cross the wall. `wall`, `obstacle` and `among` are bool (nx, ny, nz); all other
    arguments are those of `swept_from_outside`.
    """
    walled = obstacle | wall
    space = line_space(walled, heights_m, voxel_size_m, limits)
    lines = _Lines.around(walled, space, limits, closer, count)
    found = (~among).astype(np.uint8)
    for to_camera in _up_and_down(count):
        found |= lines.seen(space, to_camera, lines.marks(space, to_camera, found), found)
    return np.asarray(found > 0)


def _up_and_down(count: int) -> tuple[Float64, Float64]:
    """Return `directions` in two parts: level or up, and down."""
    to_camera = directions(count)
    level_or_up = to_camera[:, 2] >= -LEVEL
    return to_camera[level_or_up], to_camera[~level_or_up]


@dataclass(frozen=True)
class _Lines:
    """The lines of sight around an obstacle: narrow lines, and wide lines in directions between these.

    Attributes:
        obstacle: bool (nx, ny, nz).
        narrow: limits of the narrow lines.
        closer: limits of the wide lines; None: only narrow lines are tried.
        wide: bool (nx, ny, nz), where no wide line passes; None if there are none.
        spacing_rad: angle between neighbouring directions of narrow lines, radians.
    """

    obstacle: Bools
    narrow: SensorLimits
    closer: SensorLimits | None
    wide: Bools | None
    spacing_rad: float

    @classmethod
    def around(
        cls, obstacle: Bools, space: Space, narrow: SensorLimits, closer: SensorLimits | None, count: int
    ) -> "_Lines":
        """Return the lines around an obstacle in `space`, narrow ones along `count` directions."""
        wide = None
        if closer is not None:
            gap_m = _gap_m(obstacle, space.voxel_size_m, closer.line_width_m / 2)
            wide = _blocked(gap_m, space.heights_m, closer)
        return cls(obstacle, narrow, closer, wide, float(np.sqrt(4 * np.pi / count)))

    def marks(
        self,
        space: Space,
        to_camera: Float64,
        already: NDArray[np.uint8],
        less: NDArray[np.uint8] | None = None,
    ) -> NDArray[np.uint8]:
        """Return `ways_along` of narrow lines in `space`, as far as `seen` needs it; arguments as there.

        `less` is the result in a space with fewer camera positions.
        """
        most = ONE_WAY if self.closer is None else MOST_WAYS
        wanted = self._around_unseen(already, space.voxel_size_m, self.narrow)
        return ways_along(space, to_camera, most, wanted, less)

    def seen(
        self, space: Space, to_camera: Float64, marks: NDArray[np.uint8], already: NDArray[np.uint8]
    ) -> NDArray[np.uint8]:
        """Find the voxels seen along directions (n, 3), which are all level or up, or all down.

        Camera positions are those of `space`, and `marks` are those of `marks`. Voxels set in `already` are
        not searched for: they may be missing. The voxels on the axes of lines are dilated by half a line's
        width. Behind gaps further lines are tried. These are wide, because noise leaves holes in a measured
        surface that narrow lines pass.
        """
        found = grown(marks & np.uint8(SEEN), self.obstacle, space.voxel_size_m, self.narrow)
        if self.closer is None or self.wide is None:
            return found
        finer = further_directions(space, marks, to_camera, self.spacing_rad, already)
        if not len(finer):
            return found
        wide = replace(space, state=np.where(self.wide, np.uint8(BLOCKED), space.state))
        wanted = self._around_unseen(found | already, space.voxel_size_m, self.closer)
        further = seen_outwards(wide, finer, wanted)
        return found | grown(further, self.obstacle, space.voxel_size_m, self.closer)

    def _around_unseen(
        self, already: NDArray[np.uint8], voxel_size_m: float, limits: SensorLimits
    ) -> Bools | None:
        """Return the voxels beside voxels that are neither set in `already` nor obstacles; None: all voxels.

        These are as far away as a line's axis is from what the line shows, or at least one voxel.
        """
        if not already.any():
            return None
        unseen = (already == 0) & ~self.obstacle
        return dilated(unseen, (max(1, int(_grown_voxels(limits, voxel_size_m))),) * 3)


def line_space(
    obstacle: Bools, heights_m: Float32 | None, voxel_size_m: float, limits: SensorLimits
) -> Space:
    """Find where axes of lines of sight pass and cameras can be; arguments as in `swept_from_outside`."""
    heights = np.full(obstacle.shape[2], np.inf, np.float32) if heights_m is None else heights_m
    gap_m = _gap_m(obstacle, voxel_size_m, max(limits.line_width_m, limits.camera_size_m) / 2)
    place = from_beyond((gap_m >= limits.camera_size_m / 2) & (heights >= limits.camera_height_m))
    blocked = _blocked(gap_m, heights, limits)
    state = np.where(blocked, np.uint8(BLOCKED), np.where(place, np.uint8(PLACE), np.uint8(PASSABLE)))
    return Space(state, heights, voxel_size_m, limits.near_m, limits.camera_height_m)


def _gap_m(obstacle: Bools, voxel_size_m: float, within_m: float) -> Float32:
    """Return the distance of each voxel's middle to the obstacle's faces, metres; inf where it is larger."""
    return distance_within_m(obstacle, voxel_size_m, within_m + voxel_size_m) - np.float32(voxel_size_m / 2)


def _blocked(gap_m: Float32, heights_m: Float32, limits: SensorLimits) -> Bools:
    """Return where no axis of a line of sight passes: nearer than half its width to obstacle or plane."""
    half_m = limits.line_width_m / 2 - ROUNDING_M
    return (gap_m < half_m) | (heights_m < half_m)


def grown(
    reached: NDArray[np.uint8], obstacle: Bools, voxel_size_m: float, limits: SensorLimits
) -> NDArray[np.uint8]:
    """Dilate `reached`, voxels on axes of lines of sight, by half a line's width, outside the obstacle."""
    return np.asarray(_grown_back(reached, obstacle, _grown_voxels(limits, voxel_size_m)))


def _grown_voxels(limits: SensorLimits, voxel_size_m: float) -> float:
    """Return by how many voxels `grown` dilates."""
    # Half a voxel more, or layers right at the obstacle would be missed by rounding.
    return limits.line_width_m / 2 / voxel_size_m + 0.5


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _grown_back(reached, obstacle, radius):  # type: ignore[no-untyped-def]
    """Dilate `reached` (bits) by a ball of `radius` voxels, but not into the obstacle."""
    nx, ny, nz = reached.shape
    most = int(radius)
    grown = reached.copy()
    any_reached = np.empty((nx, ny), np.bool_)
    for i in range(nx):
        for j in range(ny):
            any_reached[i, j] = reached[i, j].any()
    for i in range(nx):
        for j in range(ny):
            own = grown[i, j]
            for a in range(max(-most, -i), min(most + 1, nx - i)):
                for b in range(max(-most, -j), min(most + 1, ny - j)):
                    if not any_reached[i + a, j + b]:
                        continue
                    for c in range(-most, most + 1):
                        if a * a + b * b + c * c <= radius * radius and abs(c) < nz:
                            source = reached[i + a, j + b, max(c, 0) : nz + min(c, 0)]
                            target = own[max(-c, 0) : nz - max(c, 0)]
                            for k in range(len(target)):
                                target[k] |= source[k]
            for k in range(nz):
                own[k] = reached[i, j, k] if obstacle[i, j, k] else own[k]
    return grown


def further_directions(
    space: Space, marks: NDArray[np.uint8], to_camera: Float64, spacing_rad: float, already: NDArray[np.uint8]
) -> Float64:
    """Return the directions of a finer lattice along which more may be seen behind gaps.

    Deep behind a gap, a voxel is seen along few directions. Its neighbour may be seen along none of
    `to_camera`, but along a direction between them. So directions of a finer lattice are added, near those
    that see such voxels.

    Args:
        space: the voxels.
        marks: what `ways_along` returns for `to_camera`, wherever `already` is 0, and in voxels beside these.
        to_camera: (n, 3) unit vectors, from a point to a camera; all level or up, or all down.
        spacing_rad: angle between neighbouring directions of `to_camera`, radians.
        already: (nx, ny, nz), not 0 where a voxel was seen before; these are not searched for.

    Returns:
        (m, 3) unit vectors, all level or up, or all down, as `to_camera`.
    """
    edge = _rarely_seen_beside_unseen(marks, (marks & np.uint8(SEEN)) | already, space.state)
    if len(edge) <= LEAST_ASKED_SHARE * marks.size:
        return np.zeros((0, 3))
    cells = edge[evenly(len(edge), MOST_ASKED)]
    seeing = _some_see(space.state, cells, to_camera, space.heights_m, *space.lengths_m)
    if not seeing.any():
        return np.zeros((0, 3))
    finer = directions(FINER)
    finer = finer[(finer[:, 2] >= -LEVEL) == (to_camera[0, 2] >= -LEVEL)]
    near = (finer @ to_camera[seeing].T).max(axis=1) > np.cos(spacing_rad)
    return np.asarray(finer[near])


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _rarely_seen_beside_unseen(marks, seen, state):  # type: ignore[no-untyped-def]
    """Return flat indices of voxels seen along one or two directions that have an unseen neighbour (of 26).

    `marks` is the result of `ways_along`. `seen` is 0 at unseen voxels; BLOCKED voxels of `state` do not
    count.
    """
    nx, ny, nz = marks.shape
    found = []
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if not 0 < marks[i, j, k] & MOST_WAYS < MOST_WAYS:
                    continue
                beside = False
                for a in range(max(i - 1, 0), min(i + 2, nx)):
                    for b in range(max(j - 1, 0), min(j + 2, ny)):
                        for c in range(max(k - 1, 0), min(k + 2, nz)):
                            beside |= seen[a, b, c] == 0 and state[a, b, c] != BLOCKED
                if beside:
                    found.append((i * ny + j) * nz + k)
    return np.array(found, np.int64)


@numba.njit(cache=True, nogil=True, error_model="numpy")
def _some_see(state, cells, ways, heights_m, voxel_m, near_m, least_m):  # type: ignore[no-untyped-def]
    """Return for each direction in `ways` (n, 3) whether a camera sees one of the cells (flat indices).

    The other arguments are those of `sees`.
    """
    _, ny, nz = state.shape
    seeing = np.zeros(len(ways), np.bool_)
    for n in range(len(ways)):
        for cell in cells:
            i, j, k = cell // (ny * nz), cell // nz % ny, cell % nz
            if sees(state, i, j, k, ways[n], heights_m, voxel_m, near_m, least_m):
                seeing[n] = True
                break
    return seeing

"""Unobserved openings: size, place, and viewpoints that would see into them."""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from kinectbench.core.artefacts.object import LEAST_UNDERSIDE_SHARE
from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import transform_points
from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.types import Bools, Float64, Underside
from kinectbench.core.voxels.line_kernels import PASSABLE, PLACE
from kinectbench.core.voxels.lines_of_sight import Space, count_seen, directions
from kinectbench.core.voxels.morphology import broad, opened, piece_sizes, values_of_pieces
from kinectbench.stages.segment.find.select import triple
from kinectbench.stages.segment.judge.obstacles import MOVE_AWAY
from kinectbench.stages.segment.solid.evidence import VoxelEvidence
from kinectbench.stages.segment.solid.solid import SolidShape

Direction = Literal["up", "side", "down"]

# A frontier is reported from this share of the solid's volume and this area on (chosen by hand).
LEAST_SHARE, LEAST_AREA_M2 = 0.02, 0.002
# If there is none, a region of any thickness is reported from this share on: below four nested bowls of which
# nobody saw the underside it is 35 %, between six stacked plates 28 %; on a
# helmet and on a shell, whose estimates are right, the largest is 13 and 14 %.
LEAST_NARROW_SHARE = 0.2
# Share of a region's voxels left out at either end of its extent, as streaks of single voxels extend far.
STREAKS = 0.01
# Less probable voxels are almost certainly air.
LEAST_PROBABILITY = 0.025
# Directions tried for how much of a region they show: 16 degrees apart (chosen by hand).
VIEW_DIRECTIONS = 100
# Directions that show this share of the best one's view are as good. The one nearest to this elevation,
# at which a person holds a camera, is taken (chosen by hand).
ENOUGH, CAMERA_ELEVATION_RAD = 0.8, np.radians(25.0)
# Vertical parts of a unit vector: steep from the first on, level between the others (chosen by hand).
STEEP, LEVEL, LOWER = 0.9, 0.35, 0.05
# Directions are reported in these steps: people place themselves no more exactly (chosen by hand).
TURN_STEP_DEG, HALF_TURN_DEG = 10, 180


@dataclass(frozen=True)
class Frontier:
    """The unmeasured boundary between an unseen region and free space.

    Attributes:
        direction: outward from the unseen region: up, side or down.
        area_m2: area of its faces that look in that direction; more than the rectangle of `size_m` if faces
            lie behind others.
        size_m: (2,) extents of its faces, metres. Up or down: the longer and the shorter one, seen from
            above. Side: the width and the height.
        center_m: (3,) middle of its faces, floor frame, metres.
        look_from: (3,) unit vector, floor frame: from the frontier to a camera that would look into it.
        volume_m3: volume of the unseen region behind it, cubic metres.
        inside_share: expected share of that volume that is inside the object, 0 to 1.
        solid_share: share of that volume that the solid fills, 0 to 1.
        underside: whether a camera could see the region only from below.
        obstructed: whether something that is not the object stands where the camera would be.
        from_inside: whether much of the region is only seen by a camera within the object's bounding box.
    """

    direction: Direction
    area_m2: float
    size_m: tuple[float, float]
    center_m: tuple[float, float, float]
    look_from: tuple[float, float, float]
    volume_m3: float
    inside_share: float
    solid_share: float
    underside: bool = False
    obstructed: bool = False
    from_inside: bool = False

    def restored(self, scale: float) -> "Frontier":
        """Return the same frontier in a world that is `scale` times as large."""
        (a, b), (x, y, z) = self.size_m, self.center_m
        return replace(
            self,
            area_m2=self.area_m2 * scale**2,
            size_m=(a * scale, b * scale),
            center_m=(x * scale, y * scale, z * scale),
            volume_m3=self.volume_m3 * scale**3,
        )

    def advice(self, first_rad: float, underside: Underside = "unseen") -> str:
        """Return a line that names the unseen part and advises where to stand.

        Args:
            first_rad: direction from the object to the first camera, as in `turn_in_words`.
            underside: what the user has stated; only "unseen", nothing, is advised to be stated.
        """
        size = " x ".join(f"{100 * length_m:.0f}" for length_m in self.size_m) + " cm"
        where = f"record {where_to_stand(self.look_from, self.center_m[2], first_rad)}"
        where = f"hold the camera inside, and {where}" if self.from_inside else where
        where = f"{MOVE_AWAY} {where}" if self.obstructed else where
        if self.underside:
            say = ", or say in benchmark.yaml whether its `underside` is closed or open"
            return f"nobody saw the underside, {size}: {where}{say if underside == 'unseen' else ''}"
        at = {"up": "at the top", "side": "at the side", "down": "at the bottom"}[self.direction]
        return f"nobody looked into the opening {at}, {size}: {where}"


def turn_in_words(towards_rad: float, first_rad: float) -> str:
    """Describe a direction from the object, relative to the direction of the recording's first camera.

    Both, `towards_rad` and `first_rad`, are seen from above, radians, counter-clockwise from x of the floor
    frame.
    """
    turn_deg = np.degrees(np.angle(np.exp(1j * (towards_rad - first_rad))))
    rounded = TURN_STEP_DEG * round(abs(turn_deg) / TURN_STEP_DEG)
    if not rounded:
        return "where the recording begins"
    if rounded == HALF_TURN_DEG:
        return "opposite to where the recording begins"
    # Facing the object, whoever goes counterclockwise around it goes to the right.
    return f"{rounded} degrees to the {'right' if turn_deg > 0 else 'left'} of where the recording begins"


def where_to_stand(look_from: tuple[float, float, float], height_m: float, first_rad: float) -> str:
    """Describe the viewpoint of a camera that looks at a point `height_m` above the floor.

    `look_from` is a unit vector of the floor frame, from the point to the camera; `first_rad` is the
    direction from the object to the first camera, as in `turn_in_words`.
    """
    up, height = look_from[2], f"{100 * height_m:.0f} cm"
    towards = f"from {turn_in_words(float(np.arctan2(look_from[1], look_from[0])), first_rad)}"
    if abs(up) > STEEP:
        return "from above" if up > 0 else f"from below, lower than {height}"
    if up < -LOWER:
        return f"{towards}, lower than {height}, looking up"
    return f"{towards}, at the height of {height}" if up < LEVEL else f"{towards}, obliquely from above"


def find_frontiers(
    shape: SolidShape, evidence: VoxelEvidence, limits: SensorLimits, T_floor_grid: Float64
) -> tuple[Frontier, ...]:
    """Find the frontiers larger than a minimum area, the one with the largest volume behind it first.

    A frontier is where a 26-connected piece of unknown voxels meets free space. The piece must have a minimum
    share of the solid's volume. Pieces thinner than a line of sight are skipped, with two exceptions:
    undersides always count, and if no frontier was found at all, large pieces of any thickness count. View
    directions that show at least 80 % as much of the piece as the best one are candidates for `look_from`;
    the candidate closest to the elevation of a hand-held camera is chosen.

    Args:
        shape: the solid.
        evidence: the class of each voxel.
        limits: of the sensor; they give the width of a line of sight.
        T_floor_grid: (4, 4), maps the solid's grid to the floor frame.
    """
    unknown = (shape.labels == Label.UNKNOWN) & (shape.probability > LEAST_PROBABILITY) & evidence.unknown
    aside = unknown & ~evidence.underside
    below = _large_pieces(shape, unknown & evidence.underside, limits, underside=True)
    wide = _large_pieces(shape, aside, limits, underside=False)
    found = _frontiers_of(shape, evidence, wide, below, T_floor_grid)
    if found:
        return found
    narrow = _pieces_of(aside, LEAST_NARROW_SHARE * shape.solid.sum())
    return _frontiers_of(shape, evidence, narrow, below, T_floor_grid)


def _frontiers_of(
    shape: SolidShape,
    evidence: VoxelEvidence,
    aside: tuple[NDArray[np.int32], int],
    below: tuple[NDArray[np.int32], int],
    T_floor_grid: Float64,
) -> tuple[Frontier, ...]:
    """Return the frontiers of pieces as `_large_pieces` returns them, the largest volume first.

    The pieces `aside` could be seen from the side or from above; the pieces `below` are undersides.
    """
    voxel_m = shape.grid.voxel_size_m
    if not aside[1] + below[1]:
        return ()
    ways = directions(VIEW_DIRECTIONS)
    # A camera that would rise through an underside is no advice.
    shown_aside = count_seen(evidence.space, ways, aside[0])
    shown_outside = count_seen(_without_inside(evidence.space, shape.solid), ways, aside[0])
    shown_below = count_seen(evidence.lower, ways, below[0])
    shown, outside = (np.concatenate([each, shown_below[:, 1:]], 1) for each in (shown_aside, shown_outside))
    pieces = np.where(below[0] > 0, below[0] + np.int32(aside[1]), aside[0])
    # Below an underside all may be unseen down to the floor: a camera looks through that.
    open_to = (evidence.free, evidence.free | (evidence.unknown & ~evidence.underside))
    free = [np.pad(each, 1) for each in open_to]
    frontiers = []
    for piece, window in enumerate(ndimage.find_objects(pieces), start=1):
        inner, underside = pieces[window] == piece, piece > aside[1]
        part = _Piece(
            voxel_m,
            inner,
            free[underside][tuple(slice(along.start, along.stop + 2) for along in window)],
            np.array([along.start for along in window]),
        )
        behind = (
            float(inner.sum()) * voxel_m**3,
            float(shape.probability[window][inner].astype(np.float64).mean()),
            float(shape.solid[window][inner].mean()),
        )
        # An underside that none of the directions shows is seen straight from below.
        look, inside = _viewpoint(ways, shown[:, piece], outside[:, piece])
        if underside and not shown[:, piece].any():
            look = ways[-1]
        frontier = _frontier(part, look, T_floor_grid, behind, underside)
        if frontier is not None and frontier.area_m2 >= LEAST_AREA_M2:
            frontiers.append(replace(frontier, from_inside=inside))
    return tuple(sorted(frontiers, key=lambda frontier: -frontier.volume_m3))


def _large_pieces(
    shape: SolidShape, region: Bools, limits: SensorLimits, underside: bool
) -> tuple[NDArray[np.int32], int]:
    """Find the large connected pieces of a region.

    Args:
        shape: the solid; a large piece has at least a small share of its volume.
        region: bool, the voxels of the region, in the solid's grid.
        limits: of the sensor; parts thinner than a line of sight are left out.
        underside: whether the region is an underside, of which flat parts count however thin they are.

    Returns:
        The piece of each voxel, from 1 (0: none), in the grid's shape; and the number of pieces.
    """
    cells = max(1, round(limits.line_width_m / shape.grid.voxel_size_m))
    # From below a board is wide, however thin. Elsewhere thin layers are left by the rims of lines of sight.
    wide = opened(region, (cells, cells, 1)) if underside else broad(region, cells)
    return _pieces_of(wide, (LEAST_UNDERSIDE_SHARE if underside else LEAST_SHARE) * shape.solid.sum())


def _pieces_of(region: Bools, least_voxels: float) -> tuple[NDArray[np.int32], int]:
    """Find the 26-connected pieces of at least `least_voxels` voxels; return the same as `_large_pieces`."""
    pieces, count = ndimage.label(region, np.ones((3, 3, 3)))
    large = piece_sizes(pieces, count) >= max(1, least_voxels)
    large[0] = False
    numbers = np.where(large, np.cumsum(large), 0).astype(np.int32)
    return values_of_pieces(pieces, numbers), int(large.sum())


def _without_inside(space: Space, solid: Bools) -> Space:
    """Return the space without the camera positions in the bounding box of `solid`."""
    state, (window,) = space.state.copy(), ndimage.find_objects(solid.astype(np.uint8))
    state[window] = np.where(state[window] == PLACE, np.uint8(PASSABLE), state[window])
    return replace(space, state=state)


def _viewpoint(ways: Float64, shown: NDArray[np.int64], outside: NDArray[np.int64]) -> tuple[Float64, bool]:
    """Return the direction to look from, (3,), and whether a camera must be in the object's bounding box.

    `ways` (n, 3) are unit vectors to cameras. `shown` and `outside` (n,) are how many voxels of a piece each
    one shows: to all cameras, and to those outside the box.
    """
    best = _best_direction(ways, shown)
    if outside[best] < ENOUGH * shown[best] and outside.max() >= ENOUGH * shown.max():
        best = _best_direction(ways, outside)
    return ways[best], bool(outside[best] < ENOUGH * shown[best])


def _best_direction(ways: Float64, shown: NDArray[np.int64]) -> int:
    """Return the index of the direction closest to a hand-held camera's elevation, of those that show much.

    `ways` (n, 3) are unit vectors to cameras, and `shown` (n,) is how many of a piece's voxels each one
    shows.
    """
    enough = np.flatnonzero(shown >= ENOUGH * shown.max())
    off_rad = np.abs(np.arcsin(np.clip(ways[enough, 2], -1, 1)) - CAMERA_ELEVATION_RAD)
    return int(enough[np.argmin(off_rad)])


@dataclass(frozen=True)
class _Piece:
    """A piece of unknown voxels in a window of the grid that just holds it.

    Attributes:
        voxel_m: edge of a voxel, metres.
        cells: (i, j, k) bool, which voxels of the window belong to the piece.
        free: (i + 2, j + 2, k + 2) bool, which voxels of the window and one more on each side are free. For
            an underside, unknown voxels that are not part of one count as free.
        corner: (3,) index of the window's first voxel in the grid.
    """

    voxel_m: float
    cells: Bools
    free: Bools
    corner: NDArray[np.int64]

    def faces_m(self, axis: int, sign: int) -> Float64:
        """Return the centres (n, 3), metres, grid frame, of faces to free space in direction sign * axis."""
        step = np.zeros(3, np.int64)
        step[axis] = sign
        beside = tuple(slice(1 + k, 1 + k + n) for k, n in zip(step, self.cells.shape, strict=True))
        at: Float64 = (
            self.corner + np.argwhere(self.cells & self.free[beside]) + 0.5 + step / 2
        ) * self.voxel_m
        return at


def _frontier(
    piece: _Piece,
    look: Float64,
    T_floor_grid: Float64,
    behind: tuple[float, float, float],
    underside: bool,
) -> Frontier | None:
    """Make the frontier of a piece for a camera in one direction; None if no face is visible.

    Its `direction` is that of the faces with most visible area.

    Args:
        piece: the piece of unknown voxels.
        look: (3,) unit vector to the camera, grid frame.
        T_floor_grid: (4, 4), maps the grid to the floor frame.
        behind: the frontier's `volume_m3`, `inside_share` and `solid_share`.
        underside: whether a camera could see the piece only from below.
    """
    faces = {(axis, sign): piece.faces_m(axis, sign) for axis in range(3) for sign in (-1, 1)}
    seen = {
        (axis, sign): len(points) * sign * look[axis]
        for (axis, sign), points in faces.items()
        if sign * look[axis] > 0 and len(points)
    }
    if not seen:
        return None
    upright = {sign: seen.get((2, sign), 0.0) for sign in (-1, 1)}
    level = {way: share for way, share in seen.items() if way[0] != 2}
    sign = 1 if upright[1] >= upright[-1] else -1
    if upright[sign] >= sum(level.values()):
        direction: Direction = "up" if sign > 0 else "down"
        points = faces[2, sign]
        area_m2 = len(points) * piece.voxel_m**2
    else:
        direction, points = "side", np.concatenate([faces[way] for way in level])
        # Faces along the grid's axes, added up as vectors, are the area of a smooth surface in their place.
        across = [sum(len(faces[way]) for way in level if way[0] == axis) for axis in (0, 1)]
        area_m2 = float(np.hypot(across[0], across[1])) * piece.voxel_m**2
    look_floor = T_floor_grid[:3, :3] @ look
    look_floor /= np.linalg.norm(look_floor)
    points_floor = transform_points(T_floor_grid, points)
    return Frontier(
        direction,
        area_m2,
        _extents_m(points_floor, look_floor, direction == "side", piece.voxel_m),
        triple(points_floor.mean(axis=0)),
        triple(look_floor),
        *behind,
        underside,
    )


def _extents_m(points_floor: Float64, look: Float64, side: bool, voxel_m: float) -> tuple[float, float]:
    """Return two extents, metres, of a frontier's faces with the centres `points_floor` (n, 3).

    For `side`, they are width and height as seen along `look` (3,). Otherwise they are the longer and the
    shorter side of the smallest rectangle around the faces, seen from above.
    """
    if side:
        across = np.array([-look[1], look[0], 0.0]) / np.hypot(look[0], look[1])
        return _extent_m(points_floor @ across, voxel_m), _extent_m(points_floor[:, 2], voxel_m)
    turns = np.linspace(0, np.pi / 2, 31)[:-1]
    boxes: list[list[float]] = []
    for turn in turns:
        along = np.array([np.cos(turn), np.sin(turn), 0.0])
        across = np.array([-along[1], along[0], 0.0])
        boxes.append([_extent_m(points_floor @ axis, voxel_m) for axis in (along, across)])
    least = min(boxes, key=lambda box: box[0] * box[1])
    return max(least), min(least)


def _extent_m(values: Float64, voxel_m: float) -> float:
    """Return the extent of values (n,), metres, without 1 % at either end, plus one voxel."""
    low, high = np.quantile(values, [STREAKS, 1 - STREAKS])
    return float(high - low) + voxel_m

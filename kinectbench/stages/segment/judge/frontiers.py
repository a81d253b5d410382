"""Unobserved openings: size, place, viewpoints that would see into them, and what stands in the way there."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from kinectbench.core.artefacts.object import LEAST_UNDERSIDE_SHARE
from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import OrientedBox, invert_rigid, transform_points
from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.types import Bools, Float64, Int64, Underside
from kinectbench.core.voxels.line_kernels import PASSABLE, PLACE
from kinectbench.core.voxels.lines_of_sight import Space, count_seen, directions
from kinectbench.core.voxels.morphology import broad, opened, piece_sizes, values_of_pieces
from kinectbench.core.voxels.point_cells import cell_numbers
from kinectbench.stages.segment.find.object import Segmentation
from kinectbench.stages.segment.find.pieces import triple
from kinectbench.stages.segment.solid.evidence import VoxelEvidence
from kinectbench.stages.segment.solid.solid import SolidShape

Direction = Literal["up", "side", "down"]
# Centres (n, 3), metres, grid frame, of faces between voxels, by their axis and sign.
Faces = Mapping[tuple[int, int], Float64]

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
MOVE_AWAY = "move it away from what stands behind it, and"
# A surface that a line meets has this many cells within this many cells of the line (chosen by hand: seven of
# a plane across it, three of an edge).
HIT_CELLS, BESIDE_CELLS = 3, 1.5
# The object hides what is right behind it. A wall shows on both sides of it, over this many cells each, and
# rises over this many above what is looked at: 0.5 m, which boxes on the floor do not. This many lines
# through a cell on either side are tried (chosen by hand).
WALL_CELLS, TRIED_LINES = 16, 300
# A look that is steeper than this (vertical part of a unit vector) meets no wall: 72 degrees.
WALL_STEEP = 0.95


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
    the candidate closest to the elevation of a hand-held camera is chosen. `T_floor_grid` (4, 4) maps the
    solid's grid to the floor frame.
    """
    unknown = (shape.labels == Label.UNKNOWN) & (shape.probability > LEAST_PROBABILITY) & evidence.unknown
    aside, below = unknown & ~evidence.underside, unknown & evidence.underside
    cells, volume = max(1, round(limits.line_width_m / shape.grid.voxel_size_m)), int(shape.solid.sum())
    # From below a board is wide, however thin. Elsewhere thin layers are left by the rims of lines of sight.
    undersides = _pieces_of(opened(below, (cells, cells, 1)), LEAST_UNDERSIDE_SHARE * volume)
    wide = _pieces_of(broad(aside, cells), LEAST_SHARE * volume)
    found = _frontiers_of(shape, evidence, wide, undersides, T_floor_grid)
    if found:
        return found
    narrow = _pieces_of(aside, LEAST_NARROW_SHARE * volume)
    return _frontiers_of(shape, evidence, narrow, undersides, T_floor_grid)


def _pieces_of(region: Bools, least_voxels: float) -> tuple[NDArray[np.int32], int]:
    """Find the 26-connected pieces of at least `least_voxels` voxels.

    Returns:
        The piece of each voxel, from 1 (0: none), in the region's shape; and the number of pieces.
    """
    pieces, count = ndimage.label(region, np.ones((3, 3, 3)))
    large = piece_sizes(pieces, count) >= max(1, least_voxels)
    large[0] = False
    numbers = np.where(large, np.cumsum(large), 0).astype(np.int32)
    return values_of_pieces(pieces, numbers), int(large.sum())


def _frontiers_of(
    shape: SolidShape,
    evidence: VoxelEvidence,
    aside: tuple[NDArray[np.int32], int],
    below: tuple[NDArray[np.int32], int],
    T_floor_grid: Float64,
) -> tuple[Frontier, ...]:
    """Return the frontiers of pieces as `_pieces_of` returns them, the largest volume first.

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
        around = free[underside][tuple(slice(along.start, along.stop + 2) for along in window)]
        faces = _faces_m(inner, around, np.array([along.start for along in window]), voxel_m)
        # An underside that none of the directions shows is seen straight from below.
        look, inside = _viewpoint(ways, shown[:, piece], outside[:, piece])
        if underside and not shown[:, piece].any():
            look = ways[-1]
        direction, points, area_m2 = _shown(faces, look, voxel_m)
        if not len(points) or area_m2 < LEAST_AREA_M2:
            continue
        look_floor = T_floor_grid[:3, :3] @ look
        look_floor /= np.linalg.norm(look_floor)
        points_floor = transform_points(T_floor_grid, points)
        frontiers.append(
            Frontier(
                direction,
                area_m2,
                _extents_m(points_floor, look_floor, direction == "side", voxel_m),
                triple(points_floor.mean(axis=0)),
                triple(look_floor),
                volume_m3=float(inner.sum()) * voxel_m**3,
                inside_share=float(shape.probability[window][inner].astype(np.float64).mean()),
                solid_share=float(shape.solid[window][inner].mean()),
                underside=underside,
                from_inside=inside,
            )
        )
    return tuple(sorted(frontiers, key=lambda frontier: -frontier.volume_m3))


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
    """Return the index of the direction nearest to how a camera is held, of those that show much."""
    enough = np.flatnonzero(shown >= ENOUGH * shown.max())
    off_rad = np.abs(np.arcsin(np.clip(ways[enough, 2], -1, 1)) - CAMERA_ELEVATION_RAD)
    return int(enough[np.argmin(off_rad)])


def _faces_m(cells: Bools, free: Bools, corner: NDArray[np.int64], voxel_m: float) -> Faces:
    """Return the faces of a piece to free space.

    The voxels `cells` (i, j, k) of the piece are in a window of the grid that begins at `corner` (3,). `free`
    has one more voxel than it on each side.
    """
    faces = {}
    for axis, sign in product(range(3), (-1, 1)):
        step = np.zeros(3, np.int64)
        step[axis] = sign
        beside = tuple(slice(1 + k, 1 + k + n) for k, n in zip(step, cells.shape, strict=True))
        faces[axis, sign] = (corner + np.argwhere(cells & free[beside]) + 0.5 + step / 2) * voxel_m
    return faces


def _shown(faces: Faces, look: Float64, voxel_m: float) -> tuple[Direction, Float64, float]:
    """Return the direction of the faces of which a camera sees most, their centres (n, 3) and area, m2.

    The camera lies in the direction `look` (3,), a unit vector. If it sees no face, n is 0.
    """
    seen = {
        (axis, sign): len(points) * sign * look[axis]
        for (axis, sign), points in faces.items()
        if sign * look[axis] > 0 and len(points)
    }
    if not seen:
        return "side", np.zeros((0, 3)), 0.0
    upright = {sign: seen.get((2, sign), 0.0) for sign in (-1, 1)}
    level = {way: share for way, share in seen.items() if way[0] != 2}
    sign = 1 if upright[1] >= upright[-1] else -1
    if upright[sign] >= sum(level.values()):
        return "up" if sign > 0 else "down", faces[2, sign], len(faces[2, sign]) * voxel_m**2
    # Faces along the grid's axes, added up as vectors, are the area of a smooth surface in their place.
    across = [sum(len(faces[way]) for way in level if way[0] == axis) for axis in (0, 1)]
    area_m2 = float(np.hypot(across[0], across[1])) * voxel_m**2
    return "side", np.concatenate([faces[way] for way in level]), area_m2


def _extents_m(points_floor: Float64, look: Float64, side: bool, voxel_m: float) -> tuple[float, float]:
    """Return two extents, metres, of a frontier's faces with the centres `points_floor` (n, 3).

    For `side`, they are width and height as seen along `look` (3,). Otherwise they are the longer and the
    shorter side of the smallest rectangle around the faces, seen from above.
    """
    if side:
        across = np.array([-look[1], look[0], 0.0]) / np.hypot(look[0], look[1])
        return _extent_m(points_floor @ across, voxel_m), _extent_m(points_floor[:, 2], voxel_m)
    boxes: list[list[float]] = []
    for turn in np.linspace(0, np.pi / 2, 31)[:-1]:
        along = np.array([np.cos(turn), np.sin(turn), 0.0])
        across = np.array([-along[1], along[0], 0.0])
        boxes.append([_extent_m(points_floor @ axis, voxel_m) for axis in (along, across)])
    least = min(boxes, key=lambda box: box[0] * box[1])
    return max(least), min(least)


def _extent_m(values: Float64, voxel_m: float) -> float:
    """Return the extent of values (n,), metres, without 1 % at either end, plus one voxel."""
    low, high = np.quantile(values, [STREAKS, 1 - STREAKS])
    return float(high - low) + voxel_m


def is_obstructed(chosen: Segmentation, point_floor: Float64, look: Float64, limits: SensorLimits) -> bool:
    """Whether something other than the object is in the way of a camera that looks at a point.

    The camera stands at least `near_m` outside the object's box. An obstacle is anything measured on the line
    between the box and that camera, or a wall that was measured on both sides of the line.

    Args:
        chosen: the object, and what else stands on the floor.
        point_floor: (3,) the camera's target, floor frame, metres.
        look: (3,) unit vector, floor frame, from the point to the camera.
        limits: of the sensor.
    """
    cell_m = chosen.cell_m
    others = (chosen.other_cells + 0.5) * cell_m - point_floor
    along_m = others @ look
    beside_m = np.linalg.norm(others - along_m[:, None] * look, axis=1)
    out_m = _way_out_m(chosen.box, point_floor, look)
    reach_m = out_m + limits.near_m + limits.camera_size_m / 2
    met = (along_m > out_m) & (along_m < reach_m) & (beside_m < BESIDE_CELLS * cell_m)
    if met.sum() >= HIT_CELLS:
        return True
    if abs(look[2]) > WALL_STEEP:
        return False
    towards = look[:2] / np.linalg.norm(look[:2])
    higher = others[others[:, 2] > 0, :2]
    level = np.column_stack([higher @ towards, higher @ [-towards[1], towards[0]]])
    near = (np.abs(level) < 2 * reach_m + WALL_CELLS * cell_m).all(axis=1)
    cells = np.floor(level[near] / cell_m).astype(np.int64)
    _, first, counts = np.unique(cell_numbers(cells), return_index=True, return_counts=True)
    columns = cells[first[counts >= WALL_CELLS]]
    return bool((_wall_crossings(columns) * cell_m < reach_m).any())


def _way_out_m(box: OrientedBox, point_floor: Float64, look: Float64) -> float:
    """Return the distance from a point (3,) in an upright box to its boundary along `look`; 0 if outside."""
    T_box_floor = invert_rigid(box.T_floor_box)
    point, along = transform_points(T_box_floor, point_floor), T_box_floor[:3, :3] @ look
    half = np.array(box.size_m) / 2
    with np.errstate(divide="ignore"):
        return max(0.0, float(((half - np.sign(along) * point) / np.abs(along)).min()))


def _wall_crossings(columns: Int64) -> Float64:
    """Find where a line crosses upright walls; return distances (k,) along the line, from 0 on, in cells.

    `columns` (n, 2) are the cells of measured columns seen from above: their position along the line, and to
    its left. A wall is straight, and has columns on both sides of the line.
    """
    sides: tuple[Bools, Bools] = (columns[:, 1] > 0, columns[:, 1] < 0)
    if min(int(side.sum()) for side in sides) < WALL_CELLS:
        return np.zeros(0)
    rng = np.random.default_rng(0)
    left, right = (columns[rng.choice(np.flatnonzero(side), TRIED_LINES)] for side in sides)
    step = right - left
    normal = np.column_stack([-step[:, 1], step[:, 0]]) / np.linalg.norm(step, axis=1)[:, None]
    off = np.abs(columns @ normal.T - (left * normal).sum(axis=1)) < 1
    holds = np.logical_and(*(off[side].sum(axis=0) >= WALL_CELLS for side in sides))
    crossing = left[:, 0] - left[:, 1] * step[:, 0] / step[:, 1]
    return np.asarray(crossing[holds & (crossing > 0)])

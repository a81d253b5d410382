"""Openings that nobody looked into: how large they are, where, and from where they would be seen."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.artefacts.object_grids import Label
from kinectbench.core.geometry import transform_points
from kinectbench.core.types import Bools, Float64
from kinectbench.stages.segment.evidence import Evidence
from kinectbench.stages.segment.morphology import broad
from kinectbench.stages.segment.solid import SolidShape

Direction = Literal["up", "side", "down"]

# A frontier is told of if what lies behind it is so much of the solid's volume, and if it is so large (own
# choices).
LEAST_SHARE, LEAST_AREA_M2 = 0.02, 0.002
# What is all but certainly air says nothing of the object.
LEAST_PROBABILITY = 0.025
# Above an open box most level ways out end in the air inside of it, under a shelf most ways down on the shelf
# below: from above, and then from beside, one sees most (own choices).
ABOVE_FIRST, BESIDE_FIRST = 2.0, 1.5
# A piece lies around a corner if less than this share of it leads straight out (own choice); a room has
# a roof.
STRAIGHT_SHARE = 0.5
ROOM_WAYS: tuple[Direction, ...] = ("side", "down", "up")
# From so much of a unit vector up or down it is told as straight above or below, and under so much as level
# (own choices).
STEEP, LEVEL = 0.9, 0.35


@dataclass(frozen=True)
class Frontier:
    """The boundary between a region that nobody saw and free space, where nothing was measured.

    Attributes:
        direction: from the unseen region outward.
        area_m2: of its faces, along that direction: what is open of the box `size_m`, and more than the box
            where some of its faces lie behind others.
        size_m: (2,) extents of its faces: for up and down the longer and the shorter one seen from above, for
            side the width and the height.
        center_m: (3,) middle of its faces, floor frame, metres.
        look_from: (3,) unit vector, floor frame: from the frontier to where a camera would look into it.
        volume_m3: of the unseen region behind it.
        inside_share: how much of that is expected to be inside, 0 to 1.
        solid_share: how much of it the solid takes for inside, 0 to 1.
        inside_solid_share: how much of it is expected to be inside and taken for it, 0 to 1.
        into_room: it leads into a room wider than itself, into which frames looked in part.
    """

    direction: Direction
    area_m2: float
    size_m: tuple[float, float]
    center_m: tuple[float, float, float]
    look_from: tuple[float, float, float]
    volume_m3: float
    inside_share: float
    solid_share: float
    inside_solid_share: float
    into_room: bool = False

    @property
    def advice(self) -> str:
        """One line for the person who records: what nobody saw, and where to stand, by `look_from` alone."""
        size = " x ".join(f"{100 * length_m:.0f}" for length_m in self.size_m) + " cm"
        what = {
            "up": f"nobody looked into the opening at the top, {size}",
            "side": f"nobody looked into the opening at the side, {size}",
            "down": f"nobody saw the underside, {size}",
        }[self.direction]
        where = where_to_stand(self.look_from, self.center_m[2])
        if self.into_room and self.direction == "side":
            what = f"nobody looked around the corners behind the opening at the side, {size}"
            return f"{what}: record {where}, and from the left and the right of that"
        return f"{what}: record {where}"


def where_to_stand(look_from: tuple[float, float, float], height_m: float) -> str:
    """From where to look at a point, in words.

    Args:
        look_from: unit vector, floor frame: from the point to the camera.
        height_m: of the point above the floor.
    """
    up, height = look_from[2], f"{100 * height_m:.0f} cm"
    # Not -0.0.
    x, y = (round(along, 1) + 0.0 for along in look_from[:2])
    towards = f"from the direction ({x:.1f}, {y:.1f}) of the floor frame"
    if abs(up) > STEEP:
        return "from above" if up > 0 else f"from below, lower than {height}"
    if abs(up) < LEVEL:
        return f"{towards}, at the height of {height}"
    return f"{towards}, obliquely from above" if up > 0 else f"{towards}, lower than {height}, looking up"


def find_frontiers(shape: SolidShape, evidence: Evidence, T_floor_grid: Float64) -> tuple[Frontier, ...]:
    """Every frontier of some size, that with the largest volume behind it first.

    A frontier is what of the surface of a piece of open voxels (26 neighbours) lies at free space. Its
    direction is the one in which most of the ways out of the piece lead, of those in which it borders on free
    space. Unseen layers that are thinner than an opening, as under a seat, have none.

    Args:
        shape: the solid.
        evidence: what the frames say of each of its voxels.
        T_floor_grid: (4, 4), of its grid.
    """
    # What is hidden under the object, and not of it, is no opening.
    hidden = evidence.shadow.under | evidence.shadow.empty
    is_open = (
        evidence.openings.open
        & ~hidden
        & (shape.labels == Label.UNKNOWN)
        & (shape.probability > LEAST_PROBABILITY)
    )
    is_open = broad(is_open, evidence.opening_cells)
    found: list[Frontier] = []
    corners = _around_corners(is_open, evidence)
    if corners.any():
        # One looks around the corners of a room through its doorway: that is the frontier of all of them.
        room = _with_its_edges(evidence.openings.room, evidence.carved, evidence.opening_cells)
        found += _of_pieces(shape, evidence, T_floor_grid, corners, room)
    found += _of_pieces(shape, evidence, T_floor_grid, is_open & ~corners, None)
    return tuple(sorted(found, key=lambda frontier: -frontier.volume_m3))


def _of_pieces(
    shape: SolidShape, evidence: Evidence, T_floor_grid: Float64, is_open: Bools, room: Bools | None
) -> Iterator[Frontier]:
    """The frontiers of the pieces of open voxels; those in one room are one piece with its air."""
    from scipy import ndimage

    whole = is_open if room is None else is_open | room
    pieces, count = ndimage.label(whole, np.ones((3, 3, 3)))
    voxel_m3 = shape.grid.voxel_size_m**3
    volumes_m3 = voxel_m3 * np.bincount(pieces[is_open], minlength=count + 1)[1:]
    least_m3 = LEAST_SHARE * voxel_m3 * int(shape.solid.sum())
    windows = ndimage.find_objects(pieces)
    free = np.pad(evidence.carved if room is None else evidence.carved & ~room, 1)
    for piece in 1 + np.flatnonzero((volumes_m3 > 0) & (volumes_m3 >= least_m3)):
        window = windows[piece - 1]
        cells = pieces[window] == piece
        inner = cells & is_open[window]
        taken = shape.solid[window][inner]
        expected = shape.probability[window][inner].astype(np.float64)
        part = _Piece(
            shape.grid.voxel_size_m,
            cells,
            free[tuple(slice(along.start, along.stop + 2) for along in window)],
            np.array([along.start for along in window]),
        )
        behind = (
            float(volumes_m3[piece - 1]),
            float(expected.mean()),
            float(taken.mean()),
            float((expected * taken).mean()),
        )
        for way in _ways_out(evidence, window, inner) if room is None else ROOM_WAYS:
            frontier = _frontier(part, way, T_floor_grid, behind, room is not None)
            if frontier is not None and frontier.area_m2 >= LEAST_AREA_M2:
                yield frontier
                break


def _around_corners(is_open: Bools, evidence: Evidence) -> Bools:
    """Those pieces of open voxels next to the air in a room from most of which no ray leads straight out."""
    from scipy import ndimage

    openings = evidence.openings
    if not openings.room.any():
        return openings.room
    pieces, count = ndimage.label(is_open, np.ones((3, 3, 3)))
    straight = is_open & ((openings.ups > 0) | (openings.levels > 0))
    sizes, lead_out = (np.bincount(pieces[cells], minlength=count + 1) for cells in (is_open, straight))
    beside = np.zeros(count + 1, bool)
    beside[pieces[ndimage.binary_dilation(openings.room, iterations=2)]] = True
    around: Bools = (beside & (lead_out < STRAIGHT_SHARE * sizes))[pieces]
    return around


def _with_its_edges(room: Bools, carved: Bools, cells: int) -> Bools:
    """The air in rooms with what a cube does not reach of it, along walls and in the doorway."""
    from scipy import ndimage

    if not room.any():
        return room
    reached: Bools = ndimage.binary_dilation(room, iterations=max(1, cells // 2), mask=room | carved)
    return reached


def _ways_out(evidence: Evidence, window: tuple[slice, ...], inner: Bools) -> list[Direction]:
    """In which directions some way leads out of a piece in its window, that of the most ways first.

    Most of them may end in a crack below a piece that borders on free space above it only.
    """
    ups, levels, downs = (
        float(rays[window][inner].mean())
        for rays in (evidence.openings.ups, evidence.openings.levels, evidence.openings.downs)
    )
    ways: dict[Direction, float] = {
        "up": ABOVE_FIRST * ups / 9,
        "side": BESIDE_FIRST * levels / 8,
        "down": downs / 9,
    }
    return sorted((way for way in ways if ways[way] > 0), key=lambda way: -ways[way])


@dataclass(frozen=True)
class _Piece:
    """A piece of open voxels in its window of a grid; `free` has one more voxel on each side."""

    voxel_m: float
    cells: Bools
    free: Bools
    corner: NDArray[np.int64]

    def faces_m(self, axis: int, sign: int) -> Float64:
        """Middles (n, 3) of its faces at free space that look along an axis, grid frame, metres."""
        step = np.zeros(3, np.int64)
        step[axis] = sign
        beside = tuple(slice(1 + k, 1 + k + n) for k, n in zip(step, self.cells.shape, strict=True))
        at: Float64 = (
            self.corner + np.argwhere(self.cells & self.free[beside]) + 0.5 + step / 2
        ) * self.voxel_m
        return at


def _frontier(
    piece: _Piece,
    direction: Direction,
    T_floor_grid: Float64,
    behind: tuple[float, float, float, float],
    into_room: bool,
) -> Frontier | None:
    """Of one piece of open voxels; None where it touches no free space in that direction.

    Its faces along the grid's axes, added up as vectors, are the area of a smooth surface in their place.
    """
    faces = {(axis, sign): piece.faces_m(axis, sign) for axis in range(3) for sign in (-1, 1)}
    areas_m2 = {way: len(points) * piece.voxel_m**2 for way, points in faces.items()}
    slant = np.array([areas_m2[axis, 1] - areas_m2[axis, -1] for axis in (0, 1)])
    if direction == "side":
        # What is open on both sides, such as a gap, is looked into from the side that shows more of it.
        widest = max(((axis, sign) for axis in (0, 1) for sign in (-1, 1)), key=lambda way: areas_m2[way])
        points, area_m2, normal = faces[widest], areas_m2[widest], np.zeros(3)
        normal[widest[0]] = widest[1]
        if slant.any() and np.hypot(*slant) >= area_m2:
            area_m2, normal[:2] = float(np.hypot(*slant)), slant
            shown = [(axis, 1 if slant[axis] > 0 else -1) for axis in (0, 1) if slant[axis]]
            points = np.concatenate([faces[way] for way in shown])
    else:
        sign = 1 if direction == "up" else -1
        points, area_m2 = faces[2, sign], areas_m2[2, sign]
        # At least half from above, or from below: its own walls hide the rest.
        normal = np.array([*slant, sign * max(area_m2, float(np.hypot(*slant)))])
    if not len(points):
        return None
    look = T_floor_grid[:3, :3] @ (normal / np.linalg.norm(normal))
    points_floor = transform_points(T_floor_grid, points)
    return Frontier(
        direction,
        area_m2,
        _extents_m(points_floor, look, direction == "side", piece.voxel_m),
        _three(points_floor.mean(axis=0)),
        _three(look),
        *behind,
        into_room,
    )


def _extents_m(points_floor: Float64, look: Float64, side: bool, voxel_m: float) -> tuple[float, float]:
    """Two extents of a frontier's faces: width and height at the side, else the sides of the least box."""
    if side:
        across = np.array([-look[1], look[0], 0.0])
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
    """Without the outermost hundredth at either end: streaks of single voxels reach far."""
    low, high = np.quantile(values, [0.01, 0.99])
    return float(high - low) + voxel_m


def _three(vector: Float64) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in vector)
    return x, y, z

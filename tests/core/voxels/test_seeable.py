"""What is air and what is object by definition, of shapes whose answer is plain."""

from dataclasses import replace

import numpy as np
import pytest
from manifold3d import Manifold as Solid
from raising import raises
from scipy import ndimage

from kinectbench.core.errors import ShapeError
from kinectbench.core.geometry import (
    Grid,
    TriangleMesh,
    rigid,
    rotation_from_quaternion_xyzw,
    transform_points,
)
from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.types import Bools, Float32
from kinectbench.core.voxels.line_kernels import BLOCKED, FROM_ABOVE, FROM_BELOW, PASSABLE, PLACE
from kinectbench.core.voxels.lines_of_sight import directions, seen_along
from kinectbench.core.voxels.morphology import reached_from_beyond
from kinectbench.core.voxels.open_below import (
    NUMBER,
    OPEN_WAYS,
    OPPOSITE,
    WAYS_BESIDE_LEG,
    _level_ways_out,
    underside_over_open_space,
)
from kinectbench.core.voxels.seeable import SeeableSolid, seeable_solid, seen_from_outside
from kinectbench.core.voxels.sight import (
    _grown_back,
    swept_from_outside,
)

# Voxels are 10 mm for these: eight times as fast as for lines of 30 mm.
LIMITS = SensorLimits(line_width_m=0.06)


def block(*bounds: tuple[float, float]) -> Solid:
    """From and to along x, y and z, metres."""
    low, high = np.array(bounds).T
    block: Solid = Solid.cube(high - low).translate(low)
    return block


def hollow(wall_m: float = 0.02, side_m: float = 0.4) -> Solid:
    """A closed cube on the floor."""
    inner = (wall_m, side_m - wall_m)
    hollow: Solid = block(*[(0.0, side_m)] * 3) - block(*[inner] * 3)
    return hollow


def mesh_of(solid: Solid) -> TriangleMesh:
    mesh = solid.to_mesh64()
    return TriangleMesh(np.array(mesh.vert_properties[:, :3]), np.array(mesh.tri_verts, np.int32))


def at(found: SeeableSolid, which: Bools, *point: float) -> bool:
    """One of its arrays at a point, upright frame."""
    cell = np.floor(transform_points(found.grid.T_grid_world, np.array([point])) / found.grid.voxel_size_m)
    return bool(which[tuple(cell[0].astype(int))])


SEALED = hollow()
WINDOW = SEALED - block((0.1, 0.3), (0.3, 0.5), (0.1, 0.3))  # 20 cm: a camera looks in, and gets in
SLIT = SEALED - block((0.05, 0.35), (0.3, 0.5), (0.18, 0.23))  # 50 mm high
BIN = SEALED - block((0.02, 0.38), (0.02, 0.38), (0.3, 0.5))
DOWN = BIN.translate([0, 0, -0.4]).scale([1, 1, -1])  # the same upside down
ON_FEET = DOWN.translate([0, 0, 0.05]) + block((0, 0.02), (0, 0.02), (0, 0.1))
HIGH = DOWN.translate([0, 0, 0.5])
# A room behind a room, each with a doorway: no line leads through both.
MAZE = (
    block((0, 0.8), (0, 0.4), (0, 0.4))
    - block((0.02, 0.39), (0.02, 0.38), (0.02, 0.38))
    - block((0.41, 0.78), (0.02, 0.38), (0.02, 0.38))
    - block((0.38, 0.42), (0.02, 0.12), (0.02, 0.12))
    - block((0.02, 0.14), (0.37, 0.5), (0.26, 0.38))
)
# It stands on a ring 5 cm high.
ON_A_RING = BIN.translate([0, 0, 0.05]) + (
    block((0, 0.4), (0, 0.4), (0, 0.06)) - block((0.02, 0.38), (0.02, 0.38), (-0.01, 0.05))
)


@pytest.mark.parametrize(
    ("solid", "point", "closed", "slit"),
    [
        (SEALED, (0.2, 0.2, 0.2), True, False),
        (WINDOW, (0.2, 0.2, 0.2), False, False),
        (SLIT, (0.2, 0.3, 0.205), True, True),
        (SLIT, (0.2, 0.36, 0.33), True, False),
        (BIN, (0.2, 0.2, 0.03), False, False),
        # Upside down over a gap of 50 mm, through which no line leads.
        (ON_FEET, (0.2, 0.2, 0.3), True, False),
        # Half a metre up: cameras look up into it.
        (HIGH, (0.2, 0.2, 0.7), False, False),
        (MAZE, (0.05, 0.2, 0.32), False, False),
        (MAZE, (0.7, 0.3, 0.3), True, False),
    ],
    ids=["sealed", "window", "slit", "above a slit", "bin", "on feet", "high", "first room", "second room"],
)
def test_what_no_camera_could_tell_is_object(
    solid: Solid, point: tuple[float, float, float], closed: bool, slit: bool
) -> None:
    found = seeable_solid(mesh_of(solid), np.eye(4), LIMITS)
    assert (at(found, found.closed, *point), at(found, found.slit, *point)) == (closed, slit)
    assert not (found.closed & found.solid).any() and not (found.slit & ~found.closed).any()


def test_what_stands_is_not_seen_from_below_the_floor() -> None:
    for stands in (True, False):
        found = seeable_solid(mesh_of(ON_A_RING), np.eye(4), LIMITS, stands=stands)
        assert at(found, found.closed, 0.2, 0.2, 0.025) == stands


@pytest.mark.parametrize("wall_m", [0.002, 0.004, 0.012])
def test_walls_thinner_than_a_voxel_hide_what_is_behind_them(wall_m: float) -> None:
    found = seeable_solid(mesh_of(hollow(wall_m, 0.253)), np.eye(4), LIMITS)
    inside = found.grid.voxel_size_m**3 * (found.closed & ~found.slit).sum()
    assert inside == pytest.approx((0.253 - 2 * wall_m) ** 3, rel=0.15)
    assert found.closed_share == pytest.approx(inside / found.exact_m3)


@pytest.mark.parametrize("walls", [1, 2, 3])
def test_what_wider_lines_see_does_not_grow_through_a_wall(walls: int) -> None:
    solid = np.zeros((50, 50, 48), bool)
    solid[10:40, 10:40, :30] = True
    solid[10 + walls : 40 - walls, 10 + walls : 40 - walls, walls : 30 - walls] = False
    heights_m = ((np.arange(48) + 0.5) * 0.01).astype(np.float32)
    wide = seen_from_outside(solid, heights_m, 0.01, LIMITS)
    narrow = seen_from_outside(solid, heights_m, 0.01, replace(LIMITS, line_width_m=0.03), wide)
    assert not narrow[10:40, 10:40, :30].any() and narrow[:10].any()


def test_a_mesh_that_has_no_seeable_solid() -> None:
    with raises(ShapeError, "shape.no-solid", match="no faces"):
        seeable_solid(TriangleMesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32)), np.eye(4), LIMITS)
    with raises(ShapeError, "shape.no-solid", match="below the plane"):
        seeable_solid(mesh_of(SEALED.translate([0, 0, -1])), np.eye(4), LIMITS)


def test_a_convex_body_is_itself_in_any_world() -> None:
    turn = rigid(rotation_from_quaternion_xyzw([0.4, -0.2, 0.1, 0.9]), [1.0, 2.0, -3.0])
    box = block((0, 0.3), (0, 0.2), (0, 0.25))
    found = seeable_solid(mesh_of(box).transformed(turn), turn, LIMITS)
    # Lines leave out the edge between its sides and the floor.
    assert found.closed_share == 0 and found.slit_share < 0.02
    assert found.solid.sum() * found.grid.voxel_size_m**3 == pytest.approx(0.015, rel=0.03)


def test_an_array_on_another_grid_is_that_of_the_nearest_voxel() -> None:
    found = seeable_solid(mesh_of(SEALED), np.eye(4), LIMITS)
    other = Grid(
        (30, 20, 8), 0.013, rigid(rotation_from_quaternion_xyzw([0, 0, 0.3, 0.95]), [0.05, -0.05, 0.1])
    )
    on_other = found.on(other, found.closed)
    middles = transform_points(other.T_world_grid, (np.argwhere(np.ones(other.shape)) + 0.5) * 0.013)
    inside = np.all((middles > 0.025) & (middles < 0.375), axis=1).reshape(other.shape)
    outside = np.any((middles < 0.015) | (middles > 0.385), axis=1).reshape(other.shape)
    assert on_other[inside].all() and not on_other[outside].any() and inside.sum() > 500


def room(doorway_m: float) -> tuple[Bools, Float32]:
    """A cube with a doorway down to the floor, of 10 mm, and the middles of its layers."""
    solid = np.zeros((60, 60, 56), bool)
    solid[15:45, 15:45, :40] = True
    solid[17:43, 17:43, :38] = False
    half = round(doorway_m / 0.02)
    solid[43:45, 30 - half : 30 + half, :25] = False
    return solid, ((np.arange(56) + 0.5) * 0.01).astype(np.float32)


@pytest.mark.parametrize(("doorway_m", "gets_in"), [(0.1, False), (0.2, True)])
def test_a_camera_gets_in_where_a_ball_does(doorway_m: float, gets_in: bool) -> None:
    solid, heights_m = room(doorway_m)
    seen = seen_from_outside(solid, heights_m, 0.01, replace(LIMITS, near_m=0.1))
    corner = (40, 18, 20)  # around the edge of the doorway
    assert bool(seen[corner]) == gets_in and not seen[solid].any()


def test_what_is_seen_from_below_only_says_so() -> None:
    solid = np.zeros((60, 60, 80), bool)
    solid[10:50, 10:50, 40:70] = True
    solid[12:48, 12:48, 40:60] = False  # a seat with deep aprons
    heights_m = ((np.arange(80) + 0.5) * 0.01).astype(np.float32)
    seen = seen_from_outside(solid, heights_m, 0.01, LIMITS)
    assert seen[30, 30, 55] and not seen[30, 30, 55] & FROM_ABOVE
    assert seen[30, 30, 20] & FROM_ABOVE and seen[30, 30, 75] & FROM_ABOVE


def test_narrower_lines_begin_with_what_wider_ones_see() -> None:
    solid, heights_m = room(0.12)
    whole = seen_from_outside(solid, heights_m, 0.01, LIMITS)
    wide = whole > 0
    narrow = replace(LIMITS, line_width_m=0.03)
    fresh, further = (seen_from_outside(solid, heights_m, 0.01, narrow, first) > 0 for first in (None, whole))
    assert not (wide & ~further).any() and not (fresh & ~further).any()
    assert (fresh != further).mean() < 1e-3 and (further & ~wide).sum() > 1000


def test_a_camera_that_rises_through_unseen_space_looks_from_below() -> None:
    """A seat with deep aprons, under which a camera fits; it rises where space was seen to be empty."""
    solid = np.zeros((60, 60, 80), bool)
    solid[10:50, 10:50, 30:70] = True
    solid[12:48, 12:48, 30:68] = False
    heights_m = ((np.arange(80) + 0.5) * 0.01).astype(np.float32)
    limits = replace(LIMITS, near_m=0.1)
    inner, beneath = np.s_[15:45, 15:45, 35:45], np.s_[15:45, 15:45, 5:10]
    for empty, below in ((np.zeros_like(solid), True), (~solid, False)):
        sight = swept_from_outside(solid, empty, heights_m, 0.01, limits, 400)
        assert (sight.any_way[inner] & FROM_ABOVE).all()
        assert (sight.only_from_below[inner] == below).all()
        assert not sight.only_from_below[beneath].any() and not sight.only_from_below[solid].any()


def test_closely_what_is_seen_from_below_is_looked_at_from_above_too() -> None:
    """A box on legs, open below and too narrow for a camera, with a slot in its lid."""
    solid = np.zeros((60, 90, 100), bool)
    solid[16:44, 15:75, 20:80] = True
    solid[18:42, 17:73, 20:78] = False
    solid[28:32, 20:70, 78:80] = False
    for x in (16, 42):
        for y in (15, 73):
            solid[x : x + 2, y : y + 2, :20] = True
    heights_m = ((np.arange(100) + 0.5) * 0.005).astype(np.float32)
    limits, none = replace(LIMITS, line_width_m=0.01, near_m=0.1), np.zeros_like(solid)
    roughly, closely = (
        swept_from_outside(solid, none, heights_m, 0.005, limits, 400, each) for each in (None, limits)
    )
    assert roughly.lower is roughly.space  # no camera rises into it
    ways = directions(25600)
    inside = np.zeros_like(solid)
    inside[18:42, 17:73, 20:78] = True
    seen = inside & (seen_along(closely.space, ways[ways[:, 2] >= 0]) > 0)
    missed = [int((seen & sight.only_from_below).sum()) for sight in (roughly, closely)]
    assert missed[1] < 0.05 * missed[0] and missed[0] > 500


@pytest.mark.parametrize("rail", [22, 30])
def test_beside_a_leg_a_camera_stands_below_an_object_too(rail: int) -> None:
    """A sideboard on four legs, with a rail down to a layer on two sides: beside a leg few ways lead out."""
    solid = np.zeros((80, 80, 80), bool)
    solid[15:65, 15:65, 30:70] = True
    solid[17:63, 17:63, 30:68] = False
    for x in (15, 61):
        for y in (15, 61):
            solid[x : x + 4, y : y + 4, :32] = True
    for y in (15, 63):
        solid[15:65, y : y + 2, rail:30] = True
    heights_m = ((np.arange(80) + 0.5) * 0.01).astype(np.float32)
    limits = replace(LIMITS, near_m=0.1)
    sight = swept_from_outside(solid, np.zeros_like(solid), heights_m, 0.01, limits, 400)
    inner = np.s_[20:60, 20:60, 36:60]
    assert (sight.any_way[inner] & FROM_ABOVE).mean() > 0.9 and sight.only_from_below[inner].all()


@pytest.mark.parametrize("door", [30, 60])
def test_a_camera_that_came_in_through_a_door_may_rise(door: int) -> None:
    """A cabinet with a bottom that nobody looked into; the space behind the lintel is higher."""
    solid = np.zeros((80, 80, 120), bool)
    solid[10:70, 10:70, :105] = True
    solid[12:68, 12:68, 2:103] = False
    solid[66:70, 21:59, 4:door] = False
    heights_m = ((np.arange(120) + 0.5) * 0.01).astype(np.float32)
    limits = replace(LIMITS, line_width_m=0.03, near_m=0.2)
    sight = swept_from_outside(solid, np.zeros_like(solid), heights_m, 0.01, limits, 400)
    inner = np.s_[16:64, 16:64, door + 5 : 100]
    assert (sight.any_way[inner] & FROM_ABOVE).mean() > 0.9
    # Some is only seen by lines that look up: they come in through the door, too.
    assert sight.only_from_below[inner].mean() < 0.1


@pytest.mark.parametrize("radius", [0.5, 1.0, 1.5, 2.0, 3.2])
def test_reached_voxels_are_dilated_by_a_ball(radius: float) -> None:
    rng = np.random.default_rng(2)
    obstacle = rng.random((14, 11, 9)) < 0.3
    reached = rng.choice(np.arange(4, dtype=np.uint8), obstacle.shape, p=[0.97, 0.01, 0.01, 0.01]) * ~obstacle
    grown = _grown_back(reached, obstacle, radius)
    cells = np.indices((7, 7, 7)) - 3
    ball = (cells**2).sum(axis=0) <= radius**2
    for bit in (FROM_ABOVE, FROM_BELOW):
        dilated = ndimage.binary_dilation(reached & bit > 0, ball) & ~obstacle
        np.testing.assert_array_equal(grown & bit > 0, dilated)


STEPS = [(a, b, 0) for a in (-1, 0, 1) for b in (-1, 0, 1) if (a, b) != (0, 0)]


def level_ways(blocked: Bools, place: Bools) -> Bools:
    """By stepping along each ray from each voxel of `place`: (7, 8, 9, 8), which rays lead out."""
    ways = np.zeros((*blocked.shape, 8), bool)
    for at in np.argwhere(place):
        for ray, step in enumerate(STEPS):
            line = [tuple(at + n * np.array(step)) for n in range(10)]
            inside = [cell for cell in line if 0 <= cell[0] < 7 and 0 <= cell[1] < 8]
            ways[(*at, ray)] = not any(blocked[cell] for cell in inside)
    return ways


@pytest.mark.parametrize("seed", range(5))
def test_the_underside_over_open_space(seed: int) -> None:
    rng = np.random.default_rng(seed)
    kind = rng.choice(5, (7, 8, 9), p=[0.3, 0.25, 0.1, 0.05, 0.3])
    part, body, obstacle, free = (kind == n for n in (1, 2, 3, 4))
    filled, over = part | body, {}
    below = ~filled & np.logical_or.accumulate(filled[:, :, ::-1], axis=2)[:, :, ::-1]
    ways = level_ways(obstacle, below)
    through = np.any([ways[..., n] & ways[..., 7 - n] for n in range(8)], axis=0)
    for least in (OPEN_WAYS, WAYS_BESIDE_LEG):
        over[least] = np.zeros_like(part)
        for i, j, k in np.argwhere(~filled & ndimage.binary_dilation(part, np.ones((3, 3, 3)))):
            first = k
            while first and not filled[i, j, first - 1]:
                first -= 1
            column = free[i, j, first : k + 1]
            lit = np.maximum.accumulate(column)
            rooms = np.flatnonzero(lit[:-1] & column[1:] & ~column[:-1]) + 1
            passes = first == 0 and not len(rooms) and through[i, j, 0]
            first += rooms[-1] if len(rooms) else 0
            wide = ways[i, j, first : k + 1].sum(axis=1) >= least
            over[least][i, j, k] = "oo" in "".join("o" if each else "." for each in wide) or passes
    for beside, line in ((0, 1), (1, 2)):
        square = np.ones((2 * beside + 1, 2 * beside + 1, 1))
        beside_open = ndimage.binary_dilation(over[OPEN_WAYS], square)
        opened = over[OPEN_WAYS] | (beside_open & over[WAYS_BESIDE_LEG])
        expected = part & ndimage.binary_dilation(opened, np.ones((2 * line + 1, 2 * line + 1, 3)))
        found = underside_over_open_space(part, body, free, obstacle, height=2, beside=beside, line=line)
        assert (found == expected).all() and expected.any()


@pytest.mark.parametrize("seed", range(5))
def test_positions_reached_without_rising(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = rng.choice([PLACE, PLACE, PLACE, PASSABLE, BLOCKED], (7, 8, 9)).astype(np.uint8)
    place, empty = state == PLACE, rng.random((7, 8, 9)) < 0.3
    rays = level_ways(state == BLOCKED, place)
    ways, bits = rays.sum(axis=-1), _level_ways_out(state, place)
    assert (np.unpackbits(bits[..., None], axis=-1, bitorder="little").astype(bool) == rays).all()
    assert (NUMBER[bits] == ways).all()
    assert (OPPOSITE[bits] == np.any([rays[..., n] & rays[..., 7 - n] for n in range(8)], axis=0)).all()
    may_rise = empty
    inner = np.zeros_like(place)
    inner[1:-1, 1:-1, 1:-1] = True
    expected = place & ~inner
    expected[1:-1, 1:-1, 0] &= empty[1:-1, 1:-1, 0]
    while True:  # one step of all at once, by shifted arrays
        near = np.pad(expected, 1)
        level = near[:-2, 1:-1, 1:-1] | near[2:, 1:-1, 1:-1] | near[1:-1, :-2, 1:-1] | near[1:-1, 2:, 1:-1]
        more = expected | (place & (level | near[1:-1, 1:-1, 2:] | (near[1:-1, 1:-1, :-2] & may_rise)))
        if (more == expected).all():
            break
        expected = more
    assert (reached_from_beyond(place, empty) == expected).all()

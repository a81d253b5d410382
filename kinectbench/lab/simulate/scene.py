"""The surroundings of the subject: a room or open ground, and clutter that does not occlude it.

In frame `room`, z is up, and the subject stands on z = 0 with its origin at the room's origin.
"""

from dataclasses import dataclass, replace
from itertools import product
from typing import Literal

import numpy as np

from kinectbench.core.geometry import OrientedBox, TriangleMesh, box_mesh
from kinectbench.lab.simulate.objects.joinery import Draw
from kinectbench.lab.simulate.objects.shapes import Subject, Vector3
from kinectbench.lab.simulate.spec import SceneSettings

Role = Literal["subject", "floor", "wall", "clutter"]

WALL_HEIGHT_M = 2.6
WALL_CLEARANCE_M = 0.5
THICK_M = 0.1
FLOOR_M, GROUND_M = 16.0, 30.0
CLEARANCE_M = 0.6
# A touching neighbour overlaps the subject's bounding box by this length.
TOUCH_M = 0.005
# Height of a dining or work table, and thickness of its top and legs, metres; clutter on it is as far from
# the subject as a hand needs to take the subject.
TABLE_M, TABLE_THICK_M, TABLE_LEG_M = 0.74, 0.035, 0.05
TABLE_LONG_M, TABLE_DEEP_M = (1.1, 1.5), (0.7, 0.9)
TABLE_CLEARANCE_M = (0.05, 0.12)
FLOOR_RGB: tuple[Vector3, ...] = (
    (0.62, 0.55, 0.46),
    (0.45, 0.32, 0.22),
    (0.55, 0.56, 0.58),
    (0.40, 0.42, 0.40),
)
GROUND_RGB: tuple[Vector3, ...] = ((0.50, 0.50, 0.49), (0.36, 0.42, 0.26), (0.58, 0.50, 0.42))
THING_RGB: tuple[Vector3, ...] = (
    (0.72, 0.53, 0.34),
    (0.62, 0.16, 0.15),
    (0.18, 0.32, 0.55),
    (0.25, 0.45, 0.28),
    (0.75, 0.58, 0.20),
    (0.30, 0.30, 0.33),
)


@dataclass(frozen=True)
class Item:
    """One mesh of the scene, with its role and material.

    Attributes:
        role: what the item is: a piece of the subject, floor, wall or clutter.
        mesh: the mesh, in frame `room`, metres.
        color_rgb: mean colour, each in [0, 1].
        contrast: strength of its texture in [0, 1].
        tile_m: size of tiles with dark joints, metres; 0 for none.
        albedo: reflected share of infrared light, in [0, 1].
    """

    role: Role
    mesh: TriangleMesh
    color_rgb: Vector3
    contrast: float
    tile_m: float = 0.0
    albedo: float = 0.6


def make_scene(
    subject: Subject, yaw_rad: float, reach_m: float, settings: SceneSettings, rng: np.random.Generator
) -> list[Item]:
    """Place a subject, turned by `yaw_rad` about z, in surroundings drawn by `rng`: all that a ray can hit.

    Clutter on the floor near the subject is low and at least 0.6 m away; tall clutter is behind the camera's
    path. So neither occludes the subject.

    Args:
        subject: the subject, which stands at the room's origin.
        yaw_rad: its rotation about z, radians.
        reach_m: largest horizontal distance of the camera from the origin, metres.
        settings: settings of the surroundings.
        rng: draws all random parts.
    """
    draw = Draw(rng)
    T_room_object = OrientedBox((0, 0, 0), (1, 1, 1), yaw_rad).T_floor_box
    mesh_room = subject.mesh.transformed(T_room_object)
    radius_m = float(np.linalg.norm(mesh_room.vertices[:, :2], axis=1).max())
    items = [
        Item("subject", piece.mesh.transformed(T_room_object), piece.color_rgb, 0.25, albedo=piece.albedo)
        for piece in subject.pieces
    ]
    outdoor = settings.place == "outdoor"
    around = [_floor(draw, outdoor=outdoor)]
    walls = settings.walls
    if walls is None:
        walls = 0 if outdoor else draw.integer(2, 4)
    wall_m = max(3.0, reach_m + WALL_CLEARANCE_M) + draw.between(0, 0.5)
    first = draw.integer(0, 4)
    for k in range(walls):
        around += _wall((first + k) * np.pi / 2, wall_m, draw)
    clutter = draw.integer(1, 3) if settings.clutter is None else settings.clutter
    if settings.stands_on == "table":
        items += [_lowered(item, TABLE_M) for item in around]
        items += [*_table(radius_m, draw), *_table_clutter(clutter, radius_m, draw)]
    else:
        items += [*around, *_low_clutter(clutter, radius_m, draw)]
    if settings.touching:
        items.append(_neighbour(mesh_room, draw))
    return items


def _floor(draw: Draw, *, outdoor: bool) -> Item:
    """Draw the ground: indoors a floor with or without tiles, outdoors paving, lawn or sand."""
    side_m = GROUND_M if outdoor else FLOOR_M
    mesh = box_mesh(OrientedBox((0, 0, -THICK_M / 2), (side_m, side_m, THICK_M)))
    if outdoor:
        tile_m = float(draw.rng.choice([0.0, 0.4]))
        return Item("floor", mesh, draw.choose(GROUND_RGB), 0.6, tile_m)
    tile_m = float(draw.rng.choice([0.28, 0.45, 0.0], p=[0.5, 0.2, 0.3]))
    (red, green, blue), tint = draw.choose(FLOOR_RGB), draw.between(0.8, 1.0)
    return Item("floor", mesh, (red * tint, green * tint, blue * tint), 0.45, tile_m)


def _wall(turn_rad: float, at_m: float, draw: Draw) -> list[Item]:
    """Draw a wall `at_m` from the origin in one direction, with one or two cabinets against it."""
    gray = draw.between(0.7, 0.85)
    outward = np.array([np.cos(turn_rad), np.sin(turn_rad), 0.0])
    along = np.array([-outward[1], outward[0], 0.0])

    def box(middle_m: float, aside_m: float, size: Vector3) -> TriangleMesh:
        x, y, _ = (outward * middle_m + along * aside_m).tolist()
        return box_mesh(OrientedBox((x, y, size[2] / 2), size, turn_rad))

    wall = box(at_m + THICK_M / 2, 0.0, (THICK_M, FLOOR_M, WALL_HEIGHT_M))
    items = [Item("wall", wall, (gray, gray, 0.92 * gray), 0.25)]
    for _ in range(draw.integer(1, 3)):
        deep, wide, high = draw.between(0.25, 0.4), draw.between(0.5, 1.2), draw.between(0.6, 1.9)
        mesh = box(at_m - deep / 2, draw.between(-2.2, 2.2), (deep, wide, high))
        items.append(Item("clutter", mesh, draw.choose(THING_RGB), 0.5))
    return items


def _low_clutter(count: int, subject_radius_m: float, draw: Draw) -> list[Item]:
    """Draw low boxes on the floor, spread evenly around the subject."""
    items = []
    start = draw.between(0, 2 * np.pi)
    for k in range(count):
        long, deep, high = draw.between(0.15, 0.35), draw.between(0.15, 0.35), draw.between(0.12, 0.3)
        reach = subject_radius_m + CLEARANCE_M + float(np.hypot(long, deep)) / 2 + draw.between(0.0, 0.3)
        turn = start + (k + draw.between(-0.3, 0.3)) * 2 * np.pi / count
        x, y = reach * float(np.cos(turn)), reach * float(np.sin(turn))
        box = OrientedBox((x, y, high / 2), (long, deep, high), draw.between(0, np.pi))
        items.append(Item("clutter", box_mesh(box), draw.choose(THING_RGB), 0.5))
    return items


def _lowered(item: Item, by_m: float) -> Item:
    """Return an item moved down."""
    T = np.eye(4)
    T[2, 3] = -by_m
    return replace(item, mesh=item.mesh.transformed(T))


def _table(subject_radius_m: float, draw: Draw) -> list[Item]:
    """Draw a table whose top is at z = 0, placed at random so that the subject at the origin stands on it."""
    long, deep = draw.between(*TABLE_LONG_M), draw.between(*TABLE_DEEP_M)
    (x, y), turn = (
        (
            draw.between(-free, free)
            for free in (max(0.0, side / 2 - subject_radius_m - THICK_M) for side in (long, deep))
        ),
        draw.between(0, np.pi),
    )
    T = OrientedBox((0, 0, 0), (1, 1, 1), turn).T_floor_box

    def part(center: Vector3, size: Vector3) -> Item:
        mesh = box_mesh(OrientedBox(center, size)).transformed(T)
        return Item("clutter", mesh, color, 0.35, albedo=0.65)

    color = draw.choose(FLOOR_RGB)
    high = TABLE_M - TABLE_THICK_M
    items = [part((x, y, -TABLE_THICK_M / 2), (long, deep, TABLE_THICK_M))]
    for right, far in product((-1, 1), (-1, 1)):
        at = x + right * (long / 2 - TABLE_LEG_M), y + far * (deep / 2 - TABLE_LEG_M)
        items.append(part((*at, -TABLE_THICK_M - high / 2), (TABLE_LEG_M, TABLE_LEG_M, high)))
    return items


def _table_clutter(count: int, subject_radius_m: float, draw: Draw) -> list[Item]:
    """Draw boxes and books on the table, spread evenly around the subject; farther things may be higher."""
    items = []
    start = draw.between(0, 2 * np.pi)
    for k in range(count):
        free = draw.between(*TABLE_CLEARANCE_M)
        size = draw.between(0.05, 0.16), draw.between(0.05, 0.2), draw.between(0.02, 0.04 + free)
        reach = subject_radius_m + free + float(np.hypot(*size[:2])) / 2
        turn = start + (k + draw.between(-0.2, 0.2)) * 2 * np.pi / count
        x, y = reach * float(np.cos(turn)), reach * float(np.sin(turn))
        box = OrientedBox((x, y, size[2] / 2), size, draw.between(0, np.pi))
        items.append(Item("clutter", box_mesh(box), draw.choose(THING_RGB), 0.5))
    return items


def _neighbour(subject_room: TriangleMesh, draw: Draw) -> Item:
    """Draw a box that touches the subject at its outermost vertex in a random horizontal direction."""
    turn = draw.between(0, 2 * np.pi)
    outward = np.array([np.cos(turn), np.sin(turn)])
    flat = subject_room.vertices[:, :2]
    reached = flat[np.argmax(flat @ outward)]
    size = (draw.between(0.2, 0.35), draw.between(0.2, 0.35), 0.0)
    high = draw.between(0.5, 0.9) * float(subject_room.vertices[:, 2].max())
    x, y = (reached + outward * (size[0] / 2 - TOUCH_M)).tolist()
    box = OrientedBox((x, y, high / 2), (size[0], size[1], high), turn)
    return Item("clutter", box_mesh(box), draw.choose(THING_RGB), 0.5)

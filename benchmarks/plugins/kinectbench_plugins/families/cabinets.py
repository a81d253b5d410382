"""Hollow furniture that stands open: cabinets with doors, shelves and drawers, and refrigerators."""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from kinectbench.lab.simulate.objects import looks
from kinectbench.lab.simulate.objects.joinery import CORNERS, SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import box, cushion, leg, rod, rounded_path, tube
from kinectbench_plugins import palettes

if TYPE_CHECKING:
    from manifold3d import Manifold

# Parts that are glued to one another overlap by this much; own choice.
LAP_M = 0.004


@dataclass(frozen=True)
class _Case:
    """A case's measures, metres, frame `object`; its open side faces +y.

    Attributes:
        x: half its width.
        y: half its depth; the front edges of its sides lie there.
        low: height of its lower face.
        top: height of its upper face.
        wall: thickness of its sides, bottom and top.
        back: thickness of its back.
    """

    x: float
    y: float
    low: float
    top: float
    wall: float
    back: float

    @property
    def inner(self) -> float:
        """Half the width of the room inside."""
        return self.x - self.wall

    @property
    def floor(self) -> float:
        """Height of the floor of the room inside."""
        return self.low + self.wall

    @property
    def ceiling(self) -> float:
        """Height of the ceiling of the room inside."""
        return self.top - self.wall

    def room(self) -> "Manifold":
        """The room inside, and a little of the air before it."""
        low = (-self.inner, -self.y + self.back, self.floor)
        return box(low, (self.inner, self.y + LAP_M, self.ceiling))


@dataclass(frozen=True)
class _Door:
    """A door, lengths in metres.

    Attributes:
        side: where its hinge is: -1 at the left, 1 at the right.
        wide: its width.
        low: height of its lower edge.
        top: height of its upper edge.
        thick: its thickness.
        angle_rad: how far it stands open, 0 when shut.
    """

    side: int
    wide: float
    low: float
    top: float
    thick: float
    angle_rad: float

    def hung(self, shape: "Manifold", case: _Case) -> "Manifold":
        """Turn and shift a shape that was made for a shut door whose hinge is the z axis, its room at -y."""
        turned = shape.rotate((0.0, 0.0, float(np.degrees(self.angle_rad))))
        at = self.side * (case.x - max(case.wall, self.thick) / 2)
        turned = turned.mirror((1.0, 0.0, 0.0)) if self.side > 0 else turned
        # The hinge's barrel reaches into the case's front edge.
        return turned.translate((at, case.y + self.thick / 2 - min(0.012, self.thick / 4), 0.0))

    def leaf(self) -> "Manifold":
        """The board with its round hinge edge."""
        half = self.thick / 2
        board = box((0.0, -half, self.low), (self.wide, half, self.top))
        return board + rod((0.0, 0.0, self.low), (0.0, 0.0, self.top), 1.03 * half)


def open_cabinet(draw: Draw) -> Parts:
    """Draw a cabinet that stands open; nothing is thinner than 15 mm."""
    count, tall = draw.integer(1, 3), draw.chance(0.5)
    look = draw.pick(looks.WOODS[:7])
    low = draw.choose([0.0, draw.between(0.04, 0.09), draw.between(0.09, 0.17)])
    case = _Case(
        x=draw.between(0.2, 0.31) if count == 1 else draw.between(0.34, 0.52),
        y=draw.between(0.17, 0.24) + 0.02 * tall,
        low=low,
        top=low + (draw.between(1.0, 1.65) if tall else draw.between(0.62, 0.9)),
        wall=draw.between(0.017, 0.026),
        back=draw.between(0.015, 0.02),
    )
    yield from _stand(draw, case, look)
    chest = draw.chance(0.35)
    if chest:
        # Drawers above the doors: they are shut, so that behind their fronts the case is solid.
        lower = replace(case, top=case.top - draw.between(0.16, 0.24) * (1 + tall))
        block = box((-case.x, -case.y, lower.top - LAP_M), (case.x, case.y, case.top))
        yield Part("chest", block, look)
        faces = draw.integer(1, count + 1)
        for left, right in pairwise(np.linspace(-case.x, case.x, faces + 1).tolist()):
            ends = [(left + 0.004, lower.top + 0.006), (right - 0.004, case.top - 0.006)]
            yield from _fronts(draw, ends, case.y, 1 + tall, look)
        case = lower
    shell = box((-case.x, -case.y, case.low), (case.x, case.y, case.top)) - case.room()
    yield Part("case", shell, look)
    if draw.chance(0.5) and not chest:
        over = draw.between(0.01, 0.025)
        worktop = box((-case.x - over, -case.y, case.top - LAP_M), (case.x + over, case.y, case.top + 0.022))
        yield Part("top", worktop, draw.pick(looks.WOODS[:7] + looks.STONES))
    inside = look if draw.chance(0.6) else draw.pick(looks.WOODS[:7])
    # A shut door and a divider together would shut a room in.
    shut = count == 2 and draw.chance(0.3)
    yield from _interior(draw, case, inside, divided=count == 2 and not shut and draw.chance(0.4))
    leaf = look if draw.chance(0.6) else draw.pick(looks.WOODS[:7])
    angles = [draw.between(60, 120) for _ in range(count - shut)] + [0.0] * shut
    yield from _doors(draw, case, angles, leaf)


def _stand(draw: Draw, case: _Case, look: Look) -> Parts:
    """A plinth or legs, or nothing for a case that stands on the floor."""
    if case.low == 0:
        return
    head = case.low + LAP_M
    if case.low < 0.09:
        yield Part(
            "plinth", box((-case.x + 0.02, -case.y + 0.01, 0), (case.x - 0.02, case.y - 0.03, head)), look
        )
        return
    foot, thick = draw.between(0.025, 0.035), draw.between(0.035, 0.05)
    wood, is_round = draw.pick(looks.WOODS), draw.chance(0.5)
    for sx, sy in CORNERS:
        at = (sx * (case.x - 0.04), sy * (case.y - 0.035))
        yield Part("leg", leg((*at, 0.0), (*at, head + 0.01), foot, thick, is_round=is_round), wood)


def _fronts(draw: Draw, ends: list[tuple[float, float]], y: float, count: int, look: Look) -> Parts:
    """Drawers' fronts with knobs or bars on a block's face at `y`, between two corners in x and z."""
    (left, low), (right, top) = ends
    metal, bar, middle = draw.pick(looks.METALS), draw.chance(0.5), (left + right) / 2
    for a, b in pairwise(np.linspace(low, top, count + 1).tolist()):
        yield Part("drawer", box((left, y - LAP_M, a + 0.004), (right, y + 0.014, b - 0.004)), look)
        z, reach = (a + b) / 2, min(0.07, (right - left) / 4)
        if bar:
            yield Part(
                "handle", box((middle - reach, y, z - 0.01), (middle + reach, y + 0.034, z + 0.01)), metal
            )
        else:
            yield Part("handle", rod((middle, y, z), (middle, y + 0.04, z), 0.014), metal)


def _interior(draw: Draw, case: _Case, look: Look, *, divided: bool) -> Parts:
    """Shelves, perhaps a divider, and perhaps drawers at the bottom."""
    floor, rear = case.floor, -case.y + case.back - LAP_M
    if case.ceiling - floor > 0.6 and draw.chance(0.4):
        floor += draw.between(0.2, 0.32)
        face = case.y - draw.between(0.03, 0.07)
        low, high = (-case.inner - LAP_M, rear, case.low + LAP_M), (case.inner + LAP_M, face, floor)
        yield Part("inner chest", box(low, high), look)
        ends = [(-case.inner + 0.006, case.floor + 0.004), (case.inner - 0.006, floor - 0.004)]
        yield from _fronts(draw, ends, face, draw.integer(1, 3), look)
    thick, front = draw.between(0.015, 0.022), case.y - draw.between(0.01, 0.06)
    rooms = max(2, round((case.ceiling - floor) / draw.between(0.24, 0.4)))
    for z in np.linspace(floor, case.ceiling, rooms + 1)[1:-1].tolist():
        z += draw.between(-0.03, 0.03)
        low, high = (-case.inner - LAP_M, rear, z), (case.inner + LAP_M, front, z + thick)
        yield Part("shelf", box(low, high), look)
    if divided:
        low, high = (-0.009, rear, floor - LAP_M), (0.009, front - 0.01, case.ceiling + LAP_M)
        yield Part("divider", box(low, high), look)


def _doors(draw: Draw, case: _Case, angles_deg: list[float], look: Look) -> Parts:
    """One or two doors, opened by these angles, plain or framed, with a knob or a bar."""
    thick, framed, bar = draw.between(0.018, 0.024), draw.chance(0.4), draw.chance(0.5)
    metal, first, count = draw.pick(looks.METALS), draw.choose(SIDES), len(angles_deg)
    for side, angle_deg in zip((first, -first), angles_deg, strict=False):
        wide = 2 * case.x / count - thick / 2 - 0.004
        door = _Door(side, wide, case.low + 0.003, case.top - 0.003, thick, float(np.radians(angle_deg)))
        yield Part("door", door.hung(door.leaf(), case), look)
        half = thick / 2
        if framed:
            edge, low, top = 0.06, door.low, door.top
            whole = box((0.012, half - LAP_M, low), (wide, half + 0.012, top))
            field = box((0.012 + edge, 0.0, low + edge), (wide - edge, 1.0, top - edge))
            yield Part("frame", door.hung(whole - field, case), look)
        z = (door.low + door.top) / 2 + draw.between(-0.15, 0.15) * (door.top - door.low)
        handle = rod((wide - 0.035, 0.0, z), (wide - 0.035, half + 0.042, z), 0.014)
        if bar:
            handle = box((wide - 0.045, 0.0, z - 0.07), (wide - 0.025, half + 0.036, z + 0.07))
        yield Part("handle", door.hung(handle, case), metal)


def fridge(draw: Draw) -> Parts:
    """Draw a refrigerator whose door stands open; its walls are 40 to 60 mm thick, nothing is below 15 mm."""
    look, lining = draw.pick(palettes.ENAMELS), draw.pick(palettes.ENAMELS[:2])
    low, wall = draw.between(0.02, 0.06), draw.between(0.04, 0.06)
    case = _Case(
        x=draw.between(0.27, 0.36),
        y=draw.between(0.25, 0.31),
        low=low,
        top=draw.between(1.2, 1.9),
        wall=wall,
        back=wall + draw.between(0.0, 0.02),
    )
    soft, hinge, thick = (
        draw.choose([0.0, draw.between(0.01, 0.035)]),
        draw.choose(SIDES),
        draw.between(0.045, 0.07),
    )
    freezer = draw.choose(["none", "above", "below"]) if case.top > 1.35 else "none"
    cut = {
        "none": case.low,
        "above": case.top - draw.between(0.35, 0.5),
        "below": case.low + draw.between(0.4, 0.6),
    }[freezer]
    rooms = [replace(case, low=a, top=b) for a, b in pairwise(sorted({case.low, cut, case.top}))]
    cold = {"none": 0, "above": 1, "below": 0}[freezer]
    opened = [freezer == "none" or at != cold or draw.chance(0.25) for at in range(len(rooms))]
    if soft:
        shell = cushion((-case.x, -case.y, case.low), (case.x, case.y + soft, case.top), soft)
        shell = shell.trim_by_plane((0.0, -1.0, 0.0), -case.y)
    else:
        shell = box((-case.x, -case.y, case.low), (case.x, case.y, case.top))
    for room, is_open in zip(rooms, opened, strict=True):
        # Behind a shut door nobody looks: there it is solid.
        shell = shell - room.room() if is_open else shell
    yield Part("case", shell, look)
    for s, y in ((s, y) for s in SIDES for y in (-case.y + 0.06, case.y - 0.06)):
        yield Part(
            "foot",
            rod((s * (case.x - 0.06), y, 0.0), (s * (case.x - 0.06), y, low + 0.02), 0.022),
            looks.METALS[3],
        )
    for room, is_open in zip(rooms, opened, strict=True):
        angle_rad = float(np.radians(draw.between(80, 120))) if is_open else 0.0
        door = _Door(hinge, 2 * case.x - thick / 2, room.low + 0.004, room.top - 0.004, thick, angle_rad)
        yield from _thick_door(draw, door, case, look)
        if is_open:
            yield from _cold_room(draw, room, lining)
            yield from _door_shelves(draw, door, case, lining)


def _thick_door(draw: Draw, door: _Door, case: _Case, look: Look) -> Parts:
    """A refrigerator's door with a handle that a hand fits behind, or with a ledge."""
    yield Part("door", door.hung(door.leaf(), case), look)
    metal, u, half = draw.pick(looks.METALS[:2]), door.wide - 0.05, door.thick / 2
    middle, reach = (door.low + door.top) / 2, draw.between(0.1, 0.16)
    if draw.chance(0.7):
        out, low, top = half + draw.between(0.045, 0.06), middle - reach, middle + reach
        path = rounded_path(
            [(u, half - 0.015, low), (u, out, low), (u, out, top), (u, half - 0.015, top)], 0.03
        )
        yield Part("handle", door.hung(tube(path, 0.011), case), metal)
    else:
        ledge = box((u - 0.012, 0.0, middle - reach), (u + 0.012, half + 0.03, middle + reach))
        yield Part("handle", door.hung(ledge, case), metal)


def _cold_room(draw: Draw, room: _Case, look: Look) -> Parts:
    """Shelves, perhaps drawers at the bottom and a step at the back of the floor."""
    floor, rear, wide = room.floor, -room.y + room.back - LAP_M, room.inner + LAP_M
    high = room.ceiling - floor
    if high > 0.6 and draw.chance(0.7):
        count, face, top = draw.integer(1, 3), room.y - draw.between(0.06, 0.1), draw.between(0.17, 0.24)
        floor += top
        for left, right in pairwise(np.linspace(-room.inner, room.inner, count + 1).tolist()):
            ends = (left + 0.008, rear, room.floor - LAP_M), (right - 0.008, face, floor - 0.012)
            yield Part("crisper", box(*ends), draw.pick(looks.PLASTICS[:1]))
    elif draw.chance(0.6):
        step = (draw.between(0.12, 0.2), draw.between(0.12, 0.2))
        ends = (-wide, rear, room.floor - LAP_M), (wide, rear + step[0], room.floor + step[1])
        yield Part("step", box(*ends), look)
    thick, front = draw.between(0.015, 0.02), room.y - draw.between(0.06, 0.13)
    rooms = max(1 + (high > 0.4), round((room.ceiling - floor) / draw.between(0.2, 0.32)))
    edges = np.linspace(floor, room.ceiling, rooms + 1)[1:-1].tolist()
    if floor > room.floor:
        edges = [floor - 0.016, *edges]
    for z in edges:
        yield Part("shelf", box((-wide, rear, z), (wide, front, z + thick)), look)


def _door_shelves(draw: Draw, door: _Door, case: _Case, look: Look) -> Parts:
    """Shallow trays, open at the top, on the inner face of a door."""
    deep, thick, half = draw.between(0.09, 0.13), draw.between(0.015, 0.018), door.thick / 2
    left, right = 0.08, door.wide - 0.06
    count = max(1, round((door.top - door.low - 0.15) / draw.between(0.28, 0.42)))
    for z in np.linspace(door.low + 0.07, door.top - 0.05, count + 1)[:-1].tolist():
        lip = draw.between(0.06, 0.1)
        tray = box((left, -half - deep, z), (right, -half + LAP_M, z + lip))
        inside = box((left + thick, -half - deep + thick, z + thick), (right - thick, -half + LAP_M, z + 1.0))
        yield Part("door shelf", door.hung(tray - inside, case), look)

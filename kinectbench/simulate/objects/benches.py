"""Benches: park benches, planks on legs or panels, settles with a back, padded, steel and stone ones."""

from dataclasses import dataclass

import numpy as np

from kinectbench.simulate.objects import backs, bases
from kinectbench.simulate.objects.backs import Back
from kinectbench.simulate.objects.joinery import (
    CLOTHS,
    IRONS,
    LEATHERS,
    METALS,
    STONES,
    WOODS,
    Look,
    Part,
    between,
    chance,
    choose,
    pick,
)
from kinectbench.simulate.objects.shapes import (
    Points,
    bent,
    box,
    cushion,
    leg,
    plate,
    rectangle,
    ribbon,
    rounded_path,
)

SIDES = (-1, 1)
BACKS = ("ladder", "slats", "spindles", "cross", "panel")


@dataclass(frozen=True)
class _Size:
    """Half length along x, half depth along y, and the seat's upper face; metres."""

    x: float
    y: float
    seat: float


def bench(rng: np.random.Generator) -> list[Part]:
    """Draw a bench whose front faces +y."""
    size = _Size(x=between(rng, 0.47, 0.88), y=between(rng, 0.17, 0.22), seat=between(rng, 0.41, 0.47))
    kinds = [_park, _park, _park, _plank, _plank, _settle, _settle, _padded, _slatted, _stone, _box]
    return choose(rng, kinds)(rng, size)


def _park(rng: np.random.Generator, size: _Size) -> list[Part]:
    """A slatted seat and back on two or three cast frames, perhaps with armrests."""
    iron, wood = pick(rng, IRONS), pick(rng, WOODS)
    slat, lean, top = between(rng, 0.02, 0.035), between(rng, 0.1, 0.2), size.seat + between(rng, 0.33, 0.45)
    thick, y = between(rng, 0.028, 0.04), size.y
    rest = size.seat - slat - thick / 2 + 0.006
    spread, arms = between(rng, 0.0, 0.06), chance(rng, 0.7)
    frame = [(y + spread, thick / 2), (y + 0.005, rest), (-y, rest), (-y - lean, top - 0.02)]
    paths = [rounded_path(frame, 0.05), rounded_path([(-y + 0.02, rest), (-y - 0.1, thick / 2)], 0.05)]
    slope = lean / (top - 0.02 - rest)
    if arms:
        z = size.seat + between(rng, 0.18, 0.24)
        arm = [(y - 0.02, rest), (y + 0.02, z), (-y - slope * (z - rest) - 0.01, z + 0.01)]
        paths.append(rounded_path(arm, between(rng, 0.05, 0.12)))
    count = 3 if size.x > 0.75 and chance(rng, 0.7) else 2
    parts = []
    for x in np.linspace(-size.x + 0.12, size.x - 0.12, count).tolist():
        for path in paths:
            strip = ribbon(path, (x - 0.022, x + 0.022), thick)
            parts.append(Part("frame", strip, iron))
    ahead = thick / 2 + slat / 2 - 0.006
    return (
        parts + _slats(rng, size, slat, wood) + _back_slats(rng, size, slat, (slope, rest, top, ahead), wood)
    )


def _slats(rng: np.random.Generator, size: _Size, thick: float, look: Look) -> list[Part]:
    """The seat's boards, from left to right."""
    count = int(rng.integers(3, 8))
    edges = np.linspace(-size.y + 0.015, size.y + 0.015, count + 1)
    wide = float(edges[1] - edges[0])
    gap = min(max(0.012, 0.15 * wide), wide - 0.03)
    return [
        Part(
            "slat",
            box((-size.x, at + gap / 2, size.seat - thick), (size.x, at + wide - gap / 2, size.seat)),
            look,
        )
        for at in edges[:-1].tolist()
    ]


def _back_slats(
    rng: np.random.Generator, size: _Size, thick: float, back: tuple[float, float, float, float], look: Look
) -> list[Part]:
    """The back's boards, in front of the leaning frame: slope, the height it begins at, top, distance."""
    slope, rest, top, ahead = back
    count, low = int(rng.integers(2, 6)), size.seat + between(rng, 0.07, 0.14)
    step = (top - low) / count
    high = max(0.03, step - between(rng, 0.012, 0.04))
    tilt = float(np.degrees(np.arctan(slope)))
    parts = []
    for k in range(count):
        z = low + (k + 0.5) * step
        board = box((-size.x, -thick / 2, -high / 2), (size.x, thick / 2, high / 2)).rotate((tilt, 0.0, 0.0))
        y = -size.y - slope * (z - rest) + ahead
        parts.append(Part("back slat", board.translate((0.0, y, z)), look))
    return parts


def _base(rng: np.random.Generator, size: _Size, head: float, wood: Look) -> list[Part]:
    """Legs, panels, crosses or trestles under a wooden seat."""
    half = (size.x - between(rng, 0.05, 0.16), size.y - 0.04)
    kind = choose(rng, ["legs", "legs", "panels", "crossed", "trestle"])
    if kind == "legs":
        count = 6 if size.x > 0.65 and chance(rng, 0.6) else 4
        parts = bases.wooden_legs(rng, half, head, between(rng, 0.038, 0.06), wood, count)
        return parts + (bases.apron(half, head - 0.004, 0.06, wood) if chance(rng, 0.5) else [])
    if kind == "panels":
        parts = bases.panels((half[0], size.y - 0.015), head, between(rng, 0.03, 0.06), wood)
        z = head * between(rng, 0.3, 0.75)
        beam = box((-half[0], -0.014, z - 0.05), (half[0], 0.014, z + 0.05))
        return [*parts, Part("stretcher", beam, wood)]
    if kind == "crossed":
        return bases.crossed_legs((half[0] - 0.05, size.y - 0.02), head, 0.045, wood)
    return bases.trestle(rng, (half[0] - 0.05, size.y - 0.01), head, wood)


def _plank(rng: np.random.Generator, size: _Size) -> list[Part]:
    """A backless bench: one board, straight or bent to an arc, or two boards side by side."""
    wood, thick = pick(rng, WOODS), between(rng, 0.025, 0.05)
    under, kind = size.seat - thick, choose(rng, ["one", "one", "two", "rounded", "curved"])
    full = (2 * size.x, 2 * size.y)
    if kind == "two":
        boards = [box((-size.x, s * size.y, under), (size.x, s * 0.008, size.seat)) for s in (-1,)]
        boards.append(box((-size.x, 0.008, under), (size.x, size.y, size.seat)))
        parts = [Part("seat", board, wood) for board in boards]
    elif kind == "rounded":
        parts = [Part("seat", plate(rectangle(full, 0.9 * size.y), under, size.seat, 0.3 * thick), wood)]
    elif kind == "curved":
        return _curved(rng, size, thick, wood)
    else:
        parts = [Part("seat", plate(rectangle(full), under, size.seat, 0.004), wood)]
    if kind == "two":
        battens = [
            box((x - 0.03, -size.y + 0.03, under - 0.02), (x + 0.03, size.y - 0.03, under + 0.008))
            for x in (-0.6 * size.x, 0.0, 0.6 * size.x)
        ]
        parts += [Part("batten", batten, wood) for batten in battens]
    return parts + _base(rng, size, under + 0.012, wood)


def _curved(rng: np.random.Generator, size: _Size, thick: float, wood: Look) -> list[Part]:
    """A seat bent to an arc in plan, on three pairs of legs."""
    bow, under = between(rng, 0.08, 0.2), size.seat - thick

    def arc(points: Points) -> Points:
        back = bow * (points[:, 0] / size.x) ** 2
        return points + np.column_stack([np.zeros(len(points)), back, np.zeros(len(points))])

    parts = [Part("seat", bent(box((-size.x, -size.y, under), (size.x, size.y, size.seat)), arc), wood)]
    for x in (-0.8 * size.x, 0.0, 0.8 * size.x):
        y = bow * (x / size.x) ** 2
        for s in SIDES:
            at = y + s * (size.y - 0.04)
            post = leg((x, at, 0.0), (x, at, under + 0.01), (0.035, 0.035), (0.05, 0.05))
            parts.append(Part("leg", post, wood))
    return parts


def _settle(rng: np.random.Generator, size: _Size) -> list[Part]:
    """A wooden bench with a back between posts, and perhaps armrests."""
    wood, thick, post = pick(rng, WOODS), between(rng, 0.022, 0.035), between(rng, 0.038, 0.05)
    under, x, y = size.seat - thick, size.x - post / 2, size.y - post / 2
    parts = [Part("seat", box((-size.x, -size.y, under), (size.x, size.y, size.seat)), wood)]
    columns = [-x, 0.0, x] if size.x > 0.6 else [-x, x]
    for at in columns:
        for row in (-y, y):
            shape = leg((at, row, 0.0), (at, row, size.seat - 0.004), (post, post), (post, post))
            parts.append(Part("leg", shape, wood))
    slope, top = between(rng, 0.05, 0.2), size.seat + between(rng, 0.35, 0.5)
    back = Back(x, -y, size.seat, top, slope, 0.0, post, wood)
    parts += back.posts() + backs.filling(rng, back, BACKS)
    if len(columns) == 3:
        parts.append(back.upright("post", 0.0, size.seat - 0.012, top - 0.004, post, 0.03))
    parts += bases.apron((x, y), under + 0.005, between(rng, 0.05, 0.08), wood)
    if chance(rng, 0.7):
        z = size.seat + between(rng, 0.18, 0.24)
        for s in SIDES:
            rear = back.point(x, z)[1]
            arm = plate(rectangle((0.07, y + 0.03 - rear), 0.02), z - 0.024, z, 0.006)
            arm = arm.translate((s * x, (y + 0.03 + rear) / 2, 0.0))
            front = leg(
                (s * x, y, size.seat - 0.015), (s * x, y, z - 0.01), (post, post), (post * 0.8, post * 0.8)
            )
            parts += [Part("armrest", arm, wood), Part("arm post", front, wood)]
    return parts


def _padded(rng: np.random.Generator, size: _Size) -> list[Part]:
    """A padded bench on wooden legs, sleds or loops, perhaps with raised ends."""
    look, wood, y = pick(rng, CLOTHS + LEATHERS), pick(rng, WOODS), size.y + 0.02
    thick = between(rng, 0.08, 0.14)
    under = size.seat - thick
    parts = [Part("seat", cushion((-size.x, -y, under), (size.x, y, size.seat), 0.03, 0.015), look)]
    half, head = (size.x - 0.06, y - 0.05), under + 0.025
    kind = choose(rng, ["legs", "loops", "sled"])
    if kind == "legs":
        parts += bases.wooden_legs(rng, half, head, between(rng, 0.035, 0.05), wood)
    elif kind == "loops":
        parts += bases.square_loops(
            (0.75 * size.x, half[1]), head, between(rng, 0.022, 0.035), pick(rng, METALS)
        )
    else:
        parts += bases.sled((0.75 * size.x, half[1]), head, between(rng, 0.01, 0.013), pick(rng, METALS))
    if chance(rng, 0.3):
        rise = size.seat + between(rng, 0.1, 0.2)
        for s in SIDES:
            low, high = sorted([s * (size.x - 0.02), s * (size.x + 0.06)])
            parts.append(Part("end", cushion((low, -y, under + 0.01), (high, y, rise), 0.03), look))
    return parts


def _slatted(rng: np.random.Generator, size: _Size) -> list[Part]:
    """A backless slatted seat on steel loops."""
    wood, steel, thick = pick(rng, WOODS), pick(rng, METALS), between(rng, 0.022, 0.035)
    parts = _slats(rng, size, thick, wood)
    x, bar = size.x * between(rng, 0.7, 0.9), between(rng, 0.03, 0.05)
    parts += bases.square_loops((x, size.y + 0.012), size.seat - thick + 0.006, bar, steel)
    beam = box((-x, -0.02, size.seat - thick - 0.03), (x, 0.02, size.seat - thick - 0.002))
    return [*parts, Part("beam", beam, steel)]


def _stone(rng: np.random.Generator, size: _Size) -> list[Part]:
    """A thick slab on two or three blocks."""
    stone, thick = pick(rng, STONES), between(rng, 0.07, 0.12)
    look = stone if chance(rng, 0.5) else pick(rng, WOODS)
    under, y = size.seat - thick, size.y + 0.02
    slab = plate(rectangle((2 * size.x, 2 * y), 0.03), under, size.seat, 0.01)
    parts = [Part("slab", slab, look)]
    wide, x, slim = between(rng, 0.06, 0.13), size.x - between(rng, 0.15, 0.25), between(rng, 0.6, 1.0)
    for at in (-x, 0.0, x) if size.x > 0.7 and chance(rng, 0.5) else (-x, x):
        shape = leg((at, 0.0, 0.0), (at, 0.0, under + 0.02), (2 * wide, 1.8 * y), (2 * wide * slim, 1.6 * y))
        parts.append(Part("block", shape, stone))
    return parts


def _box(rng: np.random.Generator, size: _Size) -> list[Part]:
    """A hall bench: an open shelf or a closed chest under the seat, a cushion, perhaps a back."""
    wood, thick, y = pick(rng, WOODS), between(rng, 0.02, 0.03), size.y + 0.01
    under = size.seat - thick
    parts = [Part("seat", box((-size.x, -y, under), (size.x, y, size.seat)), wood)]
    half = (size.x - 0.03, y - 0.012)
    parts += bases.panels(half, under + 0.01, 0.024, wood)
    if chance(rng, 0.5):
        bays = int(rng.integers(1, 4))
        for x in np.linspace(-half[0], half[0], bays + 1)[1:-1].tolist():
            parts.append(
                Part("partition", box((x - 0.01, -half[1], 0.07), (x + 0.01, half[1], under + 0.01)), wood)
            )
        for z in (0.07, between(rng, 0.2, 0.25)):
            parts.append(Part("shelf", box((-half[0], -half[1], z), (half[0], half[1], z + 0.018)), wood))
    else:
        chest = box((-half[0], -half[1] + 0.004, 0.06), (half[0], half[1] - 0.004, under + 0.01))
        parts.append(Part("chest", chest, wood if chance(rng, 0.5) else pick(rng, WOODS)))
    if chance(rng, 0.6):
        pad = cushion(
            (-size.x + 0.01, -y + 0.01, size.seat - 0.006), (size.x - 0.01, y, size.seat + 0.045), 0.02
        )
        parts.append(Part("cushion", pad, pick(rng, CLOTHS)))
    if chance(rng, 0.35):
        back = box((-size.x, -y, size.seat - 0.01), (size.x, -y + 0.024, size.seat + between(rng, 0.35, 0.5)))
        parts.append(Part("back", back, wood))
    return parts

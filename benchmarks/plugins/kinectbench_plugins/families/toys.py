"""Toy cars: saloons, vans, pick-ups, lorries and racing cars on four or six wheels."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kinectbench.lab.simulate.objects import looks
from kinectbench.lab.simulate.objects.joinery import SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import Vector2, box, cushion, rod
from kinectbench_plugins import palettes

if TYPE_CHECKING:
    from manifold3d import Manifold

# Walls of what is hollow are this thick; own choice.
WALL_M = 0.0125


@dataclass(frozen=True)
class _Car:
    """A toy car's measures, metres, frame `object`; it drives to +y.

    Attributes:
        x: half its width.
        y: half its length.
        wheel: radius of its wheels.
        low: height of its underside.
        deck: height of its bonnet.
        roof: height of its roof.
    """

    x: float
    y: float
    wheel: float
    low: float
    deck: float
    roof: float


def toy_car(draw: Draw) -> Parts:
    """Draw a toy car that drives to +y; nothing is thinner than 12 mm."""
    y = draw.between(0.13, 0.23)
    wheel = y * draw.between(0.2, 0.28)
    deck = wheel * draw.between(2.05, 2.5)
    car = _Car(
        x=y * draw.between(0.38, 0.5),
        y=y,
        wheel=wheel,
        low=wheel * draw.between(0.55, 0.75),
        deck=deck,
        roof=deck + y * draw.between(0.3, 0.45),
    )
    look = draw.pick(looks.PLASTICS[:5] + looks.WOODS[:4] + looks.CLOTHS[:4])
    kind = draw.choose([_saloon, _saloon, _van, _pick_up, _lorry, _racer])
    parts = [*kind(draw, car, look), *(_bumpers(draw, car) if kind is not _racer else ())]
    axles = [-0.6 * y, 0.6 * y] if kind is not _lorry else [-0.68 * y, -0.68 * y + 2.15 * wheel, 0.62 * y]
    if kind is _lorry and axles[1] > 0.1 * y:
        del axles[1]
    yield from parts
    yield from _wheels(draw, car, axles)


def _wheels(draw: Draw, car: _Car, axles: list[float]) -> Parts:
    """Two wheels on each axle, with a hub cap; they stand out of the body."""
    wide, tyre = draw.between(0.018, 0.028), draw.choose([looks.PLASTICS[5], looks.WOODS[2], looks.METALS[3]])
    hub, track = draw.pick(looks.METALS[:2] + looks.PLASTICS[:3]), car.x + draw.between(0.004, 0.012)
    for y in axles:
        yield Part("axle", rod((-car.x, y, car.wheel), (car.x, y, car.wheel), 0.0075), looks.METALS[3])
        for s in SIDES:
            inner, outer = s * (track - wide), s * track
            yield Part("wheel", rod((inner, y, car.wheel), (outer, y, car.wheel), car.wheel), tyre)
            cap = rod(
                (s * (track - 0.01), y, car.wheel), (s * (track + 0.004), y, car.wheel), 0.5 * car.wheel
            )
            yield Part("hub", cap, hub)


def _bumpers(draw: Draw, car: _Car) -> Parts:
    """Bars at both ends, and two lamps at the front."""
    if draw.chance(0.7):
        metal, high = draw.pick(looks.METALS), car.low + 0.018
        for s in SIDES:
            low, end = sorted([s * (car.y - 0.012), s * (car.y + 0.006)])
            ends = (-0.9 * car.x, low, car.low + 0.002), (0.9 * car.x, end, high)
            yield Part("bumper", box(*ends), metal)
    if draw.chance(0.7):
        z, radius = 0.4 * car.low + 0.6 * car.deck, draw.between(0.008, 0.012)
        for s in SIDES:
            at = s * 0.62 * car.x
            yield Part("lamp", rod((at, car.y - 0.03, z), (at, car.y + 0.004, z), radius), looks.PLASTICS[2])


def _block(low: tuple[float, float, float], high: tuple[float, float, float], soft: float) -> "Manifold":
    return cushion(low, high, soft) if soft > 0.002 else box(low, high)


def _cabin(y_m: Vector2, roof_m: Vector2, half_x: Vector2, z_m: Vector2) -> "Manifold":
    """A cabin between its foot and its roof, each a range in y and half a width in x."""
    from manifold3d import Manifold

    (z0, z1), (wide, narrow) = z_m, half_x
    foot = [(s * wide, y, z0) for s in SIDES for y in y_m]
    roof = [(s * narrow, y, z1) for s in SIDES for y in roof_m]
    return Manifold.hull_points([*foot, *roof])


def _glazed(cabin: "Manifold", z_m: Vector2, posts_y: list[float], look: Look) -> Parts:
    """A cabin with a dark band of windows that stands out by a millimetre, and posts between them."""
    yield Part("cabin", cabin, look)
    x0, y0, _, x1, y1, _ = cabin.bounding_box()
    grown = cabin.translate((0.0, -(y0 + y1) / 2, 0.0)).scale((1 + 0.002 / x1, 1 + 0.004 / (y1 - y0), 1.0))
    band = grown.translate((0.0, (y0 + y1) / 2, 0.0)) ^ box(
        (x0 - 1, y0 - 1, z_m[0]), (x1 + 1, y1 + 1, z_m[1])
    )
    for at in posts_y:
        band = band - box((x0 - 1, at - 0.007, 0.0), (x1 + 1, at + 0.007, 1.0))
    for window in band.decompose():
        yield Part("window", window, looks.METALS[3])


def _saloon(draw: Draw, car: _Car, look: Look) -> Parts:
    """A body with bonnet and boot, or a bonnet only, and a cabin with windows."""
    soft = draw.choose([0.0, draw.between(0.006, 0.012)])
    yield Part("body", _block((-car.x, -car.y, car.low), (car.x, car.y, car.deck), soft), look)
    rear = draw.choose([-0.92, draw.between(-0.7, -0.5)]) * car.y
    front = draw.between(0.2, 0.4) * car.y
    roof = (rear + draw.between(0.06, 0.25) * car.y, front - draw.between(0.2, 0.35) * car.y)
    narrow = draw.between(0.7, 0.88) * car.x
    cabin = _cabin((rear, front), roof, (0.95 * car.x, narrow), (car.deck - 0.006, car.roof))
    high = car.roof - car.deck
    band = (car.deck + 0.18 * high, car.roof - 0.2 * high)
    yield from _glazed(cabin, band, [sum(roof) / 2], draw.choose([look, draw.pick(looks.PLASTICS[:5])]))
    if draw.chance(0.35):
        rack = car.roof + 0.012
        bars = np.linspace(roof[0] + 0.01, roof[1] - 0.01, 3).tolist()
        for y in bars:
            yield Part(
                "rack",
                box((-narrow, y - 0.007, car.roof - 0.006), (narrow, y + 0.007, rack)),
                looks.METALS[0],
            )
        load = box(
            (-0.6 * narrow, bars[0], rack - 0.006), (0.6 * narrow, bars[-1], rack + draw.between(0.02, 0.05))
        )
        yield Part("luggage", load, draw.pick(looks.LEATHERS[:2] + palettes.CARDS))


def _van(draw: Draw, car: _Car, look: Look) -> Parts:
    """One high body with a short nose, and windows; a bus has many."""
    roof, soft = car.roof + draw.between(0.0, 0.03), draw.between(0.004, 0.012)
    yield Part("body", _block((-car.x, -car.y, car.low), (car.x, car.y, car.deck), soft), look)
    nose = draw.between(0.6, 0.95) * car.y
    cabin = _cabin(
        (-car.y + 0.004, nose),
        (-0.96 * car.y, nose - draw.between(0.05, 0.25) * car.y),
        (0.97 * car.x, 0.9 * car.x),
        (car.deck - 0.008, roof),
    )
    count, high = draw.choose([2, 3, 5]), roof - car.deck
    posts = np.linspace(-0.75 * car.y, 0.6 * nose, count).tolist()
    yield from _glazed(cabin, (car.deck + 0.25 * high, roof - 0.22 * high), posts, look)


def _tray(x: float, y_m: Vector2, low: float, top: float, floor: float) -> "Manifold":
    """An open box whose floor is so thick."""
    outer = box((-x, y_m[0], low), (x, y_m[1], top))
    inner = (-x + WALL_M, y_m[0] + WALL_M, low + floor), (x - WALL_M, y_m[1] - WALL_M, top + 0.1)
    return outer - box(*inner)


def _pick_up(draw: Draw, car: _Car, look: Look) -> Parts:
    """A cabin in the middle, a bonnet before it, and an open bed behind it."""
    split = draw.between(-0.15, 0.05) * car.y
    body = box((-car.x, split - 0.004, car.low), (car.x, car.y, car.deck))
    yield Part("body", body, look)
    # Its floor covers the axle.
    top, floor = car.deck + draw.between(0.0, 0.02), car.wheel + 0.012 - car.low
    bed = _tray(car.x - 0.001, (-car.y, split), car.low + 0.002, top, floor)
    yield Part("bed", bed, look if draw.chance(0.5) else draw.pick(looks.PLASTICS[:5] + looks.WOODS[:3]))
    front = split + draw.between(0.55, 0.7) * car.y
    cabin = _cabin(
        (split + 0.002, front),
        (split + 0.012, front - 0.25 * car.y),
        (0.95 * car.x, 0.85 * car.x),
        (car.deck - 0.006, car.roof),
    )
    high = car.roof - car.deck
    yield from _glazed(cabin, (car.deck + 0.2 * high, car.roof - 0.2 * high), [], look)


def _lorry(draw: Draw, car: _Car, look: Look) -> Parts:
    """A cab at the front, and behind it a tipper, perhaps raised, a tank, a box or logs."""
    split, chassis = 0.25 * car.y, car.low + 0.022
    dark = draw.pick(looks.METALS)
    yield Part(
        "chassis", box((-0.75 * car.x, -car.y, car.low), (0.75 * car.x, car.y - 0.002, chassis + 0.006)), dark
    )
    cab = _cabin(
        (split + 0.008, car.y),
        (split + 0.008, car.y - draw.between(0.004, 0.05)),
        (car.x, 0.93 * car.x),
        (car.low + 0.004, car.roof),
    )
    high = car.roof - car.deck
    yield from _glazed(cab, (car.deck + 0.1 * high, car.roof - 0.25 * high), [], look)
    kind, other = (
        draw.choose(["tipper", "tipper", "tank", "box", "logs"]),
        draw.pick(looks.PLASTICS[:5] + looks.METALS[:2]),
    )
    end, x = -car.y - 0.008, car.x - 0.002
    if kind == "tipper":
        # Its floor lies above the wheels.
        floor = max(WALL_M, 2 * car.wheel - chassis + 0.004)
        tray = _tray(x, (end, split - 0.012), chassis, car.deck + draw.between(0.02, 0.05), floor)
        angle = draw.choose([0.0, draw.between(12, 35)])
        # It turns about its lower rear edge and rests on a block.
        tray = tray.translate((0.0, 0.01 + car.y, -chassis)).rotate((angle, 0.0, 0.0))
        yield Part("tipper", tray.translate((0.0, -car.y - 0.01, chassis + 0.002)), other)
        lift = 0.5 * (split + car.y) * float(np.tan(np.radians(angle)))
        middle = -car.y + 0.5 * (split + car.y)
        yield Part(
            "lift",
            box((-0.02, middle - 0.02, chassis - 0.004), (0.02, middle + 0.012, chassis + lift + 0.004)),
            dark,
        )
    elif kind == "tank":
        radius = 0.92 * x
        tank = rod(
            (0.0, end, chassis + radius - 0.012), (0.0, split - 0.012, chassis + radius - 0.012), radius
        )
        yield Part("tank", tank, other)
    elif kind == "box":
        yield Part(
            "box", _block((-x, end, chassis - 0.002), (x, split - 0.012, car.roof + 0.02), 0.004), other
        )
    else:
        radius = x / 3
        for row, count in enumerate((3, 2, 1)[: draw.integer(2, 4)]):
            for k in range(count):
                at = (2 * k + 1 - count) * radius * 0.97
                z = chassis + radius * (0.9 + 1.68 * row)
                long = draw.between(-0.012, 0.012)
                yield Part(
                    "log",
                    rod((at, end + long, z), (at, split - 0.016 + 0.3 * long, z), radius),
                    draw.pick(looks.WOODS[:3]),
                )


def _racer(draw: Draw, car: _Car, look: Look) -> Parts:
    """A long rounded body with a seat for the driver, perhaps a driver, and a wing behind."""
    from manifold3d import Manifold

    half, z = 0.72 * car.x, (car.low + car.deck) / 2
    rise = (car.deck - car.low) / 2
    balls = [
        Manifold.sphere(1.0, 32)
        .scale((half * w, rise * w, rise * w))
        .translate((0.0, y * car.y, z - rise * (1 - w)))
        for y, w in ((-0.88, 0.8), (-0.2, 1.0), (0.3, 0.95), (0.9, 0.6))
    ]
    body = Manifold.batch_hull(balls)
    seat = cushion(
        (-0.62 * half, -0.32 * car.y, z - 0.1 * rise), (0.62 * half, 0.12 * car.y, car.deck + 0.1), 0.012
    )
    yield Part("body", body - seat, look)
    # Boards under the body reach out to the wheels.
    yield Part(
        "floor",
        box((-car.x + 0.004, -0.75 * car.y, car.low - 0.004), (car.x - 0.004, 0.72 * car.y, car.low + 0.012)),
        looks.METALS[3],
    )
    if draw.chance(0.6):
        head, seat_z = draw.between(0.02, 0.026), z - 0.1 * rise
        driver = rod((0.0, -0.14 * car.y, seat_z - 0.006), (0.0, -0.14 * car.y, car.deck + 0.006), 0.016)
        yield Part("driver", driver, draw.pick(looks.CLOTHS))
        ball = Manifold.sphere(head, 24).translate((0.0, -0.14 * car.y, car.deck + head))
        yield Part("driver", ball, draw.pick(looks.PLASTICS[:5]))
    if draw.chance(0.7):
        top = car.deck + draw.between(0.03, 0.06)
        for s in SIDES:
            at = s * 0.45 * half
            post = box((at - 0.007, -0.9 * car.y, z), (at + 0.007, -0.9 * car.y + 0.02, top))
            yield Part("post", post, look)
        wing = box((-car.x, -0.95 * car.y, top - 0.006), (car.x, -0.95 * car.y + 0.05, top + 0.008))
        yield Part("wing", wing, draw.pick(looks.PLASTICS[:5]))

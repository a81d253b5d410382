"""Bases of furniture: legs, tube frames, columns, trestles and panels.

Every base stands on z = 0 and reaches up to `head_m`, which lies inside the seat or top that it carries.
`half_m` is the distance in x and y from the middle to the outermost legs' centres. Frame `object`, metres.
"""

from itertools import product

import numpy as np
from manifold3d import Manifold

from kinectbench.lab.simulate.objects import looks
from kinectbench.lab.simulate.objects.joinery import CORNERS, SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import (
    Vector2,
    box,
    leg,
    plate,
    rectangle,
    rod,
    rounded_path,
    tube,
    turned,
    union,
)

# (height, radius) of a turned leg, as shares of its height and of its largest radius.
TURNED_LEG = (
    (0.0, 0.55),
    (0.04, 0.75),
    (0.09, 0.5),
    (0.3, 0.62),
    (0.5, 0.85),
    (0.62, 1.0),
    (0.68, 0.6),
    (0.71, 0.9),
    (0.74, 0.9),
    (0.75, 0.7),
    (0.84, 0.7),
)


def wooden_legs(
    draw: Draw,
    half_m: Vector2,
    head_m: float,
    thick_m: float,
    look: Look,
    count: int = 4,
    *,
    upright: bool = False,
) -> Parts:
    """Make four or six wooden legs: straight, tapered, splayed or turned, perhaps with stretchers.

    Args:
        draw: draws the kind.
        half_m: x and y of the outermost legs' centres.
        head_m: top of the legs.
        thick_m: thickness at the top; a foot has at least 22 mm, the foot of a turned leg 19 mm.
        look: material of all parts.
        count: four, or six with a middle pair.
        upright: whether splayed legs are excluded, so that a shelf can be fixed to the legs.
    """
    kinds = ["straight", "tapered", "turned"]
    kind = draw.choose(kinds if upright else [*kinds, "splayed", "splayed round"])
    splay = draw.between(0.02, 0.06) if kind.startswith("splayed") else 0.0
    share = 1.0 if kind == "straight" else draw.between(0.5, 0.8)
    foot = max(0.022, thick_m * share)
    for sx, sy in product((-1, 1) if count == 4 else (-1, 0, 1), SIDES):
        x, y = sx * half_m[0], sy * half_m[1]
        if kind == "turned" and thick_m >= 0.035:
            shape = turned_leg((x, y), head_m, thick_m)
        else:
            shape = leg(
                (x + sx * splay, y + sy * splay, 0.0),
                (x, y, head_m),
                foot,
                thick_m,
                is_round=kind == "splayed round",
            )
        yield Part("leg", shape, look)
    if draw.chance(0.4):
        z = head_m * draw.between(0.2, 0.45)
        out = splay * (1 - z / head_m)
        yield from stretchers(draw, (half_m[0] + out, half_m[1] + out), z, look)


def turned_leg(at_m: Vector2, head_m: float, thick_m: float) -> Manifold:
    """Make a leg turned on a lathe at (x, y) `at_m`, `head_m` high, with a square block at its top."""
    rings = [(share * thick_m / 2, height * head_m) for height, share in TURNED_LEG]
    column = turned([(0.0, 0.0), *rings, (0.0, rings[-1][1])]).translate((*at_m, 0.0))
    block = leg((*at_m, 0.8 * head_m), (*at_m, head_m), thick_m, thick_m)
    return union([column, block])


def stretchers(draw: Draw, half_m: Vector2, height_m: float, look: Look, rake_m: float = 0.0) -> Parts:
    """Make horizontal bars between four legs, in the shape of an H or of a closed rectangle.

    `half_m` are x and y of a front leg's axis, which the others mirror; rear legs stand `rake_m` farther
    back.
    """
    x, y = half_m
    rear = -y - rake_m
    wide, high = 0.018, draw.between(0.022, 0.035)
    low, top = height_m - high / 2, height_m + high / 2
    for s in SIDES:
        yield Part("stretcher", box((s * x - wide / 2, rear, low), (s * x + wide / 2, y, top)), look)
    if draw.chance(0.5):
        yield Part("stretcher", box((-x, -wide / 2, low), (x, wide / 2, top)), look)
        return
    lift = draw.between(-0.04, 0.04)
    for at in (rear, y):
        yield Part("stretcher", box((-x, at - wide / 2, low + lift), (x, at + wide / 2, top + lift)), look)


def apron(half_m: Vector2, head_m: float, high_m: float, look: Look) -> Parts:
    """Make four boards between legs at (+-x, +-y) of `half_m`, `high_m` high, whose top is at `head_m`."""
    return ring("apron", half_m, (head_m - high_m, head_m), 0.01, look)


def ring(name: str, half_m: Vector2, z_m: Vector2, thick_m: float, look: Look) -> Parts:
    """Make four boards between legs at (+-x, +-y) of `half_m`, from the lower to the upper height of `z_m`.

    They extend `thick_m` to both sides of the line between two legs.
    """
    (x, y), (low, high) = half_m, z_m
    for s in SIDES:
        yield Part(name, box((-x, s * y - thick_m, low), (x, s * y + thick_m, high)), look)
    for s in SIDES:
        yield Part(name, box((s * x - thick_m, -y, low), (s * x + thick_m, y, high)), look)


def round_legs(
    count: int, reach_m: float, inner_m: float, head_m: float, thick_m: float, look: Look
) -> Parts:
    """Make three or more round legs in a circle, of radius `reach_m` at the floor and `inner_m` at the top.

    The first leg points to the front. `thick_m` is the diameter at the top, at the height `head_m`.
    """
    foot = max(0.02, 0.65 * thick_m)
    for turn in np.arange(count) * 2 * np.pi / count + np.pi / 2:
        x, y = float(np.cos(turn)), float(np.sin(turn))
        shape = leg(
            (reach_m * x, reach_m * y, 0.0), (inner_m * x, inner_m * y, head_m), foot, thick_m, is_round=True
        )
        yield Part("leg", shape, look)


def tube_legs(half_m: Vector2, head_m: float, radius_m: float, splay_m: float, look: Look) -> Parts:
    """Make two bent tubes, each of two splayed legs and a bar between, and two bars that join the tubes.

    `half_m` is x and y of the upper ends, `head_m` their height; the feet are `splay_m` farther out along
    both axes.
    """
    x, y, z = *half_m, head_m - radius_m
    for s in SIDES:
        # The legs continue below the floor, where they are cut off level.
        out = splay_m * (1 + 0.02 / z)
        feet = [(s * (x + out), way * (y + out), -0.02) for way in SIDES]
        path = [feet[0], (s * x, -y, z), (s * x, y, z), feet[1]]
        yield Part("leg", tube(rounded_path(path, 0.05), radius_m).trim_by_plane((0.0, 0.0, 1.0), 0.0), look)
        yield Part("rail", rod((-x, s * y * 0.6, z), (x, s * y * 0.6, z), radius_m), look)


def sled(half_m: Vector2, head_m: float, radius_m: float, look: Look) -> Parts:
    """Make two tube loops that lie on the floor from front to back, and two bars between them.

    `half_m` is x of the right loop, and half a loop's length along y. `head_m` is the height of the loops.
    """
    x, y, z = *half_m, head_m - radius_m
    for s in SIDES:
        corners = [(s * x, -0.8 * y, z), (s * x, -y, radius_m), (s * x, y, radius_m), (s * x, 0.8 * y, z)]
        # The loop starts and ends in the middle under the seat, so that it is closed.
        path = [(s * x, 0.0, z), *corners, (s * x, 0.0, z)]
        yield Part("runner", tube(rounded_path(path, 0.05), radius_m), look)
        yield Part("rail", rod((-x, s * y * 0.6, z), (x, s * y * 0.6, z), radius_m), look)


def square_loops(half_m: Vector2, head_m: float, thick_m: float, look: Look) -> Parts:
    """Make two closed frames of square tube at the left and right ends.

    `half_m` is x of the right frame, and half a frame's length along y. `head_m` is the height of the frames,
    `thick_m` the thickness of the tube.
    """
    x, y = half_m
    for s in SIDES:
        outer = box((s * x - thick_m / 2, -y, 0.0), (s * x + thick_m / 2, y, head_m))
        inner = box((s * x - thick_m, thick_m - y, thick_m), (s * x + thick_m, y - thick_m, head_m - thick_m))
        yield Part("frame", outer - inner, look)


def hairpins(half_m: Vector2, head_m: float, look: Look) -> Parts:
    """Make four legs at (+-x, +-y) of `half_m`, each of two thin steel bars that meet at the foot."""
    size = (0.017, 0.017)
    for sx, sy in CORNERS:
        x, y = sx * half_m[0], sy * half_m[1]
        heads = [(x - sx * 0.10, y, head_m), (x, y - sy * 0.10, head_m)]
        yield Part("leg", union([leg((x, y, 0.0), head, size, size, is_round=True) for head in heads]), look)


def column(draw: Draw, reach_m: float, head_m: float, thick_m: float, look: Look) -> Parts:
    """Make a column on a round plate or a trumpet-shaped foot of radius `reach_m`, or a drum."""
    radius, kind = thick_m / 2, draw.choose(["plate", "trumpet", "trumpet", "drum"])
    if kind == "drum":
        neck = reach_m * draw.between(0.55, 0.8)
        profile = [(0.0, 0.0), (reach_m * 0.9, 0.0), (neck, head_m), (0.0, head_m)]
        yield Part("drum", turned(profile), look)
    elif kind == "plate":
        edge = [(reach_m, 0.0), (reach_m, 0.016), (radius + 0.02, 0.03), (radius, 0.05)]
        flare = [(radius, head_m - 0.03), (radius * 1.8, head_m - 0.015), (radius * 1.8, head_m)]
        yield Part("column", turned([(0.0, 0.0), *edge, *flare, (0.0, head_m)]), look)
    else:
        share = np.linspace(0, 1, 16)
        widths = radius + (reach_m - radius) * (1 - share) ** 5 + (reach_m * 0.4) * share**6
        heights = 0.015 + share * (head_m - 0.015)
        rings = list(zip(widths.tolist(), heights.tolist(), strict=True))
        yield Part("column", turned([(0.0, 0.0), (reach_m, 0.0), *rings, (0.0, head_m)]), look)


def star(
    draw: Draw, count: int, reach_m: float, head_m: float, thick_m: float, look: Look, *, wheels: bool
) -> Parts:
    """Make a column on a star of feet, perhaps on castors; the first foot points to the back.

    Args:
        draw: draws the height of feet without castors.
        count: number of feet.
        reach_m: length of a foot from the column's axis.
        head_m: top of the column.
        thick_m: diameter of the column.
        look: material, except of castors.
        wheels: whether the feet stand on castors.
    """
    lift, high = (0.05, 0.035) if wheels else (0.0, draw.between(0.04, 0.07))
    top = lift + high
    yield Part("column", rod((0.0, 0.0, lift), (0.0, 0.0, head_m), thick_m / 2), look)
    for turn in -np.pi / 2 + np.arange(count) * 2 * np.pi / count:
        x, y = float(np.cos(turn)), float(np.sin(turn))
        end = reach_m - 0.02
        # A foot is a board on edge, thinner at its tip.
        root = box((0.0, -0.024, lift), (0.03, 0.024, top + 0.02))
        tip = box((end - 0.02, -0.016, lift), (reach_m, 0.016, lift + 0.026))
        yield Part("foot", Manifold.batch_hull([root, tip]).rotate((0.0, 0.0, float(np.degrees(turn)))), look)
        if wheels:
            side = 0.018
            ends = [(end * x - s * side * y, end * y + s * side * x, 0.028) for s in SIDES]
            yield Part("castor", rod(ends[0], ends[1], 0.028), looks.BLACK_STEEL)


def crossed_legs(half_m: Vector2, head_m: float, thick_m: float, look: Look) -> Parts:
    """Make an X of two legs at the left and right ends, and a bar that joins the crossings.

    `half_m` is x of the right X, and y of the ends of its legs. `head_m` is the height of the X.
    """
    x, y = half_m
    for s, way in CORNERS:
        # One leg is a little thinner, so that the two share no plane.
        size = (thick_m - 0.004 * (way > 0), thick_m * 1.4)
        yield Part("leg", leg((s * x, -way * y, 0.0), (s * x, way * y, head_m), size, size), look)
    middle = head_m / 2
    yield Part("stretcher", box((-x, -0.02, middle - 0.025), (x, 0.02, middle + 0.025)), look)


def trestle(draw: Draw, half_m: Vector2, head_m: float, look: Look) -> Parts:
    """Make two trestles (a post between foot and head beam, or an A of two legs), and a long stretcher.

    `half_m` has x of the right trestle and half a trestle's length along y. `head_m` is their height.
    """
    x, y, wide = *half_m, draw.between(0.045, 0.07)
    if draw.chance(0.5):
        post = draw.between(0.09, 0.16)
        for s in SIDES:
            low, high = s * x - wide / 2, s * x + wide / 2
            yield Part("foot", plate(rectangle((wide, 2 * y)), 0.0, 0.06).translate((s * x, 0.0, 0.0)), look)
            yield Part(
                "post", box((low + 0.005, -post / 2, 0.05), (high - 0.005, post / 2, head_m - 0.04)), look
            )
            yield Part("beam", box((low, -0.85 * y, head_m - 0.06), (high, 0.85 * y, head_m)), look)
        z = head_m * draw.between(0.25, 0.55)
    else:
        for s, way in CORNERS:
            foot, top = (s * x, way * y, 0.0), (s * x, way * 0.35 * y, head_m)
            yield Part("leg", leg(foot, top, (wide, 0.05), (wide, 0.06)), look)
        z = head_m * draw.between(0.25, 0.4)
        reach = y * (1 - 0.65 * z / head_m)
        for s in SIDES:
            cross = box((s * x - 0.015, -reach, z - 0.03), (s * x + 0.015, reach, z + 0.03))
            yield Part("cross bar", cross, look)
    yield Part("stretcher", box((-x, -0.0125, z - 0.045), (x, 0.0125, z + 0.045)), look)


def panels(half_m: Vector2, head_m: float, thick_m: float, look: Look) -> Parts:
    """Make two upright boards at the left and right ends.

    `half_m` is x of the right board, and half its length along y. `head_m` is the height of the boards.
    """
    x, y = half_m
    for s in SIDES:
        yield Part("panel", box((s * x - thick_m / 2, -y, 0.0), (s * x + thick_m / 2, y, head_m)), look)

"""Round and rectangular containers, open at the top: waste bins, buckets, laundry baskets, and pots."""

from typing import TYPE_CHECKING

import numpy as np

from kinectbench.lab.simulate.objects import looks
from kinectbench.lab.simulate.objects.joinery import SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import box, plate, rod, rounded_path, tube, turned, union
from kinectbench_plugins import palettes
from kinectbench_plugins.families import vessels
from kinectbench_plugins.families.vessels import THIN_M, Footprint, Rim, Vessel, both_sides, footprint

if TYPE_CHECKING:
    from manifold3d import Manifold

BIN_KINDS: tuple[Footprint, ...] = ("round", "round", "rectangle", "rectangle", "oval")
BASKET_KINDS: tuple[Footprint, ...] = ("round", "rectangle", "rectangle", "oval")
PLANTER_KINDS: tuple[Footprint, ...] = ("round", "round", "rectangle")


def _vessel(
    draw: Draw,
    kind: Footprint,
    size_m: tuple[float, float, float],
    share: float,
    *,
    base_m: float = 0.0,
    edge_m: float = 0.0,
) -> Vessel:
    """A vessel of an outer width, depth and height, its floor narrower than its top by a share."""
    wall, bottom = draw.between(THIN_M, 0.019), draw.between(THIN_M, 0.02)
    inside = (size_m[0] - 2 * wall, size_m[1] - 2 * wall)
    radius = draw.between(0.02, 0.3 * min(inside)) * share if kind == "rectangle" else 0.0
    low = footprint(kind, (inside[0] * share, inside[1] * share), radius)
    high = footprint(kind, inside, radius)
    return Vessel(low, high, base_m, base_m + bottom, size_m[2], wall, edge_m)


def waste_bin(draw: Draw) -> Parts:
    """Draw a bin: a tapered waste bin, or a pedal bin whose lid stands up at its back."""
    pedal = draw.chance(0.35)
    kind = draw.choose(BIN_KINDS)
    wide = draw.between(0.25, 0.43)
    deep = wide if kind == "round" else wide * draw.between(0.65, 0.9)
    high = draw.between(max(0.3, 0.95 * wide), min(0.7, 1.9 * wide))
    share = draw.between(0.96, 1.0) if pedal else draw.between(0.7, 0.98)
    look = draw.pick(
        looks.METALS[:2] + looks.PLASTICS if pedal else looks.PLASTICS + looks.PLASTICS[:5] + looks.WOODS[:4]
    )
    trim = look if draw.chance(0.5) else draw.pick(looks.PLASTICS[:5] + looks.METALS)
    base = draw.between(0.015, 0.03) if draw.chance(0.35) else 0.0
    bin_ = _vessel(draw, kind, (wide, deep, high), share, base_m=base)
    holes = not pedal and draw.chance(0.3)
    body = bin_.body()
    if holes:
        hole = vessels.slot(bin_, (0.0, high - 0.07), draw.between(0.08, 0.11), draw.between(0.028, 0.035))
        body = body - hole - vessels.turned_by(hole, np.pi)
    yield Part("body", body, look)
    rims: tuple[Rim, ...] = ("plain", "rolled", "flanged", "collar")
    yield from vessels.rim(
        draw, bin_, "plain" if holes and draw.chance(0.5) else draw.choose(rims[:2] if holes else rims), trim
    )
    if base:
        yield vessels.foot_ring(bin_, draw.between(0.85, 0.97), trim)
    elif draw.chance(0.4):
        yield Part("plinth", bin_.band(0.0, draw.between(0.03, 0.06), draw.between(0.005, 0.012)), trim)
    if draw.chance(0.3):
        for z in np.linspace(0.3, 0.72, draw.integer(1, 4)) * high:
            yield Part("hoop", bin_.band(float(z), float(z) + 0.018, 0.006), trim)
    if pedal:
        yield from _lid(draw, bin_, trim)
        yield from _pedal(draw, bin_, trim)


def _lid(draw: Draw, bin_: Vessel, look: Look) -> Parts:
    """A lid that stands up, or leans back, on a hinge at the back."""
    thick, lean = draw.between(0.014, 0.02), draw.between(0.0, 15.0)
    outline = bin_.outer(bin_.top_m, 0.004)
    back = float(outline[:, 1].min())
    lid = plate(outline, 0.0, thick, 0.004 if draw.chance(0.5) else 0.0).translate((0.0, -back, 0.0))
    lid = lid.rotate((90.0 + lean, 0.0, 0.0)).translate((0.0, back - 0.004, bin_.top_m + 0.012))
    yield Part("lid", lid, look)
    half = draw.between(0.04, 0.06)
    hinge = box((-half, back - 0.028, bin_.top_m - 0.04), (half, back + 0.03, bin_.top_m + 0.035))
    keep = vessels.grown(bin_.inner(bin_.top_m), 0.4 * bin_.wall_m)
    yield Part("hinge", hinge - vessels.tub(keep, keep, 0.0, bin_.top_m + 0.1), look)


def _pedal(draw: Draw, bin_: Vessel, look: Look) -> Parts:
    """A pedal low at the front."""
    front, half = float(bin_.outer(bin_.base_m)[:, 1].max()), draw.between(0.03, 0.06)
    low = draw.between(0.012, 0.02) + bin_.base_m
    pedal = box((-half, front - 0.08, low), (half, front + draw.between(0.03, 0.05), low + 0.014))
    yield Part("pedal", pedal - bin_.core(), look)


def bucket(draw: Draw) -> Parts:
    """Draw a round bucket with a bail that stands up, leans, or hangs down at its front."""
    wide = draw.between(0.25, 0.36)
    high = wide * draw.between(0.8, 1.1)
    base = draw.between(0.012, 0.022) if draw.chance(0.6) else 0.0
    pail = _vessel(
        draw, "round", (wide, wide, high), draw.between(0.66, 0.88), base_m=base,
        edge_m=0.02 if draw.chance(0.3) else 0.0,
    )  # fmt: skip
    look = draw.pick(looks.PLASTICS[:5] + looks.METALS[:2] + looks.WOODS[:4])
    trim = look if draw.chance(0.5) else draw.pick(looks.METALS + looks.PLASTICS[:5])
    yield Part("body", pail.body(), look)
    rims: tuple[Rim, ...] = ("plain", "rolled", "rolled", "flanged", "collar")
    yield from vessels.rim(draw, pail, draw.choose(rims), look if draw.chance(0.7) else trim)
    if base:
        yield vessels.foot_ring(pail, draw.between(0.85, 0.95), look)
    for z in np.linspace(0.3, 0.7, draw.integer(1, 4)) * high if draw.chance(0.5) else ():
        yield Part("hoop", pail.band(float(z), float(z) + draw.between(0.015, 0.03), 0.005), trim)
    if draw.chance(0.85):
        yield from _bail(draw, pail, trim)
    else:
        loop = vessels.loop_handle(
            pail, high - 0.05, draw.between(0.1, 0.13), 0.045, draw.between(0.0075, 0.01)
        )
        yield from both_sides("handle", loop, trim)


def _bail(draw: Draw, pail: Vessel, look: Look) -> Parts:
    """The bail from ear to ear, perhaps with a grip around its middle."""
    radius, top = draw.between(0.0068, 0.009), pail.top_m
    reach = float(pail.outer(top)[:, 0].max()) + 0.034
    ear_z = top - draw.between(0.028, 0.04)
    wall = reach - 0.034
    for s in SIDES:
        low, high = sorted([s * (wall - 0.03), s * (reach + 0.008)])
        yield Part("ear", box((low, -0.018, ear_z - 0.02), (high, 0.018, ear_z + 0.02)) - pail.core(), look)
    long = reach * draw.between(1.15, 1.45)
    # It hangs on the rim where its projection to the floor keeps clear of it.
    hanging = -float(np.arccos((reach + 0.004) / long))
    rise = draw.choose([np.pi / 2, draw.between(0.35, 1.3), hanging, hanging])
    side = draw.choose(SIDES)
    turn = np.linspace(0, np.pi, 17)
    out, up = side * np.cos(rise), np.sin(rise)
    path = np.column_stack(
        [reach * np.cos(turn), long * np.sin(turn) * out, ear_z + long * np.sin(turn) * up]
    )
    yield Part("bail", tube(path, radius), look)
    if draw.chance(0.6):
        half, y, z = draw.between(0.04, 0.06), long * float(out), ear_z + long * float(up)
        grip = rod((-half, y, z), (half, y, z), draw.between(0.013, 0.017))
        yield Part("grip", grip, draw.pick(looks.WOODS[:6] + looks.PLASTICS[:5]))


def basket(draw: Draw) -> Parts:
    """Draw a laundry basket: slotted walls, woven bands, or plain walls with hand holes."""
    kind = draw.choose(BASKET_KINDS)
    wide = draw.between(0.36, 0.6) if kind != "round" else draw.between(0.34, 0.5)
    deep = wide if kind == "round" else wide * draw.between(0.62, 0.85)
    high = draw.between(0.24, 0.6) if kind == "round" else draw.between(0.22, 0.42)
    hamper = _vessel(draw, kind, (wide, deep, high), draw.between(0.72, 0.97))
    style = draw.choose(["slots", "slots", "windows", "woven", "woven", "plain"])
    woods = (*looks.WOODS[:5], looks.WOODS[6], *looks.CLOTHS[4:6])
    look = draw.pick(woods if style == "woven" else looks.PLASTICS[:5])
    trim = look if draw.chance(0.6) else draw.pick(looks.PLASTICS[:5] + looks.WOODS[:5])
    body = hamper.body()
    if style in ("slots", "windows"):
        body = body - _openings(draw, hamper, kind, upright=style == "slots")
    holes = style != "slots" and draw.chance(0.6)
    if holes:
        hole = vessels.slot(hamper, (0.0, high - 0.06), draw.between(0.09, 0.13), draw.between(0.028, 0.036))
        body = body - hole - vessels.turned_by(hole, np.pi)
    yield Part("body", body, look)
    yield from vessels.rim(
        draw,
        hamper,
        draw.choose(("plain", "rolled", "rolled") if holes else ("rolled", "flanged", "flanged")),
        trim,
    )
    if style == "woven":
        yield from _woven(draw, hamper, 0.1 if holes else 0.02, look)
    if not holes and draw.chance(0.6):
        radius, width = draw.between(0.0075, 0.011), draw.between(0.12, 0.18)
        if draw.chance(0.5):
            yield from both_sides(
                "handle", vessels.grip_handle(hamper, width, draw.between(0.05, 0.09), radius), trim
            )
        else:
            yield from both_sides(
                "handle", vessels.loop_handle(hamper, high - 0.04, width, 0.05, radius), trim
            )


def _openings(draw: Draw, hamper: Vessel, kind: Footprint, *, upright: bool) -> "Manifold":
    """Slots side by side, or rows of level windows, all around the walls."""
    width, gap = (
        (draw.between(0.026, 0.034), draw.between(0.03, 0.045))
        if upright
        else (draw.between(0.05, 0.08), draw.between(0.035, 0.05))
    )
    low, top = hamper.floor_m + 0.035, hamper.top_m - 0.06
    tall = min(top - low, 0.22) if upright else draw.between(0.027, 0.035)
    rows = max(1, int((top - low + 0.03) / (tall + 0.03)))
    heights = np.linspace(low + tall / 2, top - tall / 2, rows) if rows > 1 else [(low + top) / 2]
    cuts = []
    for z in heights:
        for turn, aside in _places(hamper, kind, width, gap):
            cuts.append(vessels.turned_by(vessels.slot(hamper, (aside, float(z)), width, tall), turn))
    return union(cuts)


def _places(hamper: Vessel, kind: Footprint, width_m: float, gap_m: float) -> list[tuple[float, float]]:
    """The turn and the place along the wall of each opening."""
    size = np.ptp(hamper.low, axis=0)
    if kind != "rectangle":
        count = int(np.pi * size.min() / (width_m + gap_m))
        return [(2 * np.pi * k / count, 0.0) for k in range(count)]
    corner = float(hamper.low[:, 0].max() - hamper.low[np.argmax(hamper.low[:, 1]), 0])
    places = []
    for turn in range(4):
        flat = float(size[1 - turn % 2]) - 2 * max(corner, 0.02)
        count = int((flat + gap_m) / (width_m + gap_m))
        pitch = width_m + gap_m
        places += [(turn * np.pi / 2, (k - (count - 1) / 2) * pitch) for k in range(count)]
    return places


def _woven(draw: Draw, hamper: Vessel, free_m: float, look: Look) -> Parts:
    """Rolls around the walls, one above the other, as of thick rope or wicker."""
    radius = draw.between(0.009, 0.013)
    for z in np.arange(radius, hamper.top_m - free_m, 2.1 * radius * draw.choose([1, 1, 2])).tolist():
        ring = hamper.outer(z, -0.2 * radius)
        path = np.column_stack([ring, np.full(len(ring), z)])
        yield Part("roll", tube(np.concatenate([path, path[:1]]), radius) - hamper.core(), look)


def pot(draw: Draw) -> Parts:
    """Draw a cooking pot with handles, a planter, or a bellied pot, 25 to 45 cm wide."""
    return draw.choose([_cooking_pot, _planter, _belly])(draw)


def _cooking_pot(draw: Draw) -> Parts:
    """A straight round pot with two handles, or one long one."""
    wide = draw.between(0.25, 0.4)
    high = wide * draw.between(0.45, 0.95)
    look = draw.pick(looks.METALS[:2] + looks.PLASTICS[:5])
    trim = look if draw.chance(0.5) else draw.pick(looks.METALS + looks.WOODS[:4])
    pan = _vessel(draw, "round", (wide, wide, high), draw.between(0.93, 1.0), edge_m=draw.between(0.01, 0.03))
    yield Part("body", pan.body(), look)
    yield from vessels.rim(draw, pan, draw.choose(("plain", "rolled", "rolled")), look)
    z = high - draw.between(0.03, 0.25 * high)
    kind = draw.choose(["loops", "loops", "lugs", "long"])
    if kind == "loops":
        loop = vessels.loop_handle(
            pan, z, draw.between(0.09, 0.13), draw.between(0.035, 0.05), draw.between(0.0075, 0.01)
        )
        yield from both_sides("handle", loop, trim)
    elif kind == "lugs":
        lug = vessels.block_handle(
            pan, z, draw.between(0.07, 0.12), draw.between(0.03, 0.045), draw.between(0.014, 0.02)
        )
        yield from both_sides("handle", lug, trim)
    else:
        near, far = pan.reach_m(z) - 0.03, pan.reach_m(z) + draw.between(0.14, 0.2)
        handle = rod((near, 0.0, z), (far, 0.0, z + draw.between(0.0, 0.05)), draw.between(0.01, 0.013))
        yield Part("handle", handle - pan.core(), trim)


def _planter(draw: Draw) -> Parts:
    """A tapered planter, round or rectangular, perhaps with a saucer, feet or lugs."""
    kind = draw.choose(PLANTER_KINDS)
    wide = draw.between(0.26, 0.42)
    deep = wide if kind == "round" or draw.chance(0.6) else wide * draw.between(0.6, 0.9)
    high = wide * draw.between(0.7, 1.2)
    look = draw.pick(looks.STONES + palettes.CLAYS + looks.WOODS[:4])
    foot = draw.choose(["none", "saucer", "feet", "ring"])
    base = {"none": 0.0, "saucer": 0.013, "feet": draw.between(0.02, 0.04), "ring": 0.02}[foot]
    tub = _vessel(draw, kind, (wide, deep, high), draw.between(0.62, 0.95), base_m=base)
    yield Part("body", tub.body(), look)
    rims: tuple[Rim, ...] = ("plain", "rolled", "flanged", "collar", "collar")
    yield from vessels.rim(draw, tub, draw.choose(rims), look)
    if foot == "saucer":
        inside = tub.outer(base, draw.between(0.018, 0.03))
        outside = vessels.grown(inside, 0.014)
        saucer = vessels.tub(outside, outside, 0.0, 0.04) - vessels.tub(inside, inside, 0.0135, 0.1)
        yield Part("saucer", saucer, look if draw.chance(0.5) else draw.pick(looks.STONES + palettes.CLAYS))
    elif foot == "feet":
        yield from vessels.knob_feet(tub, draw.integer(3, 5), draw.between(0.035, 0.05), look)
    elif foot == "ring":
        yield vessels.foot_ring(tub, 0.9, look)
    if draw.chance(0.4):
        lug = vessels.block_handle(tub, 0.72 * high, draw.between(0.08, 0.12), 0.03, 0.02)
        yield from both_sides("handle", lug, look)


def _belly(draw: Draw) -> Parts:
    """A turned pot with a belly, a neck, and a lip, perhaps with two handles."""
    from scipy.interpolate import PchipInterpolator

    wide, wall = draw.between(0.27, 0.42), draw.between(0.014, 0.019)
    high, look = wide * draw.between(0.75, 1.15), draw.pick(palettes.CLAYS + looks.STONES + looks.METALS[1:2])
    foot, neck, lip = draw.between(0.5, 0.65), draw.between(0.66, 0.82), draw.between(0.72, 0.92)
    belly = draw.between(0.4, 0.6)
    # Radius over height, as shares, by a smooth curve through foot, belly, neck and lip.
    knots_z, knots_r = np.array([0.0, belly, 0.88, 1.0]), np.array([foot, 1.0, neck, lip])
    z = np.linspace(0, 1, 25)
    r = wide / 2 * PchipInterpolator(knots_z, knots_r)(z)
    outer = np.column_stack([r, z * high])
    steps = np.gradient(outer, axis=0)
    normals = np.column_stack([steps[:, 1], -steps[:, 0]]) / np.linalg.norm(steps, axis=1, keepdims=True)
    inner = outer - wall * normals
    floor = draw.between(THIN_M, 0.02)
    inner = inner[inner[:, 1] > floor + 0.004]
    inner[-1, 1] = high
    start = (float(np.interp(floor, outer[:, 1], outer[:, 0])) - 1.2 * wall, floor)
    profile = [
        (0.0, 0.0),
        *map(tuple, outer.tolist()),
        *map(tuple, inner[::-1].tolist()),
        start,
        (0.0, floor),
    ]
    yield Part("body", turned(profile), look)
    if draw.chance(0.6):
        half, at = draw.between(0.04, 0.06), draw.between(0.6, 0.72)
        radius = draw.between(0.0075, 0.01)
        low, top = at * high - half, at * high + half
        near = [float(np.interp(v / high, z, r)) - 0.007 for v in (low, top)]
        far = max(near) + draw.between(0.045, 0.06)
        path = rounded_path(
            [(near[0], 0.0, low), (far, 0.0, low), (far, 0.0, top), (near[1], 0.0, top)], 0.03
        )
        yield from both_sides("handle", tube(path, radius), look)

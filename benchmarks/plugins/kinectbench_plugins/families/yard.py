"""Open containers of yard and garden: wheelbarrows, troughs on stands, and watering cans."""

from typing import TYPE_CHECKING

import numpy as np

from kinectbench.lab.simulate.objects import bases, looks
from kinectbench.lab.simulate.objects.joinery import CORNERS, SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import (
    Vector2,
    Vector3,
    bar_between,
    box,
    leg,
    rectangle,
    rod,
    rounded_path,
    tube,
    turned,
)
from kinectbench_plugins import palettes
from kinectbench_plugins.families.ceramics import horn, smooth_profile, vessel
from kinectbench_plugins.families.vessels import THIN_M, Vessel, rim

if TYPE_CHECKING:
    from manifold3d import CrossSection, Manifold

# Bars of wheelbarrows; none is black.
BARS = (*looks.METALS[:2], looks.METALS[3])
# What lies in a wheelbarrow or a trough: brown earth; own choice.
SOIL = looks.Look((0.36, 0.26, 0.18), 0.45)
# A cavity runs on above the rim by this much, so that it is open; own choice.
ABOVE_M = 0.1


def wheelbarrow(draw: Draw) -> Parts:
    """Draw a wheelbarrow or a garden cart whose wheel is at +x; its walls are 12.5 mm thick or more."""
    radius, base = draw.between(0.15, 0.2), draw.between(0.26, 0.32)
    tray = _tray(draw, base)
    look, bars = draw.pick(looks.METALS[:2] + looks.IRONS[1:] + looks.PLASTICS[:5]), draw.pick(BARS)
    wooden = draw.chance(0.25)
    look = draw.pick(looks.WOODS[:6]) if wooden else look
    yield Part("tray", tray.body(), look)
    if not wooden:
        yield from rim(draw, tray, draw.choose(["rolled", "flanged"]), look)
    if draw.chance(0.25):
        # A load fills it in part.
        level = base + draw.between(0.3, 0.75) * (tray.top_m - base)
        yield Part("load", tray.core() ^ box((-2.0, -2.0, 0.0), (2.0, 2.0, level)), SOIL)
    front = float(tray.inner(tray.floor_m)[:, 0].max())
    axle = front + radius + draw.between(0.0, 0.08)
    pair = draw.chance(0.25)
    track = draw.between(0.2, 0.26) if pair else 0.0
    yield from _wheels(draw, (axle, radius), track, bars)
    rubber, keep_out = draw.pick(looks.PLASTICS[:5]), tray.core()
    rear = float(tray.inner(tray.floor_m)[:, 0].min())
    bar_m = draw.between(0.65, 0.8) * float(tray.inner(tray.floor_m)[:, 1].max())
    thick = draw.between(0.013, 0.017)
    grip = (-draw.between(0.72, 0.86), draw.between(0.25, 0.3), draw.between(0.52, 0.66))
    beam = base - thick + 0.008
    for s in SIDES:
        near = track if pair else 0.075
        path = [(axle, s * near, radius), (front - 0.02, s * bar_m, beam), (rear - 0.03, s * bar_m, beam)]
        path += [(grip[0], s * grip[1], grip[2])]
        yield Part("handle", tube(rounded_path(path, 0.06), thick) - keep_out, bars)
        # The grip ends a little beyond the bar.
        root = np.array(path[2])
        whole = np.array([grip[0], s * grip[1], grip[2]]) - root
        yield Part(
            "grip", rod(_point(root + 0.72 * whole), _point(root + 1.01 * whole), thick + 0.004), rubber
        )
    yield from _props(draw, bar_m, beam, thick, bars)


def _point(at: np.ndarray) -> Vector3:
    x, y, z = at.tolist()
    return x, y, z


def _tray(draw: Draw, base: float) -> Vessel:
    """A tapered tray whose front wall leans more than its rear one."""
    long, wide = draw.between(0.5, 0.66), draw.between(0.34, 0.46)
    deep, corner = draw.between(0.16, 0.28), draw.choose([0.0, 0.05, 0.09])
    # Its slanting front and rounded corners take a little off the wall.
    wall = draw.between(THIN_M + 0.002, 0.019)
    out, ahead = draw.between(0.06, 0.16), draw.between(0.0, 0.12)
    low = rectangle((long, wide), corner)
    high = rectangle((long + 2 * out + ahead, wide + 2 * out), corner)
    high[:, 0] += ahead / 2
    edge = 0.02 if corner else 0.0
    return Vessel(low, high, base, base + wall + 0.002, base + deep, wall, edge)


def _wheels(draw: Draw, at_xz: Vector2, track_m: float, look: Look) -> Parts:
    """One wheel in the middle, or two `track_m` beside it, with an axle."""
    (x, radius), wide = at_xz, draw.between(0.032, 0.045)
    hub, inner = draw.between(0.03, 0.04), 0.62 * radius
    soft = 0.35 * wide
    tyre = [(0.0, -wide), (radius - soft, -wide), (radius, -wide + soft), (radius, wide - soft)]
    wheel = turned([*tyre, (radius - soft, wide), (0.0, wide)])
    # The rim lies deeper than the tyre on both sides.
    dent = turned([(hub, 0.0), (inner, 0.0), (inner, 0.1), (hub, 0.1)]).translate((0.0, 0.0, 0.45 * wide))
    wheel = (wheel - dent - dent.mirror((0.0, 0.0, 1.0))).rotate((90.0, 0.0, 0.0))
    tint = draw.choose([looks.PLASTICS[5], looks.METALS[3]])
    for y in (-track_m, track_m) if track_m else (0.0,):
        yield Part("wheel", wheel.translate((x, y, radius)), tint)
    reach = track_m + wide + 0.045
    yield Part("axle", rod((x, -reach, radius), (x, reach, radius), 0.012), look)


def _props(draw: Draw, beside_m: float, head_m: float, radius_m: float, look: Look) -> Parts:
    """Two props under the handles, as bent loops or straight, with a bar between them."""
    x, out = -draw.between(0.14, 0.22), draw.between(0.0, 0.06)
    loops, back = draw.chance(0.5), draw.between(0.06, 0.12)
    for s in SIDES:
        head = (x, s * beside_m, head_m)
        foot = (x - 0.02, s * (beside_m + out), radius_m)
        if loops:
            rear = (foot[0] - back, foot[1], radius_m)
            path = [head, foot, rear, (x - back - 0.05, s * (beside_m + 0.01), head_m + 0.01)]
            yield Part("prop", tube(rounded_path(path, 0.03), radius_m), look)
        else:
            yield Part("prop", leg((*foot[:2], 0.0), head, 2 * radius_m, 2 * radius_m, is_round=True), look)
    z = draw.between(0.35, 0.6) * head_m
    y = beside_m + out * (1 - z / head_m)
    brace_x = x - 0.02 * (1 - z / head_m)
    yield Part("brace", rod((brace_x, -y, z), (brace_x, y, z), 0.009), look)


def trough(draw: Draw) -> Parts:
    """Draw a long trough for water or feed, on a stand or on skids; its walls are 12.5 mm thick or more."""
    x, y, high = draw.between(0.35, 0.65), draw.between(0.15, 0.24), draw.between(0.17, 0.3)
    kind = draw.choose(["half-round", "half-round", "tapered", "vee"])
    wall, low = draw.between(THIN_M, 0.019), draw.choose([0.06, draw.between(0.22, 0.5)])
    look = draw.pick(looks.METALS[:2] + looks.PLASTICS[:5] + looks.WOODS[:5] + looks.STONES[:1])
    outer = _section(draw, kind, y, high)
    room = _room(outer, wall)
    solid, hollow = _along(outer, (-x, x)), _along(room, (-x + wall, x - wall))
    yield Part("trough", (solid - hollow).translate((0.0, 0.0, low)), look)
    # What is in it or below it ends within its walls.
    within = _along(_room(outer, 0.6 * wall), (-x + 0.6 * wall, x - 0.6 * wall)).translate((0.0, 0.0, low))
    top = low + high
    if draw.chance(0.7):
        roll = draw.between(0.0075, 0.011)
        # A little below the walls' upper faces, so that no edge of it lies in them.
        corners = [(-x, -y), (x, -y), (x, y), (-x, y), (-x, -y)]
        ring = [(*corner, top - 0.003) for corner in corners]
        yield Part("rim", tube(ring, roll), look)
    if draw.chance(0.4):
        level = low + draw.between(0.25, 0.7) * high
        feed = within ^ box((-2.0, -2.0, 0.0), (2.0, 2.0, level))
        yield Part("feed", feed, draw.choose([SOIL, draw.pick(palettes.CARDS)]))
    bars, end = draw.pick(looks.METALS + looks.WOODS[:3]), y - 0.6 * wall
    for at in np.linspace(-x, x, draw.integer(2, 5))[1:-1].tolist():
        yield Part("bar", rod((at, -end, top - 0.01), (at, end, top - 0.01), 0.009), bars)
    for part in _trough_stand(draw, (x, y), (low, low + high), kind):
        yield Part(part.name, part.shape - within, part.look)


def _section(draw: Draw, kind: str, y: float, high: float) -> "CrossSection":
    """A trough's outer section, its axis first, its height second: half-round, tapered or a blunt V."""
    from manifold3d import CrossSection, FillRule

    if kind == "half-round":
        turn = np.linspace(np.pi, 2 * np.pi, 33)
        points = np.column_stack([y * np.cos(turn), high * (1 + np.sin(turn))])
    else:
        foot = y * (draw.between(0.6, 0.85) if kind == "tapered" else draw.between(0.25, 0.4))
        points = np.array([(-y, high), (-foot, 0.0), (foot, 0.0), (y, high)])
    return CrossSection([points], FillRule.Positive)


def _room(outer: "CrossSection", wall: float) -> "CrossSection":
    """The hollow's section: the outer one that runs on above the rim, smaller by the wall."""
    from manifold3d import CrossSection, JoinType

    low_y, _, high_y, top = outer.bounds()
    above = CrossSection.square((high_y - low_y, ABOVE_M + wall)).translate((low_y, top - 1e-4))
    return (outer + above).offset(-wall, JoinType.Miter, 2.0, 32).simplify(1e-5)


def _along(section: "CrossSection", x_m: Vector2) -> "Manifold":
    """A section in y and z drawn out along x."""
    from manifold3d import Manifold

    strip = Manifold.extrude(section, x_m[1] - x_m[0])
    return strip.transform([[0, 0, 1, x_m[0]], [1, 0, 0, 0], [0, 1, 0, 0]])


def _trough_stand(draw: Draw, half_m: Vector2, z_m: Vector2, kind: str) -> Parts:
    """Skids or boards across under a low trough; crossed legs, boards or frames under a high one."""
    (x, y), (low_m, top_m), wood = half_m, z_m, draw.pick(looks.WOODS[:6] + looks.METALS)
    inset = draw.between(0.08, 0.18)
    head = low_m + {"half-round": 0.06, "tapered": 0.02, "vee": 0.05}[kind]
    if low_m < 0.1:
        for s in SIDES:
            at = s * (x - inset)
            yield Part("skid", box((at - 0.022, -y, 0.0), (at + 0.022, y, head)), wood)
        return
    stand = draw.choose(["crossed", "boards", "frames"])
    if stand == "crossed":
        reach, up = y + 0.06, low_m + 0.13
        yield from bases.crossed_legs((x - inset, reach), up, 0.036, wood)
        # The trough rests on bars between the legs where these are as high as its bottom.
        wide = reach * (2 * low_m / up - 1)
        for s in SIDES:
            at = s * (x - inset)
            ends = (at - 0.014, -wide - 0.01, low_m - 0.03), (at + 0.014, wide + 0.01, low_m + 0.008)
            yield Part("cross bar", box(*ends), wood)
    elif stand == "boards":
        for s in SIDES:
            at = s * (x - inset)
            yield Part("board", box((at - 0.014, -y - 0.02, 0.0), (at + 0.014, y + 0.02, head + 0.05)), wood)
        z = low_m * draw.between(0.3, 0.6)
        yield Part("stretcher", box((-x + inset, -0.012, z - 0.04), (x - inset, 0.012, z + 0.04)), wood)
    else:
        out, thick = y + draw.between(0.0, 0.06), draw.between(0.026, 0.036)
        # The legs end beside the wall, a little below the rim.
        head = low_m + 0.92 * (top_m - low_m)
        for sx, sy in CORNERS:
            at = sx * (x - inset)
            yield Part("leg", leg((at, sy * out, 0.0), (at, sy * (y - 0.008), head), thick, thick), wood)
        for s in SIDES:
            at = s * (x - inset)
            for z in (0.3 * low_m, low_m - 0.012):
                reach = out + (y - 0.008 - out) * z / head
                yield Part("cross bar", bar_between((at, -reach, z), (at, reach, z), 0.022, 0.04), wood)


def watering_can(draw: Draw) -> Parts:
    """Draw a watering can, open at its top, its spout at +x; its walls are 8 mm thick or more."""
    look, wall = (
        draw.pick(looks.METALS[:2] + palettes.ENAMELS + looks.PLASTICS[:5]),
        draw.between(0.009, 0.013),
    )
    high, radius = draw.between(0.16, 0.28), draw.between(0.075, 0.12)
    kind = draw.choose(["straight", "cone", "belly"])
    share = {
        "straight": [(1.0, 0.0), (1.0, 0.5), (1.0, 1.0)],
        "cone": [(1.1, 0.0), (0.95, 0.5), (draw.between(0.7, 0.85), 1.0)],
        "belly": [(0.85, 0.0), (1.1, 0.4), (draw.between(0.7, 0.9), 1.0)],
    }[kind]
    profile = smooth_profile([(r * radius, z * (high - wall / 2)) for r, z in share])
    body = vessel(profile, wall, wall + 0.003)[0]
    # What is fixed to the wall ends within it; above the rim it may cross.
    room = vessel(profile, 0.6 * wall, 0.6 * wall)[1]
    oval = draw.choose([1.0, draw.between(0.92, 1.0)])
    yield Part("body", body.scale((1.0, oval, 1.0)), look)
    room = room.scale((1.0, oval, 1.0)).trim_by_plane((0.0, 0.0, -1.0), -high - 0.002)
    if draw.chance(0.6):
        # A cover closes the half at the spout.
        lid = turned(
            [
                (0.0, high - 0.004),
                (profile[-1, 0] - 0.002, high - 0.004),
                (profile[-1, 0] - 0.002, high + 0.007),
                (0.0, high + 0.007),
            ]
        )
        lid = lid.scale((1.0, oval, 1.0)).trim_by_plane((1.0, 0.0, 0.0), draw.between(-0.1, 0.3) * radius)
        yield Part("cover", lid, look)
    tip = _spout_line(draw, radius, high)
    path = rounded_path(
        [(float(np.interp(0.2 * high, profile[:, 1], profile[:, 0])) - 0.012, 0.0, 0.2 * high), *tip], 0.04
    )
    thick = np.linspace(draw.between(0.017, 0.024), draw.between(0.0115, 0.014), len(path))
    yield Part("spout", horn(path, thick) - room, look)
    yield from _rose(draw, path, look)
    yield from _hold(draw, profile, high, room, look)


def _spout_line(draw: Draw, radius: float, high: float) -> list[Vector3]:
    """Where a spout goes on from its root: straight, or in a bend."""
    out, up = radius + draw.between(0.1, 0.2), high * draw.between(0.95, 1.3)
    end = (out, 0.0, up)
    return (
        [end]
        if draw.chance(0.5)
        else [(0.6 * out + 0.4 * radius, 0.0, 0.3 * high), (out - 0.03, 0.0, 0.85 * up), end]
    )


def _rose(draw: Draw, path: np.ndarray, look: Look) -> Parts:
    """A sprinkling head on the end of a spout, or none."""
    if draw.chance(0.35):
        return
    way = (path[-1] - path[-2]) / np.linalg.norm(path[-1] - path[-2])
    wide = draw.between(0.022, 0.034)
    head = turned([(0.0, -0.02), (0.012, -0.02), (wide, 0.03), (wide, 0.042), (0.0, 0.042)])
    tilt = float(np.degrees(np.arctan2(way[0], way[2])))
    at = path[-1] - 0.004 * way
    yield Part(
        "rose", head.rotate((0.0, tilt, 0.0)).translate(_point(at)), draw.choose([look, looks.METALS[3]])
    )


def _hold(draw: Draw, profile: np.ndarray, high: float, room: "Manifold", look: Look) -> Parts:
    """What a can is carried by: an arch over its top, a loop at its back, or both in one bow."""
    radius, bend = draw.between(0.0068, 0.009), draw.choose(["arch", "loop", "bow"])
    low = draw.between(0.2, 0.45) * high
    near = float(np.interp(low, profile[:, 1], profile[:, 0])) - 0.006
    neck = float(profile[-1, 0]) - 0.006
    up, out = high + draw.between(0.05, 0.09), max(near, neck) + draw.between(0.045, 0.065)
    upper = 0.9 * high
    at_upper = float(np.interp(upper, profile[:, 1], profile[:, 0])) - 0.006
    paths = {
        "arch": [(-at_upper, 0.0, upper), (-at_upper, 0.0, up), (at_upper, 0.0, up), (at_upper, 0.0, upper)],
        "loop": [(-near, 0.0, low), (-out, 0.0, low), (-out, 0.0, upper), (-at_upper, 0.0, upper)],
        "bow": [
            (-near, 0.0, low),
            (-out, 0.0, low + 0.02),
            (-out, 0.0, up),
            (at_upper, 0.0, up),
            (at_upper, 0.0, upper),
        ],
    }
    grip = look if draw.chance(0.6) else draw.pick((looks.WOODS[1], looks.METALS[3], looks.PLASTICS[2]))
    chosen = ["loop", "arch"] if bend == "loop" and draw.chance(0.4) else [bend]
    for name in chosen:
        yield Part(
            "handle", tube(rounded_path(paths[name], 0.04), radius).scale((1.0, 1.3, 1.0)) - room, grip
        )

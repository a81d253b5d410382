"""Table-top things that are turned: mugs and steins, kettles and teapots, vases, bottles."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from kinectbench.lab.simulate.objects import looks
from kinectbench.lab.simulate.objects.joinery import SIDES, Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import Points, Vector2, Vector3, bent, rounded_path, tube, turned
from kinectbench_plugins import palettes

if TYPE_CHECKING:
    from manifold3d import CrossSection, Manifold

# Sides of a turned thing: facets of 5 mm on a vase of 15 cm; own choice.
TURNS = 96
# Points of a smooth profile; own choice.
PROFILE_POINTS = 40
# A cavity runs on above the rim by this much, so that it is open; own choice.
ABOVE_M = 0.1


def smooth_profile(corners_rz_m: Sequence[Vector2]) -> Points:
    """Radii and heights (n, 2) float64 of a smooth line through points whose heights rise; metres.

    Monotone cubic pieces (Fritsch and Carlson 1980): the line never overshoots its points.
    """
    from scipy.interpolate import PchipInterpolator

    radius, height = np.array(corners_rz_m, np.float64).T
    z = np.linspace(height[0], height[-1], PROFILE_POINTS)
    return np.column_stack([PchipInterpolator(height, radius)(z), z])


def _section(profile_rz: Points) -> "CrossSection":
    """The whole section, both sides of the axis, of what is turned from a line from its foot to its rim."""
    from manifold3d import CrossSection, FillRule

    mirrored = profile_rz[::-1] * [-1.0, 1.0]
    return CrossSection([np.concatenate([profile_rz, mirrored])], FillRule.NonZero)


def vessel(profile_rz_m: Points, wall_m: float, floor_m: float) -> tuple["Manifold", "Manifold"]:
    """A turned vessel that is open at its top, and the room inside it.

    Args:
        profile_rz_m: (n, 2) radius and height of its outer line from the foot, z = 0, up to the rim.
        wall_m: least thickness of its wall, measured square to the wall.
        floor_m: thickness of its floor.

    Returns:
        The vessel, its rim rounded; the room inside, which runs on above the rim.
    """
    from manifold3d import CrossSection, JoinType, Manifold

    (rim, top), half = profile_rz_m[-1], wall_m / 2
    higher = np.concatenate([profile_rz_m, [(rim, top + ABOVE_M + wall_m)]])
    room = _section(higher).offset(-wall_m, JoinType.Round, 2.0, 64)
    room ^= CrossSection.square((2.0, 2.0)).translate((-1.0, floor_m))
    lip = CrossSection.circle(half, 16).translate((rim - half, top))
    # Where the round lip touches the wall, points would lie closer than single precision tells apart.
    whole = ((_section(profile_rz_m) - room) + lip + lip.mirror((1.0, 0.0))).simplify(1e-5)
    return Manifold.revolve(whole, TURNS), Manifold.revolve(room, TURNS)


def band(profile_rz_m: Points, low_m: float, high_m: float, out_m: float, deep_m: float) -> "Manifold":
    """A ring around a turned thing between two heights: it stands out by `out_m`, goes in by `deep_m`."""
    z = np.linspace(low_m, high_m, 12)
    radius = np.interp(z, profile_rz_m[:, 1], profile_rz_m[:, 0])
    outer = np.column_stack([radius + out_m, z])
    inner = np.column_stack([radius - deep_m, z])[::-1]
    return turned([(float(r), float(h)) for r, h in np.concatenate([outer, inner])])


def mug(draw: Draw) -> Parts:
    """Draw a big mug or a stein; its wall is 8 mm thick or more, its handle 12 mm."""
    look, wall = draw.pick(palettes.GLAZES), draw.between(0.008, 0.014)
    high, kind = draw.between(0.10, 0.16), draw.choose(["straight", "tapered", "barrel", "waisted", "stein"])
    radius = high * draw.between(0.36, 0.5) if high < 0.13 else high * draw.between(0.32, 0.4)
    foot, middle, rim = {
        "straight": (1.0, 1.0, 1.0),
        "tapered": (draw.between(0.72, 0.85), 0.92, 1.0),
        "barrel": (draw.between(0.75, 0.85), 1.04, draw.between(0.8, 0.92)),
        "waisted": (1.0, draw.between(0.82, 0.9), 1.02),
        "stein": (1.08, 0.95, draw.between(0.82, 0.9)),
    }[kind]
    shape = [(foot * radius - 0.004, 0.0), (foot * radius, 0.006), (middle * radius, high / 2)]
    profile = smooth_profile([*shape, (rim * radius, high - wall / 2)])
    body, room = vessel(profile, wall, wall + draw.between(0.0, 0.006))
    yield Part("body", body, look)
    for low in {"stein": (0.05, 0.82)}.get(kind, (draw.between(0.1, 0.7),) if draw.chance(0.4) else ()):
        thick = draw.between(0.08, 0.2) * high
        ring = band(profile, low * high, low * high + thick, 0.002, wall / 2)
        yield Part("band", ring, look if kind == "stein" else draw.pick(palettes.GLAZES))
    gap, thick = draw.between(0.028, 0.04), draw.between(0.0066, 0.009)
    low, top = draw.between(0.16, 0.28) * high, draw.between(0.74, 0.88) * high
    handle = _ear(draw, profile, (low, top), gap + thick, thick).scale((1.0, draw.between(1.0, 1.7), 1.0))
    yield Part("handle", handle - room, look if draw.chance(0.75) else draw.pick(palettes.GLAZES))


def _ear(draw: Draw, profile: Points, ends: Vector2, reach: float, radius: float) -> "Manifold":
    """A handle in the plane y = 0 at a turned thing's right: an arc, a D, a square or an ear.

    Args:
        draw: chooses its kind.
        profile: (n, 2) outer line of what it is fixed to.
        ends: heights at which its two ends enter.
        reach: distance of its middle line from the wall, metres.
        radius: of its round section, metres.
    """
    r_low, r_top = np.interp(ends, profile[:, 1], profile[:, 0]).tolist()
    (low, top), out = ends, float(np.interp(ends, profile[:, 1], profile[:, 0]).max()) + reach
    # Its ends lie a little inside the wall's outer face.
    a, b = (r_low - 0.006, 0.0, low), (r_top - 0.006, 0.0, top)
    corners = {
        "arc": [(out, 0.0, low - 0.1 * (top - low)), (out, 0.0, top + 0.1 * (top - low))],
        "square": [(out, 0.0, low), (out, 0.0, top)],
        "ear": [(r_low + 0.7 * reach, 0.0, low), (out, 0.0, (low + top) / 2), (out, 0.0, top)],
    }
    kind = draw.choose(["arc", "square", "ear"])
    soft = {"arc": 0.04, "square": 0.018, "ear": 0.03}[kind]
    return tube(rounded_path([a, *corners[kind], b], soft), radius)


def horn(path_m: Points, radii_m: Points) -> "Manifold":
    """A smooth tapering horn with round ends: the hull of each ball with the next.

    Args:
        path_m: (n, 3) centres of the balls.
        radii_m: (n,) their radii.
    """
    from manifold3d import Manifold, OpType

    balls = [
        Manifold.sphere(float(r), 24).translate(tuple(p))
        for p, r in zip(path_m.tolist(), radii_m, strict=True)
    ]
    links = [Manifold.batch_hull([balls[k], balls[k + 1]]) for k in range(len(balls) - 1)]
    return Manifold.batch_boolean(links, OpType.Add)


def _curve(points: Sequence[Vector3], count: int) -> Points:
    """A Bezier curve (count, 3) with three or four control points."""
    ends = np.array(points, np.float64)
    share = np.linspace(0, 1, count)[:, None]
    while len(ends) > 1 and ends.ndim == 2:
        # De Casteljau's scheme for all points of the curve at once.
        ends = ends[:, None, :] + np.zeros((1, count, 1))
    while len(ends) > 1:
        ends = (1 - share) * ends[:-1] + share * ends[1:]
    return np.asarray(ends[0])


def kettle(draw: Draw) -> Parts:
    """Draw a kettle or a teapot, closed, with a spout; nothing is thinner than 12 mm."""
    kind = draw.choose(["dome", "cone", "round", "drum"])
    high, radius = draw.between(0.12, 0.18), draw.between(0.085, 0.12)
    look = draw.pick(palettes.GLAZES if kind == "round" else palettes.ENAMELS)
    share = {
        "dome": [(0.92, 0.0), (1.0, 0.12), (0.96, 0.5), (0.7, 0.85), (0.42, 1.0)],
        "cone": [(1.0, 0.0), (1.02, 0.06), (0.86, 0.45), (0.62, 0.9), (0.5, 1.0)],
        "round": [(0.55, 0.0), (0.85, 0.2), (1.0, 0.5), (0.8, 0.82), (0.45, 1.0)],
        "drum": [(0.96, 0.0), (1.0, 0.06), (1.0, 0.7), (0.93, 0.92), (0.6, 1.0)],
    }[kind]
    profile = smooth_profile([(r * radius, z * high) for r, z in share])
    yield Part("body", turned([(0.0, 0.0), *_pairs(profile), (0.0, high)]), look)
    yield from _lid(draw, float(profile[-1, 0]), high, look)
    start = draw.between(0.3, 0.5) * high
    root = float(np.interp(start, profile[:, 1], profile[:, 0]))
    tip = (radius + draw.between(0.05, 0.08), 0.0, high * draw.between(0.9, 1.1))
    lead = (tip[0] - 0.02, 0.0, start) if draw.chance(0.5) else (tip[0] - 0.045, 0.0, 0.7 * high)
    path = _curve([(root - 0.02, 0.0, start - 0.01), lead, tip], 10)
    thick = np.linspace(draw.between(0.022, 0.03), draw.between(0.012, 0.016), 10)
    yield Part("spout", horn(path, thick), look)
    grip = draw.pick((looks.METALS[3], looks.WOODS[1], looks.WOODS[4])) if draw.chance(0.5) else look
    bar = draw.between(0.0072, 0.01)
    if kind == "round" and draw.chance(0.6):
        ear = _ear(draw, profile, (0.2 * high, 0.82 * high), draw.between(0.045, 0.055), bar)
        yield Part("handle", ear.mirror((1.0, 0.0, 0.0)), grip)
        return
    hold = draw.between(0.72, 0.85) * high
    at = float(np.interp(hold, profile[:, 1], profile[:, 0])) - 0.008
    top = high + draw.between(0.085, 0.12)
    arch: list[Vector3] = [(-at, 0.0, hold), (-at, 0.0, top), (at, 0.0, top), (at, 0.0, hold)]
    if draw.chance(0.4):
        # The arch leans to the back, away from the spout.
        arch = [(-at, 0.0, hold), (-1.2 * at, 0.0, top), (0.5 * at, 0.0, top), (at, 0.0, hold)]
    turn = draw.choose([0.0, 90.0]) if arch[1][0] == -at else 0.0
    shape = tube(rounded_path(arch, draw.between(0.05, 0.09)), bar).scale((1.0, draw.between(1.0, 1.4), 1.0))
    yield Part("handle", shape.rotate((0.0, 0.0, turn)), grip)


def _pairs(profile: Points) -> list[Vector2]:
    return [(float(r), float(z)) for r, z in profile]


def _lid(draw: Draw, radius: float, high: float, look: Look) -> Parts:
    """A lid that lies on a kettle's neck, with a knob."""
    rise, wide = draw.between(0.012, 0.022), radius + draw.between(-0.004, 0.006)
    line = smooth_profile([(wide, high - 0.006), (wide, high + 0.004), (0.6 * wide, high + 0.8 * rise)])
    yield Part("lid", turned([(0.0, high - 0.006), *_pairs(line), (0.0, high + rise)]), look)
    ball, z = draw.between(0.011, 0.016), high + rise
    path = np.array([(0.0, 0.0, z - 0.002), (0.0, 0.0, z + ball)])
    yield Part(
        "knob", horn(path, np.array([0.0085, ball])), draw.pick((look, looks.WOODS[1], looks.METALS[3]))
    )


def vase(draw: Draw) -> Parts:
    """Draw a vase, open at its top; its wall is 8 mm thick or more."""
    look, wall, high = draw.pick(palettes.GLAZES), draw.between(0.009, 0.014), draw.between(0.20, 0.44)
    wide = max(0.06, high * draw.between(0.2, 0.3))
    neck, lip = draw.between(0.4, 0.65), draw.between(0.55, 0.9)
    share = {
        "bottle": [(0.65, 0.0), (1.0, 0.32), (0.95, 0.45), (neck, 0.75), (neck, 0.88), (lip, 1.0)],
        "shoulder": [(0.55, 0.0), (0.7, 0.25), (1.0, 0.72), (neck, 0.93), (lip, 1.0)],
        "pot": [(0.6, 0.0), (0.98, 0.35), (1.0, 0.5), (0.75, 0.9), (0.82, 1.0)],
        "trumpet": [(0.62, 0.0), (0.55, 0.2), (0.6, 0.5), (0.75, 0.8), (1.0, 1.0)],
        "beaker": [(0.6, 0.0), (0.75, 0.4), (0.9, 1.0)],
    }
    kind = draw.choose(list(share))
    # So narrow a neck lets at least 12 mm of air through beside its walls.
    least = wall + 0.014
    line = smooth_profile([(max(r * wide, least), z * (high - 1.5 * wall)) for r, z in share[kind]])
    # Below its lip it is upright, so that a wide mouth does not end in a thin edge.
    profile = np.concatenate([line, [(line[-1, 0], high - wall / 2)]])
    profile[0, 0] = max(profile[0, 0], 0.035)
    body, room = vessel(profile, wall, wall + draw.between(0.002, 0.01))
    handled = kind in ("bottle", "shoulder") and draw.chance(0.4)
    # Where ribs are steepest, they make the wall thinner by the cosine of their slope: 8 % at most.
    ribs, steep = draw.choose([0, 0, 6, 8, 12]) if not handled else 0, draw.between(0.15, 0.4)
    twist = draw.between(-4.0, 4.0)

    def fluted(shape: "Manifold") -> "Manifold":
        """The shape with ribs around its axis that wind as they rise."""

        def move(points: Points) -> Points:
            angle = np.arctan2(points[:, 1], points[:, 0]) + twist * points[:, 2]
            # The cosine's least value leaves the wall as it was.
            swell = 1 + steep / ribs * (1 + np.cos(ribs * angle))
            return points * np.column_stack([swell, swell, np.ones_like(swell)])

        return bent(shape, move, 0.012) if ribs else shape

    yield Part("body", fluted(body), look)
    if draw.chance(0.5):
        low, thick = draw.between(0.1, 0.6) * high, draw.between(0.05, 0.2) * high
        yield Part(
            "band", fluted(band(profile, low, low + thick, 0.002, wall / 2)), draw.pick(palettes.GLAZES)
        )
    if handled:
        ends = (draw.between(0.5, 0.6) * high, draw.between(0.84, 0.9) * high)
        ear = _ear(draw, profile, ends, draw.between(0.035, 0.05), draw.between(0.0066, 0.009))
        for side in SIDES:
            shape = ear if side > 0 else ear.mirror((1.0, 0.0, 0.0))
            yield Part("handle", shape - room, look)


def bottle(draw: Draw) -> Parts:
    """Draw a bottle with its cap on: closed, 60 to 80 mm wide."""
    look = draw.pick(palettes.GLAZES)
    radius, high = draw.between(0.03, 0.04), draw.between(0.16, 0.28)
    neck = draw.between(0.012, 0.016)
    share = {
        "shoulder": [(0.95, 0.0), (1.0, 0.03), (1.0, 0.62), (neck / radius, 0.8), (neck / radius, 0.93)],
        "cone": [(1.0, 0.0), (1.0, 0.35), (0.7, 0.65), (neck / radius, 0.85), (neck / radius, 0.93)],
        "flask": [
            (0.8, 0.0),
            (1.0, 0.1),
            (1.0, 0.3),
            (0.6, 0.55),
            (neck / radius, 0.7),
            (neck / radius, 0.93),
        ],
    }[draw.choose(["shoulder", "cone", "flask"])]
    profile = smooth_profile([(r * radius, z * high) for r, z in share])
    yield Part("body", turned([(0.0, 0.0), *_pairs(profile), (0.0, 0.93 * high)]), look)
    cap = neck + draw.between(0.001, 0.004)
    line = [(0.0, 0.92 * high), (cap, 0.92 * high), (cap, high), (0.0, high)]
    yield Part("cap", turned(line), draw.pick(looks.PLASTICS))
    if draw.chance(0.6):
        yield Part("label", band(profile, 0.15 * high, 0.5 * high, 0.0006, 0.004), draw.pick(looks.PLASTICS))

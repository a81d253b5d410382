"""What hollow objects are made of: vessels with walls, rims, feet, slots and handles.

Frame `object`, metres. Walls, rims and bars are at least `THIN_M` thick: two voxels of 5 mm fit into them.
All sizes are own choices.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from kinectbench.lab.simulate.objects.joinery import Draw, Part, Parts
from kinectbench.lab.simulate.objects.looks import Look
from kinectbench.lab.simulate.objects.shapes import (
    Outline,
    Vector2,
    box,
    ellipse,
    leg,
    rectangle,
    rod,
    rounded_path,
    tube,
)

if TYPE_CHECKING:
    from manifold3d import Manifold

Footprint = Literal["round", "oval", "rectangle"]
Rim = Literal["plain", "rolled", "flanged", "collar"]

THIN_M = 0.0125
# A cavity is cut to this height above the rim, and what is fixed to a wall begins this far inside its face.
BEYOND_M = 0.05


def grown(outline: Outline, by_m: float) -> Outline:
    """A convex outline (n, 2), counterclockwise, each of whose sides moves outward by `by_m`."""
    sides = np.roll(outline, -1, axis=0) - outline
    normals = np.column_stack([sides[:, 1], -sides[:, 0]]) / np.linalg.norm(sides, axis=1, keepdims=True)
    before = np.roll(normals, 1, axis=0)
    # Where two sides meet, their shifted lines cross on the bisector of their normals.
    bisectors = (normals + before) / (1 + (normals * before).sum(axis=1, keepdims=True))
    return np.asarray(outline + by_m * bisectors)


def tub(low: Outline, high: Outline, low_m: float, high_m: float, edge_m: float = 0.0) -> "Manifold":
    """The solid between a convex outline at one height and one at another, its lower edge rounded.

    Args:
        low: (n, 2), metres.
        high: (n, 2), metres; of as many points.
        low_m: height of the lower face.
        high_m: height of the upper face.
        edge_m: radius of the lower edge.
    """
    from manifold3d import Manifold

    rings = [np.column_stack([high, np.full(len(high), high_m)])]
    for turn in np.linspace(0, np.pi / 2, 6) if edge_m > 0 else [np.pi / 2]:
        up_m = edge_m * (1 - np.cos(turn))
        side = low + up_m / (high_m - low_m) * (high - low)
        ring = side * (1 - edge_m * (1 - np.sin(turn)) / (np.ptp(side, axis=0) / 2))
        rings.append(np.column_stack([ring, np.full(len(ring), low_m + up_m)]))
    return Manifold.hull_points(np.concatenate(rings))


def footprint(kind: Footprint, size_m: Vector2, radius_m: float) -> Outline:
    """An outline (n, 2) of a kind and a size; `radius_m` rounds the corners of rectangles."""
    return rectangle(size_m, radius_m) if kind == "rectangle" else ellipse(size_m)


@dataclass(frozen=True)
class Vessel:
    """A vessel that is open at the top, with straight walls between the two outlines of its cavity.

    Attributes:
        low: (n, 2) outline of the cavity at its floor, metres.
        high: (n, 2) outline of the cavity at the top; its sides are parallel to those of `low`.
        base_m: height of the underside.
        floor_m: height of the cavity's floor.
        top_m: height of the rim.
        wall_m: thickness of the walls, square to them.
        edge_m: radius of the cavity's lower edge.
    """

    low: Outline
    high: Outline
    base_m: float
    floor_m: float
    top_m: float
    wall_m: float
    edge_m: float = 0.0

    def inner(self, height_m: float) -> Outline:
        """The cavity's outline (n, 2) at a height, also beyond its ends."""
        share = (height_m - self.floor_m) / (self.top_m - self.floor_m)
        return np.asarray(self.low + share * (self.high - self.low))

    def outer(self, height_m: float, more_m: float = 0.0) -> Outline:
        """The outline (n, 2) of the walls' outer faces at a height, perhaps grown by `more_m`."""
        run = np.linalg.norm(self.high - self.low, axis=1).max() / (self.top_m - self.floor_m)
        return grown(self.inner(height_m), self.wall_m * float(np.hypot(1, run)) + more_m)

    def band(self, low_m: float, high_m: float, more_m: float) -> "Manifold":
        """A band around the walls between two heights, `more_m` thicker than they are."""
        low, high = self.outer(low_m, more_m), self.outer(high_m, more_m)
        return tub(low, high, low_m, high_m) - self.core()

    def cavity(self) -> "Manifold":
        """What is hollow, and a little above it."""
        above_m = self.top_m + BEYOND_M
        return tub(self.low, self.inner(above_m), self.floor_m, above_m, self.edge_m)

    def core(self) -> "Manifold":
        """The cavity and the inner part of the walls: others keep out of it, so that no faces coincide."""
        above_m = self.top_m + BEYOND_M
        low, high = (grown(self.inner(z), 0.4 * self.wall_m) for z in (self.floor_m, above_m))
        return tub(low, high, self.floor_m - 0.4 * (self.floor_m - self.base_m), above_m)

    def body(self) -> "Manifold":
        """Walls and bottom."""
        thick_m = min(self.wall_m, self.floor_m - self.base_m)
        edge_m = self.edge_m + thick_m if self.edge_m > 0 else 0.0
        outer = tub(self.outer(self.base_m), self.outer(self.top_m), self.base_m, self.top_m, edge_m)
        return outer - self.cavity()

    def reach_m(self, height_m: float, aside_m: float = 0.0) -> float:
        """How far the outer faces reach to +x at a height, beside the middle by `aside_m`."""
        right = self.outer(height_m)
        right = right[right[:, 0] > 0]
        right = right[np.argsort(right[:, 1])]
        return float(np.interp(aside_m, right[:, 1], right[:, 0]))


def turned_by(shape: "Manifold", turn_rad: float) -> "Manifold":
    """A shape turned about the z axis."""
    return shape.rotate((0.0, 0.0, float(np.degrees(turn_rad))))


def rim(draw: Draw, vessel: Vessel, kind: Rim, look: Look) -> Parts:
    """What runs around the top of a vessel: nothing, a roll, a flange, or a collar that reaches down."""
    # A rim stands a little higher than the wall that it goes around.
    top_m, core = vessel.top_m + 0.002, vessel.core()
    if kind == "rolled":
        radius = draw.between(0.0075, 0.012)
        ring = vessel.outer(top_m - radius, 0.3 * radius)
        path = np.column_stack([ring, np.full(len(ring), top_m - radius)])
        yield Part("rim", tube(np.concatenate([path, path[:1]]), radius) - core, look)
    elif kind == "flanged":
        low_m, more_m = top_m - draw.between(THIN_M, 0.018), draw.between(0.012, 0.03)
        ring = vessel.outer(top_m, more_m)
        yield Part("rim", tub(ring, ring, low_m, top_m) - core, look)
    elif kind == "collar":
        high = draw.between(0.03, 0.08)
        yield Part("rim", vessel.band(top_m - high, top_m, draw.between(0.006, 0.012)), look)


def foot_ring(vessel: Vessel, share: float, look: Look) -> Part:
    """A ring on the floor under a vessel whose underside is raised, as wide as a share of its cavity."""
    inside = vessel.inner(vessel.base_m) * share
    outside, high_m = grown(inside, 0.016), vessel.base_m + 0.006
    ring = tub(outside, outside, 0.0, high_m) - tub(inside, inside, -BEYOND_M, high_m + BEYOND_M)
    return Part("foot ring", ring, look)


def knob_feet(vessel: Vessel, count: int, size_m: float, look: Look) -> Parts:
    """Short round feet on the floor under a vessel whose underside is raised."""
    half = np.ptp(vessel.inner(vessel.base_m), axis=0) / 2 * 0.68
    for turn in (np.arange(count) + 0.5) * 2 * np.pi / count:
        at = (half[0] * float(np.cos(turn)), half[1] * float(np.sin(turn)))
        foot = leg((*at, 0.0), (*at, vessel.base_m + 0.006), 0.8 * size_m, size_m, is_round=True)
        yield Part("foot", foot, look)


def slot(vessel: Vessel, at_m: Vector2, width_m: float, height_m: float) -> "Manifold":
    """What is cut out of the wall at +x: a hole with round ends, upright if it is higher than wide.

    Args:
        vessel: whose wall.
        at_m: its middle, along the wall and in height.
        width_m: along the wall.
        height_m: in height.
    """
    from manifold3d import Manifold

    radius = min(width_m, height_m) / 2
    far_m = vessel.reach_m(vessel.top_m) + BEYOND_M
    near_m = 0.35 * far_m
    aside, up = width_m / 2 - radius, height_m / 2 - radius
    ends = [
        rod(
            (near_m, at_m[0] + s * aside, at_m[1] + s * up),
            (far_m, at_m[0] + s * aside, at_m[1] + s * up),
            radius,
        )
        for s in (-1, 1)
    ]
    return Manifold.batch_hull(ends)


def loop_handle(vessel: Vessel, height_m: float, width_m: float, out_m: float, radius_m: float) -> "Manifold":
    """A level loop of a round bar at the wall's outer face at +x.

    Args:
        vessel: whose wall.
        height_m: where.
        width_m: along the wall, between the bar's middle lines.
        out_m: from the wall's outer face to the bar's middle line.
        radius_m: of the bar.
    """
    half, far_m = width_m / 2, vessel.reach_m(height_m) + out_m
    near_m = vessel.reach_m(height_m, half) - BEYOND_M
    path = [
        (near_m, -half, height_m),
        (far_m, -half, height_m),
        (far_m, half, height_m),
        (near_m, half, height_m),
    ]
    return tube(rounded_path(path, 0.6 * min(half, out_m)), radius_m) - vessel.core()


def grip_handle(vessel: Vessel, width_m: float, high_m: float, radius_m: float) -> "Manifold":
    """An upright loop of a round bar on the rim at +x, which a roll or a flange carries."""
    half, low_m, high = width_m / 2, vessel.top_m - 0.011, vessel.top_m + high_m
    # The bar begins in the wall and the rim; where the wall is round, it must not reach through it.
    x = vessel.reach_m(vessel.top_m, half) - vessel.wall_m + radius_m + 0.003
    path = [(x, -half, low_m), (x, -half, high), (x, half, high), (x, half, low_m)]
    return tube(rounded_path(path, 0.7 * min(half, high_m)), radius_m)


def block_handle(vessel: Vessel, height_m: float, width_m: float, out_m: float, thick_m: float) -> "Manifold":
    """A solid lug at the wall's outer face at +x."""
    near_m = vessel.reach_m(height_m, width_m / 2) - BEYOND_M
    far_m = vessel.reach_m(height_m) + out_m
    low, high = height_m - thick_m / 2, height_m + thick_m / 2
    return box((near_m, -width_m / 2, low), (far_m, width_m / 2, high)) - vessel.core()


def both_sides(name: str, shape: "Manifold", look: Look, turns_rad: Sequence[float] = (0.0, np.pi)) -> Parts:
    """A shape made for +x, turned to several sides."""
    for turn in turns_rad:
        yield Part(name, turned_by(shape, turn), look)

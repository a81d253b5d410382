"""Solids made of convex parts: exact to mesh, and exact to test for inside.

A solid is the union of its parts. No boolean engine is needed: rays from outside hit the union's surface
first, and a point is inside the union if it is inside a part. The mesh of a solid is therefore the
concatenation of closed parts, which may overlap; its winding number is above zero exactly inside the union.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

Outline = Literal["rectangle", "rounded", "ellipse"]
Vector2 = tuple[float, float]
Vector3 = tuple[float, float, float]

ELLIPSE_SIDES = 28
CORNER_SEGMENTS = 3
CORNER_SHARE = 0.2


@dataclass(frozen=True)
class Mesh:
    """A closed triangle mesh, outward faces counter-clockwise.

    Attributes:
        vertices: (n, 3) float64, metres.
        triangles: (m, 3) int64, indices of vertices.
    """

    vertices: NDArray[np.float64]
    triangles: NDArray[np.int64]


@dataclass(frozen=True)
class Part:
    """A convex piece: a horizontal outline joined by straight lines to its scaled copy higher up.

    Boxes, cylinders, tapered and splayed legs and leaning backs are all of this kind, and feet stay flat.

    Attributes:
        name: what it is, such as "leg".
        outline: shape of the bottom; "rounded" is a rectangle with round corners.
        size_m: extent of the bottom outline along x and y, metres.
        bottom_m: centre of the bottom, object frame, metres.
        top_m: centre of the top, object frame, metres; higher than the bottom.
        top_scale: size of the top relative to the bottom.
        yaw_rad: turn of the outline about z, radians.
        color_rgb: its colour, each in [0, 1].
    """

    name: str
    outline: Outline
    size_m: Vector2
    bottom_m: Vector3
    top_m: Vector3
    top_scale: float = 1.0
    yaw_rad: float = 0.0
    color_rgb: Vector3 = (0.6, 0.6, 0.6)

    def rings(self) -> NDArray[np.float64]:
        """Bottom and top outlines (2, n, 3), counter-clockwise seen from above, object frame, metres."""
        c, s = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        flat = outline_points(self.outline, self.size_m) @ np.array([[c, s], [-s, c]])
        flat = np.column_stack([flat, np.zeros(len(flat))])
        return np.stack([flat + self.bottom_m, flat * self.top_scale + self.top_m])

    def mesh(self) -> Mesh:
        """The closed mesh of the part, object frame."""
        rings = self.rings()
        n = rings.shape[1]
        i = np.arange(n)
        j = (i + 1) % n
        fan = np.arange(1, n - 1)
        first = np.zeros_like(fan)
        triangles = [
            np.column_stack([i, j, n + j]),
            np.column_stack([i, n + j, n + i]),
            np.column_stack([first, fan + 1, fan]),
            np.column_stack([first + n, fan + n, fan + 1 + n]),
        ]
        return Mesh(rings.reshape(-1, 3), np.concatenate(triangles))

    def planes(self) -> NDArray[np.float64]:
        """Faces (m, 4) as [a, b, c, d], unit outward normals: inside where `a x + b y + c z + d <= 0`."""
        bottom, top = self.rings()
        along = np.roll(bottom, -1, axis=0) - bottom
        normals = np.cross(along, top - bottom)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        sides = np.column_stack([normals, -np.sum(normals * bottom, axis=1)])
        caps = [[0.0, 0.0, -1.0, self.bottom_m[2]], [0.0, 0.0, 1.0, -self.top_m[2]]]
        return np.concatenate([sides, np.array(caps)])

    def to_json(self) -> dict[str, Any]:
        """The part as plain JSON values."""
        return asdict(self)

    @classmethod
    def from_json(cls, value: Mapping[str, Any]) -> "Part":
        """The part that `to_json` wrote; KeyError, TypeError or ValueError if it is not one."""
        tuples = {k: tuple(map(float, value[k])) for k in ("size_m", "bottom_m", "top_m", "color_rgb")}
        return cls(**{**value, **tuples})


@dataclass(frozen=True)
class Solid:
    """The union of convex parts, in its object frame: z up, standing on z = 0, centred at x = y = 0."""

    parts: tuple[Part, ...]

    def mesh(self) -> Mesh:
        """All parts' closed meshes, one after the other, object frame."""
        return join([part.mesh() for part in self.parts])

    def bounds_m(self) -> NDArray[np.float64]:
        """Lowest and highest corner (2, 3), object frame, metres."""
        vertices = self.mesh().vertices
        return np.stack([vertices.min(axis=0), vertices.max(axis=0)])

    def contains(self, points_object: NDArray[np.floating]) -> NDArray[np.bool_]:
        """Which points (..., 3), object frame, lie inside or on the solid: bool (...)."""
        inside = np.zeros(points_object.shape[:-1], dtype=np.bool_)
        for part in self.parts:
            planes = part.planes()
            inside |= np.all(points_object @ planes[:, :3].T + planes[:, 3] <= 0, axis=-1)
        return inside


def join(meshes: list[Mesh]) -> Mesh:
    """Concatenate meshes into one."""
    offsets = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes[:-1]])
    triangles = [mesh.triangles + offset for mesh, offset in zip(meshes, offsets, strict=True)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(triangles))


def outline_points(outline: Outline, size_m: Vector2) -> NDArray[np.float64]:
    """Corners (n, 2) of a convex outline around the origin, counter-clockwise, metres."""
    half = np.array(size_m) / 2
    if outline == "ellipse":
        angle = np.arange(ELLIPSE_SIDES) * 2 * np.pi / ELLIPSE_SIDES
        return np.column_stack([np.cos(angle), np.sin(angle)]) * half
    corners = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
    if outline == "rectangle":
        return corners * half
    radius = CORNER_SHARE * min(size_m)
    steps = np.linspace(0, np.pi / 2, CORNER_SEGMENTS + 1)
    arc = np.column_stack([np.cos(steps), np.sin(steps)]) * radius
    quarter_turn = np.array([[0.0, 1.0], [-1.0, 0.0]])
    turned = [arc @ np.linalg.matrix_power(quarter_turn, k) for k in range(4)]
    return np.concatenate([corners[k] * (half - radius) + turned[k] for k in range(4)])

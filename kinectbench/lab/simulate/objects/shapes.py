"""Shapes from which objects are made: boards, cushions, legs, tubes, turned pieces; and the object itself.

Shapes are Manifolds of the library manifold3d: closed, oriented outwards, float64, metres. In frame `object`,
x is to the right, y to the front, z up. Curved surfaces are inscribed polyhedra of `SEGMENTS` sides.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from manifold3d import CrossSection, Error, FillRule, Manifold, Mesh64, OpType
from numpy.typing import NDArray

from kinectbench.core.geometry import TriangleMesh

Vector3 = tuple[float, float, float]
Vector2 = tuple[float, float]
Size = Vector2 | float
Outline = NDArray[np.float64]
Points = NDArray[np.float64]

SEGMENTS = 24
TUBE_SEGMENTS = 12
CORNER_EDGE_M = 0.03
BEND_EDGE_M = 0.05


@dataclass(frozen=True)
class Piece:
    """A visible piece of an object, of one colour and albedo.

    Attributes:
        name: kind of the part, such as "leg".
        mesh: triangles, object frame, metres; pieces may overlap, and need not be closed.
        color_rgb: red, green and blue, each in [0, 1].
        albedo: reflected share of infrared light, in [0, 1]; dark pieces give less depth.
    """

    name: str
    mesh: TriangleMesh
    color_rgb: Vector3
    albedo: float = 0.6


@dataclass(frozen=True)
class Subject:
    """The object of a simulated recording, in frame `object`: z up, on z = 0, centred at x = y = 0.

    Attributes:
        name: the object's name, such as "chair:seed=3", or a mesh file's name.
        pieces: the pieces that a camera sees.
        mesh: the solid's surface: watertight, outward, without inner faces; metres.
        origin: where the solid comes from and how it was closed, one line.
    """

    name: str
    pieces: tuple[Piece, ...]
    mesh: TriangleMesh
    origin: str


def box(low_m: Vector3, high_m: Vector3) -> Manifold:
    """Make the axis-aligned box from its lowest to its highest corner."""
    low, high = np.array(low_m, np.float64), np.array(high_m, np.float64)
    return Manifold.cube(tuple(high - low)).translate(tuple(low))


def rectangle(size_m: Vector2, radius_m: float = 0.0) -> Outline:
    """Return the outline (n, 2) float64, metres, of a centred rectangle, perhaps with round corners."""
    half = np.array(size_m) / 2 - radius_m
    segments = int(np.clip(np.pi / 2 * radius_m / CORNER_EDGE_M, 4, 16))
    steps = np.linspace(0, np.pi / 2, segments + 1) if radius_m > 0 else np.zeros(1)
    corners = []
    for turn, (sx, sy) in enumerate([(1, 1), (-1, 1), (-1, -1), (1, -1)]):
        angle = steps + turn * np.pi / 2
        arc = radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
        corners.append(np.array([sx, sy]) * half + arc)
    return np.concatenate(corners)


def ellipse(size_m: Vector2) -> Outline:
    """Return the outline (n, 2) float64, metres, of an ellipse around the origin with these full axes."""
    angle = np.arange(2 * SEGMENTS) * np.pi / SEGMENTS
    return np.column_stack([np.cos(angle) * size_m[0], np.sin(angle) * size_m[1]]) / 2


def plate(outline: Outline, low_m: float, high_m: float, edge_m: float = 0.0) -> Manifold:
    """Make a horizontal plate with a convex outline (n, 2) around the origin, between two heights.

    Args:
        outline: the convex outline, metres.
        low_m: height of the lower face.
        high_m: height of the upper face.
        edge_m: radius of the rounded edges, at most half the thickness.
    """
    half = np.ptp(outline, axis=0) / 2
    turns = np.linspace(-np.pi / 2, np.pi / 2, 9) if edge_m > 0 else np.array([-np.pi / 2, np.pi / 2])
    rings = []
    for turn in turns:
        inset = edge_m * (1 - np.cos(turn)) if edge_m > 0 else 0.0
        z = high_m - edge_m if turn > 0 else low_m + edge_m
        ring = outline * (1 - inset / half)
        rings.append(np.column_stack([ring, np.full(len(ring), z + edge_m * np.sin(turn))]))
    return Manifold.hull_points(np.concatenate(rings))


def cushion(low_m: Vector3, high_m: Vector3, radius_m: float, crown_m: float = 0.0) -> Manifold:
    """Make a box with rounded edges and corners, whose upper face bulges by `crown_m` in the middle.

    `low_m` and `high_m` are opposite corners of the box, `radius_m` is the radius of the edges.
    """
    low, high = np.array(low_m, np.float64), np.array(high_m, np.float64)
    radius_m = min(radius_m, float((high - low).min()) / 2 * 0.999)
    ball = Manifold.sphere(radius_m, 16)
    inner = np.stack([low + radius_m, high - radius_m])
    at = [tuple(inner[list(corner), range(3)]) for corner in np.ndindex(2, 2, 2)]
    block = Manifold.batch_hull([ball.translate(point) for point in at])
    if crown_m <= 0:
        return block
    middle, half = (low + high) / 2, (high - low) / 2

    def swell(points: Points) -> Points:
        x, y, z = ((points - middle) / half).T
        lift = np.clip(1 - x**2, 0, 1) * np.clip(1 - y**2, 0, 1) * np.clip(z, 0, 1)
        raised: Points = points + np.column_stack([0 * lift, 0 * lift, crown_m * lift])
        return raised

    return bent(block, swell, 0.09)


def leg(
    foot_m: Vector3, head_m: Vector3, foot_size_m: Size, head_size_m: Size, *, is_round: bool = False
) -> Manifold:
    """Make a prism between two horizontal ends, perhaps leaning and tapered.

    An end's size is in x and y, or one number if both are the same; round ends are ellipses.
    """
    ends = []
    for center, size in ((foot_m, foot_size_m), (head_m, head_size_m)):
        size_m = size if isinstance(size, tuple) else (size, size)
        outline = ellipse(size_m)[::3] if is_round else rectangle(size_m)
        ends.append(np.column_stack([outline, np.zeros(len(outline))]) + np.array(center))
    return Manifold.hull_points(np.concatenate(ends))


def rod(a_m: Vector3, b_m: Vector3, radius_m: float) -> Manifold:
    """Make a round bar between two points, with flat ends."""
    a, b = np.array(a_m, np.float64), np.array(b_m, np.float64)
    bar = Manifold.cylinder(float(np.linalg.norm(b - a)), radius_m, radius_m, SEGMENTS)
    return bar.transform(_frame(a, b))


def bar_between(a_m: Vector3, b_m: Vector3, width_m: float, height_m: float) -> Manifold:
    """Make a rectangular bar between two points; its width is horizontal, its ends are cut square."""
    a, b = np.array(a_m, np.float64), np.array(b_m, np.float64)
    block = Manifold.cube((width_m, height_m, float(np.linalg.norm(b - a))))
    return block.translate((-width_m / 2, -height_m / 2, 0.0)).transform(_frame(a, b))


def _frame(a: Points, b: Points) -> NDArray[np.float64]:
    """Return the transform (3, 4) with origin a, z in the direction from a to b, and a horizontal x axis."""
    forward = (b - a) / np.linalg.norm(b - a)
    side = np.array([-forward[1], forward[0], 0.0])
    length = np.linalg.norm(side)
    side = side / length if length > 1e-9 else np.array([1.0, 0.0, 0.0])
    return np.column_stack([side, np.cross(forward, side), forward, a])


def tube(path_m: Sequence[Vector3] | Points, radius_m: float) -> Manifold:
    """Make a round tube along a polyline (n, 3), mitred at its corners.

    Its ends are flat. A planar path that ends where it begins gives a closed ring.
    """
    path = np.array(path_m, np.float64)
    closed = bool(np.allclose(path[0], path[-1]))
    steps = np.diff(path, axis=0)
    ways = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    angle = np.arange(TUBE_SEGMENTS) * 2 * np.pi / TUBE_SEGMENTS
    side, up = _frame(path[0], path[1])[:, :2].T
    ring = path[0] + radius_m * (np.cos(angle)[:, None] * side + np.sin(angle)[:, None] * up)
    planes = np.concatenate([ways[:1], ways[:-1] + ways[1:], ways[-1:]])
    if closed:
        planes[0] = planes[-1] = ways[-1] + ways[0]
    rings = []
    for point, normal, way in zip(path, planes, np.concatenate([ways[:1], ways]), strict=True):
        # The tube's lines continue in their direction to the plane that bisects the corner.
        ring = ring + ((point - ring) @ normal / (way @ normal))[:, None] * way
        rings.append(ring)
    rings = rings[:-1] if closed else rings
    points = np.concatenate(rings)
    return Manifold(Mesh64(points, _tube_faces(len(rings), closed)))


def _tube_faces(rings: int, closed: bool) -> NDArray[np.uint64]:
    """Return the faces (m, 3) between a tube's consecutive rings of points, and of its ends unless closed."""
    ring = np.arange(TUBE_SEGMENTS)
    beside = (ring + 1) % TUBE_SEGMENTS
    faces = []
    for first in range(rings if closed else rings - 1):
        a, b = first * TUBE_SEGMENTS, (first + 1) % rings * TUBE_SEGMENTS
        faces += [np.column_stack([a + ring, a + beside, b + beside])]
        faces += [np.column_stack([a + ring, b + beside, b + ring])]
    if not closed:
        cap = np.column_stack([np.zeros_like(ring[2:]), ring[2:], ring[1:-1]])
        faces += [cap, cap[:, ::-1] + (rings - 1) * TUBE_SEGMENTS]
    return np.concatenate(faces).astype(np.uint64)


def ribbon(path_yz_m: Sequence[Vector2] | Points, x_m: Vector2, thick_m: float) -> Manifold:
    """Make a strip of constant thickness and round ends along a path (n, 2) in y and z, over a range of x."""
    disc = CrossSection.circle(thick_m / 2, 16)
    at = [disc.translate((float(y), float(z))) for y, z in path_yz_m]
    links = [CrossSection.batch_hull([at[k], at[k + 1]]) for k in range(len(at) - 1)]
    profile = CrossSection.batch_boolean(links, OpType.Add).simplify(1e-5)
    strip = Manifold.extrude(profile, x_m[1] - x_m[0])
    return strip.transform([[0, 0, 1, x_m[0]], [1, 0, 0, 0], [0, 1, 0, 0]])


def rounded_path(path_m: Sequence[Sequence[float]], radius_m: float) -> Points:
    """Return a polyline (n, 2 or 3) with rounded corners: curves that start and end `radius_m` from them."""
    path = np.array(path_m, np.float64)
    share = np.linspace(0, 1, 6)[:, None]
    points = [path[:1]]
    for before, corner, after in zip(path[:-2], path[1:-1], path[2:], strict=True):
        ends = []
        for other in (before, after):
            length = float(np.linalg.norm(other - corner))
            ends.append(corner + (other - corner) * min(radius_m / length, 0.49))
        # A quadratic Bezier curve is tangent to both sides.
        points.append((1 - share) ** 2 * ends[0] + 2 * share * (1 - share) * corner + share**2 * ends[1])
    return np.concatenate([*points, path[-1:]])


def turned(profile_rz_m: Sequence[Vector2]) -> Manifold:
    """Make a solid of revolution about the z axis from a closed polygon of (radius, height), metres."""
    outline = np.array(profile_rz_m, np.float64)
    return Manifold.revolve(CrossSection([outline], FillRule.NonZero), 2 * SEGMENTS)


def bent(shape: Manifold, move: Callable[[Points], Points], edge_m: float = BEND_EDGE_M) -> Manifold:
    """Deform a shape: subdivide its edges to at most `edge_m`, then map its vertices (n, 3) by `move`."""
    return shape.refine_to_length(edge_m).warp_batch(move)


def bowed(low_m: Vector3, high_m: Vector3, bow_m: float) -> Manifold:
    """Make an upright board between two opposite corners, its middle bent backwards (-y) by `bow_m`."""
    middle, half = (low_m[0] + high_m[0]) / 2, (high_m[0] - low_m[0]) / 2

    def move(points: Points) -> Points:
        back = bow_m * (1 - ((points[:, 0] - middle) / half) ** 2)
        return points - np.column_stack([np.zeros(len(points)), back, np.zeros(len(points))])

    return bent(box(low_m, high_m), move) if bow_m else box(low_m, high_m)


def leaned(shape: Manifold, from_m: float, slope: float) -> Manifold:
    """Shear a shape backwards (-y) by `slope` metres for each metre above the height `from_m`."""
    return shape.transform([[1, 0, 0, 0], [0, 1, -slope, slope * from_m], [0, 0, 1, 0]])


def union(shapes: Sequence[Manifold]) -> Manifold:
    """Return the union of shapes, without inner faces."""
    return Manifold.batch_boolean(list(shapes), OpType.Add)


def solid(vertices: Points, faces: NDArray[np.integer]) -> Manifold | None:
    """Return the solid inside a mesh, with negative volume if its faces point inwards; None if it is open."""
    shape = Manifold(Mesh64(np.ascontiguousarray(vertices), np.ascontiguousarray(faces, np.uint64)))
    return None if shape.status() != Error.NoError or shape.is_empty() else shape


def surface(shape: Manifold) -> TriangleMesh:
    """Return the surface of a shape as triangles."""
    mesh = shape.to_mesh64()
    # Copied, because the library's own arrays are read-only.
    vertices = np.array(mesh.vert_properties[:, :3], dtype=np.float64, order="C")
    return TriangleMesh(vertices, np.array(mesh.tri_verts, dtype=np.int32, order="C"))


def standing_shift(mesh: TriangleMesh) -> Points:
    """Return the shift (3,) that centres a mesh at x = y = 0 by its bounding box and puts it on z = 0."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    return -np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])

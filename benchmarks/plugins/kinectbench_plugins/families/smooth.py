"""Smooth organic bodies: blobs and sculptures, and the distance fields that such bodies are blended of.

A field gives for points (n, 3), metres, a number (n,) that is negative inside and about the distance to the
surface near it. Formulas: I. Quilez, "Distance functions", https://iquilezles.org/articles/distfunctions.
"""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry.mesh import isosurface
from kinectbench.core.types import Float64
from kinectbench.lab.simulate.objects import looks
from kinectbench.lab.simulate.objects.joinery import Draw, Part, Parts
from kinectbench.lab.simulate.objects.shapes import Points, Vector3, box, solid, surface
from kinectbench_plugins import palettes

if TYPE_CHECKING:
    from manifold3d import Manifold

Field = Callable[[Points], Float64]

# Points of a field that are computed at once: they stay in the processor's cache; own choice.
BLOCK = 1 << 13
# A field is computed in the middle of every block of so many cells' edge, and at all points of blocks near
# the surface; own choice.
COARSE = 4
# Surfaces are thinned out as long as they move by no more than this; own choice.
THINNED_M = 1e-5
# Sides of a sphere's equator before it is displaced: 11 mm on a body of 70 cm; own choice.
SPHERE_SEGMENTS = 192
# A body is flattened where it stands until its centre of mass lies this far inside what it stands on.
STEADY_M = 0.04


def ellipsoid(points: Points, center_m: Vector3, radii_m: Vector3) -> Float64:
    """About the distance (n,) of points (n, 3) to an ellipsoid, metres, negative inside."""
    offset, radii = points - np.array(center_m), np.array(radii_m)
    inner = np.linalg.norm(offset / radii, axis=1)
    slope = np.linalg.norm(offset / radii**2, axis=1)
    distance: Float64 = inner * (inner - 1) / np.maximum(slope, 1e-9)
    # In the middle the formula is 0 by 0.
    return np.where(inner < 1e-6, -radii.min(), distance)


def cone(points: Points, a_m: Points, b_m: Points, radii_m: tuple[float, float]) -> Float64:
    """About the distance (n,) of points (n, 3) to a bar with round ends, its radius changing evenly."""
    along = b_m - a_m
    share = np.clip((points - a_m) @ along / max(float(along @ along), 1e-12), 0, 1)
    radius = radii_m[0] + (radii_m[1] - radii_m[0]) * share
    distance: Float64 = np.linalg.norm(points - a_m - share[:, None] * along, axis=1) - radius
    return distance


def limb(points: Points, path_m: Points, radii_m: Points) -> Float64:
    """About the distance (n,) of points (n, 3) to a tube along a path (m, 3) of changing radius (m,)."""
    links = [
        cone(points, path_m[k], path_m[k + 1], (float(radii_m[k]), float(radii_m[k + 1])))
        for k in range(len(path_m) - 1)
    ]
    nearest: Float64 = np.min(links, axis=0)
    return nearest


def blended(fields: Sequence[Float64], soft_m: float) -> Float64:
    """The smooth union (n,) of distances (n,): their soft minimum; joints are filled out over `soft_m`."""
    stacked = np.stack(fields)
    least = stacked.min(axis=0)
    rounded: Float64 = least - soft_m * np.log(np.exp((least - stacked) / soft_m).sum(axis=0))
    return rounded


def body(field: Field, low_m: Vector3, high_m: Vector3, step_m: float) -> "Manifold":
    """The largest piece of where a field is negative, within two corners that lie outside, as a solid.

    Args:
        field: of points (n, 3), metres.
        low_m: corner.
        high_m: opposite corner.
        step_m: edge of the cells in which the surface is sought.
    """
    low = np.array(low_m, np.float64)
    blocks = np.ceil((np.array(high_m) - low) / step_m / COARSE).astype(int)
    at = _grid(blocks)
    coarse = _values(field, low + step_m * (COARSE * at + (COARSE - 1) / 2))
    # From a block's middle to its corners it is less than its edge; half as much again for inexact fields.
    near = np.abs(coarse) < 1.5 * step_m * COARSE
    inner = _grid(np.full(3, COARSE))
    fine = np.repeat(coarse[:, None], len(inner), axis=1)
    points = COARSE * at[near][:, None] + inner
    fine[near] = _values(field, low + step_m * points.reshape(-1, 3)).reshape(-1, len(inner))
    values = np.empty(tuple(blocks * COARSE))
    cells = (COARSE * at[:, None] + inner).reshape(-1, 3)
    values[tuple(cells.T)] = fine.ravel()
    mesh = isosurface((values / step_m).astype(np.float32))
    whole = solid(low + step_m * mesh.vertices, mesh.faces)
    assert whole is not None, "a field that is positive at the box's faces has a closed surface"
    return max(whole.decompose(), key=lambda piece: piece.volume()).simplify(THINNED_M)


def _grid(shape: NDArray[np.intp]) -> NDArray[np.intp]:
    """All indices (n, 3) of an array of this shape."""
    return np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1).reshape(-1, 3)


def _values(field: Field, points: Points) -> Float64:
    """A field's values (n,), block by block."""
    starts = range(0, len(points), BLOCK)
    return np.concatenate([field(points[at : at + BLOCK]) for at in starts])


def flattened(shape: "Manifold", least_share: float) -> "Manifold":
    """Cut a body off at the bottom so that it stands on a flat face, and does not tip over.

    Args:
        shape: a body.
        least_share: of its height that is cut off at the least; more until it stands steadily.
    """
    from scipy.spatial import ConvexHull

    low, high = shape.bounding_box()[2], shape.bounding_box()[5]
    for share in np.arange(least_share, 0.5, 0.02).tolist():
        cut = shape.trim_by_plane((0.0, 0.0, 1.0), low + share * (high - low))
        cut = max(cut.decompose(), key=lambda piece: piece.volume())
        vertices = surface(cut).vertices
        foot = vertices[vertices[:, 2] < vertices[:, 2].min() + 1e-6, :2]
        if len(foot) < 3:
            continue
        sides = ConvexHull(foot).equations
        if (sides[:, :2] @ center_of_mass(cut)[:2] + sides[:, 2]).max() < -STEADY_M:
            break
    return cut


def center_of_mass(shape: "Manifold") -> Float64:
    """Centre of mass (3,) of a solid, metres: the mean of its surface's tetrahedra with the origin."""
    mesh = surface(shape)
    corners = mesh.vertices[mesh.faces]
    volume = np.linalg.det(corners)
    center: Float64 = volume @ corners.sum(axis=1) / 4 / volume.sum()
    return center


def blob(draw: Draw) -> Parts:
    """Draw a smooth closed body: a sphere displaced by waves, stretched, and flattened where it stands."""
    from manifold3d import Manifold

    count = draw.integer(3, 7)
    ways = draw.rng.normal(size=(count, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    waves = np.array([draw.between(1.2, 3.6) for _ in range(count)])
    phases = np.array([draw.between(0, 2 * np.pi) for _ in range(count)])
    heights = np.array([draw.between(0.3, 1.0) for _ in range(count)])
    heights *= draw.between(0.3, 0.6) / heights.sum() * np.sqrt(count / 3)
    stretch = np.array([draw.between(0.75, 1.25), draw.between(0.75, 1.25), draw.between(0.7, 1.35)])

    def displaced(points: Points) -> Points:
        radius = 1 + np.sin(points @ ways.T * waves + phases) @ heights
        moved: Points = points * radius[:, None] * stretch
        return moved

    ball = Manifold.sphere(1.0, SPHERE_SEGMENTS).warp_batch(displaced)
    shape = flattened(ball, draw.between(0.06, 0.16))
    x0, y0, z0, x1, y1, z1 = shape.bounding_box()
    size = draw.between(0.34, 0.69) / max(x1 - x0, y1 - y0, z1 - z0)
    yield Part(
        "body", shape.scale((size, size, size)), draw.pick(looks.CLOTHS + palettes.GLAZES[:8] + looks.STONES)
    )


def sculpture(draw: Draw) -> Parts:
    """Draw a smooth body of 40 to 90 cm with holes or arms, perhaps on a plinth; 3 cm thick or more."""
    size = draw.between(0.42, 0.85)
    kind = draw.choose([_loops, _arms, _pierced])
    field, low, high = kind(draw)
    # The unit of the fields is the sculpture's size, about.
    shape = body(field, low, high, 0.01 if kind is _pierced else 0.0125)
    on_plinth = draw.chance(0.4)
    shape = flattened(shape, draw.between(0.03, 0.07))
    x0, y0, z0, x1, y1, z1 = shape.bounding_box()
    scale = size / max(x1 - x0, y1 - y0, z1 - z0)
    look = draw.pick(looks.STONES + palettes.GLAZES[:8] + looks.METALS[:1] + looks.WOODS[:3])
    shape = shape.translate((0.0, 0.0, -z0)).scale((scale, scale, scale))
    yield Part("body", shape, look)
    if on_plinth:
        foot = shape.trim_by_plane((0.0, 0.0, -1.0), -0.02).bounding_box()
        more, thick = draw.between(0.01, 0.04), draw.between(0.03, 0.06)
        corner, opposite = (foot[0] - more, foot[1] - more, -thick), (foot[3] + more, foot[4] + more, 0.003)
        yield Part("plinth", box(corner, opposite), draw.pick(looks.STONES + looks.WOODS))


_Shape = tuple[Field, Vector3, Vector3]


def _loops(draw: Draw) -> _Shape:
    """One or two closed winding tubes that stand on a thick foot."""
    count = draw.integer(1, 3)
    turn = np.linspace(0, 2 * np.pi, 65)
    limbs: list[tuple[Points, Points]] = []
    for at in range(count):
        wide, high = draw.between(0.22, 0.32), draw.between(0.28, 0.4)
        bend, wave = draw.between(-0.1, 0.1), draw.between(0, 2 * np.pi)
        x, z = wide * np.cos(turn), high + high * np.sin(turn)
        y = bend * np.sin(2 * turn + wave) + draw.between(0.0, 0.08) * np.sin(3 * turn)
        yaw = at * draw.between(0.9, 1.6)
        path = np.column_stack([x * np.cos(yaw) - y * np.sin(yaw), x * np.sin(yaw) + y * np.cos(yaw), z])
        # Thick at the foot, thinner above.
        thick = draw.between(0.085, 0.11) + 0.03 * np.cos(turn + np.pi / 2) + 0.012 * np.sin(2 * turn + wave)
        limbs.append((path, thick))

    def field(points: Points) -> Float64:
        parts = [limb(points, path, thick) for path, thick in limbs]
        parts.append(ellipsoid(points, (0.0, 0.0, 0.0), (0.22, 0.2, 0.12)))
        return blended(parts, 0.02)

    return field, (-0.6, -0.6, -0.25), (0.6, 0.6, 1.05)


def _arms(draw: Draw) -> _Shape:
    """A trunk with two to four arms that rise in curves."""
    count, start = draw.integer(2, 5), draw.between(0, 2 * np.pi)
    share = np.linspace(0, 1, 17)[:, None]
    limbs: list[tuple[Points, Points]] = []
    for at in range(count):
        angle = start + at * 2 * np.pi / count + draw.between(-0.3, 0.3)
        out, high = draw.between(0.22, 0.36), draw.between(0.55, 0.85)
        way = np.array([np.cos(angle), np.sin(angle), 0.0])
        root = np.array([0.0, 0.0, draw.between(0.2, 0.4)])
        lead = root + out * way * draw.between(1.0, 1.5) + [0.0, 0.0, draw.between(-0.1, 0.15)]
        tip = out * way * draw.between(0.5, 1.2) + [0.0, 0.0, high]
        path = (1 - share) ** 2 * root + 2 * share * (1 - share) * lead + share**2 * tip
        ends = draw.between(0.07, 0.085), draw.between(0.06, 0.1)
        limbs.append((path, np.linspace(*ends, len(path))))
    rise = share * [0.0, 0.0, draw.between(0.35, 0.6)]
    foot, neck = draw.between(0.17, 0.22), draw.between(0.09, 0.12)
    limbs.append((rise, foot + (neck - foot) * (share * share * (3 - 2 * share))[:, 0]))

    def field(points: Points) -> Float64:
        return blended([limb(points, path, thick) for path, thick in limbs], 0.02)

    return field, (-0.7, -0.7, -0.3), (0.7, 0.7, 1.05)


def _pierced(draw: Draw) -> _Shape:
    """Balls that have flowed together, with one or two smooth holes through them."""
    count = draw.integer(3, 6)
    balls = [
        (
            (draw.between(-0.09, 0.09), draw.between(-0.06, 0.06), at),
            (draw.between(0.23, 0.3), draw.between(0.13, 0.18), draw.between(0.16, 0.24)),
        )
        for at in np.linspace(0.1, 0.75, count).tolist()
    ]
    holes = []
    for z in (draw.between(0.2, 0.3), draw.between(0.56, 0.66))[: draw.integer(1, 3)]:
        x, slant = draw.between(-0.03, 0.03), draw.between(-0.15, 0.15)
        holes.append(
            (np.array([x - slant, -0.5, z]), np.array([x + slant, 0.5, z]), draw.between(0.06, 0.085))
        )

    def field(points: Points) -> Float64:
        """Signed distance (n,) of points (n, 3), metres, negative inside."""
        whole = blended([ellipsoid(points, at, radii) for at, radii in balls], 0.03)
        for a, b, radius in holes:
            # Its edges are rounded: the soft maximum of the body and of what is outside the hole.
            hole = cone(points, a, b, (radius, radius))
            whole = -blended([-whole, hole], 0.015)
        return whole

    return field, (-0.65, -0.5, -0.4), (0.65, 0.5, 1.25)

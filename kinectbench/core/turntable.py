"""Pictures of an object from all around, side by side, which a page shows as a turning object.

The surface is drawn as points by elementary arithmetic, not by a library's ray casting: the last bits of that
differ between processors. So a page with the pictures has the same bytes everywhere.
"""

import numpy as np
from scipy.spatial import cKDTree

from kinectbench.core.geometry import TriangleMesh, decimated
from kinectbench.core.pictures import CLAY, LIGHT, PAPER
from kinectbench.core.types import Float64, Rgb

# Pictures are 18 degrees apart; as a JPEG they have 42 to 68 kB for a real cabinet and four simulated
# objects.
FRAMES, FRAME_PX, QUALITY = 20, 160, 75
# The height from which people look at furniture; each pixel is the mean of two by two.
ELEVATION_DEG = 20.0
SUPERSAMPLING = 2
# Largest number of triangles to draw, and the share of a picture that the object fills.
MOST_TRIANGLES, FILLED = 60_000, 0.94
# Coordinates are rounded to this many decimals, so that their last bits do not matter.
MICROMETRES = 6
# A vertex farther than this from the scene was not measured there.
NEAR_M = 0.03


def turntable(mesh_floor: TriangleMesh, scene_floor: TriangleMesh | None = None) -> Rgb:
    """Draw a mesh from `FRAMES` azimuths, side by side: (FRAME_PX, FRAMES * FRAME_PX, 3) uint8 RGB.

    Args:
        mesh_floor: closed surface with at least one triangle, z up, metres.
        scene_floor: a mesh that gives the vertices its colours; None: the mesh is clay-coloured.
    """
    mesh = decimated(mesh_floor, MOST_TRIANGLES)
    colors = surface_colors(mesh.vertices, scene_floor)
    vertices = mesh.vertices.round(MICROMETRES)
    vertices -= (vertices.min(axis=0) + vertices.max(axis=0)) / 2
    around = np.sqrt(vertices[:, 0] ** 2 + vertices[:, 1] ** 2)
    sine, cosine = (float(round(of(np.deg2rad(ELEVATION_DEG)), 6)) for of in (np.sin, np.cos))
    half_m = max(float(around.max()), float((cosine * np.abs(vertices[:, 2]) + sine * around).max())) / FILLED
    size_px = FRAME_PX * SUPERSAMPLING
    placed = vertices / half_m * (size_px / 2)
    points, looks = _dense(TriangleMesh(placed, mesh.faces), colors)
    angles = np.arange(FRAMES) * (2 * np.pi / FRAMES)
    turns = np.stack([np.cos(angles), np.sin(angles)], axis=1).round(MICROMETRES)
    return np.concatenate(
        [_frame(points, looks, (float(c), float(s)), (cosine, sine), size_px) for c, s in turns], axis=1
    )


def surface_colors(vertices: Float64, scene: TriangleMesh | None) -> Float64:
    """Return vertices' RGB colours (n, 3), 0 to 255: that of the nearest scene vertex, clay if none is near.

    Args:
        vertices: (n, 3), metres, in the scene's frame.
        scene: a mesh with coloured vertices; without colours, or for None, all vertices are clay-coloured.
    """
    colors = np.tile(np.array(CLAY, np.float64), (len(vertices), 1))
    if scene is None or scene.colors is None:
        return colors
    low, high = vertices.min(axis=0) - NEAR_M, vertices.max(axis=0) + NEAR_M
    inside = ((scene.vertices >= low) & (scene.vertices <= high)).all(axis=1)
    distance_m, nearest = cKDTree(scene.vertices[inside]).query(vertices, distance_upper_bound=NEAR_M)
    near = np.isfinite(distance_m)
    colors[near] = scene.colors[inside][nearest[near]]
    return colors


def _dense(mesh_px: TriangleMesh, colors: Float64) -> tuple[Float64, Float64]:
    """Sample a surface at most a pixel apart: return points (n, 3), and their normals and colours (n, 6)."""
    corners = mesh_px.vertices[mesh_px.faces]
    bends = np.concatenate([mesh_px.vertex_normals, colors], axis=1)[mesh_px.faces]
    sides = corners - np.roll(corners, 1, axis=1)
    longest = np.sqrt((sides[..., 0] ** 2 + sides[..., 1] ** 2 + sides[..., 2] ** 2).max(axis=1))
    parts = np.maximum(1, np.ceil(longest)).astype(int)
    samples: list[tuple[Float64, Float64]] = []
    for count in np.unique(parts):
        selected = parts == count
        # The centres of the count * count small triangles into which a triangle is divided.
        i, j = (each.ravel() for each in np.mgrid[:count, :count])
        up = i + j < count
        a = np.concatenate([i[up] + 1 / 3, i[i + j < count - 1] + 2 / 3]) / count
        b = np.concatenate([j[up] + 1 / 3, j[i + j < count - 1] + 2 / 3]) / count
        weights = (1 - a - b)[:, None], a[:, None], b[:, None]
        point, normal = (
            sum(w * of[selected, k][:, None] for k, w in enumerate(weights)).reshape(-1, of.shape[-1])
            for of in (corners, bends)
        )
        samples.append((point, normal))
    return np.concatenate([p for p, _ in samples]), np.concatenate([n for _, n in samples])


def _frame(
    points: Float64, looks: Float64, turn: tuple[float, float], tilt: tuple[float, float], size_px: int
) -> Rgb:
    """Draw points in parallel projection as a shaded picture; of the points on a pixel, the nearest is shown.

    Args:
        points: (n, 3), z up, in pixels from the picture's centre.
        looks: (n, 6), normal and colour of each point.
        turn: cosine and sine of the viewer's azimuth.
        tilt: cosine and sine of the viewer's elevation.
        size_px: edge of the picture before it is reduced to FRAME_PX.
    """

    def seen(of: Float64) -> tuple[Float64, Float64, Float64]:
        """Coordinates (right, down, forward) of vectors (n, 3) for a viewer at this azimuth and elevation."""
        (c, s), (level, steep) = turn, tilt
        towards = c * of[:, 0] + s * of[:, 1]
        right = c * of[:, 1] - s * of[:, 0]
        return right, steep * towards - level * of[:, 2], -level * towards - steep * of[:, 2]

    right, down, forward = seen(points)
    column, row = (np.floor(each + size_px / 2).astype(np.int64) for each in (right, down))
    nearest = np.full(size_px * size_px, np.iinfo(np.int64).max)
    # The high bits hold the distance in 1/256 pixel, the low bits the index of the point.
    order = (np.floor((forward + 2 * size_px) * 256).astype(np.int64) << 32) + np.arange(len(points))
    np.minimum.at(nearest, row * size_px + column, order)
    hit = nearest < np.iinfo(np.int64).max
    first = nearest[hit] & 0xFFFFFFFF
    facing = seen(looks[first])
    length = np.maximum(np.sqrt(facing[0] ** 2 + facing[1] ** 2 + facing[2] ** 2), 1e-9)
    lit = sum(float(to) * each for to, each in zip(LIGHT, facing, strict=True)) / length
    shade = (0.52 + 0.6 * np.clip(lit, 0.0, 1.0)) * (1 - 0.2 * forward[first] / size_px)
    # Recorded colours already contain shading, so they get half of it (chosen from pictures).
    shade = np.where((looks[first, 3:] == CLAY).all(axis=1), shade, (1 + shade) / 2)
    picture = np.full((size_px * size_px, 3), PAPER, np.float64)
    picture[hit] = shade[:, None] * looks[first, 3:]
    whole = np.clip(picture, 0, 255).astype(np.uint16)
    blocks = whole.reshape(FRAME_PX, SUPERSAMPLING, FRAME_PX, SUPERSAMPLING, 3)
    return np.asarray(blocks.sum(axis=(1, 3)) // SUPERSAMPLING**2, np.uint8)

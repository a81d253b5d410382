"""Render meshes and voxel grids in parallel projection; make plots as PNG files.

A viewpoint's axes are optical: right, down, forward.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import TriangleMesh, isosurface, raycaster
from kinectbench.core.images import shrunk
from kinectbench.core.types import Float32, Float64, Rgb

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Color = tuple[int, int, int]

PAPER: Color = (243, 242, 238)
CLAY: Color = (205, 186, 160)
BLUE: Color = (118, 160, 205)
# Direction to the light in the viewpoint's axes: above, left, and behind the viewer.
LIGHT = np.array([-0.45, -0.7, -0.55]) / np.linalg.norm([-0.45, -0.7, -0.55])
SUPERSAMPLING = 1.5
# Left, bottom, right and top.
Margins = tuple[float, float, float, float]
# For plots: dots per inch, colours of lines, and colour of the paper.
DPI = 110
INK, SOFT, PLOT_PAPER = "#1f2328", "#8a8f98", "#fdfcf9"


@dataclass(frozen=True)
class Viewpoint:
    """A parallel projection onto a square picture.

    Attributes:
        R_frame_view: (3, 3), columns are the picture's right, down and forward in the mesh's frame.
        center_m: (3,) the point in the middle of the picture, in the mesh's frame.
        half_m: half the edge of the picture, metres.
        depth_m: distance of the viewer from the centre; everything to draw lies beyond the viewer.
    """

    R_frame_view: Float64
    center_m: Float64
    half_m: float
    depth_m: float


def look_along(forward: Float64, up: Float64) -> Float64:
    """Rotation (3, 3), columns right, down, forward, of a view along `forward` (not parallel to `up`)."""
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(forward, right), forward], axis=-1)


def fit_viewpoint(points_m: Float64, R_frame_view: Float64, margin: float = 1.08) -> Viewpoint:
    """Return the viewpoint that has this orientation and just shows all points.

    The picture's edge is `margin` times the larger extent of the points (n, 3), n > 0, in it.
    """
    points_view = points_m @ R_frame_view
    low, high = points_view.min(axis=0), points_view.max(axis=0)
    size = high - low
    half_m = max(float(size[:2].max()) / 2 * margin, 1e-6)
    return Viewpoint(R_frame_view, R_frame_view @ ((low + high) / 2), half_m, float(size[2]) + half_m)


def viewpoints_around(points_m: Float64, looks_deg: Sequence[tuple[float, float]]) -> list[Viewpoint]:
    """Return for each (azimuth, elevation), degrees, z up, a viewpoint that just shows all points (n, 3)."""
    viewpoints = []
    for azimuth, elevation in np.radians(looks_deg):
        level = np.array([-np.cos(azimuth), -np.sin(azimuth), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        forward = np.cos(elevation) * level - np.sin(elevation) * up
        viewpoints.append(fit_viewpoint(points_m, look_along(forward, up)))
    return viewpoints


def ray_starts(viewpoint: Viewpoint, size_px: int) -> Float64:
    """Origins of the rays through the pixel centres: (size_px, size_px, 3), in the mesh's frame."""
    right, down, forward = viewpoint.R_frame_view.T
    offset_m = ((np.arange(size_px) + 0.5) / size_px * 2 - 1) * viewpoint.half_m
    start = viewpoint.center_m - viewpoint.depth_m * forward
    return np.asarray(start + offset_m[None, :, None] * right + offset_m[:, None, None] * down)


def cast(mesh: TriangleMesh, viewpoint: Viewpoint, size_px: int) -> tuple[Float64, Float64]:
    """Cast a ray through each pixel centre.

    Returns:
        Distances (size_px, size_px) in metres, inf without a hit, and the normals at the hits
        (size_px, size_px, 3), in the viewpoint's axes, turned towards the viewer.
    """
    if not len(mesh.faces):
        return np.full((size_px, size_px), np.inf), np.zeros((size_px, size_px, 3))
    return cast_pieces([mesh], viewpoint, size_px)[:2]


def cast_pieces(
    pieces: Sequence[TriangleMesh], viewpoint: Viewpoint, size_px: int
) -> tuple[Float64, Float64, NDArray[np.intp]]:
    """Cast rays at several meshes. Return the results of `cast`, and the index of each pixel's mesh.

    The index is len(pieces) where no mesh is hit.
    """
    scene, tensor = raycaster(*pieces)
    rays = np.empty((size_px, size_px, 6), np.float32)
    rays[..., :3] = ray_starts(viewpoint, size_px)
    rays[..., 3:] = viewpoint.R_frame_view[:, 2]
    hit = scene.cast_rays(tensor(rays))
    normals_view = hit["primitive_normals"].numpy().astype(np.float64) @ viewpoint.R_frame_view
    normals_view *= np.where(normals_view[..., 2:] > 0, -1.0, 1.0)
    distance_m = hit["t_hit"].numpy().astype(np.float64)
    which = np.where(np.isfinite(distance_m), hit["geometry_ids"].numpy(), len(pieces)).astype(np.intp)
    return distance_m, normals_view, which


def render(mesh: TriangleMesh, viewpoint: Viewpoint, size_px: int, color: Color = CLAY) -> Rgb:
    """Render a shaded mesh on plain paper: (size_px, size_px, 3) uint8 RGB."""
    return render_pieces([(mesh, color)], viewpoint, size_px)


def render_pieces(
    pieces: Sequence[tuple[TriangleMesh, Color]], viewpoint: Viewpoint, size_px: int, contrast: float = 1.0
) -> Rgb:
    """Render shaded meshes, each in its colour, on plain paper: (size_px, size_px, 3) uint8 RGB.

    With less `contrast`, 0 to 1, colours in the shade are easier to distinguish.
    """
    shown = [piece for piece in pieces if len(piece[0].faces)]
    if not shown:
        return np.full((size_px, size_px, 3), PAPER, np.uint8)
    meshes = [mesh for mesh, _ in shown]
    distance_m, normals_view, which = cast_pieces(meshes, viewpoint, round(size_px * SUPERSAMPLING))
    colors = np.array([*(color for _, color in shown), PAPER])[which]
    lit = 0.52 + 0.6 * np.clip(normals_view @ LIGHT, 0.0, 1.0)
    # Farther surfaces are a little darker, so that a leg stands out from the leg behind it.
    far = np.clip((distance_m - viewpoint.depth_m) / (2 * viewpoint.depth_m) + 0.5, 0.0, 1.0)
    shade = 1 - contrast * (1 - (lit * (1.08 - 0.3 * far))[..., None])
    picture = np.where(np.isfinite(distance_m)[..., None], shade * colors, np.array(PAPER))
    return shrunk(np.clip(picture, 0, 255).astype(np.uint8), size_px)


def mesh_outlines(mesh: TriangleMesh, viewpoint: Viewpoint, size_px: int) -> list[Float64]:
    """Return the outlines of a mesh from a viewpoint: polygons (n, 2), metres right and down of the centre.

    They are closed, and traced in a picture of `size_px` pixels a side. Holes are not outlined.
    """
    import cv2

    hit = np.isfinite(cast(mesh, viewpoint, size_px)[0]).astype(np.uint8)
    contours, _ = cv2.findContours(np.pad(hit, 1), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    scale = 2 * viewpoint.half_m / size_px
    outlines = [cv2.approxPolyDP(contour, 1.0, True)[:, 0].astype(np.float64) for contour in contours]
    return [(outline - 0.5) * scale - viewpoint.half_m for outline in outlines if len(outline) > 2]


def voxel_mesh(density: Float32, cell_m: float, level: float = 0.5) -> TriangleMesh:
    """Return the closed surface where densities (nx, ny, nz) cross `level`; they are 0 outside the grid.

    Vertices are in metres from the grid's corner; a cell's edge is `cell_m`. Faces look inward, which
    makes no difference to pictures.
    """
    surface = isosurface(np.pad(density, 1), level=level)
    return replace(surface, vertices=(surface.vertices - 0.5) * cell_m)


def block_density(packed: NDArray[np.uint8]) -> Float32:
    """Fraction of set voxels in each 4x4x4 block of a bit-packed (n, n, n / 8) uint8 grid: (n / 4,) * 3."""
    n = packed.shape[0] // 4
    half_bytes = np.stack([np.bitwise_count(packed >> 4), np.bitwise_count(packed & 15)], axis=-1)
    # A sum of 16 counts is at most 64, so uint8 suffices. Sums along one axis at a time add whole rows.
    rows = np.add.reduce(half_bytes.reshape(n, 4, n, 4, n), axis=1, dtype=np.uint8)
    counts: NDArray[np.uint8] = np.add.reduce(rows, axis=2, dtype=np.uint8)
    return counts.astype(np.float32) * np.float32(1 / 64)


def blurred_density(density: Float32) -> Float32:
    """Blur a grid (nx, ny, nz) by (1, 2, 1) / 4 along each axis, so that its isosurface is smooth."""
    from scipy import ndimage

    for axis in range(3):
        density = ndimage.correlate1d(density, [0.25, 0.5, 0.25], axis, mode="constant")
    return density


def new_figure(
    width_in: float, height_in: float, paper: str = PLOT_PAPER, margins: Margins | None = None
) -> "Figure":
    """Make an empty figure for a plot.

    Sizes are in inches. `margins` are left, bottom, right and top, as fractions of the figure; None: as the
    labels need, which doubles the drawing time.
    """
    # Without pyplot there is no global state, and no display is needed.
    from matplotlib.figure import Figure

    if margins is None:
        return Figure(figsize=(width_in, height_in), layout="constrained", facecolor=paper)
    figure = Figure(figsize=(width_in, height_in), facecolor=paper)
    left, bottom, right, top = margins
    figure.subplots_adjust(left, bottom, 1 - right, 1 - top)
    return figure


def figure_png(figure: "Figure", version: bool = False) -> bytes:
    """Encode a plot as a PNG file, with the plotting library's version in its metadata if `version`."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=DPI, metadata=None if version else {"Software": None})
    return buffer.getvalue()

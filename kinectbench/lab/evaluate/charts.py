"""Pictures of an evaluation as PNG: path, surface errors, meshes coloured by error, slices of the solid."""

from collections.abc import Callable

import matplotlib as mpl
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.patches import Patch
from numpy.typing import NDArray

from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.images import shrunk
from kinectbench.core.pictures import (
    INK,
    LIGHT,
    PAPER,
    SOFT,
    Viewpoint,
    cast,
    figure_png,
    new_figure,
    ray_starts,
    viewpoints_around,
)
from kinectbench.core.types import Float64, Rgb
from kinectbench.lab.evaluate.solid import EvaluatedSolids
from kinectbench.lab.evaluate.surface import ReferenceSurface, SurfaceErrors

# Maps distances (n,) in metres to colours (n, 3) in [0, 1].
Colors = Callable[[Float64], Float64]

SIZE_PX = 320
SUPERSAMPLING = 2
# Two viewpoints from a person's height and one from below: azimuth and elevation, degrees.
LOOKS_DEG = ((-50.0, 24.0), (130.0, 24.0), (-50.0, -35.0))
BUILT, TRUE = "#b4572b", "#2b6cb4"
# Larger errors have the last colour; the scale is the same in every picture, so that pictures compare.
SCALE_M = 0.020
REACH_M = 0.030
BINS = 120
# Colours (RGB) of cells: empty, correctly built, missing, excess.
SLICE_COLORS = np.array([(253, 252, 249), (176, 172, 164), (43, 108, 180), (200, 70, 40)], np.float64)
UNKNOWN_COLOR = np.array([246, 214, 120], np.float64)


def _render_errors(
    mesh: TriangleMesh, other: ReferenceSurface, viewpoint: Viewpoint, signed: bool, colors: Colors
) -> Rgb:
    """Draw a mesh, each point coloured by its distance from another surface.

    All are in the frame `object`. With `signed`, distances from the closed surface `other` are positive
    outside. `colors` maps distances (n,) in metres to colours (n, 3) in [0, 1].
    """
    size_px = SIZE_PX * SUPERSAMPLING
    distance_m, normals_view = cast(mesh, viewpoint, size_px)
    hit = np.isfinite(distance_m)
    points = ray_starts(viewpoint, size_px)[hit] + distance_m[hit, None] * viewpoint.R_frame_view[:, 2]
    error_m = other.signed_distance_m(points) if signed else other.distance_m(points)
    lit = 0.75 + 0.25 * np.clip(normals_view[hit] @ LIGHT, 0.0, 1.0)
    picture = np.empty((size_px, size_px, 3))
    picture[...] = PAPER
    picture[hit] = 255 * colors(error_m) * lit[:, None]
    return shrunk(np.clip(picture, 0, 255).astype(np.uint8), SIZE_PX)


def path_chart(
    positions_true: Float64, positions_built: Float64, errors_m: Float64, outline: Float64
) -> bytes:
    """Plot the camera path from above as PNG: true path in grey, built positions coloured by their error.

    Args:
        positions_true: (n, 3) true positions of all frames in order, frame `object`; NaN where unknown.
        positions_built: (m, 3) positions of the frames with a built pose, aligned to the true ones, frame
            `object`.
        errors_m: (m,) distances of built positions from true ones, metres.
        outline: (k, 2) points on the true object's surface: x and y in frame `object`, metres.
    """
    figure = new_figure(6.6, 5.6)
    axes = figure.add_subplot(aspect="equal")
    axes.plot(*outline.T, ".", color="#cdbaa0", markersize=1.5)
    axes.plot(positions_true[:, 0], positions_true[:, 1], color=SOFT, linewidth=1.2, label="true path")
    top_mm = max(float(errors_m.max()) * 1000, 0.1)
    points = axes.scatter(
        positions_built[:, 0], positions_built[:, 1], c=errors_m * 1000, s=14, cmap="plasma_r", vmin=0,
        vmax=top_mm, label="built, aligned", zorder=3,
    )  # fmt: skip
    figure.colorbar(points, label="position error, mm", shrink=0.8)
    axes.set(xlabel="x, m", ylabel="y, m")
    axes.legend(loc="upper right", frameon=False, fontsize=8)
    return figure_png(figure, version=True)


def error_picture(errors: SurfaceErrors) -> bytes:
    """Return a PNG file: a histogram of the signed surface errors, and precision and recall by distance."""
    figure = new_figure(9.0, 3.6)
    left, right = figure.subplots(1, 2)
    signed_mm = np.clip(errors.built_m, -REACH_M, REACH_M) * 1000
    left.hist(signed_mm, bins=np.linspace(-REACH_M, REACH_M, BINS + 1) * 1000, color=BUILT, density=True)
    left.axvline(0, color=INK, linewidth=0.8)
    left.set(xlabel="built surface outside (+) or inside (−) the true one, mm", yticks=[])
    reach_mm = np.linspace(0, REACH_M * 1000, 200)
    curves = (
        ("precision", np.abs(errors.built_m), BUILT, "-"),
        ("recall", errors.true_m, TRUE, "-"),
        ("precision, seen", np.abs(errors.built_m)[errors.built_visible], BUILT, "--"),
        ("recall, seen", errors.true_m[errors.true_visible], TRUE, "--"),
    )
    for label, distances_m, color, style in curves:
        within = np.searchsorted(np.sort(distances_m) * 1000, reach_mm) / max(len(distances_m), 1)
        right.plot(reach_mm, 100 * within, style, color=color, linewidth=1.4, label=label)
    right.set(xlabel="distance, mm", ylabel="surface that close, %", ylim=(0, 102), xlim=(0, reach_mm[-1]))
    right.legend(loc="lower right", frameon=False, fontsize=8)
    return figure_png(figure, version=True)


def mesh_picture(built_object: TriangleMesh, true_object: TriangleMesh) -> bytes:
    """Return a PNG file of the built mesh and, below it, the true mesh, both coloured by error.

    The error of a point of the built mesh is its signed distance from the true mesh. The error of a point of
    the true mesh is its unsigned distance from the built mesh.

    Args:
        built_object: closed mesh, frame `object`.
        true_object: closed mesh, frame `object`.
    """
    figure = new_figure(10.2, 6.9)
    points = np.concatenate([built_object.vertices, true_object.vertices])
    looks = viewpoints_around(points, LOOKS_DEG)
    rows: tuple[tuple[TriangleMesh, ReferenceSurface, bool, str, float, str], ...] = (
        (
            built_object,
            ReferenceSurface(true_object),
            True,
            "coolwarm",
            -SCALE_M,
            "built mesh: outside the truth, mm",
        ),
        (
            true_object,
            ReferenceSurface(built_object),
            False,
            "YlOrRd",
            0.0,
            "true mesh: from the built one, mm",
        ),
    )
    grid = figure.subplots(2, len(looks))
    for axes_row, (mesh, other, signed, name, least_m, label) in zip(grid, rows, strict=True):
        scale = ScalarMappable(Normalize(least_m * 1000, SCALE_M * 1000), mpl.colormaps[name])

        def colors(error_m: Float64, scale: ScalarMappable = scale) -> Float64:
            return np.asarray(scale.to_rgba(error_m * 1000)[:, :3], dtype=np.float64)

        for axes, viewpoint in zip(axes_row, looks, strict=True):
            axes.imshow(_render_errors(mesh, other, viewpoint, signed, colors))
            axes.axis("off")
        figure.colorbar(
            scale, ax=list(axes_row), label=label, shrink=0.85, extend="both" if signed else "max"
        )
    return figure_png(figure, version=True)


def slice_picture(solids: EvaluatedSolids) -> bytes:
    """Return a PNG file of three slices through the true solid's centre of mass, coloured by `slice_colors`.

    The grids are on the canonical cube, whose axes are those of frame `object`.
    """
    figure = new_figure(10.2, 3.9)
    middle = np.rint(np.argwhere(solids.true).mean(axis=0)).astype(int)
    titles = ("from the side, x", "from the front, y", "from above, z")
    for axis, axes in enumerate(figure.subplots(1, 3)):
        true, built, known = (
            np.take(g, middle[axis], axis) for g in (solids.true, solids.built, solids.known)
        )
        # In the picture, rows go up along the second remaining axis.
        picture = np.swapaxes(slice_colors(true, built, known), 0, 1)
        axes.imshow(picture.astype(np.uint8), origin="lower", interpolation="nearest")
        axes.set_title(f"{titles[axis]} = cell {middle[axis]}", fontsize=9)
        axes.set(xticks=[], yticks=[])
    names = ("true and built", "missing", "too much")
    patches = [Patch(color=_hex(c), label=n) for c, n in zip(SLICE_COLORS[1:], names, strict=True)]
    patches.append(Patch(color=_hex(UNKNOWN_COLOR), label="unknown (tinted)"))
    figure.legend(handles=patches, loc="outside lower center", ncols=4, frameon=False, fontsize=9)
    return figure_png(figure, version=True)


def slice_colors(true: NDArray[np.bool_], built: NDArray[np.bool_], known: NDArray[np.bool_]) -> Float64:
    """Return a slice's colours (n, m, 3), 0 to 255: its cells are empty, correct, missing or excess.

    Args:
        true: (n, m), the cell is in the true solid.
        built: (n, m), the cell is in the built solid.
        known: (n, m), the build's label of the cell is not `unknown`. The colours of unknown cells are tinted
            if they are empty or correct.
    """
    kind = np.where(true, np.where(built, 1, 2), np.where(built, 3, 0))
    colors = SLICE_COLORS[kind]
    # Errors keep their colour even if unknown: tinted, they would look correct.
    plain = known | (true != built)
    tinted: Float64 = np.where(plain[..., None], colors, 0.45 * colors + 0.55 * UNKNOWN_COLOR)
    return tinted


def _hex(color: Float64) -> str:
    return "#" + "".join(f"{int(channel):02x}" for channel in color)

"""Draw pictures of objects, pairs and views for the page, with their viewpoints and colours."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import StorageError, images, pictures
from kinectbench.core.artefacts.views import ViewRow, ViewsFile
from kinectbench.core.even_choice import evenly
from kinectbench.core.geometry import TriangleMesh
from kinectbench.core.types import Float64
from kinectbench.core.voxels.pair_file import BLOCK, unpack
from kinectbench.report.figures import text_of

FRAMES_SHOWN = 6
FRAME_PX = 320
TILE_PX = 120
# A pair is drawn from beside and above its camera, so that the partial's empty back is visible.
TILE_AZIMUTH_DEG = 32.0
TILE_RAISED_DEG = 10.0
TILE_ELEVATIONS_DEG = (12.0, 50.0)
STEEP_SINE = 0.97
# Isosurface levels of smoothed grids; below a half, so that parts thinner than a cell of 64 do not vanish.
FULL_LEVEL = 0.25
PARTIAL_LEVEL = 0.15


def outlines(mesh_floor: TriangleMesh) -> list[Float64]:
    """Return the object's outlines seen from above: closed polygons (n, 2), x and y, floor frame, metres."""
    # The viewer looks down: the floor's x is to the right, and its y is up in the picture.
    R_floor_view = np.array([[1.0, 0, 0], [0, -1.0, 0], [0, 0, -1.0]])
    viewpoint = pictures.fit_viewpoint(mesh_floor.vertices, R_floor_view)
    center = viewpoint.center_m[:2]
    return [center + o * np.array([1, -1]) for o in pictures.mesh_outlines(mesh_floor, viewpoint, 256)]


def pair_picture(
    partial: NDArray[np.uint8], full: NDArray[np.uint8], voxel_size_m: float, up_grid: Float64
) -> NDArray[np.uint8]:
    """Draw a pair: partial on the left, full on the right, from beside and above the view's camera.

    Args:
        partial: (64, 64, 8), packed.
        full: (256, 256, 32), packed.
        voxel_size_m: edge of a cell of `full`, metres.
        up_grid: (3,) unit vector that points up in the picture, in the grid's axes.

    Returns:
        (TILE_PX, 2 * TILE_PX, 3) uint8 RGB.
    """
    cell_m = voxel_size_m * BLOCK
    shown = pictures.voxel_mesh(
        pictures.blurred_density(unpack(partial).astype(np.float32)), cell_m, PARTIAL_LEVEL
    )
    whole = pictures.voxel_mesh(pictures.blurred_density(pictures.block_density(full)), cell_m, FULL_LEVEL)
    points = np.concatenate([shown.vertices, whole.vertices])
    if not len(points):
        points = np.array([[0.0, 0, 0], [1.0, 1, 1]]) * cell_m * partial.shape[0]
    viewpoint = pictures.fit_viewpoint(points, _beside_the_camera(up_grid))
    left = pictures.render(shown, viewpoint, TILE_PX, pictures.BLUE)
    right = pictures.render(whole, viewpoint, TILE_PX, pictures.CLAY)
    return np.concatenate([left, right], axis=1)


def _beside_the_camera(up_grid: Float64) -> Float64:
    """Return R_grid_view (3, 3) of an upright viewpoint to the camera's right and somewhat above it."""
    sine = float(-up_grid[2])
    # If the camera looks straight down or up, the top of its picture replaces the level direction ahead.
    ahead = np.array([0.0, 0, 1]) if abs(sine) < STEEP_SINE else np.array([0.0, -1, 0])
    level = ahead - (ahead @ up_grid) * up_grid
    level /= np.linalg.norm(level)
    azimuth = np.deg2rad(TILE_AZIMUTH_DEG)
    turned = np.cos(azimuth) * level + np.sin(azimuth) * np.cross(up_grid, level)
    low, high = np.deg2rad(TILE_ELEVATIONS_DEG)
    elevation = np.clip(np.arcsin(np.clip(sine, -1, 1)) + np.deg2rad(TILE_RAISED_DEG), low, high)
    return pictures.look_along(np.cos(elevation) * turned - np.sin(elevation) * up_grid, up_grid)


@dataclass(frozen=True)
class FramePicture:
    """A recorded view: `masked` is its picture, dimmed outside the mask.

    `color` is its colour image if that is not registered to the depth, else None. Pictures are `data:` URLs.
    """

    view: str
    frame: str
    masked: str
    color: str | None


def frame_pictures(folder: Path, views: ViewsFile, most: int = FRAMES_SHOWN) -> tuple[FramePicture, ...]:
    """Draw at most `most` of the views, evenly spread; `folder` holds their images.

    Views without images are left out.

    Raises:
        StorageError: an image is damaged, or a mask has another size than its view.
    """
    rows = views.views
    chosen = evenly(len(rows), most)
    shown = [_frame(folder, rows[i], views.color_registered is not False) for i in chosen]
    return tuple(frame for frame in shown if frame)


def _frame(folder: Path, row: ViewRow, registered: bool) -> FramePicture | None:
    """Draw one view on its colour image if `registered`, else on its depth; None if it has no image."""
    paths = {kind: folder / f"{row.view}.{kind}" for kind in ("color.jpg", "depth.png", "mask.png")}
    color_path = paths["color.jpg"] if paths["color.jpg"].exists() else None
    color = images.read_color(color_path) if color_path else None
    if registered and color is not None:
        picture = color
    elif paths["depth.png"].exists():
        picture = images.depth_picture(images.read_gray(paths["depth.png"]))
    else:
        return None
    if paths["mask.png"].exists():
        mask = images.read_gray(paths["mask.png"]) > 0
        if mask.shape != picture.shape[:2]:
            raise StorageError(f"{paths['mask.png']}: not as large as the view; build the views again")
        picture = images.overlay_mask(picture, mask)
    beside = images.data_uri(images.shrunk(color, FRAME_PX)) if color is not None and not registered else None
    masked = images.data_uri(images.shrunk(picture, FRAME_PX))
    return FramePicture(row.view, text_of(row.frame), masked, beside)

"""The fit of a view's depth to the object, and whether the frame is usable as a view."""

from dataclasses import dataclass, replace

import numpy as np

from kinectbench.core.geometry import Camera, DepthRenderer
from kinectbench.core.sequence import Sequence
from kinectbench.core.types import Bools, Float32, Float64
from kinectbench.core.voxels.pair_file import BLOCK
from kinectbench.core.voxels.solid import voxelize_solid
from kinectbench.core.voxels.view_grids import containment_of_cells, depth_cells, object_cube
from kinectbench.settings.models import FitLimits, ViewSettings
from kinectbench.stages.sample_views.masks import inner_silhouette
from kinectbench.stages.segment.object_model import ObjectModel

# The outline beyond the image is searched this far around it, in image sizes, with this stride.
AROUND, OUTLINE_STRIDE_PX = 1, 8


@dataclass(frozen=True)
class ViewFit:
    """The fit of a view's depth to the object. Shares are in [0, 1].

    Attributes:
        pixels: valid depth pixels on the object.
        visible_share: share of the rendered silhouette with valid depth of the object.
        border_share: share of the silhouette's pixels within 1 px of the image border.
        dropped_share: share of the valid depth inside the eroded silhouette that the mask leaves out.
        containment: share of the partial's occupied cells that lie in the full shape, dilated once. The
            partial (64^3) is made from all depth inside the eroded silhouette, without the mask.
        residual_m: median absolute difference of measured and rendered depth inside the eroded silhouette,
            metres.
        truncated_share: share of the object's full silhouette that lies outside the image.
    """

    pixels: int
    visible_share: float
    border_share: float
    dropped_share: float
    containment: float
    residual_m: float
    truncated_share: float = 0.0


def fit_of_view(
    depth_m: Float32,
    rendered_m: Float32,
    mask: Bools,
    sequence: Sequence,
    T_world_camera: Float64,
    model: ObjectModel,
    renderer: DepthRenderer,
) -> ViewFit:
    """Measure the fit of a view's depth to the object; if no depth lies on it, the residual is infinite.

    Args:
        depth_m: (height, width) float32, metres, 0 = none.
        rendered_m: (height, width) float32, depth of the rendered object, 0 = not on it.
        mask: (height, width) bool, the object's pixels, found from depth or from the recording's mask, before
            the user's masks are applied.
        sequence: the recording.
        T_world_camera: (4, 4), the view's pose.
        model: the object.
        renderer: renderer of the object's mesh.
    """
    silhouette = rendered_m > 0
    inner = inner_silhouette(rendered_m) & (depth_m > 0)
    pixels, area = int(mask.sum()), int(silhouette.sum())
    if pixels == 0 or not inner.any():
        return ViewFit(pixels, 0.0, 0.0, 1.0, 0.0, float("inf"))
    grid = object_cube(model.shape.mesh.vertices, T_world_camera)
    cells = depth_cells(depth_m, inner, sequence.camera, T_world_camera, grid.coarser(BLOCK))
    full = voxelize_solid(model.shape.mesh.vertices, model.shape.mesh.faces, grid)
    border = silhouette.copy()
    border[1:-1, 1:-1] = False
    return ViewFit(
        pixels=pixels,
        visible_share=int((mask & silhouette).sum()) / area,
        border_share=int(border.sum()) / area,
        truncated_share=truncated_share(sequence.camera, T_world_camera, renderer),
        dropped_share=int((inner & ~mask).sum()) / int(inner.sum()),
        containment=containment_of_cells(cells, full),
        residual_m=float(np.median(np.abs(depth_m[inner] - rendered_m[inner]))),
    )


def truncated_share(camera: Camera, T_world_camera: Float64, renderer: DepthRenderer) -> float:
    """Return the share of an object's silhouette that lies outside the image.

    The silhouette is sampled at every 8th pixel of an image three times as wide and high, centred on the
    camera's.

    Returns:
        In [0, 1]; 0 if no ray hits the object.
    """
    step = OUTLINE_STRIDE_PX
    across, down = camera.width // step, camera.height // step
    coarse = camera.every(step)
    wide = replace(
        coarse,
        width=(2 * AROUND + 1) * across,
        height=(2 * AROUND + 1) * down,
        cx=coarse.cx + AROUND * across,
        cy=coarse.cy + AROUND * down,
    )
    outline = renderer.depth_m(wide, T_world_camera) > 0
    inside = outline[AROUND * down : (AROUND + 1) * down, AROUND * across : (AROUND + 1) * across]
    return 1 - int(inside.sum()) / int(outline.sum()) if outline.any() else 0.0


def refusal(fit: ViewFit, settings: ViewSettings, pairs: FitLimits) -> str | None:
    """Return why a frame is not usable as a view by the limits in `settings` and `pairs`, None if it is."""
    if fit.pixels < settings.min_pixels:
        return f"only {fit.pixels} pixels on the object, less than {settings.min_pixels}"
    if fit.residual_m > pairs.max_residual_m:
        most_mm = pairs.max_residual_m * 1000
        return f"depth is {fit.residual_m * 1000:.1f} mm (median) off the object, more than {most_mm:g} mm"
    if fit.containment < pairs.min_containment:
        least = pairs.min_containment
        return f"only {fit.containment:.1%} of the partial lies in the object, less than {least:.0%}"
    outlined = fit.visible_share * (1 - fit.truncated_share)
    if outlined < pairs.min_visible_share:
        cut = f"{fit.truncated_share:.0%} is cut by the image"
        least = pairs.min_visible_share
        return f"depth on only {outlined:.1%} of the object's outline, less than {least:.0%} ({cut})"
    return None

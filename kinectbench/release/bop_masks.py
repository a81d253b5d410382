"""An object's silhouette in a view, and what of it is visible, as the BOP benchmark defines them."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import Camera, TriangleMesh, invert_rigid, transform_points
from kinectbench.segmentation.render import DepthRenderer

# A surface counts as seen if it lies no deeper behind the measured one (BOP: delta).
DELTA_MM = 15.0
NO_BOX = (-1, -1, -1, -1)
Box = tuple[int, int, int, int]


@dataclass(frozen=True)
class ObjectInView:
    """A row of scene_gt_info.json and its two masks.

    Attributes:
        mask: (height, width) bool, the silhouette within the image.
        mask_visib: (height, width) bool, the visible part of it.
        px_count_all: pixels of the silhouette, beyond the image too.
        px_count_valid: of `mask`, those with a measured depth.
        px_count_visib: of `mask_visib`.
        bbox_obj: x, y, width, height of the silhouette, beyond the image too; -1 if nothing is visible.
        bbox_visib: of `mask_visib`.
    """

    mask: NDArray[np.bool_]
    mask_visib: NDArray[np.bool_]
    px_count_all: int
    px_count_valid: int
    px_count_visib: int
    bbox_obj: Box
    bbox_visib: Box

    @property
    def visib_fract(self) -> float:
        """The visible share of the silhouette."""
        return self.px_count_visib / self.px_count_all if self.px_count_all else 0.0


def object_in_view(
    depth_mm: NDArray[np.uint16],
    camera: Camera,
    T_world_camera: NDArray[np.float64],
    mesh: TriangleMesh,
    renderer: DepthRenderer,
) -> ObjectInView:
    """Silhouette, visible part and their figures.

    Args:
        depth_mm: (height, width) uint16, measured, 0 = none.
        camera: of the image.
        T_world_camera: (4, 4).
        mesh: of the object, world frame, metres.
        renderer: of the same mesh.

    Source: the BOP format page and its definition of visibility, mode `bop19`: a pixel of the silhouette is
    visible if the model lies at most 15 mm behind the measurement, along the ray, or there is none. The
    silhouette is looked for in an image three times as wide and high, the camera's own in its middle.
    """
    wide, left, top = _wide_camera(camera, T_world_camera, mesh)
    wide_m = renderer.depth_m(wide, T_world_camera)
    model_m = wide_m[top : top + camera.height, left : left + camera.width]
    mask = model_m > 0
    ray_lengths = np.linalg.norm(camera.rays(), axis=-1)
    behind_mm = (model_m * 1000.0 - depth_mm) * ray_lengths
    mask_visib = mask & ((behind_mm <= DELTA_MM) | (depth_mm == 0))
    visible = bool(mask_visib.any())
    return ObjectInView(
        mask=mask,
        mask_visib=mask_visib,
        px_count_all=int((wide_m > 0).sum()),
        px_count_valid=int((depth_mm[mask] > 0).sum()),
        px_count_visib=int(mask_visib.sum()),
        bbox_obj=_box(wide_m > 0, left, top) if visible else NO_BOX,
        bbox_visib=_box(mask_visib, 0, 0) if visible else NO_BOX,
    )


def _wide_camera(
    camera: Camera, T_world_camera: NDArray[np.float64], mesh: TriangleMesh
) -> tuple[Camera, int, int]:
    """A camera whose image holds the whole object, at most three times the size; and where the own begins."""
    points_camera = transform_points(invert_rigid(T_world_camera), mesh.vertices)
    left, right, top, bottom = camera.width, camera.width, camera.height, camera.height
    if points_camera[:, 2].min() > 0:
        u, v = np.moveaxis(camera.project(points_camera), -1, 0)
        left, right = _margins(u, camera.width)
        top, bottom = _margins(v, camera.height)
    wide = replace(
        camera,
        width=camera.width + left + right,
        height=camera.height + top + bottom,
        cx=camera.cx + left,
        cy=camera.cy + top,
    )
    return wide, left, top


def _margins(pixels: NDArray[np.float64], size: int) -> tuple[int, int]:
    """Pixels needed before and after an image's side, each at most the side itself."""
    before, after = np.ceil([-pixels.min(), pixels.max() - (size - 1)])
    return int(np.clip(before, 0, size)), int(np.clip(after, 0, size))


def _box(mask: NDArray[np.bool_], left: int, top: int) -> Box:
    """The box around a mask as BOP writes it: the first pixel, and the way from there to the last."""
    rows, columns = np.flatnonzero(mask.any(axis=1)), np.flatnonzero(mask.any(axis=0))
    return (
        int(columns[0]) - left,
        int(rows[0]) - top,
        int(columns[-1] - columns[0]),
        int(rows[-1] - rows[0]),
    )

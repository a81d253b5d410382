"""Compute how much truth is outside a method's volume, and how much of a prediction is outside the mask."""

import numpy as np

from kinectbench.core.geometry import transform_points
from kinectbench.core.types import Float64
from kinectbench.scoring.camera.surface import Surface
from kinectbench.scoring.camera.truth import SpaceTruth
from kinectbench.scoring.camera_shape import CameraShape


def cut_share(truth: SpaceTruth, shape: CameraShape, volume_m: Float64 | None) -> float | None:
    """Return the share of the known true solid outside the volume that a method covers.

    Args:
        truth: the truth of the view.
        shape: the predicted shape, camera frame; if it is a grid of cells or distances, that grid also bounds
            the volume.
        volume_m: (2, 3), lowest and highest corner of the volume in the camera frame, metres, as method.json
            declares it; None if it declares none.

    Returns:
        The share; None if nothing bounds the volume, or if no cell of the true solid is known.
    """
    if volume_m is None and shape.cells is None:
        return None
    points_m = truth.some_cells_m
    if not len(points_m):
        return None
    inside = np.ones(len(points_m), bool)
    if volume_m is not None:
        inside &= ((points_m >= volume_m[0]) & (points_m <= volume_m[1])).all(axis=1)
    if shape.cells is not None and shape.T_camera_grid is not None and shape.voxel_size_m is not None:
        T_grid_camera = np.linalg.inv(shape.T_camera_grid).astype(np.float64)
        at = transform_points(T_grid_camera, points_m) / shape.voxel_size_m
        inside &= ((at >= 0) & (at <= shape.cells.shape)).all(axis=1)
    return float(1 - inside.mean())


def outside_mask_share(truth: SpaceTruth, surface: Surface) -> float | None:
    """Return the area share of a predicted surface that projects outside the mask; None if there is no mask.

    Args:
        truth: the truth of the view.
        surface: the predicted surface, camera frame; points behind the camera count as outside.
    """
    if truth.K is None or truth.mask is None:
        return None
    height, width = truth.mask.shape
    points_m = surface.points_m
    before = points_m[:, 2] > 0
    depth_m = np.where(before, points_m[:, 2], 1.0)
    # Pixel centres are integers. Clip, so that pixels far outside do not overflow.
    u = np.clip(np.rint(truth.K[0, 0] * points_m[:, 0] / depth_m + truth.K[0, 2]), -1, width).astype(np.int64)
    v = np.clip(np.rint(truth.K[1, 1] * points_m[:, 1] / depth_m + truth.K[1, 2]), -1, height).astype(
        np.int64
    )
    before &= (u >= 0) & (u < width) & (v >= 0) & (v < height)
    inside = np.zeros(len(points_m), bool)
    inside[before] = truth.mask[v[before], u[before]]
    return float(surface.areas[~inside].sum() / surface.areas.sum())

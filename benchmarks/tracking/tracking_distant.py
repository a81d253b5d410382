"""How well frames far apart in time agree under a trajectory, measured without the tracker.

Every sixth pixel becomes a small plane: the least-squares plane of the 11 x 11 pixels around it, so that one
pixel's noise does not count. A frame's plane points are carried into another frame, and held against the
plane of the nearest pixel there.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry import Camera, invert_rigid, transform_points
from kinectbench.core.sequence import Sequence
from kinectbench.core.types import Float64

STEP_PX, REACH_PX = 6, 5
# A window counts where most of it lies on one surface: closer to the middle's depth than this share of it.
DEPTH_SHARE, MIN_SHARE = 0.03, 0.6
MAX_DEPTH_M = 4.0
# Farther apart than the gate is another surface, and so is one that faces elsewhere.
GATE_M, MIN_COSINE = 0.1, 0.7
MIN_APART, MIN_OVERLAP = 10, 0.3


@dataclass(frozen=True)
class Planes:
    """Small planes of one frame, camera axes.

    Attributes:
        points: (rows, columns, 3), metres; NaN where there is none.
        normals: (rows, columns, 3), unit, towards the camera.
    """

    points: Float64
    normals: Float64


@dataclass(frozen=True)
class Distant:
    """How distant frames agree.

    Attributes:
        residual_m: median absolute distance of a point to the plane it meets, over all points of all pairs.
        share: of the points, that meet a plane within the gate.
        pairs: number of pairs of frames.
    """

    residual_m: float
    share: float
    pairs: int


def small_planes(depth_m: NDArray[np.float32], camera: Camera) -> Planes:
    """The planes of a depth image (height, width)."""
    points = camera.backproject(depth_m)
    v, u = np.meshgrid(
        np.arange(REACH_PX, camera.height - REACH_PX, STEP_PX),
        np.arange(REACH_PX, camera.width - REACH_PX, STEP_PX),
        indexing="ij",
    )
    near = np.arange(-REACH_PX, REACH_PX + 1)
    dv, du = (offsets.ravel() for offsets in np.meshgrid(near, near, indexing="ij"))
    window = points[v[..., None] + dv, u[..., None] + du]
    middle_m = points[v, u, 2]
    same = (window[..., 2] > 0) & (
        np.abs(window[..., 2] - middle_m[..., None]) < DEPTH_SHARE * middle_m[..., None]
    )
    usable = (middle_m > 0) & (middle_m < MAX_DEPTH_M) & (same.mean(axis=-1) >= MIN_SHARE)
    weight = same / np.maximum(same.sum(axis=-1, keepdims=True), 1)
    mean = np.einsum("rcw,rcwk->rck", weight, window)
    off = (window - mean[..., None, :]) * same[..., None]
    normals = np.linalg.eigh(np.einsum("rcwi,rcwj->rcij", off, off))[1][..., 0]
    normals = np.where(np.sum(normals * mean, axis=-1, keepdims=True) > 0, -normals, normals)
    return Planes(np.where(usable[..., None], mean, np.nan), normals)


def all_planes(sequence: Sequence) -> list[Planes]:
    """The planes of every frame."""
    return [small_planes(sequence.depth_m(index), sequence.camera) for index in range(len(sequence))]


def distant_pairs(planes: list[Planes], camera: Camera, T_world_camera: Float64) -> list[tuple[int, int]]:
    """Pairs (a, b) of posed frames, more than 10 frames apart, of which over 30 % of b's points meet a."""
    posed = np.flatnonzero(np.isfinite(T_world_camera).all(axis=(1, 2)))
    pairs = [(int(a), int(b)) for a in posed for b in posed if b - a > MIN_APART]
    return [
        (a, b)
        for a, b in pairs
        if _residuals_m(planes[a], planes[b], _between(T_world_camera, a, b), camera)[1] > MIN_OVERLAP
    ]


def measure_distant(
    planes: list[Planes], camera: Camera, T_world_camera: Float64, pairs: list[tuple[int, int]]
) -> Distant:
    """Hold the second frame of each pair against the first, both posed."""
    found = [_residuals_m(planes[a], planes[b], _between(T_world_camera, a, b), camera) for a, b in pairs]
    residuals_m = np.concatenate([residuals for residuals, _ in found]) if found else np.zeros(0)
    if not len(residuals_m):
        return Distant(float("nan"), 0.0, len(pairs))
    share = float(np.mean([share for _, share in found]))
    return Distant(float(np.median(np.abs(residuals_m))), share, len(pairs))


def _between(T_world_camera: Float64, a: int, b: int) -> Float64:
    return np.asarray(invert_rigid(T_world_camera[a]) @ T_world_camera[b])


def _residuals_m(a: Planes, b: Planes, T_a_b: Float64, camera: Camera) -> tuple[Float64, float]:
    """Distances of b's points to the planes of a that they meet, and the share of them that meet one."""
    there = np.isfinite(b.points[..., 0])
    points, normals = transform_points(T_a_b, b.points[there]), b.normals[there] @ T_a_b[:3, :3].T
    front = points[:, 2] > 0.1
    points, normals = points[front], normals[front]
    column, row = np.rint((camera.project(points) - REACH_PX) / STEP_PX).astype(int).T
    rows, columns = a.points.shape[:2]
    inside = (row >= 0) & (row < rows) & (column >= 0) & (column < columns)
    points, normals, row, column = points[inside], normals[inside], row[inside], column[inside]
    met, facing = a.points[row, column], a.normals[row, column]
    close = np.linalg.norm(points - met, axis=1) < GATE_M
    close &= np.sum(facing * normals, axis=1) > MIN_COSINE
    residuals_m = np.sum(facing[close] * (points[close] - met[close]), axis=1)
    return residuals_m, len(residuals_m) / max(int(there.sum()), 1)

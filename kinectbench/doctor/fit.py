"""How well poses fit the depth: points of one frame against the surface that another frame saw."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from kinectbench.doctor.look import Look
from kinectbench.geometry import Camera, invert_rigid, transform_points

Float64 = NDArray[np.float64]

ANCHORS = 12
# A frame is held against the frames so many places after it, if they are among those looked at.
AHEAD = (1, 4, 12, 40)
POINT_STEP = 7
# Farther off than this share of the distance is as wrong as can be.
WRONG_SHARE = 0.1
NEAREST_M = 1e-3


@dataclass(frozen=True)
class Pair:
    """Two frames that should show the same surface.

    Attributes:
        first: index among the frames looked at; `second` likewise.
        points: (n, 3) of the first frame, its camera's axes, metres.
        depth_m: of the second frame.
        camera: of that small image.
    """

    first: int
    second: int
    points: Float64
    depth_m: NDArray[np.float32]
    camera: Camera


def small_camera(look: Look) -> Camera:
    """The camera of the small depth images: pixel i is pixel n i of the whole image."""
    c, n = look.recording.camera, look.depth_step_px
    return Camera(-(-c.width // n), -(-c.height // n), c.fx / n, c.fy / n, c.cx / n, c.cy / n)


def choose_pairs(look: Look, has_pose: NDArray[np.bool_]) -> tuple[Pair, ...]:
    """Pairs of frames that have poses, evenly over the recording, near and farther apart."""
    camera, count = small_camera(look), len(look.frames)
    rays = camera.rays()[::POINT_STEP, ::POINT_STEP]
    pairs = []
    for first in np.unique(np.linspace(0, count - 1, min(ANCHORS, count)).astype(int)).tolist():
        for ahead in AHEAD:
            second = first + ahead if first + ahead < count else first - ahead
            if second < 0 or not (has_pose[first] and has_pose[second]):
                continue
            z = look.frames[first].depth_m[::POINT_STEP, ::POINT_STEP]
            if z.shape != rays.shape[:2] or look.frames[second].depth_m.shape != (
                camera.height,
                camera.width,
            ):
                continue
            points = (rays * z[..., None])[z > 0]
            if len(points):
                pairs.append(Pair(first, second, points, look.frames[second].depth_m, camera))
    return tuple(pairs)


def frames_of(pairs: Sequence[Pair]) -> NDArray[np.int64]:
    """The frames in pairs, increasing."""
    return np.unique([index for pair in pairs for index in (pair.first, pair.second)]).astype(np.int64)


def disagreement(pairs: Sequence[Pair], T_world_camera: Float64) -> float:
    """How badly poses (n, 4, 4) of the frames looked at fit: the mean of `pair_disagreement`."""
    return float(np.mean([pair_disagreement(pair, T_world_camera) for pair in pairs]))


def pair_disagreement(pair: Pair, T_world_camera: Float64) -> float:
    """How badly poses fit two frames: 0 to 1, the mean over points of how far off each is (own rule).

    A point is off by the difference of its distance and the one measured at its pixel, as a share of a tenth
    of the distance, at most 1. Points without a partner count as 1: wrong poses often leave none.

    Args:
        pair: what is compared.
        T_world_camera: (n, 4, 4) of the frames looked at; NaN where there is no pose.
    """
    points, rows, columns, inside = _fall(pair, T_world_camera)
    expected_m, measured_m = points[inside, 2], pair.depth_m[rows, columns]
    off = np.abs(measured_m - expected_m) / (WRONG_SHARE * expected_m)
    known = measured_m > 0
    # A point that falls where nothing was measured says nothing.
    counted = len(points) - int((~known).sum())
    wrong = float(np.minimum(off[known], 1.0).sum()) + len(points) - len(expected_m)
    return wrong / max(counted, 1)


def residual_m(pairs: Sequence[Pair], T_world_camera: Float64) -> float:
    """Median distance of points to the planes of the surface that they fall on, metres; NaN if none does."""
    found = [np.zeros(0)]
    for pair in pairs:
        points, rows, columns, inside = _fall(pair, T_world_camera)
        surface = pair.camera.rays() * pair.depth_m[..., None]
        normals = _normals(surface, pair.depth_m)
        p, q, n = points[inside], surface[rows, columns], normals[rows, columns]
        near = (np.abs(p - q)[:, 2] < WRONG_SHARE * p[:, 2]) & np.isfinite(n).all(axis=1)
        found.append(np.abs(((p - q) * n).sum(axis=1))[near])
    distances_m = np.concatenate(found)
    return float(np.median(distances_m)) if len(distances_m) else float("nan")


def _fall(
    pair: Pair, T_world_camera: Float64
) -> tuple[Float64, NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Points of the first frame in the second's axes; rows and columns in its image; which are inside it."""
    T_second_first = invert_rigid(T_world_camera[pair.second]) @ T_world_camera[pair.first]
    points = transform_points(T_second_first, pair.points)
    camera, z = pair.camera, np.maximum(points[:, 2], NEAREST_M)
    u = camera.fx * points[:, 0] / z + camera.cx
    v = camera.fy * points[:, 1] / z + camera.cy
    inside = (
        (points[:, 2] > NEAREST_M) & (u >= 0) & (v >= 0) & (u < camera.width - 1) & (v < camera.height - 1)
    )
    rows, columns = (np.rint(each[inside]).astype(np.int64) for each in (v, u))
    return points, rows, columns, inside


def _normals(surface: Float64, depth_m: NDArray[np.float32]) -> Float64:
    """(height, width, 3) unit normals from neighbours in the image; NaN where one is missing."""
    known = np.where((depth_m > 0)[..., None], surface, np.nan)
    across, down = np.full(surface.shape, np.nan), np.full(surface.shape, np.nan)
    across[:, 1:-1] = known[:, 2:] - known[:, :-2]
    down[1:-1] = known[2:] - known[:-2]
    normals = np.cross(across, down)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    return np.asarray(normals / np.where(length > 0, length, np.nan))

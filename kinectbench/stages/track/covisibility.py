"""Find keyframes that see the same places, from their poses and a few of their points."""

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from kinectbench.core.even_choice import evenly
from kinectbench.core.geometry import invert_rigid, transform_points
from kinectbench.core.types import Float64
from kinectbench.stages.track.frame_maps import FrameMaps
from kinectbench.stages.track.map_kernels import PROJECTED_FROM_M

# Resolution level of the thumbnails.
COARSEST = 2
# Points per keyframe: they determine a share of 0.3 to within 0.03 (one standard deviation of a binomial).
POINTS = 200
# Depth tolerance, which includes drift: a measurement farther off than this is another surface.
TOLERANCE_M, TOLERANCE_SHARE = 0.15, 0.05
# Only keyframes whose point centroids lie within this ratio of the mean depth are compared.
NEAR_SHARE = 0.8
# Largest number of keyframes to compare with, the nearest ones; more would cost time.
MAX_NEIGHBOURS = 60


@dataclass(frozen=True)
class KeyframeThumbnail:
    """A depth thumbnail of a keyframe and a few points, enough to compute shared views.

    Attributes:
        depth_m: (height, width) float32, metres, at the coarsest level, about 80 x 60 pixels.
        intrinsics: (4,) fx, fy, cx, cy of that level.
        points: (m, 6) float64, m <= 200: position (metres) and normal, camera frame.
    """

    depth_m: NDArray[np.float32]
    intrinsics: Float64
    points: Float64


def keyframe_thumbnail(maps: FrameMaps) -> KeyframeThumbnail:
    """Make the thumbnail of a keyframe from its maps."""
    level = maps[COARSEST]
    chosen = evenly(len(level.points), POINTS)
    return KeyframeThumbnail(
        level.depth_m, level.camera.intrinsics, level.points[chosen, :6].astype(np.float64)
    )


def shared_view(a: KeyframeThumbnail, b: KeyframeThumbnail, T_a_b: Float64) -> float:
    """Return the fraction (0 to 1) of b's points that a sees; `T_a_b` (4, 4) maps camera b to camera a.

    A point is seen if it faces a, and a's depth at its pixel is within 0.15 m plus 5 % of the point's depth.
    """
    if not len(b.points):
        return 0.0
    return float(_shared(a.depth_m, a.intrinsics, b.points, np.ascontiguousarray(T_a_b)))


def covisible(thumbnails: Sequence[KeyframeThumbnail], T_world: Float64) -> list[tuple[float, int, int]]:
    """Return (share, i, j) for the pairs i < j of keyframes that look at nearby places.

    `share` is the smaller of the pair's two `shared_view` values; it may be 0. Each keyframe is paired with
    at most the 60 nearest others, so the cost grows linearly with the number of keyframes. `T_world` is
    (k, 4, 4), NaN where unknown.
    """
    known = [i for i in range(len(thumbnails)) if np.isfinite(T_world[i]).all() and len(thumbnails[i].points)]
    if len(known) < 2:
        return []
    centres = np.array(
        [transform_points(T_world[i], thumbnails[i].points[:, :3].mean(axis=0)) for i in known]
    )
    reach = [NEAR_SHARE * float(thumbnails[i].points[:, 2].mean()) for i in known]
    tree = cKDTree(centres)
    pairs = set()
    for row, i in enumerate(known):
        near = [j for j in tree.query_ball_point(centres[row], reach[row]) if j != row]
        apart = np.linalg.norm(centres[near] - centres[row], axis=1)
        for j in np.array(near, int)[np.argsort(apart, kind="stable")][:MAX_NEIGHBOURS]:
            pairs.add((min(i, known[j]), max(i, known[j])))
    result = []
    for i, j in sorted(pairs):
        T_i_j = invert_rigid(T_world[i]) @ T_world[j]
        share = min(
            shared_view(thumbnails[i], thumbnails[j], T_i_j),
            shared_view(thumbnails[j], thumbnails[i], invert_rigid(T_i_j)),
        )
        result.append((share, i, j))
    return result


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _shared(depth, intrinsics, points, T):  # type: ignore[no-untyped-def]
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    seen = 0
    for i in range(len(points)):
        p = points[i]
        x = T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]
        y = T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]
        z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
        if z <= PROJECTED_FROM_M:
            continue
        u, v = int(fx * x / z + cx + 0.5), int(fy * y / z + cy + 0.5)
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        nx = T[0, 0] * p[3] + T[0, 1] * p[4] + T[0, 2] * p[5]
        ny = T[1, 0] * p[3] + T[1, 1] * p[4] + T[1, 2] * p[5]
        nz = T[2, 0] * p[3] + T[2, 1] * p[4] + T[2, 2] * p[5]
        if nx * x + ny * y + nz * z >= 0:
            continue
        d = depth[v, u]
        if d > 0 and abs(d - z) < TOLERANCE_M + TOLERANCE_SHARE * z:
            seen += 1
    return seen / len(points)

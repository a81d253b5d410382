"""Whether what the cameras look at stands on a higher plane than the floor: a table, a shelf, a counter."""

import numpy as np

from kinectbench.core.geometry import transform_points
from kinectbench.core.types import Bools, Float64, Int64
from kinectbench.stages.segment.planes import FLAT_COSINE, Surface, floor_frame
from kinectbench.stages.segment.select import GROUNDED_M, SMALL_CELLS, connected, fit_box

# The focus may lie so far below what a flat thing stands on: people do not aim at a finger's breadth.
FOCUS_BELOW_M = 0.03
# A thing that stands on a plane rises so far above it.
CUT_M = 0.02
# What stands on a plane is at most so many times as long as it: a chair's back is as long as its seat, and
# stands on the floor with it; a kettle is a third of what can be seen of a table (own choice).
MAX_SHARE_OF_PLANE = 0.5
# The cameras look at it if their focus is at most so many of its longer sides beside it (own choice).
MAX_BESIDE = 0.5
# Points lie so many times their usual distance apart at most (own choice): cells of that edge touch.
SPACINGS = 2.0


def carries_what_is_looked_at(plane: Float64, surface: Surface) -> bool:
    """Whether a thing stands on a plane where the cameras look, and the plane is larger than it (own rule).

    What only reaches past a table, as a lamp beside it does, has its foot outside of the plane.

    Args:
        plane: (4,), its unit normal up.
        surface: of the scene.
    """
    height_m = surface.points_world @ plane[:3] + plane[3]
    focus_m = float(surface.focus_world @ plane[:3] + plane[3])
    if focus_m < -FOCUS_BELOW_M:
        return False
    T_level_world = floor_frame(plane)
    local = transform_points(T_level_world, surface.points_world)
    focus = transform_points(T_level_world, surface.focus_world)
    cell_m = SPACINGS * surface.spacing_m
    on_plane = (np.abs(height_m) < 2 * surface.inlier_m) & (surface.normals_world @ plane[:3] > FLAT_COSINE)
    thing = _nearest_piece(local[height_m > CUT_M], focus, cell_m)
    patch = _nearest_piece(local[on_plane] * [1, 1, 0], focus * [1, 1, 0], cell_m)
    if thing is None or patch is None:
        return False
    long_m, around = max(fit_box(thing).size_m[:2]), fit_box(patch)
    beside_m = float(np.linalg.norm(thing[:, :2] - focus[:2], axis=1).min())
    stands = thing[:, 2] <= GROUNDED_M
    if not stands.any():
        return False
    foot = np.append(np.median(thing[stands, :2], axis=0), around.center_m[2])
    return bool(
        around.contains(foot[None])[0]
        and long_m <= MAX_SHARE_OF_PLANE * max(around.size_m[:2])
        and beside_m <= MAX_BESIDE * long_m
    )


def _nearest_piece(points: Float64, focus: Float64, cell_m: float) -> Float64 | None:
    """The connected piece (k, 3) of points that is nearest to the focus; None if none is large enough."""
    if len(points) < SMALL_CELLS:
        return None
    label: Int64 = connected(points, cell_m).astype(np.int64)
    distance_m = np.full(int(label.max()) + 1, np.inf)
    np.minimum.at(distance_m, label, np.linalg.norm(points - focus, axis=1))
    distance_m[np.bincount(label) < SMALL_CELLS] = np.inf
    if not np.isfinite(distance_m).any():
        return None
    nearest: Bools = label == np.argmin(distance_m)
    return np.asarray(points[nearest])

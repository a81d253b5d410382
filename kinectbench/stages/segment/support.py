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
# A larger one stands on it if the plane reaches beyond it on so many of these sides (a chair's back ends with
# its seat, behind and beside), and if the cameras look at the thing and not at the plane: their focus is so
# high above it, as a share of the thing's height (own choices; a bin on a small table .37, furniture 0).
SIDES, MOST_SIDES, LEAST_HEIGHT = 12, 0.75, 0.2
# The cameras look at it if their focus is at most so many of its longer sides beside it (own choice).
MAX_BESIDE = 0.5
# Points lie so many times their usual distance apart at most (own choice): cells of that edge touch.
SPACINGS = 2.0


def carries_what_is_looked_at(plane: Float64, surface: Surface) -> bool:
    """Whether a thing stands on a plane where the cameras look, and the plane is larger than it (own rule).

    It is twice as long as the thing; or it goes on all around it, and the cameras look at the thing. What
    only reaches past a table, as a lamp beside it does, has its foot outside of the plane.

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
    is_larger = long_m <= MAX_SHARE_OF_PLANE * max(around.size_m[:2]) or (
        focus_m >= LEAST_HEIGHT * float(thing[:, 2].max()) and _surrounds(patch[:, :2], thing[:, :2])
    )
    return bool(around.contains(foot[None])[0] and is_larger and beside_m <= MAX_BESIDE * long_m)


def _surrounds(patch: Float64, thing: Float64) -> bool:
    """Whether points (k, 2) reach farther out than others (n, 2) on most sides, from the middle of these."""
    middle = (thing.min(axis=0) + thing.max(axis=0)) / 2
    reach_m = np.zeros((2, SIDES))
    for row, points in enumerate((patch - middle, thing - middle)):
        turn = np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) + 0.5
        side = (turn * SIDES).astype(np.int64) % SIDES
        np.maximum.at(reach_m[row], side, np.linalg.norm(points, axis=1))
    return bool((reach_m[0] > reach_m[1]).mean() >= MOST_SIDES)


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

"""Obstacles to a camera, such as a wall or a neighbour, that are not the object."""

import numpy as np

from kinectbench.core.geometry import OrientedBox, invert_rigid, transform_points
from kinectbench.core.sensor_limits import SensorLimits
from kinectbench.core.types import Bools, Float64, Int64
from kinectbench.core.voxels.morphology import cell_numbers
from kinectbench.stages.segment.find.object import Segmentation

MOVE_AWAY = "move it away from what stands behind it, and"
# A surface that a line meets has this many cells within this many cells of the line (chosen by hand: seven of
# a plane across it, three of an edge).
HIT_CELLS, BESIDE_CELLS = 3, 1.5
# The object hides what is right behind it. A wall shows on both sides of it, over this many cells each, and
# rises over this many above what is looked at: 0.5 m, which boxes on the floor do not. This many lines
# through a cell on either side are tried (chosen by hand).
WALL_CELLS, TRIED_LINES = 16, 300
# A look that is steeper than this (vertical part of a unit vector) meets no wall: 72 degrees.
STEEP = 0.95


def is_obstructed(chosen: Segmentation, point_floor: Float64, look: Float64, limits: SensorLimits) -> bool:
    """Whether something other than the object is in the way of a camera that looks at a point.

    The camera stands at least `near_m` outside the object's box. An obstacle is anything measured on the line
    between the box and that camera, or a wall that was measured on both sides of the line.

    Args:
        chosen: the object, and what else stands on the floor.
        point_floor: (3,) the camera's target, floor frame, metres.
        look: (3,) unit vector, floor frame, from the point to the camera.
        limits: of the sensor.
    """
    cell_m = chosen.cell_m
    others = (chosen.other_cells + 0.5) * cell_m - point_floor
    along_m = others @ look
    beside_m = np.linalg.norm(others - along_m[:, None] * look, axis=1)
    out_m = _way_out_m(chosen.box, point_floor, look)
    reach_m = out_m + limits.near_m + limits.camera_size_m / 2
    met = (along_m > out_m) & (along_m < reach_m) & (beside_m < BESIDE_CELLS * cell_m)
    if met.sum() >= HIT_CELLS:
        return True
    if abs(look[2]) > STEEP:
        return False
    towards = look[:2] / np.linalg.norm(look[:2])
    higher = others[others[:, 2] > 0, :2]
    level = np.column_stack([higher @ towards, higher @ [-towards[1], towards[0]]])
    near = (np.abs(level) < 2 * reach_m + WALL_CELLS * cell_m).all(axis=1)
    cells = np.floor(level[near] / cell_m).astype(np.int64)
    _, first, counts = np.unique(cell_numbers(cells), return_index=True, return_counts=True)
    columns = cells[first[counts >= WALL_CELLS]]
    return bool((_wall_crossings(columns) * cell_m < reach_m).any())


def _way_out_m(box: OrientedBox, point_floor: Float64, look: Float64) -> float:
    """Return the distance from a point (3,) in an upright box to its boundary along `look`; 0 if outside."""
    T_box_floor = invert_rigid(box.T_floor_box)
    point, along = transform_points(T_box_floor, point_floor), T_box_floor[:3, :3] @ look
    half = np.array(box.size_m) / 2
    with np.errstate(divide="ignore"):
        return max(0.0, float(((half - np.sign(along) * point) / np.abs(along)).min()))


def _wall_crossings(columns: Int64) -> Float64:
    """Find where a line crosses upright walls; return distances (k,) along the line, from 0 on, in cells.

    `columns` (n, 2) are the cells of measured columns seen from above: their position along the line, and to
    its left. A wall is straight, and has columns on both sides of the line.
    """
    sides: tuple[Bools, Bools] = (columns[:, 1] > 0, columns[:, 1] < 0)
    if min(int(side.sum()) for side in sides) < WALL_CELLS:
        return np.zeros(0)
    rng = np.random.default_rng(0)
    left, right = (columns[rng.choice(np.flatnonzero(side), TRIED_LINES)] for side in sides)
    step = right - left
    normal = np.column_stack([-step[:, 1], step[:, 0]]) / np.linalg.norm(step, axis=1)[:, None]
    off = np.abs(columns @ normal.T - (left * normal).sum(axis=1)) < 1
    holds = np.logical_and(*(off[side].sum(axis=0) >= WALL_CELLS for side in sides))
    crossing = left[:, 0] - left[:, 1] * step[:, 0] / step[:, 1]
    return np.asarray(crossing[holds & (crossing > 0)])

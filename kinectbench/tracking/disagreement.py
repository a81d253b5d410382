"""By how much two or more frames disagree with the poses they are said to have."""

from collections.abc import Sequence
from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.geometry import invert_rigid, rotation_angle_rad, transform_points
from kinectbench.tracking.frame_maps import FrameMaps, Level
from kinectbench.tracking.registration import PLACED, Registration, register
from kinectbench.tracking.twist import twist_from_rigid

Float64 = NDArray[np.float64]

# Of a shift, so many of its standard deviations are put down to the registration.
SIGMAS = 3.0
# Frames of which no more than this falls on measurements of others are not compared.
MIN_OVERLAP = 0.05
# Points that tell how far a motion moves what is seen.
MOVED_POINTS = 1000
# Residuals: how far along the ray a measurement may lie from the point it is taken for, and the least cosine
# between their normals.
GATE_M = 0.1
MIN_FACING = 0.5
MIN_DEPTH_M = 0.1


@dataclass(frozen=True)
class Disagreement:
    """How a frame would move to agree with others.

    Attributes:
        registration: of the frame to the first of the others, from where its pose puts it.
        shift_m: how far its points move, median, metres.
        certain_shift_m: of this, what the registration cannot be wrong by.
        turn_rad: by how much the camera turns, radians.
    """

    registration: Registration
    shift_m: float
    certain_shift_m: float
    turn_rad: float


def ask(
    source: FrameMaps,
    targets: Sequence[FrameMaps],
    T_targets_source: Sequence[Float64],
    coarsest: int,
    every: int,
) -> Disagreement | None:
    """Register a frame to others from where the poses put it; None if they have too little in common.

    Args:
        source: the frame.
        targets: one or more others, that stand still to each other.
        T_targets_source: (4, 4) each, as the poses say.
        coarsest: level to start at; 0 finds less than half of a shift of 100 mm, 2 all of it.
        every: only every n-th point is used.
    """
    found = register(source, targets, T_targets_source, coarsest, PLACED, every)
    if found.overlap < MIN_OVERLAP or found.over_noise == 0:
        return None
    return disagreement(source, T_targets_source[0], found)


def disagreement(source: FrameMaps, T_target_source: Float64, found: Registration) -> Disagreement:
    """How far a registration is from where the poses put the frame (own rule).

    A shift is as certain as the information along it says; along an open motion there is none.

    Args:
        source: the frame.
        T_target_source: (4, 4), as the poses say.
        found: its registration to the same target.
    """
    off = invert_rigid(T_target_source) @ found.T_target_source
    points = source.levels[0].points[:, :3].astype(np.float64)
    points = points[:: max(1, len(points) // MOVED_POINTS)]
    shift_m = float(np.median(np.linalg.norm(transform_points(off, points) - points, axis=1)))
    twist = twist_from_rigid(off)
    over_sigma = np.sqrt(max(float(twist @ found.information @ twist), 1e-12))
    certain_shift_m = shift_m * max(0.0, 1 - SIGMAS / float(over_sigma))
    return Disagreement(found, shift_m, certain_shift_m, float(rotation_angle_rad(off[:3, :3])))


def residuals_m(source: FrameMaps, target: Level, T_target_source: Float64, every: int) -> Float64:
    """Point-to-plane distances (m,) of all points of a frame that lie within 0.1 m of what they fall on.

    Unlike a registration's they are not cut off at the noise, so they tell how wrong a pose is.

    Args:
        source: the frame.
        target: the finest level of the other.
        T_target_source: (4, 4).
        every: only every n-th point is used.
    """
    return np.asarray(
        _residuals(
            source.levels[0].points[::every],
            target.depth_m,
            target.normals,
            target.intrinsics,
            np.ascontiguousarray(T_target_source),
        )
    )


@numba.njit(cache=True, error_model="numpy")
def _residuals(points, depth, normals, intrinsics, T):  # type: ignore[no-untyped-def]
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    found = np.empty(len(points))
    count = 0
    for i in range(len(points)):
        p = points[i]
        x = T[0, 0] * p[0] + T[0, 1] * p[1] + T[0, 2] * p[2] + T[0, 3]
        y = T[1, 0] * p[0] + T[1, 1] * p[1] + T[1, 2] * p[2] + T[1, 3]
        z = T[2, 0] * p[0] + T[2, 1] * p[1] + T[2, 2] * p[2] + T[2, 3]
        if z <= MIN_DEPTH_M:
            continue
        u, v = fx * x / z + cx + 0.5, fy * y / z + cy + 0.5
        if u < 0 or v < 0 or u >= width or v >= height:
            continue
        column, row = int(u), int(v)
        d, m = depth[row, column], normals[row, column]
        if d <= 0 or abs(d - z) > GATE_M:
            continue
        nx = T[0, 0] * p[3] + T[0, 1] * p[4] + T[0, 2] * p[5]
        ny = T[1, 0] * p[3] + T[1, 1] * p[4] + T[1, 2] * p[5]
        nz = T[2, 0] * p[3] + T[2, 1] * p[4] + T[2, 2] * p[5]
        if nx * m[0] + ny * m[1] + nz * m[2] < MIN_FACING:
            continue
        dx, dy = (column - cx) / fx * d - x, (row - cy) / fy * d - y
        found[count] = abs(nx * dx + ny * dy + nz * (d - z))
        count += 1
    return found[:count].copy()

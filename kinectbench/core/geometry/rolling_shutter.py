"""Undo a rolling shutter: move each pixel to where it would be at the middle of the frame's readout.

The rows of a frame are read one after the other while the camera moves. A Kinect v1 takes about 30 ms from
the first row to the last (Ringaby & Forssen: Scan rectification for structured light range sensors with
rolling shutters, ICCV 2011): at 150 degrees a second, the view turns by 4.5 degrees in that time.
"""

from dataclasses import dataclass

import numba
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.geometry.camera import Camera
from kinectbench.core.geometry.rigid import invert_rigid, twist_from_rigid
from kinectbench.core.types import Bools, Float64, Int64

# The source row of a pixel depends on its readout time, and that time on the source row. Each pass divides
# the error by the ratio of the frame's rows to the rows that the pixel moves, at least 10.
PASSES = 3
# Neighbouring pixels belong to one surface if their depths differ by less than this share.
SAME_SURFACE = 0.03
# Frames farther apart in time do not determine the camera's motion at a frame.
MAX_STEP_S = 0.1


@dataclass(frozen=True)
class RollingShutter:
    """The readout time of a recording's frames, and the camera's motion during each frame.

    Attributes:
        readout_s: time from the first row to the last, seconds; negative: the last row comes first.
        color_delay_s: delay of colour relative to depth, seconds.
        motion: (n, 12), the camera's motion at each frame in its own axes: angular velocity (rad/s) and
            velocity (m/s), then their derivatives (rad/s^2, m/s^2).
    """

    readout_s: float
    color_delay_s: float
    motion: Float64


def upright_depth(
    depth: NDArray[np.uint16], units_per_m: float, camera: Camera, motion: Float64, readout_s: float
) -> NDArray[np.uint16]:
    """Return depth (height, width) as a global shutter would record it.

    Args:
        depth: (height, width) uint16, 0 = none.
        units_per_m: units of depth per metre.
        camera: intrinsics for this image size.
        motion: (12,) of the camera, as in `RollingShutter.motion`.
        readout_s: time from the first row to the last, seconds.
    """
    return np.asarray(_depth_at_once(depth, float(units_per_m), camera.intrinsics, motion, readout_s))


def upright_gray(
    gray: NDArray[np.uint8],
    depth_m: NDArray[np.float32],
    camera: Camera,
    motion: Float64,
    readout_s: float,
    delay_s: float,
) -> NDArray[np.uint8]:
    """Return a grey or colour image as a global shutter would record it, at the middle of depth's readout.

    Args:
        gray: (height, width) or (height, width, 3) uint8.
        depth_m: (height, width), already corrected; only the rotation is undone where it is 0.
        camera: intrinsics for this image size.
        motion: (12,) of the camera, as in `RollingShutter.motion`.
        readout_s: time from the first row to the last, seconds.
        delay_s: delay of colour relative to depth, seconds.
    """
    import cv2

    u, v = _taken_at(depth_m, camera.intrinsics, motion, readout_s, delay_s)
    moved = cv2.remap(gray, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(moved, np.uint8)


def upright_mask(
    mask: Bools, depth_m: NDArray[np.float32], camera: Camera, motion: Float64, readout_s: float
) -> Bools:
    """Return a mask (height, width) bool as a global shutter would record it.

    Args:
        mask: (height, width) bool, a mask of depth as recorded.
        depth_m: (height, width) float32, metres, after `upright_depth`; 0 = none.
        camera: intrinsics for this image size.
        motion: (12,) of the camera, as in `RollingShutter.motion`.
        readout_s: time from the first row to the last, seconds.
    """
    import cv2

    u, v = _taken_at(depth_m, camera.intrinsics, motion, readout_s, 0.0)
    return np.asarray(cv2.remap(mask.astype(np.uint8), u, v, cv2.INTER_NEAREST), dtype=bool)


def motions(T_segment_camera: Float64, segment: Int64, stamps_s: Float64) -> Float64:
    """Estimate the camera's motion at each frame, (n, 12) as in `RollingShutter.motion`.

    Rates come from neighbouring poses, from first to last at most 0.2 s apart, and are interpolated where a
    frame has no such neighbour. All are 0 if fewer than two frames have one.

    Args:
        T_segment_camera: (n, 4, 4), NaN where unknown.
        segment: (n,) index of the world of each pose: poses of two worlds are unrelated.
        stamps_s: (n,) times of the frames, seconds.
    """
    n = len(stamps_s)
    known: Bools = np.isfinite(T_segment_camera[:, 0, 0])
    rates = np.full((n, 6), np.nan)
    for index in np.flatnonzero(known):
        around = [k for k in (index - 1, index, index + 1) if 0 <= k < n and known[k]]
        around = [k for k in around if segment[k] == segment[index]]
        apart_s = stamps_s[around[-1]] - stamps_s[around[0]]
        if len(around) < 2 or not 0 < apart_s <= 2 * MAX_STEP_S:
            continue
        step = twist_from_rigid(invert_rigid(T_segment_camera[around[0]]) @ T_segment_camera[around[-1]])
        rates[index] = step / apart_s
    measured = np.flatnonzero(np.isfinite(rates[:, 0]))
    if len(measured) < 2:
        return np.zeros((n, 12))
    between = np.column_stack([np.interp(np.arange(n), measured, rates[measured, k]) for k in range(6)])
    return np.column_stack([between, np.gradient(between, _ascending(stamps_s), axis=0)])


def _ascending(stamps_s: Float64) -> Float64:
    """Return times from 0 on with the steps of `stamps_s`, but each step at least 0.1 median steps."""
    steps = np.diff(stamps_s)
    least = 0.1 * max(float(np.median(steps)), 1e-6)
    return np.concatenate([[0.0], np.cumsum(np.maximum(steps, least))])


@numba.njit(cache=True, error_model="numpy", nogil=True, inline="always")
def _seen_from(x, y, over_z, motion, since_s):  # type: ignore[no-untyped-def]
    """Transform a point from the camera's axes at mid-readout to those `since_s` later.

    The point is (x, y, 1) / over_z, metres. The result is the transformed point times over_z. `motion` (12,)
    is as in `RollingShutter.motion`.
    """
    half_s = 0.5 * since_s
    ax = since_s * (motion[0] + half_s * motion[6])
    ay = since_s * (motion[1] + half_s * motion[7])
    az = since_s * (motion[2] + half_s * motion[8])
    x -= since_s * (motion[3] + half_s * motion[9]) * over_z
    y -= since_s * (motion[4] + half_s * motion[10]) * over_z
    z = 1 - since_s * (motion[5] + half_s * motion[11]) * over_z
    # Rotate back, to second order.
    bx, by, bz = ay * z - az * y, az * x - ax * z, ax * y - ay * x
    return (
        x - bx + 0.5 * (ay * bz - az * by),
        y - by + 0.5 * (az * bx - ax * bz),
        z - bz + 0.5 * (ax * by - ay * bx),
    )


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _taken_at(depth_m, intrinsics, motion, readout_s, delay_s):  # type: ignore[no-untyped-def]
    """Return u and v, (height, width) each, of the recorded pixel for each pixel of the corrected image.

    Arguments as in `upright_gray`, but `intrinsics` is (fx, fy, cx, cy).
    """
    height, width = depth_m.shape
    fx, fy, cx, cy = intrinsics
    at_u, at_v = np.empty((height, width), np.float32), np.empty((height, width), np.float32)
    for v in range(height):
        for u in range(width):
            x, y = (u - cx) / fx, (v - cy) / fy
            row, column = float(v), float(u)
            over_z = 1 / float(depth_m[v, u]) if depth_m[v, u] > 0 else 0.0
            for _ in range(PASSES):
                since_s = delay_s + readout_s * (row / (height - 1) - 0.5)
                rx, ry, rz = _seen_from(x, y, over_z, motion, since_s)
                column, row = fx * rx / rz + cx, fy * ry / rz + cy
            at_u[v, u], at_v[v, u] = column, row
    return at_u, at_v


@numba.njit(cache=True, error_model="numpy", nogil=True)
def _depth_at_once(depth, units_per_m, intrinsics, motion, readout_s):  # type: ignore[no-untyped-def]
    """Return the depth at mid-readout; see `upright_depth`. `intrinsics` is (fx, fy, cx, cy).

    It is interpolated between four recorded pixels, or taken from the nearest one at depth edges.
    """
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    moved = np.zeros((height, width), np.uint16)
    for v in range(height):
        for u in range(width):
            x, y = (u - cx) / fx, (v - cy) / fy
            row, column, rz = float(v), float(u), 1.0
            over_z = units_per_m / float(depth[v, u]) if depth[v, u] > 0 else 0.0
            for _ in range(PASSES):
                since_s = readout_s * (row / (height - 1) - 0.5)
                rx, ry, rz = _seen_from(x, y, over_z, motion, since_s)
                column, row = fx * rx / rz + cx, fy * ry / rz + cy
                if column < 0 or row < 0 or column >= width - 1 or row >= height - 1:
                    break
                near = float(depth[np.uint32(row + 0.5), np.uint32(column + 0.5)])
                if near > 0:
                    over_z = units_per_m * rz / near
            if column < 0 or row < 0 or column >= width - 1 or row >= height - 1:
                continue
            near = float(depth[np.uint32(row + 0.5), np.uint32(column + 0.5)])
            if near == 0:
                continue
            i, j = np.uint32(row), np.uint32(column)
            down, right = row - i, column - j
            d00, d01 = float(depth[i, j]), float(depth[i, j + 1])
            d10, d11 = float(depth[i + 1, j]), float(depth[i + 1, j + 1])
            seen = near
            if max(abs(d00 - near), abs(d01 - near), abs(d10 - near), abs(d11 - near)) < SAME_SURFACE * near:
                seen = (d00 * (1 - right) + d01 * right) * (1 - down)
                seen += (d10 * (1 - right) + d11 * right) * down
            moved[v, u] = np.uint16(min(seen / rz + 0.5, 65535.0))
    return moved

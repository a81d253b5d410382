"""Whether a floor is in view, and how high the camera is above it."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from kinectbench.doctor.finding import Finding
from kinectbench.doctor.fit import small_camera
from kinectbench.doctor.look import Look, SmallFrame
from kinectbench.errors import SegmentationError
from kinectbench.geometry import Camera

FRAMES, STEP_PX = 6, 4
FOCUS_CAMERA = np.array([0.0, 0.0, 1.5])
# Of a person's camera above the floor, metres.
LOWEST_M, HIGHEST_M = 0.25, 2.5
SEEN_SHARE = 0.3
MIN_POINTS = 200


def camera_heights_m(look: Look) -> NDArray[np.float64]:
    """(k,) height above the floor in each of some frames, metres; NaN where no floor is found.

    A frame's floor is a plane that faces up and has nothing below it, if the camera is held upright.
    """
    count = len(look.frames)
    indices = np.unique(np.linspace(0, count - 1, min(FRAMES, count)).astype(int)).tolist()
    camera = small_camera(look)
    return np.array([_height_m(look.frames[i], camera) for i in indices])


def check_floor(look: Look, heights_m: NDArray[np.float64]) -> Iterator[Finding]:
    """Judge whether there is a floor, and whether it is where floors are."""
    seen = np.isfinite(heights_m)
    if seen.mean() < SEEN_SHARE:
        what = f"a floor is in view in {seen.sum()} of {len(seen)} frames"
        advice = "hold the camera upright and let it see the floor around the object; or give a `box`"
        yield Finding("no_floor", "note", what, look.where, advice)
        return
    height_m = float(np.nanmedian(heights_m))
    if not LOWEST_M <= height_m <= HIGHEST_M:
        what = f"the camera is {height_m:.2f} m above the floor, if depth has the right unit"
        yield Finding("camera_height", "warning", what, look.where, "check `depth_scale`")


def _height_m(frame: SmallFrame, camera: Camera) -> float:
    from kinectbench.segmentation.floor import find_floor

    if frame.depth_m.shape != (camera.height, camera.width):
        return float("nan")
    points, normals = _surface(frame.depth_m, camera)
    if len(points) < MIN_POINTS:
        return float("nan")
    # Lengths are given as if the middle were 1.5 m away: a wrong unit must not hide the floor.
    unit = float(FOCUS_CAMERA[2]) / float(np.median(points[:, 2]))
    try:
        floor = find_floor(points * unit, normals, np.eye(4)[None], FOCUS_CAMERA, 0)
    except SegmentationError:
        return float("nan")
    return float(floor.plane_world[3]) / unit


def _surface(depth_m: NDArray[np.float32], camera: Camera) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Points (n, 3) and unit normals (n, 3) towards the camera, camera axes, on every fourth pixel."""
    surface = camera.backproject(depth_m)
    known = np.where((depth_m > 0)[..., None], surface, np.nan)
    across, down = np.full(surface.shape, np.nan), np.full(surface.shape, np.nan)
    across[:, 2:-2] = known[:, 4:] - known[:, :-4]
    down[2:-2] = known[4:] - known[:-4]
    normals = np.cross(down, across)
    length = np.linalg.norm(normals, axis=-1, keepdims=True)
    normals = normals / np.where(length > 0, length, np.nan)
    chosen = np.isfinite(np.concatenate([normals, known], axis=-1)).all(axis=-1)
    keep = np.zeros_like(chosen)
    keep[::STEP_PX, ::STEP_PX] = chosen[::STEP_PX, ::STEP_PX]
    return surface[keep], normals[keep]

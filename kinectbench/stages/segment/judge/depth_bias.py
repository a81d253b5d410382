"""Tell by its values whether depth is a Kinect v1's, for which alone the surface error is known.

Light that comes by a detour makes a time-of-flight sensor see every surface some millimetres too far away,
from all sides: the object is smaller, and nothing in the recording contradicts it. So the kind of the sensor
has to be known. The depth of a Kinect v1 comes in steps of disparity (Khoshelham and Elberink: Accuracy and
Resolution of Kinect Depth Data, Sensors 12(2), 2012). Its inverse has 346 steps in 1/m, which is the product
of 576 px, a baseline of 75 mm, and 8 steps a pixel: 3 mm at 1 m, 12 mm at 2 m. A RealSense D435 has 1.6 times
its focal length in pixels (50 mm, 32 steps a pixel): 678 at 848x480, 337 at 424x240. But it sees 90 degrees,
and a Kinect 57 to 63.
"""

from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from kinectbench.core.geometry import Camera
from kinectbench.core.own_pixels import whole
from kinectbench.core.sequence import Sequence
from kinectbench.core.threads import ahead
from kinectbench.core.types import Int64
from kinectbench.stages.fuse.depth_range import some_frames

# Measured: 341 to 349 of a Kinect v1 in 41 recordings (simulated, cabinet, kitchen). A scale that is wrong by
# 5 % changes them as much. Its images are 1.1 to 1.24 focal lengths wide, a RealSense's two.
KINECT_STEPS, LEAST_KINECT_STEPS, MOST_KINECT_STEPS, WIDEST_KINECT = 346.0, 325.0, 365.0, 1.4
# Values are counted in bins as wide as a millimetre, or the unit of depth if that is wider; from the depth on
# where a Kinect's steps are this many bins wide, and up to where there is little depth, metres.
BIN_M, STEP_BINS, FARTHEST_M = 0.001, 2.5, 4.0
# A value occurs if it is at most this much rarer than those around it, in a window of so many bins, which
# have on average at least so many pixels. So many values must occur.
RARER, WINDOW_BINS, LEAST_PIXELS, LEAST_VALUES = 4.0, 41, 20, 20
# Every second row and column is counted.
STEP_PX = 2


def inverse_depth_steps(sequence: Sequence, frames: Int64) -> float | None:
    """Return how many steps the inverse of depth has in 1/m, by at most 40 of the frames (n,).

    Where depth has no steps, its unit makes 865 or more. None if there is too little depth between about 1 m
    (for units above a millimetre, more) and 4 m.
    """
    bin_m = max(BIN_M, 1 / sequence.depth_scale)
    counts = np.zeros(round(FARTHEST_M / bin_m))
    for native in ahead(partial(_some_depth, whole(sequence)), some_frames(frames)):
        values = np.rint(native[native > 0] / (bin_m * sequence.depth_scale)).astype(np.int64)
        counts += np.bincount(values[values < len(counts)], minlength=len(counts))
    usual = ndimage.uniform_filter1d(counts, WINDOW_BINS)
    found_m = bin_m * np.flatnonzero((RARER * counts > usual) & (usual >= LEAST_PIXELS))
    middles_m, gaps_m = (found_m[1:] + found_m[:-1]) / 2, np.diff(found_m)
    judged = (middles_m**2 >= STEP_BINS * bin_m * KINECT_STEPS) & (gaps_m < WINDOW_BINS * bin_m)
    if int(judged.sum()) < LEAST_VALUES:
        return None
    return float(np.median(middles_m[judged] ** 2 / gaps_m[judged]))


def is_of_kinect(steps: float | None, camera: Camera) -> bool:
    """Whether `inverse_depth_steps` and field of view are those of a Kinect v1 or other PrimeSense camera."""
    is_wide = camera.width > WIDEST_KINECT * camera.fx
    return steps is not None and not is_wide and LEAST_KINECT_STEPS <= steps <= MOST_KINECT_STEPS


def _some_depth(sequence: Sequence, frame: int) -> NDArray[np.uint16]:
    """Return the depth of some pixels of a frame, native units: (rows, columns)."""
    return sequence.frames.depth_native(int(frame))[::STEP_PX, ::STEP_PX]

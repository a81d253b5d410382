"""Tell by its depth values what a recording's depth may be off by everywhere.

Light that comes by a detour makes a time-of-flight sensor see every surface some millimetres too far away,
from all sides: the object is smaller, and nothing in the recording contradicts it. So the kind of the sensor
has to be known. The depth of a Kinect v1 comes in steps of disparity (Khoshelham and Elberink:
Accuracy and Resolution of Kinect Depth Data, Sensors 12(2), 2012): 3 mm at 1 m, 13 mm at 2 m. That of a time
of flight has every value.
"""

from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from kinectbench.core.own_pixels import whole
from kinectbench.core.sequence import Sequence
from kinectbench.core.threads import ahead
from kinectbench.core.types import Int64
from kinectbench.stages.fuse.depth_range import some_frames

# The range of depth in which values are counted, metres: nearer than this, a Kinect's steps are below 1.6 mm,
# and the values of farther surfaces are few.
NEAREST_M, FARTHEST_M = 0.7, 3.0
# Values are counted in bins as wide as a millimetre, or the unit of depth if that is wider.
BIN_M = 0.001
# A value is missing if it is this much rarer than the values around it, in a window of so many bins, which
# have on average at least so many pixels. So many bins must be judged.
RARER, WINDOW_BINS, LEAST_PIXELS, LEAST_BINS = 4.0, 41, 20, 100
# Depth has steps if a smaller share of its values occurs. Measured: 0.05 to 0.17 in 40 recordings by a Kinect
# v1 (simulated, cabinet, kitchen); 0.98 to 1 in 18 by a simulated Azure Kinect and phone.
MAX_FILLED = 0.7
# Every second row and column is counted.
STEP_PX = 2


def shows_disparity_steps(sequence: Sequence, frames: Int64) -> bool:
    """Whether depth as recorded comes in steps of disparity, by at most 40 of the frames (n,).

    False if too little of it lies in the range of depth that tells.
    """
    bin_units = max(1.0, BIN_M * sequence.depth_scale)
    first, end = (round(depth_m * sequence.depth_scale / bin_units) for depth_m in (NEAREST_M, FARTHEST_M))
    counts = np.zeros(end)
    for native in ahead(partial(_some_depth, whole(sequence)), some_frames(frames)):
        values = np.rint(native[native > 0] / bin_units).astype(np.int64)
        counts += np.bincount(values[values < end], minlength=end)
    usual = ndimage.uniform_filter1d(counts, WINDOW_BINS)
    judged = usual >= LEAST_PIXELS
    judged[:first] = False
    if int(judged.sum()) < LEAST_BINS:
        return False
    return float((RARER * counts > usual)[judged].mean()) < MAX_FILLED


def _some_depth(sequence: Sequence, frame: int) -> NDArray[np.uint16]:
    """Return the depth of some pixels of a frame, native units: (rows, columns)."""
    return sequence.frames.depth_native(int(frame))[::STEP_PX, ::STEP_PX]

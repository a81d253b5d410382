"""What a prediction says is occupied at a threshold: packed bits of the 256-grid."""

import numpy as np

from kinectbench.scoring.counts import Prediction
from kinectbench.voxels.pair_file import FULL_CELLS, Packed
from kinectbench.voxels.resample import HALF_PIXEL, upsampled_planes


def occupied(prediction: Prediction, threshold: float, upsampling: str = HALF_PIXEL) -> Packed:
    """Where y > threshold, compared in float64: (256, 256, 32) uint8, most significant bit first.

    Args:
        prediction: (n, n, n), C order, values in [0, 1]; a cube that is not 256 a side is upsampled.
        threshold: in [0, 1).
        upsampling: see `upsampled_planes`.
    """
    if len(prediction) != FULL_CELLS:
        planes = upsampled_planes(prediction, convention=upsampling)
        return np.stack([np.packbits(plane > threshold, axis=-1) for plane in planes])
    if prediction.dtype == np.bool_:
        return np.packbits(prediction.view(np.bool_), axis=-1)
    # The largest number of this type that is not above the threshold: a comparison without conversion.
    cut = prediction.dtype.type(threshold)
    if float(cut) > threshold:
        cut = np.nextafter(cut, prediction.dtype.type(0))
    if prediction.dtype == np.float16:  # of numbers in [0, 1] the bit patterns are in the same order
        return np.packbits(prediction.view(np.int16) > cut.view(np.int16), axis=-1)
    return np.packbits(prediction > cut, axis=-1)

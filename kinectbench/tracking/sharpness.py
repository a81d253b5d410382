"""How sharp the colour images are: motion blur shows before it costs the track."""

import numpy as np
from numpy.typing import NDArray

# Detail finer than this, in pixels of the halved image, is what motion takes first.
COARSE_SIGMA_PX = 2.0
# Below this the coarse detail of an image is rounding: there is nothing to see in it.
MIN_COARSE_VARIANCE = 0.01


def image_sharpness(gray: NDArray[np.uint8]) -> float:
    """How much fine detail there is for the coarse detail that there is; NaN for an image without any.

    The variance of the Laplacian (Pech-Pacheco et al., "Diatom autofocusing in brightfield microscopy", ICPR
    2000) over that of the smoothed image's: so it depends little on what is shown, and not on exposure (own
    rule).

    Args:
        gray: (height, width) uint8, about 320 wide, where less of its detail is the sensor's noise.
    """
    import cv2

    image = gray.astype(np.float32)
    coarse = cv2.GaussianBlur(image, (0, 0), COARSE_SIGMA_PX)
    fine_variance, coarse_variance = (
        float(cv2.meanStdDev(cv2.Laplacian(each, cv2.CV_32F))[1][0, 0] ** 2) for each in (image, coarse)
    )
    return fine_variance / coarse_variance if coarse_variance > MIN_COARSE_VARIANCE else np.nan


def relative_blur(sharpness: NDArray[np.float64]) -> NDArray[np.float64]:
    """How blurred each frame is, relative to the recording's median frame.

    Args:
        sharpness: (n,), NaN where unknown.

    Returns:
        (n,): 1 is as sharp as the median frame, 2 half as sharp; NaN where unknown.
    """
    known = np.isfinite(sharpness) & (sharpness > 0)
    relative = np.full(len(sharpness), np.nan)
    if known.any():
        relative[known] = np.median(sharpness[known]) / sharpness[known]
    return relative

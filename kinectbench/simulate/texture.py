"""Procedural textures by room coordinates: one seeded, periodic noise image serves every surface."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

# A power of two, so that coordinates wrap by masking bits.
TEXTURE_PX = 512
PIXELS_PER_M = 256.0
BLURS_PX = (1.5, 5.0, 16.0, 50.0)


@dataclass(frozen=True)
class Texture:
    """Smooth noise in [-1, 1] that repeats every 2 m.

    Attributes:
        image: (512, 512) float32.
    """

    image: NDArray[np.float32]


def make_texture(rng: np.random.Generator) -> Texture:
    """Draw the noise: white noise blurred at four scales, each normalised, then summed (own choice).

    Detail at every scale gives a tracker something to hold on to from near and from far.
    """
    frequency = np.fft.fftfreq(TEXTURE_PX)
    squared = frequency[:, None] ** 2 + frequency[None, :] ** 2
    image = np.zeros((TEXTURE_PX, TEXTURE_PX))
    for blur_px in BLURS_PX:
        gain = np.exp(-2 * (np.pi * blur_px) ** 2 * squared)
        white = rng.standard_normal((TEXTURE_PX, TEXTURE_PX))
        octave = np.fft.ifft2(np.fft.fft2(white) * gain).real
        image += octave / octave.std()
    return Texture(np.clip(image / (2.5 * image.std()), -1, 1).astype(np.float32))

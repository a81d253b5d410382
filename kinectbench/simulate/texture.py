"""Procedural textures by room coordinates: one seeded, periodic noise image serves every surface."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

TEXTURE_PX = 512
PIXELS_PER_M = 256.0
BLURS_PX = (1.5, 5.0, 16.0, 50.0)
JOINT_M = 0.012
# The two room axes that span a surface, by the axis its normal is nearest to.
SPANNING_AXES = np.array([[1, 2], [0, 2], [0, 1]])


@dataclass(frozen=True)
class Texture:
    """Smooth noise in [-1, 1] that repeats every 2 m.

    Attributes:
        image: (512, 512) float32.
    """

    image: NDArray[np.float32]

    def brightness(
        self,
        points_room: NDArray[np.float64],
        normals_room: NDArray[np.float64],
        contrast: NDArray[np.float64],
        tile_m: NDArray[np.float64],
    ) -> NDArray[np.float64]:
        """Factor on the colour at surface points.

        Args:
            points_room: (height, width, 3), metres.
            normals_room: (height, width, 3).
            contrast: (height, width), strength of the noise.
            tile_m: (height, width), size of tiles, 0 for none.

        Returns:
            (height, width), around 1.
        """
        import cv2

        axes = SPANNING_AXES[np.argmax(np.abs(normals_room), axis=-1)]
        plane_m = np.take_along_axis(points_room, axes, axis=-1)
        pixels = np.mod(plane_m * PIXELS_PER_M, TEXTURE_PX).astype(np.float32)
        u, v = pixels[..., 0], pixels[..., 1]
        noise = cv2.remap(self.image, u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_WRAP)
        factor: NDArray[np.float64] = 1.0 + contrast * noise
        rows, columns = np.nonzero(tile_m > 0)
        cell, within = np.divmod(plane_m[rows, columns], tile_m[rows, columns, None])
        joint = within.min(axis=-1) < JOINT_M
        shade = 1.0 + 0.25 * self.image[tuple(np.mod(cell * 37, TEXTURE_PX).astype(int).T)]
        factor[rows, columns] *= np.where(joint, 0.55, shade)
        return factor


def make_texture(rng: np.random.Generator) -> Texture:
    """Draw the noise: white noise blurred at four scales, each normalised, then summed."""
    frequency = np.fft.fftfreq(TEXTURE_PX)
    squared = frequency[:, None] ** 2 + frequency[None, :] ** 2
    image = np.zeros((TEXTURE_PX, TEXTURE_PX))
    for blur_px in BLURS_PX:
        gain = np.exp(-2 * (np.pi * blur_px) ** 2 * squared)
        white = rng.standard_normal((TEXTURE_PX, TEXTURE_PX))
        octave = np.fft.ifft2(np.fft.fft2(white) * gain).real
        image += octave / octave.std()
    return Texture(np.clip(image / (2.5 * image.std()), -1, 1).astype(np.float32))

"""A recording with its rolling shutter undone: images as a global shutter would record them."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.encoded_images import decoded_image
from kinectbench.core.geometry import Camera
from kinectbench.core.geometry.rolling_shutter import (
    RollingShutter,
    upright_depth,
    upright_gray,
    upright_mask,
)
from kinectbench.core.sequence import FrameStore, Sequence, depth_in_metres
from kinectbench.core.types import Bools, Float32

# Corrected colour is encoded without loss, at a fast level.
PNG_LEVEL = 1


@dataclass(frozen=True)
class UprightFrames:
    """Frames with depth and registered colour as if taken at one instant, in the middle of the readout.

    Attributes:
        frames: the frames as recorded.
        camera: intrinsics of the frames.
        depth_scale: native units per metre.
        shutter: the rolling shutter to undo.
        color_registered: colour pixels lie on depth pixels; other colour stays as it is.
    """

    frames: FrameStore
    camera: Camera
    depth_scale: float
    shutter: RollingShutter
    color_registered: bool

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        """Return depth as if all rows were measured at once: (height, width) uint16, 0 = no depth."""
        native, shutter = self.frames.depth_native(index), self.shutter
        if not shutter.readout_s:
            return native
        return upright_depth(native, self.depth_scale, self.camera, shutter.motion[index], shutter.readout_s)

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        """Colour of one frame: (suffix, bytes); None if it has no colour.

        Colour that is registered to depth is corrected, unless the image is damaged.
        """
        encoded, shutter = self.frames.color_encoded(index), self.shutter
        if encoded is None or not self.color_registered:
            return encoded
        try:
            bgr = np.asarray(decoded_image(encoded[1], cv2.IMREAD_COLOR), np.uint8)
        except ValueError:
            return encoded
        motion, times_s = shutter.motion[index], (shutter.readout_s, shutter.color_delay_s)
        moved = upright_gray(bgr, self._depth_m(index), self.camera, motion, *times_s)
        return ".png", cv2.imencode(".png", moved, [cv2.IMWRITE_PNG_COMPRESSION, PNG_LEVEL])[1].tobytes()

    def mask(self, index: int, mask: Bools) -> Bools:
        """Correct a mask (height, width) of a recorded frame, to match the corrected depth."""
        shutter = self.shutter
        if not shutter.readout_s:
            return mask
        motion = shutter.motion[index]
        return upright_mask(mask, self._depth_m(index), self.camera, motion, shutter.readout_s)

    def _depth_m(self, index: int) -> Float32:
        return depth_in_metres(self.depth_native(index), self.depth_scale)


def upright(sequence: Sequence, shutter: RollingShutter | None) -> Sequence:
    """Return the recording with its rolling shutter undone, also in masks; unchanged if `shutter` is None."""
    if shutter is None:
        return sequence
    frames = UprightFrames(
        sequence.frames, sequence.camera, sequence.depth_scale, shutter, sequence.color_registered
    )
    changed = replace(sequence, frames=frames)
    return replace(changed, masks=upright_masks(changed, sequence.masks)) if sequence.masks else changed


def upright_masks(sequence: Sequence, masks: Callable[[int], Bools | None]) -> Callable[[int], Bools | None]:
    """Adapt masks of recorded frames to a sequence whose rolling shutter may have been undone."""
    frames = sequence.frames
    if not isinstance(frames, UprightFrames):
        return masks

    def moved(index: int) -> Bools | None:
        """Return the corrected mask of a frame: (height, width) bool; None if it has no mask."""
        mask = masks(index)
        return None if mask is None else frames.mask(index, mask)

    return moved

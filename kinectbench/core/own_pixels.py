"""Masked recordings: depth inside the masks belongs to the object; depth well outside shows free space."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from kinectbench.core.sequence import FrameStore, Sequence
from kinectbench.core.types import Bools, Float32

# At an outline a sensor's depth mixes object and background, and a drawn mask is a pixel off. So masks are
# eroded by the first number for the object, and dilated by the second for free space.
INSIDE_PX, OUTSIDE_PX = 1, 3

Masks = Callable[[int], Bools | None]


@dataclass(frozen=True)
class OwnPixels:
    """The frames of a recording, with depth inside the masks only.

    Attributes:
        frames: the unmasked frames.
        masks: index -> (height, width) bool; None for a frame without mask: all its depth is dropped.
    """

    frames: FrameStore
    masks: Masks

    def depth_native(self, index: int) -> NDArray[np.uint16]:
        """Native depth of a frame inside its mask eroded by a pixel: (height, width) uint16, 0 elsewhere."""
        native, mask = self.frames.depth_native(index), self.masks(index)
        if mask is None:
            return np.zeros_like(native)
        inside = cv2.erode(mask.astype(np.uint8), _square(INSIDE_PX))
        return np.where(inside > 0, native, np.uint16(0))

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        """Encoded colour of one frame, not masked: (suffix, bytes); None if it has no colour."""
        return self.frames.color_encoded(index)


def by_own_pixels(sequence: Sequence, masks: Masks) -> Sequence:
    """Keep only the depth inside the masks of a recording, so that poses are relative to the masked object.

    Surfaces outside the masks may move relative to the object. But the space in front of them was free when
    the frame was taken, so `Sequence.beside_m` keeps their depth.

    Args:
        sequence: the unmasked recording.
        masks: index -> (height, width) bool, the object; None for a frame without mask.
    """

    def beside_m(index: int) -> Float32:
        """Return depth well outside a frame's mask (height, width), metres; 0 elsewhere or without a mask."""
        mask = masks(index)
        if mask is None:
            return np.zeros((sequence.camera.height, sequence.camera.width), np.float32)
        near = cv2.dilate(mask.astype(np.uint8), _square(OUTSIDE_PX))
        return np.where(near > 0, np.float32(0), sequence.depth_m(index))

    return replace(sequence, frames=OwnPixels(sequence.frames, masks), beside_m=beside_m)


def whole(sequence: Sequence) -> Sequence:
    """Return the unmasked recording behind a result of `by_own_pixels`, or another recording unchanged."""
    own = sequence.frames
    return replace(sequence, frames=own.frames, beside_m=None) if isinstance(own, OwnPixels) else sequence


def frames_with_masks(sequence: Sequence, masks: Masks) -> Bools:
    """Whether each frame has a mask that is not empty: (n,) bool."""
    frame_masks = (masks(index) for index in range(len(sequence)))
    return np.array([mask is not None and bool(mask.any()) for mask in frame_masks], dtype=bool)


def _square(reach_px: int) -> NDArray[np.uint8]:
    return np.ones((2 * reach_px + 1,) * 2, np.uint8)

"""A recording seen through masks, by hand."""

from dataclasses import dataclass

import numpy as np

from kinectbench.core.geometry import Camera
from kinectbench.core.own_pixels import INSIDE_PX, OUTSIDE_PX, by_own_pixels, frames_with_masks
from kinectbench.core.sequence import Sequence
from kinectbench.core.types import Bools

WIDTH, HEIGHT = 20, 16


@dataclass(frozen=True)
class Flat:
    """Every pixel is 2 m away."""

    def depth_native(self, index: int) -> np.ndarray:
        return np.full((HEIGHT, WIDTH), 2000, np.uint16)

    def color_encoded(self, index: int) -> tuple[str, bytes] | None:
        return (".png", b"colour")


def masks(index: int) -> Bools | None:
    """A square in the middle; one that touches the image's corner; an empty one; none."""
    mask = np.zeros((HEIGHT, WIDTH), bool)
    if index == 0:
        mask[5:11, 7:13] = True
    if index == 1:
        mask[:6, :6] = True
    return None if index == 3 else mask


def recording() -> Sequence:
    camera = Camera(WIDTH, HEIGHT, 20.0, 20.0, 9.5, 7.5)
    return Sequence(camera, 1000.0, np.arange(4) * 10**9, True, None, Flat())


def test_what_is_left_is_within_the_mask_less_its_outline() -> None:
    own = by_own_pixels(recording(), masks)
    kept = np.zeros((HEIGHT, WIDTH), bool)
    kept[5 + INSIDE_PX : 11 - INSIDE_PX, 7 + INSIDE_PX : 13 - INSIDE_PX] = True
    assert (own.depth_m(0) == np.where(kept, np.float32(2), np.float32(0))).all()
    # The image's border cuts the object, and is no outline of it.
    corner = np.zeros((HEIGHT, WIDTH), bool)
    corner[: 6 - INSIDE_PX, : 6 - INSIDE_PX] = True
    assert ((own.depth_m(1) > 0) == corner).all()
    assert not own.depth_m(2).any()
    assert not own.depth_m(3).any()
    assert own.frames.color_encoded(0) == (".png", b"colour")


def test_what_is_beside_the_mask_is_kept_apart_from_it() -> None:
    own = by_own_pixels(recording(), masks)
    assert own.beside_m is not None
    beside = own.beside_m(0) > 0
    near = np.zeros((HEIGHT, WIDTH), bool)
    near[5 - OUTSIDE_PX : 11 + OUTSIDE_PX, 7 - OUTSIDE_PX : 13 + OUTSIDE_PX] = True
    assert (beside == ~near).all()
    # An empty mask says that the object is not there; no mask says nothing.
    assert own.beside_m(2).all()
    assert not own.beside_m(3).any()


def test_an_empty_mask_is_none() -> None:
    assert frames_with_masks(recording(), masks).tolist() == [True, True, False, False]

"""Pictures of pairs for the preview, by additions and divisions alone: the same bytes on every machine."""

import numpy as np
from numpy.typing import NDArray

from kinectbench.voxels.pair_file import BLOCK

Bools = NDArray[np.bool_]
Float64 = NDArray[np.float64]
Rgb = NDArray[np.uint8]

PAPER = (243, 242, 238)
CLAY = (205, 186, 160)
BLUE = (118, 160, 205)
UNKNOWN = (228, 214, 170)
BORDER = (196, 192, 184)
# Towards the light: right, down and towards the viewer.
LIGHT = (-0.45, -0.6, 0.66)
BLUR_CELLS = 2


def seen_from_the_front(cells: Bools, color: tuple[int, int, int]) -> Rgb:
    """A grid (x right, y down, z forward) as the camera looks at it: (ny, nx, 3) uint8 RGB."""
    return _shaded(cells.transpose(1, 0, 2), color)


def seen_from_the_right(cells: Bools, color: tuple[int, int, int]) -> Rgb:
    """The same from the camera's right: (ny, nz, 3) uint8 RGB; the camera is on the left."""
    return _shaded(cells[::-1].transpose(1, 2, 0), color)


def upright_slice(partial: Bools, full: Bools, known: Bools) -> Rgb:
    """A cut along the view through the middle of the shape: (ny, nz, 3) uint8 RGB; the camera is on the left.

    The solid is clay, what the view saw of it blue, and what nobody knows yellow.
    """
    filled = np.flatnonzero(full.any(axis=(1, 2)))
    middle = int(filled[0] + filled[-1]) // 2 if len(filled) else len(full) // 2
    picture = np.broadcast_to(np.array(PAPER, np.uint8), (*full.shape[1:], 3)).copy()
    picture[~known[middle]] = UNKNOWN
    picture[full[middle]] = CLAY
    # A layer of single cells would hardly show.
    near = np.asarray(partial[max(0, middle - 1) : middle + 2].any(axis=0))
    picture[_grown(near)] = BLUE
    return picture


def enlarged(picture: Rgb) -> Rgb:
    """A picture of 64-cells at the size of one of 256-cells."""
    return picture.repeat(BLOCK, axis=0).repeat(BLOCK, axis=1)


def _shaded(cells: Bools, color: tuple[int, int, int]) -> Rgb:
    """(rows, columns, away from the viewer) as a shaded relief."""
    covered = np.asarray(cells.any(axis=2))
    depth = np.where(covered, cells.argmax(axis=2), 0).astype(np.float64)
    smooth = _blurred(depth, covered)
    down, right = np.zeros_like(smooth), np.zeros_like(smooth)
    down[1:-1] = (smooth[2:] - smooth[:-2]) / 2
    right[:, 1:-1] = (smooth[:, 2:] - smooth[:, :-2]) / 2
    # An edge before something far is no steep slope.
    down, right = (np.where(np.abs(slope) < 6, slope, 0.0) for slope in (down, right))
    facing = (LIGHT[0] * right + LIGHT[1] * down + LIGHT[2]) / np.sqrt(right * right + down * down + 1)
    far = depth / cells.shape[2]
    shade = np.clip((0.55 + 0.6 * np.clip(facing, 0, 1)) * (1.08 - 0.4 * far), 0, 1.2)[..., None]
    picture = np.where(covered[..., None], shade * np.array(color, np.float64), np.array(PAPER, np.float64))
    return np.clip(picture, 0, 255).astype(np.uint8)


def _blurred(depth: Float64, covered: Bools) -> Float64:
    """Mean depth over the covered cells around each cell, so that the relief has no steps."""
    total, count = np.where(covered, depth, 0.0), covered.astype(np.float64)
    for axis in (0, 1):
        total, count = _summed(total, axis), _summed(count, axis)
    return np.where(covered, total / np.maximum(count, 1), 0.0)


def _summed(values: Float64, axis: int) -> Float64:
    """Sum over a cell and its neighbours along an axis."""
    width = [(BLUR_CELLS, BLUR_CELLS) if a == axis else (0, 0) for a in (0, 1)]
    padded = np.pad(values, width)
    size = values.shape[axis]
    result = np.zeros_like(values)
    for shift in range(2 * BLUR_CELLS + 1):
        result += padded[shift : shift + size] if axis == 0 else padded[:, shift : shift + size]
    return result


def _grown(mask: Bools) -> Bools:
    """A mask and its four neighbours."""
    grown = mask.copy()
    grown[1:] |= mask[:-1]
    grown[:-1] |= mask[1:]
    grown[:, 1:] |= mask[:, :-1]
    grown[:, :-1] |= mask[:, 1:]
    return grown

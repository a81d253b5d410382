"""Read and write a file of the paper's authors (3D-RecGAN): a grid of cells in their axes."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import PairError
from kinectbench.core.types import Bools
from kinectbench.core.voxels.npz import UNREADABLE, load_arrays, npz_bytes
from kinectbench.core.voxels.pair_file import FULL_CELLS

KEY = "arr_0"
LEVEL = 1
MAX_CELLS = 512
# A grid of 512 a side as bytes, or one of 256 as doubles, and the npy header.
MAX_BYTES = MAX_CELLS**3 + (64 << 10)


def recgan_file_bytes(cells: Bools) -> bytes:
    """Convert a grid (nx, ny, nz) bool (x right, y down, z forward) to the bytes of the authors' file.

    The file has the key `arr_0`: int8, (x, y, z, 1), x to the left, y up. Their back-projection is x = -(u -
    w/2) z / f, y = -(v - h/2) z / f, so theirs is ours with x and y reversed.
    """
    theirs = np.ascontiguousarray(cells[::-1, ::-1, :, None]).view(np.int8)
    return npz_bytes({KEY: theirs}, level=LEVEL)


def read_recgan_file(path: Path) -> Bools:
    """Read the authors' file as a grid (256, 256, 256) bool: x right, y down, z forward.

    Other sizes are centred as their readers do it: pad in front (256 - d) // 2, or crop (d - 256) // 2.

    Raises:
        PairError: missing, damaged, or not such a file.
    """
    try:
        arrays = load_arrays(path, MAX_BYTES)
    except UNREADABLE as error:
        raise PairError(f"{path}: cannot be read as an npz ({error}); get the file again") from error
    cells = arrays.get(KEY)
    if cells is None or cells.ndim != 4 or cells.shape[3] != 1 or not 0 < min(cells.shape) <= MAX_CELLS:
        raise PairError(f"{path}: holds no grid '{KEY}' of (x, y, z, 1) cells; is it of this layout?")
    if max(cells.shape) > MAX_CELLS or cells.dtype.kind not in "biuf" or not _is_binary(cells):
        raise PairError(f"{path}: '{KEY}' must hold 0 and 1 only, at most {MAX_CELLS} cells a side")
    centred = np.zeros((FULL_CELLS,) * 3, dtype=bool)
    source, target = zip(*(_centring(count) for count in cells.shape[:3]), strict=True)
    centred[target] = cells[..., 0][source] > 0
    return np.ascontiguousarray(centred[::-1, ::-1, :])


def _is_binary(cells: NDArray[np.generic]) -> bool:
    """Return whether a grid holds only 0 and 1; it is checked slab by slab to save memory."""
    return all(bool(((slab == 0) | (slab == 1)).all()) for slab in cells)


def _centring(count: int) -> tuple[slice, slice]:
    """Return (source, target) slices along an axis that centre `count` cells in 256: they crop or pad."""
    crop, pad = max(0, (count - FULL_CELLS) // 2), max(0, (FULL_CELLS - count) // 2)
    kept = min(count, FULL_CELLS)
    return slice(crop, crop + kept), slice(pad, pad + kept)

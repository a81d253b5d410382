"""Resampling of cubes: predictions to 256 cells a side, occupancy to a quarter of its cells a side."""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import PairError, PredictionError, SettingsError
from kinectbench.core.types import Bools, Float64, Int64
from kinectbench.core.voxels.pair_file import BLOCK, FULL_CELLS

MAX_CELLS = 512
HALF_PIXEL, CORNER_ALIGNED = "half-pixel", "corner-aligned"
CONVENTIONS = (HALF_PIXEL, CORNER_ALIGNED)

Values = Bools | NDArray[np.uint8] | NDArray[np.floating]


def upsampled_planes(
    values: Values, side: int = FULL_CELLS, convention: str = HALF_PIXEL
) -> Iterator[Float64]:
    """Resample a cube trilinearly; yield it plane by plane along x.

    Convention "half-pixel" maps the cubes' faces onto each other, edges clamped, as does
    `scipy.ndimage.zoom(order=1, grid_mode=True, mode="nearest")` if the cube grows; a cube that shrinks is
    sampled by the same formula, without smoothing. "corner-aligned" maps the centres of the outermost cells
    onto each other, as `scipy.ndimage.zoom(order=1)` does, for comparison with scores computed so.

    Args:
        values: (n, n, n), n at most 512, any real dtype or bool; converted to float64 first.
        side: cells along each axis of the result.
        convention: "half-pixel" or "corner-aligned".

    Yields:
        `side` times (side, side) float64. The planes share one buffer: use each before asking for the next.
        Memory does not grow with `side`**3.

    Raises:
        PredictionError: `values` is not a cube of 1 to 512 cells a side.
        SettingsError: unknown convention.

    Source: the paper upsamples by trilinear interpolation; the half-pixel convention is ours.
    """
    from kinectbench.core.voxels.resample_kernels import expand_rows, plane_between

    if values.ndim != 3 or len(set(values.shape)) != 1 or not 1 <= len(values) <= MAX_CELLS:
        raise PredictionError(f"a grid of {values.shape} cells: it must be a cube of 1 to {MAX_CELLS} a side")
    if convention not in CONVENTIONS:
        raise SettingsError(f"no upsampling '{convention}': choose {' or '.join(CONVENTIONS)}")
    lower, upper, weight = _taps(len(values), side, convention)
    expanded: dict[int, Float64] = {}
    plane = np.empty((side, side))
    for i in range(side):
        wanted = (int(lower[i]), int(upper[i]))
        expanded = {k: plane_k for k, plane_k in expanded.items() if k in wanted}
        for k in wanted:
            if k not in expanded:
                values_k = np.ascontiguousarray(values[k], dtype=np.float64)
                expanded[k] = expand_rows(values_k, lower, upper, weight)
        first, second = (expanded[k] for k in wanted)
        plane_between(first, second, weight[i], lower, upper, weight, plane)
        yield plane


def _taps(n: int, side: int, convention: str) -> tuple[Int64, Int64, Float64]:
    """Return for each of `side` output cells its two input cells of `n`, and the weight of the second."""
    if convention == CORNER_ALIGNED:
        position = np.arange(side) * ((n - 1) / max(side - 1, 1))
    else:
        position = (np.arange(side) + 0.5) * (n / side) - 0.5
    position = np.clip(position, 0.0, n - 1.0)
    lower = np.floor(position).astype(np.int64)
    return lower, np.minimum(lower + 1, n - 1), position - lower


def reduce_blocks(occupancy: Bools, rule: str) -> Bools:
    """Reduce each 4x4x4 block to one cell.

    Args:
        occupancy: bool, every side a multiple of 4, such as (256, 256, 256).
        rule: "any": set if any cell is (the paper's block maximum); "majority": if more than half are.

    Returns:
        bool, a quarter as many cells along each axis, such as (64, 64, 64).

    Raises:
        PairError: unknown rule.
    """
    if rule not in ("any", "majority"):
        raise PairError(f"no partial rule '{rule}': it is any or majority")
    counts = occupancy.view(np.uint8)  # up to 64 a block: fits
    # x first: its slices are whole planes; z, whose slices stride over bytes, when least is left
    counts = counts[0::4] + counts[1::4] + counts[2::4] + counts[3::4]
    counts = counts[:, 0::4] + counts[:, 1::4] + counts[:, 2::4] + counts[:, 3::4]
    counts = counts[:, :, 0::4] + counts[:, :, 1::4] + counts[:, :, 2::4] + counts[:, :, 3::4]
    reduced: Bools = counts > (0 if rule == "any" else BLOCK**3 // 2)
    return reduced

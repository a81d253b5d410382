"""The surface metrics a second time, in plain numpy and scipy, from their definitions in docs/scoring.md."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

Bools = NDArray[np.bool_]
Reals = NDArray[np.float64]
NEIGHBOURS = 32
RADIUS = 3


def surface_reference(
    predicted: Bools, full: Bools, counted: Bools, trusted: Bools, voxel_size_m: float, sigma_m: float
) -> dict[str, float]:
    """All surface metrics of one pair, from what is counted to what is trusted; no surface is empty."""
    surfaces = [_surface(solid) for solid in (predicted, full)]
    ours, theirs = (np.argwhere(surface & counted) for surface in surfaces)
    our_targets, their_targets = (np.argwhere(surface & trusted) for surface in surfaces)
    there, nearest_true = _nearest(ours, their_targets)
    back, nearest_ours = _nearest(theirs, our_targets)
    mm = voxel_size_m * 1000
    there, back = there * mm, back * mm
    occupied = np.argwhere(full)
    size_mm = float(np.linalg.norm(np.ptp(occupied, axis=0) + 1)) * mm
    agreements = [
        _agreement(_normals(predicted, ours), _normals(full, their_targets)[nearest_true]),
        _agreement(_normals(full, theirs), _normals(predicted, our_targets)[nearest_ours]),
    ]
    tolerance = 2 * sigma_m * 1000
    near = np.count_nonzero(there <= tolerance) + np.count_nonzero(back <= tolerance)
    return {
        "chamfer_mm": float(there.mean() + back.mean()) / 2,
        "f_score_1pct": _f_score(there, back, 0.01 * size_mm),
        "f_score_2pct": _f_score(there, back, 0.02 * size_mm),
        "f_score_10mm": _f_score(there, back, 10),
        "f_score_20mm": _f_score(there, back, 20),
        "surface_dice": near / (len(there) + len(back)),
        "normal_consistency": float(np.mean(agreements)),
    }


def _surface(solid: Bools) -> Bools:
    surface: Bools = solid & ~ndimage.binary_erosion(solid, ndimage.generate_binary_structure(3, 1))
    return surface


def _nearest(queries: NDArray[Any], targets: NDArray[Any]) -> tuple[Reals, NDArray[Any]]:
    """Distance in cells to the nearest target, and which: of several the first in C order."""
    count = min(NEIGHBOURS, len(targets))
    distances, found = (a.reshape(len(queries), count) for a in cKDTree(targets).query(queries, k=count))
    squared = np.rint(distances**2)
    tied = squared == squared[:, :1]
    first = np.where(tied, found, len(targets)).min(axis=1)
    for n in np.flatnonzero(tied.all(axis=1)):  # there may be more
        first[n] = ((targets - queries[n]) ** 2).sum(axis=1).argmin()
    return np.sqrt(squared[:, 0]), first


def _normals(solid: Bools, cells: NDArray[Any]) -> Reals:
    """Away from the centre of mass of the 7^3 cells around; zero where there is none."""
    box = [
        slice(max(low - 4, 0), high + 5)
        for low, high in zip(cells.min(axis=0), cells.max(axis=0), strict=True)
    ]
    around, at = solid[tuple(box)].astype(np.int32), cells - [part.start for part in box]
    steps, ones = np.arange(-RADIUS, RADIUS + 1), np.ones(2 * RADIUS + 1, int)
    moments = np.zeros((len(cells), 3))
    for along in range(3):
        field = around
        for axis in range(3):
            field = ndimage.correlate1d(field, steps if axis == along else ones, axis, mode="constant")
        moments[:, along] = field[tuple(at.T)]
    lengths = np.linalg.norm(moments, axis=1)
    return -moments / np.where(lengths > 0, lengths, 1)[:, None]


def _agreement(first: Reals, second: Reals) -> float:
    cosines = np.abs((first * second).sum(axis=1))
    cosines[(first == 0).all(axis=1) & (second == 0).all(axis=1)] = 1
    return float(cosines.mean())


def _f_score(there: Reals, back: Reals, tolerance: float) -> float:
    precision, recall = np.mean(there <= tolerance), np.mean(back <= tolerance)
    return float(2 * precision * recall / (precision + recall)) if precision + recall else 0.0

"""The surface metrics a second time, in plain numpy and scipy, from their definitions in docs/scoring.md."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from kinectbench.core.types import Bools

Reals = NDArray[np.float64]
NEIGHBOURS = (4, 32)
RADIUS = 3


@dataclass(frozen=True)
class Surface:
    """The surface cells of a solid, (n, 3) in C order, and their normals, (n, 3)."""

    cells: NDArray[np.int64]
    normals: Reals

    def where(self, mask: Bools) -> "Surface":
        """The part of it that lies in a mask."""
        chosen = mask[tuple(self.cells.T)]
        return Surface(self.cells[chosen], self.normals[chosen])


def surface_of(solid: Bools) -> Surface:
    """The surface of a solid; its normals do not depend on what a protocol counts."""
    cells = np.argwhere(_surface(solid))
    return Surface(cells, _normals(solid, cells))


def surface_reference(
    predicted: Surface, full: Surface, counted: Bools, trusted: Bools, voxel_size_m: float, sigma_m: float
) -> dict[str, float]:
    """All surface metrics of one pair, from what is counted to what is trusted; no surface is empty."""
    ours, theirs = predicted.where(counted), full.where(counted)
    our_targets, their_targets = predicted.where(trusted), full.where(trusted)
    there, nearest_true = _nearest(ours.cells, their_targets.cells)
    back, nearest_ours = _nearest(theirs.cells, our_targets.cells)
    mm = voxel_size_m * 1000
    there, back = there * mm, back * mm
    size_mm = float(np.linalg.norm(np.ptp(full.cells, axis=0) + 1)) * mm
    agreements = [
        _agreement(ours.normals, their_targets.normals[nearest_true]),
        _agreement(theirs.normals, our_targets.normals[nearest_ours]),
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
    tree, left = cKDTree(targets), np.arange(len(queries))
    squared, first = np.zeros(len(queries)), np.zeros(len(queries), np.int64)
    for count in NEIGHBOURS:  # where all that were asked for are tied there may be more
        count = min(count, len(targets))
        distances, found = (a.reshape(len(left), count) for a in tree.query(queries[left], k=count))
        squares = np.rint(distances**2)
        tied = squares == squares[:, :1]
        squared[left], first[left] = squares[:, 0], np.where(tied, found, len(targets)).min(axis=1)
        left = left[tied.all(axis=1)]
    for n in left:
        first[n] = ((targets - queries[n]) ** 2).sum(axis=1).argmin()
    return np.sqrt(squared), first


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

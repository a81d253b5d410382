"""Surface metrics: Chamfer distance, F-score, surface Dice, normal consistency (see docs/scoring.md).

The surface of a set of cells consists of its cells with an empty 6-neighbour; cells outside the grid are
empty. Distances are exact, between cell centres. They are measured from a surface cell that the protocol
counts to the nearest known cell of the other surface (under `paper`: known or not). So under `occluded`, the
nearest cell to a hidden cell may be one that the view saw.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kinectbench.core.artefacts.score_figures import SurfaceMetrics
from kinectbench.core.types import Float64, Int64
from kinectbench.core.voxels.pair_file import FULL_CELLS, Packed
from kinectbench.scoring.protocols import PROTOCOLS
from kinectbench.scoring.truth import PackedTruth

if TYPE_CHECKING:  # numba is slow to load
    from kinectbench.scoring.surface_kernels import Spread

F_SCORE_MM = (10.0, 20.0)
SIGMAS = 2.0


SAME = SurfaceMetrics(0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Distances:
    """Distances between the surface cells of two nonempty shapes.

    Attributes:
        mm: (k,) the distances of 0, 1, sqrt(2), sqrt(3), ... cells, millimetres.
        to_truth: (k,), the number of cells of the prediction's surface at each distance from the truth's
            surface.
        to_prediction: (k,), the number of cells of the truth's surface at each distance from the prediction's
            surface.
    """

    mm: Float64
    to_truth: Int64
    to_prediction: Int64

    def chamfer_mm(self) -> float:
        """Return the Chamfer distance: the mean of the two directions' mean distances, millimetres."""
        # No dot product: its sum depends on the number of cores.
        ways = (self.to_truth, self.to_prediction)
        return sum(float((self.mm * cells).sum()) / int(cells.sum()) for cells in ways) / 2

    def f_score(self, tolerance_mm: float) -> float:
        """Return the harmonic mean of both surfaces' shares within a tolerance; 0 if no cell is within it."""
        near = self.mm <= tolerance_mm
        precision = int(self.to_truth[near].sum()) / int(self.to_truth.sum())
        recall = int(self.to_prediction[near].sum()) / int(self.to_prediction.sum())
        return 2 * precision * recall / (precision + recall) if precision + recall else 0.0

    def dice(self, tolerance_mm: float) -> float:
        """Return the share of the cells of both surfaces that are within a tolerance of the other surface."""
        cells = self.to_truth + self.to_prediction
        return int(cells[self.mm <= tolerance_mm].sum()) / int(cells.sum())


def surface_metrics(
    predicted: Packed, truth: PackedTruth, protocols: Sequence[str]
) -> dict[str, SurfaceMetrics]:
    """Return the surface metrics under each protocol.

    Args:
        predicted: (256, 256, 32) uint8, packed: predicted occupancy.
        truth: the packed truth.
        protocols: names of `PROTOCOLS`.

    Returns:
        {protocol: metrics}. If neither surface has a counted cell, all metrics are perfect. If only one
        surface has counted cells, every share is 0 and the Chamfer distance is the grid's diagonal.
    """
    from kinectbench.scoring.surface_kernels import solid_surface, spreads

    ours, theirs = solid_surface(predicted), solid_surface(truth.full)
    # Several protocols cut both surfaces to the same cells. Under `shell`, too, the truth's surface is that
    # of the solid.
    cut = {name: (PROTOCOLS[name].known, PROTOCOLS[name].distrusts) for name in protocols}
    keys = list(dict.fromkeys(cut.values()))
    everything = np.full_like(truth.known, 255)
    masks = [truth.distrusting(distrusts).known if known else everything for known, distrusts in keys]
    forward = dict(zip(keys, spreads(ours, theirs, masks, ~truth.seen), strict=True))
    back = dict(zip(keys, spreads(theirs, ours, masks, ~truth.seen), strict=True))
    return {
        name: _metrics(forward[cut[name]][hidden], back[cut[name]][hidden], truth)
        for name in protocols
        for hidden in (int(PROTOCOLS[name].hidden),)
    }


def _metrics(forward: "Spread", back: "Spread", truth: PackedTruth) -> SurfaceMetrics:
    """Return the surface metrics; `forward` is from the prediction to the truth, `back` the other way."""
    if not len(forward) and not len(back):
        return SAME
    voxel_mm = truth.voxel_size_m * 1000
    if not len(forward) or not len(back):
        return SurfaceMetrics(math.sqrt(3) * FULL_CELLS * voxel_mm, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    counts = np.zeros((2, max(len(forward.cells), len(back.cells))), np.int64)
    counts[0, : len(forward.cells)], counts[1, : len(back.cells)] = forward.cells, back.cells
    between = Distances(np.sqrt(np.arange(counts.shape[1])) * voxel_mm, *counts)
    size_mm = size_cells(truth.full) * voxel_mm
    one_percent, two_percent, near, wide = 0.01 * size_mm, 0.02 * size_mm, *F_SCORE_MM
    return SurfaceMetrics(
        chamfer_mm=between.chamfer_mm(),
        f_score_1pct=between.f_score(one_percent),
        f_score_2pct=between.f_score(two_percent),
        f_score_10mm=between.f_score(near),
        f_score_20mm=between.f_score(wide),
        surface_dice=between.dice(SIGMAS * truth.surface_sigma_m * 1000),
        normal_consistency=(forward.agreement / len(forward) + back.agreement / len(back)) / 2,
    )


def size_cells(full: Packed) -> float:
    """Return the diagonal of a packed shape's bounding box, in cells; 0 if the shape is empty."""
    bits = np.unpackbits(np.bitwise_or.reduce(full, axis=(0, 1)))
    sides = [
        np.flatnonzero(full.any(axis=(1, 2))),
        np.flatnonzero(full.any(axis=(0, 2))),
        np.flatnonzero(bits),
    ]
    return math.sqrt(sum(int(side[-1] - side[0] + 1) ** 2 for side in sides if len(side)))

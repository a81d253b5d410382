"""Metrics of surfaces: Chamfer distance, F-score, surface Dice, normal consistency; docs/scoring.md.

A set's surface is its cells with an empty 6-neighbour (outside the grid is empty). Distances are exact, and
between cell centres: from the cells that the protocol counts to the nearest cell of the other surface that
it takes for known (under `paper` to any). So under `occluded` a hidden cell may have its nearest where the
view saw.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kinectbench.core.artefacts.score_figures import SurfaceMetrics
from kinectbench.core.types import Float64
from kinectbench.core.voxels.pair_file import FULL_CELLS, Packed
from kinectbench.scoring.protocols import PROTOCOLS
from kinectbench.scoring.truth import Truth

if TYPE_CHECKING:  # numba is slow to load
    from kinectbench.scoring.surface_kernels import Matched

F_SCORE_MM = (10.0, 20.0)
SIGMAS = 2.0


SAME = SurfaceMetrics(0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Distances:
    """How far two surfaces are from each other, neither of them empty.

    Attributes:
        to_truth_mm: (n,) from each cell of the prediction's surface.
        to_prediction_mm: (m,) from each cell of the truth's surface.
    """

    to_truth_mm: Float64
    to_prediction_mm: Float64

    def chamfer_mm(self) -> float:
        """Mean of the two mean distances."""
        return float(self.to_truth_mm.mean() + self.to_prediction_mm.mean()) / 2

    def f_score(self, tolerance_mm: float) -> float:
        """Harmonic mean of the shares of both surfaces within a tolerance; 0 if nothing is."""
        precision = float((self.to_truth_mm <= tolerance_mm).mean())
        recall = float((self.to_prediction_mm <= tolerance_mm).mean())
        return 2 * precision * recall / (precision + recall) if precision + recall else 0.0

    def dice(self, tolerance_mm: float) -> float:
        """Share of the cells of both surfaces together within a tolerance."""
        near = (self.to_truth_mm <= tolerance_mm).sum() + (self.to_prediction_mm <= tolerance_mm).sum()
        return float(near) / (len(self.to_truth_mm) + len(self.to_prediction_mm))


def surface_metrics(predicted: Packed, truth: Truth, protocols: Sequence[str]) -> dict[str, SurfaceMetrics]:
    """The surface metrics under each protocol.

    Args:
        predicted: (256, 256, 32) uint8, packed: what is predicted occupied.
        truth: the packed truth.
        protocols: names of `PROTOCOLS`.

    Returns:
        By protocol. Of two empty surfaces all is perfect; of one, every share is 0 and the Chamfer distance
        is the grid's diagonal.
    """
    from kinectbench.scoring.surface_kernels import Matched, matched, surface_of

    ours, theirs = surface_of(predicted), surface_of(truth.full)
    found, matches = dict[str, SurfaceMetrics](), dict[tuple[bool, str | None], tuple[Matched, Matched]]()
    for name in protocols:
        of = PROTOCOLS[name]
        trusted = truth.distrusting(of.distrusts)
        key = of.known, None if trusted is truth else of.distrusts
        if key not in matches:  # one of several protocols that measure to the same cells
            near, far = (each.within(trusted.known) if of.known else each for each in (ours, theirs))
            matches[key] = matched(near, far), matched(far, near)
        there, back = (each.within(~truth.seen) if of.hidden else each for each in matches[key])
        found[name] = _metrics(there, back, truth)
    return found


def _metrics(there: "Matched", back: "Matched", truth: Truth) -> SurfaceMetrics:
    """The metrics of the prediction's surface cells and of the truth's; `truth` is for its lengths."""
    if not len(there) and not len(back):
        return SAME
    voxel_mm = truth.voxel_size_m * 1000
    if not len(there) or not len(back):
        return SurfaceMetrics(math.sqrt(3) * FULL_CELLS * voxel_mm, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    between = Distances(np.sqrt(there.squared) * voxel_mm, np.sqrt(back.squared) * voxel_mm)
    size_mm = size_cells(truth.full) * voxel_mm
    one_percent, two_percent, near, wide = 0.01 * size_mm, 0.02 * size_mm, *F_SCORE_MM
    return SurfaceMetrics(
        chamfer_mm=between.chamfer_mm(),
        f_score_1pct=between.f_score(one_percent),
        f_score_2pct=between.f_score(two_percent),
        f_score_10mm=between.f_score(near),
        f_score_20mm=between.f_score(wide),
        surface_dice=between.dice(SIGMAS * truth.surface_sigma_m * 1000),
        normal_consistency=(float(there.cosines.mean()) + float(back.cosines.mean())) / 2,
    )


def size_cells(full: Packed) -> float:
    """The diagonal of the box of a packed shape, in cells; 0 if it is empty."""
    bits = np.unpackbits(np.bitwise_or.reduce(full, axis=(0, 1)))
    sides = [
        np.flatnonzero(full.any(axis=(1, 2))),
        np.flatnonzero(full.any(axis=(0, 2))),
        np.flatnonzero(bits),
    ]
    return math.sqrt(sum(int(side[-1] - side[0] + 1) ** 2 for side in sides if len(side)))

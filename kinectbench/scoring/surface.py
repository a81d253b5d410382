"""Metrics of surfaces: Chamfer distance, F-score, surface Dice, normal consistency; docs/scoring.md.

A set's surface is its cells with an empty 6-neighbour (outside the grid is empty). Distances are exact, and
between cell centres: from the cells that the protocol counts to the nearest known cell of the other surface
(under `paper` to any). So under `occluded` a hidden cell may have its nearest where the view saw.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from kinectbench.core.artefacts.score_figures import SurfaceMetrics
from kinectbench.core.types import Float64
from kinectbench.core.voxels.pair_file import FULL_CELLS, Packed
from kinectbench.scoring.truth import Truth

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
        protocols: some of "paper", "known", "occluded".

    Returns:
        By protocol. Of two empty surfaces all is perfect; of one, every share is 0 and the Chamfer distance
        is the grid's diagonal.
    """
    from kinectbench.core.voxels.morphology import packed_shell

    ours, theirs = packed_shell(predicted), packed_shell(truth.full)
    everywhere = np.full_like(truth.known, 255)
    masks = {
        "paper": (everywhere, everywhere),
        "known": (truth.known, truth.known),
        "occluded": (truth.known & ~truth.seen, truth.known),
    }
    return {name: _between((predicted, ours), (truth.full, theirs), masks[name], truth) for name in protocols}


def _between(
    ours: tuple[Packed, Packed], theirs: tuple[Packed, Packed], masks: tuple[Packed, Packed], truth: Truth
) -> SurfaceMetrics:
    """The metrics between prediction and truth, each a solid and its surface.

    Args:
        ours: of the prediction.
        theirs: of the truth.
        masks: cells of a surface that are measured from, and that are measured to.
        truth: for its lengths.
    """
    from kinectbench.scoring.surface_kernels import agreement, cells_of, nearest, normals

    (our_solid, our_surface), (their_solid, their_surface) = ours, theirs
    counted, trusted = masks
    our_cells, their_cells = cells_of(our_surface & counted), cells_of(their_surface & counted)
    if not len(our_cells) and not len(their_cells):
        return SAME
    voxel_mm = truth.voxel_size_m * 1000
    if not len(our_cells) or not len(their_cells):
        return SurfaceMetrics(math.sqrt(3) * FULL_CELLS * voxel_mm, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    our_targets, their_targets = cells_of(our_surface & trusted), cells_of(their_surface & trusted)
    squared, to_theirs = nearest(our_cells, their_targets)
    squared_back, to_ours = nearest(their_cells, our_targets)
    between = Distances(np.sqrt(squared) * voxel_mm, np.sqrt(squared_back) * voxel_mm)
    there = agreement(
        normals(our_solid, our_cells.index), normals(their_solid, their_targets.index)[to_theirs]
    )
    back = agreement(normals(their_solid, their_cells.index), normals(our_solid, our_targets.index)[to_ours])
    size_mm = size_cells(truth.full) * voxel_mm
    one_percent, two_percent, near, wide = 0.01 * size_mm, 0.02 * size_mm, *F_SCORE_MM
    return SurfaceMetrics(
        chamfer_mm=between.chamfer_mm(),
        f_score_1pct=between.f_score(one_percent),
        f_score_2pct=between.f_score(two_percent),
        f_score_10mm=between.f_score(near),
        f_score_20mm=between.f_score(wide),
        surface_dice=between.dice(SIGMAS * truth.surface_sigma_m * 1000),
        normal_consistency=(there + back) / 2,
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

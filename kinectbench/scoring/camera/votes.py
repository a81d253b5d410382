"""Votes of several solids of one view: how often the truth is solid where a share of them is."""

from dataclasses import dataclass, field

import numpy as np

from kinectbench.core.artefacts.score_figures import Calibration, ShapePart
from kinectbench.core.types import Int64
from kinectbench.core.voxels.pair_file import FULL_CELLS, Packed, unpack
from kinectbench.scoring.camera.metrics import counted_cells
from kinectbench.scoring.camera.truth import SpaceTruth

# Tenths of the votes. Source: C. Guo et al., "On calibration of modern neural networks" (2017), with 15 bins.
BINS = 10


@dataclass
class Votes:
    """The solids of a view, by how they were registered.

    Attributes:
        solids: {what was asked: packed cells (256, 256, 32) of each prediction that has an inside}.
    """

    solids: dict[tuple[str, str | None], list[Packed]] = field(default_factory=dict)

    def calibration(
        self, truth: SpaceTruth, asked: tuple[str, str | None], part: ShapePart, k: int
    ) -> Calibration | None:
        """Of k predictions in a part; None unless all have an inside, and a cell has a vote."""
        solids = self.solids.get(asked, [])
        if len(solids) < k:
            return None
        votes = np.zeros((FULL_CELLS,) * 3, np.uint8)  # of at most 100 hypotheses
        for solid in solids:
            votes += unpack(solid).view(np.uint8)
        counted = counted_cells(truth, part)
        cells, true = (
            np.bincount(votes[unpack(of)], minlength=k + 1) for of in (counted, counted & truth.full)
        )
        return calibration_of(cells, true)


def calibration_of(cells: Int64, solid: Int64) -> Calibration | None:
    """The calibration by tenths of the votes.

    Args:
        cells: (k + 1,) how many have 0, 1, ... k votes.
        solid: (k + 1,) how many of these are solid in the truth.

    Returns:
        None where no cell has a vote.
    """
    k = len(cells) - 1
    votes = np.arange(1, k + 1)
    tenth = (BINS * votes + k - 1) // k - 1
    count, said, true = (
        np.bincount(tenth, weights=of, minlength=BINS) for of in (cells[1:], cells[1:] * votes / k, solid[1:])
    )
    if not count.sum():
        return None
    return Calibration(
        error=float(np.abs(said - true).sum() / count.sum()),
        cells=tuple(int(of) for of in count),
        said=tuple(float(s / n) if n else None for s, n in zip(said, count, strict=True)),
        true=tuple(float(t / n) if n else None for t, n in zip(true, count, strict=True)),
    )

"""Calibration of several predictions: how often a cell is truly solid if m of k predictions say so."""

from dataclasses import dataclass, field

import numpy as np

from kinectbench.core.artefacts.score_figures import Calibration, ShapePart
from kinectbench.core.types import Int64
from kinectbench.core.voxels.pair_file import FULL_CELLS, Packed, unpack
from kinectbench.scoring.camera.metrics import counted_cells
from kinectbench.scoring.camera.truth import SpaceTruth

# Number of bins of the share of votes. Source: C. Guo et al., "On calibration of modern neural networks"
# (2017), who use 15.
BINS = 10


@dataclass
class Votes:
    """The solids of all predictions of a view, grouped by protocol and kind of registration.

    Attributes:
        solids: {(protocol, kind of registration): list of packed cells (256, 256, 32), one for each
            prediction that has an inside}.
    """

    solids: dict[tuple[str, str | None], list[Packed]] = field(default_factory=dict)

    def calibration(
        self, truth: SpaceTruth, asked: tuple[str, str | None], part: ShapePart, k: int
    ) -> Calibration | None:
        """Return how often cells are truly solid, by the share of predictions that call them solid.

        Args:
            truth: the truth of the view.
            asked: (protocol, kind of registration) of the solids.
            part: whole, visible or occluded; only its known cells are counted.
            k: number of predictions of the view.

        Returns:
            The calibration; None if a prediction has no inside, or if no prediction calls a counted cell
            solid.
        """
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
    """Return how often cells are truly solid, in ten bins of the share of predictions that call them solid.

    Cells that are solid in no prediction are left out.

    Args:
        cells: (k + 1,), the number of cells that are solid in 0, 1, ... k predictions.
        solid: (k + 1,), how many of these cells are solid in the truth.

    Returns:
        The calibration; None if no cell is solid in any prediction.
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

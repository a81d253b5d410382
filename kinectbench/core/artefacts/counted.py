"""Voxel counts of a pair, and .counted.jsonl, which keeps them, one pair a line, while a method is scored."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from kinectbench.core.artefacts.score_figures import SurfaceMetrics
from kinectbench.core.artefacts.stored import StoredPart, array_in_file
from kinectbench.core.storage import canonical_json
from kinectbench.core.types import Float64, Int64

JOURNAL = ".counted.jsonl"
# Files of parts that several runs count in parallel, one each.
PART_JOURNAL, JOURNALS = ".counted.{number}-of-{of}.jsonl", ".counted*.jsonl"


@dataclass(frozen=True)
class Tally:
    """Voxel counts of one pair, by a code of the voxel.

    The code is 1 if the voxel is occupied, plus 2 if it is known, plus 4 if it is seen by the input view.

    Attributes:
        voxels: (8,) int64, number of voxels of each code.
        above: (17, 8) int64, number of these predicted above each threshold k / 20, k = 2 to 18.
        ce_sum: (8,) float64, sum of the cross-entropy of the voxels of each code, nats.
    """

    voxels: Annotated[Int64, *array_in_file((8,), np.int64)]
    above: Annotated[Int64, *array_in_file((17, 8), np.int64)]
    ce_sum: Annotated[Float64, *array_in_file((8,))]


@dataclass(frozen=True)
class PairResult:
    """The counts and other results of one pair, before they become scores.

    Attributes:
        tally: voxel counts of the prediction.
        cells: side of the predicted grid, cells; 0 if there was no prediction.
        ceilings: {protocol: the IoU that a grid of this side can reach}.
        surface: {protocol: surface metrics}; empty if they were not requested.
        digest: BLAKE3 of the prediction's file, as "blake3:<hex>"; None if there is no file.
        outside_share: fraction of a predicted mesh's volume that lies outside the grid and was cut off.
        tallies: {protocol: voxel counts}, for protocols that take fewer voxels of the truth as known.
    """

    tally: Tally
    cells: int
    ceilings: Mapping[str, float]
    surface: Mapping[str, SurfaceMetrics]
    digest: str | None
    outside_share: float = 0.0
    tallies: Mapping[str, Tally] = field(default_factory=dict)

    def tally_under(self, protocol: str) -> Tally:
        """Return the voxel counts that a protocol's scores are computed from."""
        return self.tallies.get(protocol, self.tally)


class CountedPair(StoredPart):
    """One line of .counted.jsonl: a pair's name, a key that identifies the inputs, and the exact result."""

    pair: str
    key: str
    result: PairResult

    def line(self) -> str:
        """Return the line of .counted.jsonl: JSON with a line break."""
        return canonical_json(self.json_value()) + "\n"

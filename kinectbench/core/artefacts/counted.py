"""Counts of a pair, and .counted.jsonl, which keeps them until a method is scored: one pair a line."""

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
    """Voxels of one pair by code: 1 if occupied, + 2 if known, + 4 if seen by the input view.

    Attributes:
        voxels: (8,) int64, how many there are.
        above: (17, 8) int64, how many are predicted above each threshold k / 20, k = 2 to 18.
        ce_sum: (8,) float64, sum of the cross-entropy in nats.
    """

    voxels: Annotated[Int64, *array_in_file((8,), np.int64)]
    above: Annotated[Int64, *array_in_file((17, 8), np.int64)]
    ce_sum: Annotated[Float64, *array_in_file((8,))]


@dataclass(frozen=True)
class PairResult:
    """The counts of one pair.

    Attributes:
        tally: of the prediction.
        cells: side of the prediction; 0 if there was none.
        ceilings: {protocol: the IoU that this side can reach}.
        surface: {protocol: surface metrics}; empty if they were not asked for.
        digest: BLAKE3 of the prediction's file, as "blake3:<hex>"; None if there is no file.
        outside_share: share of a mesh's volume outside the grid, which was cut off.
        tallies: {protocol: its tally}, where it trusts less of the truth than `tally`.
    """

    tally: Tally
    cells: int
    ceilings: Mapping[str, float]
    surface: Mapping[str, SurfaceMetrics]
    digest: str | None
    outside_share: float = 0.0
    tallies: Mapping[str, Tally] = field(default_factory=dict)

    def tally_under(self, protocol: str) -> Tally:
        """The tally that a protocol counts by."""
        return self.tallies.get(protocol, self.tally)


class CountedPair(StoredPart):
    """A line of the journal: a pair's name, the inputs of its result, and the exact result."""

    pair: str
    key: str
    result: PairResult

    def line(self) -> str:
        """The line in the journal."""
        return canonical_json(self.json_value()) + "\n"

"""The score to beat for nothing: a constant, the share of a category's voxels that is occupied."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinectbench.release.release import Release, Target
from kinectbench.scoring.counts import Tally
from kinectbench.scoring.truth import read_grids
from kinectbench.scoring.workers import run_tasks

# Truth that a method may have learnt from comes first; test truth makes an oracle.
SOURCES = {"validation": "validation", "train": "train", "test": "test (oracle)"}

_ONES = np.unpackbits(np.arange(256, dtype=np.uint8)[:, None], axis=1).sum(axis=1).astype(np.int64)


@dataclass(frozen=True)
class BaseRate:
    """The base rate of one category.

    Attributes:
        value: mean share of occupied voxels over all 256**3, in [0, 1].
        source: "validation", "train" or "test (oracle)": the split whose truth it was taken from.
    """

    value: float
    source: str


def base_rates(
    release: Release, jobs: int = 1, counted: Mapping[Target, Tally] | None = None
) -> dict[str, BaseRate]:
    """The base rate of every category, from the first of validation, train and test that has it.

    A category whose truth is held back everywhere has none.

    Args:
        release: its truth is read.
        jobs: number of processes.
        counted: tallies of pairs whose truth need not be read again.

    Raises:
        ReleaseError: a pair file is missing or changed.
    """
    chosen = {}
    for category in release.categories:
        of_split = {
            split: [target for target in release.open_split(split) if target.category == category]
            for split in SOURCES
        }
        for split in SOURCES:
            if of_split[split]:
                chosen[category] = (split, of_split[split])
                break
    shares = {target: _occupied_of(tally) for target, tally in (counted or {}).items()}
    unread = [t for _, targets in chosen.values() for t in targets if t not in shares]
    tasks = [(release.pair_path(t), t.sha256) for t in unread]
    shares |= dict(zip(unread, run_tasks(_occupied_share, tasks, jobs), strict=True))
    return {
        category: BaseRate(float(np.mean([shares[target] for target in targets])), SOURCES[split])
        for category, (split, targets) in chosen.items()
    }


def _occupied_of(tally: Tally) -> float:
    """The same share, of a pair that was counted."""
    return float(tally.voxels[1::2].sum()) / float(tally.voxels.sum())


def _occupied_share(task: tuple[Path, str]) -> float:
    """Share of a pair's voxels that is occupied."""
    (full,) = read_grids(*task, ("full",))
    return float(_ONES[full].sum()) / (8 * full.size)

"""Base rates of categories, by which scores are compared, and names of baselines."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from kinectbench.core.artefacts.counted import Tally
from kinectbench.core.artefacts.scores import BaseRate
from kinectbench.release.release import Release, Target
from kinectbench.scoring.truth import read_parts
from kinectbench.scoring.workers import run_tasks

# The splits that base rates are taken from, in this order. Validation and training truth come first, because
# the truth of the test split makes the base rate an oracle.
SOURCES = {"validation": "validation", "train": "train", "test": "test (oracle)"}
# Number of pairs for which another process is worthwhile: it takes 2.5 s to start, and a pair takes 13 ms
# (measured).
PAIRS_A_PROCESS = 200


def base_rates(
    release: Release, jobs: int = 1, counted: Mapping[Target, Tally] | None = None
) -> dict[str, BaseRate]:
    """Return {category: base rate}, from the first split of validation, train and test that has its truth.

    A base rate is the mean, over pairs, of the share of voxels that are occupied in the truth. A category is
    left out if its truth is held back in all splits.

    Args:
        release: the release whose truth is read.
        jobs: maximum number of processes; if there are few pairs, the calling process reads them.
        counted: {pair: tally} of pairs that are already counted; their truth is not read again.

    Raises:
        ReleaseError: a pair file is missing or changed.
    """
    chosen = {}
    for category in release.categories:
        for split in SOURCES:
            targets = [target for target in release.open_split(split) if target.category == category]
            if targets:
                chosen[category] = (split, targets)
                break
    shares = {
        target: float(tally.voxels[1::2].sum()) / float(tally.voxels.sum())
        for target, tally in (counted or {}).items()
    }
    unread = [t for _, targets in chosen.values() for t in targets if t not in shares]
    tasks = [(release.pair_path(t), t.sha256) for t in unread]
    workers = min(jobs, 1 + len(tasks) // PAIRS_A_PROCESS)
    shares |= dict(zip(unread, run_tasks(_occupied_share, tasks, workers), strict=True))
    return {
        category: BaseRate(
            value=float(np.mean([shares[target] for target in targets])), source=SOURCES[split]
        )
        for category, (split, targets) in chosen.items()
    }


def _occupied_share(task: tuple[Path, str]) -> float:
    """Return the share of voxels that are occupied in the truth of a pair; `task` is (file, SHA-256)."""
    (full,) = read_parts(*task, ("full",))
    return int(np.bitwise_count(full).sum()) / (8 * full.size)


# Names of baselines. An older table of such a name, which does not state what it is, is marked as a baseline.
BASELINE_NAMES = (
    *("empty", "base-rate", "partial", "hull", "carved-hull", "mirror", "silhouette"),
    *("mean-shape", "nearest"),
)

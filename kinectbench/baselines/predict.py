"""Which baselines a release allows, and their predictions pair by pair."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from kinectbench.baselines.inputs import Inputs, read_training, up_in_grid
from kinectbench.baselines.registry import BASE_RATE, BASELINES, LEARNED
from kinectbench.release.release import Release, Target
from kinectbench.scoring.base_rate import SOURCES, base_rates
from kinectbench.voxels.pair_input import read_input

SPLITS = ("test", "validation")


@dataclass(frozen=True)
class BaselineTask:
    """One pair to be predicted by some baselines.

    Attributes:
        release: whose pair it is.
        target: the pair.
        base_rate: of its category; NaN where its truth is held back.
        names: of the baselines.
    """

    release: Release
    target: Target
    base_rate: float
    names: tuple[str, ...]


def possible_baselines(release: Release) -> tuple[str, ...]:
    """The baselines that can be made.

    Those that learn only where every category has training pairs, and `base-rate` only where some truth of
    every category is not held back.
    """
    trained = {target.category for target in release.open_split("train")}
    known = {target.category for split in SOURCES for target in release.open_split(split)}
    wanted = {target.category for split in SPLITS for target in release.split(split)}
    blind = (() if wanted <= trained else LEARNED) + (() if wanted <= known else (BASE_RATE,))
    return tuple(name for name in BASELINES if name not in blind)


def baseline_tasks(release: Release, names: Sequence[str], jobs: int = 1) -> list[BaselineTask]:
    """A task for every test and validation pair.

    Raises:
        ReleaseError: a pair file is missing or changed.
    """
    rates = {category: rate.value for category, rate in base_rates(release, jobs).items()}
    return [
        BaselineTask(release, target, rates.get(target.category, math.nan), tuple(names))
        for split in SPLITS
        for target in release.split(split)
    ]


_training = lru_cache(maxsize=1)(read_training)  # the tasks of a category follow each other


def predicted(task: BaselineTask) -> Iterator[tuple[str, NDArray[np.bool_] | NDArray[np.float16]]]:
    """Each baseline's name and its prediction (n, n, n) for the pair of a task.

    Raises:
        PairError, ReleaseError: a pair cannot be read.
    """
    release, target = task.release, task.target
    pair = read_input(release.pair_path(target))
    learns = any(name in LEARNED for name in task.names)
    training = _training(release, target.category) if learns else None
    inputs = Inputs(pair, task.base_rate, up_in_grid(release, target, pair), training)
    for name in task.names:
        yield name, BASELINES[name](inputs)

"""Write the baselines' predictions for a release."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from kinectbench.baselines.inputs import Inputs, read_training, up_in_grid
from kinectbench.baselines.registry import BASE_RATE, BASELINES, LEARNED
from kinectbench.errors import SettingsError
from kinectbench.release.release import Release, Target
from kinectbench.scoring.base_rate import SOURCES, base_rates
from kinectbench.scoring.workers import Progress, run_tasks
from kinectbench.voxels.npz import npz_bytes
from kinectbench.voxels.pair_input import read_input
from kinectbench.workspace import replaced_file

SPLITS = ("test", "validation")


@dataclass(frozen=True)
class _Task:
    """One pair to be predicted by some baselines."""

    release: Release
    target: Target
    base_rate: float
    names: tuple[str, ...]
    out: Path


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


def write_baselines(
    release: Release,
    out: Path,
    names: Sequence[str] | None = None,
    jobs: int = 1,
    progress: Progress | None = None,
) -> tuple[str, ...]:
    """Write `out/<name>/<recording>/<view>.npz` for every test and validation pair; same input, same bytes.

    Args:
        release: what is predicted.
        out: a folder of methods.
        names: some of `BASELINES`; default: all that are possible.
        jobs: number of processes.
        progress: called with (pairs done, pairs in all).

    Returns:
        The names written.

    Raises:
        SettingsError: no such baseline, or one that learns without training pairs.
        PairError, ReleaseError: a pair cannot be read.
        StorageError: the disk is full or read-only.
    """
    possible = possible_baselines(release)
    chosen = tuple(names or possible)
    unknown = [name for name in chosen if name not in BASELINES]
    if unknown:
        raise SettingsError(f"no baseline '{', '.join(unknown)}': choose among {', '.join(BASELINES)}")
    blind = [name for name in chosen if name not in possible]
    if BASE_RATE in blind:
        raise SettingsError(f"{BASE_RATE}: needs truth of every category, and it is held back; leave it out")
    if blind:
        raise SettingsError(f"{', '.join(blind)}: needs training pairs of every category; leave it out")
    rates = {category: rate.value for category, rate in base_rates(release, jobs).items()}
    tasks = [
        _Task(release, target, rates.get(target.category, math.nan), chosen, out)
        for split in SPLITS
        for target in release.split(split)
    ]
    run_tasks(_write, tasks, jobs, progress)
    return chosen


_training = lru_cache(maxsize=1)(read_training)  # the tasks of a category follow each other


def _write(task: _Task) -> None:
    """Write one pair's predictions."""
    release, target = task.release, task.target
    pair = read_input(release.pair_path(target))
    learns = any(name in LEARNED for name in task.names)
    training = _training(release, target.category) if learns else None
    inputs = Inputs(pair, task.base_rate, up_in_grid(release, target, pair), training)
    for name in task.names:
        path = task.out / name / target.recording / f"{target.view}.npz"
        with replaced_file(path) as temporary:
            temporary.write_bytes(npz_bytes({"prediction": BASELINES[name](inputs)}))

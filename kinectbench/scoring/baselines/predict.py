"""Find which baselines a release allows, predict each pair with them, and write prediction files."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from kinectbench._version import __version__
from kinectbench.core import SettingsError, replaced_file, storage_errors
from kinectbench.core.artefacts.method import MethodFile
from kinectbench.core.artefacts.scores import BaseRate
from kinectbench.core.types import Progress, Split, no_progress
from kinectbench.core.voxels.npz import npz_bytes
from kinectbench.core.voxels.pair_file import PairInput, checked_pair, pair_values
from kinectbench.release.release import Release, Target
from kinectbench.scoring.base_rates import SOURCES, base_rates
from kinectbench.scoring.baselines.inputs import Inputs, read_training, up_in_grid
from kinectbench.scoring.baselines.registry import BASE_RATE, BASELINES, LEARNED
from kinectbench.scoring.workers import run_tasks

SPLITS: tuple[Split, ...] = ("test", "validation")
# Prefix of the version in a method.json of `write_baselines`.
BY = "kinectbench "


@dataclass(frozen=True)
class BaselineTask:
    """A pair, and the baselines that predict it.

    Attributes:
        release: the release that contains the pair.
        target: the pair.
        base_rate: share of occupied voxels in the category's truth, in [0, 1]; NaN if the truth is held back.
        names: the baselines' names.
    """

    release: Release
    target: Target
    base_rate: float
    names: tuple[str, ...]


def possible_baselines(release: Release) -> tuple[str, ...]:
    """Return the names of baselines that this release allows.

    Baselines that learn need training pairs in every category. `base-rate` needs, in every category, at least
    one pair whose truth is solid and not held back.
    """
    trained = {target.category for target in release.open_split("train")}
    known = {target.category for split in SOURCES for target in release.open_split(split)}
    wanted = {target.category for split in SPLITS for target in release.split(split)}
    blind = (() if wanted <= trained else LEARNED) + (() if wanted <= known else (BASE_RATE,))
    return tuple(name for name in BASELINES if name not in blind)


def baseline_tasks(
    release: Release, names: Sequence[str], rates: Mapping[str, BaseRate], splits: Sequence[Split] = SPLITS
) -> list[BaselineTask]:
    """Return a task for every pair of the given splits; `rates` are the base rates of the categories."""
    values = {category: rate.value for category, rate in rates.items()}
    return [
        BaselineTask(release, target, values.get(target.category, math.nan), tuple(names))
        for split in splits
        for target in release.split(split)
    ]


_training = lru_cache(maxsize=1)(read_training)  # tasks of one category are consecutive


def predicted(task: BaselineTask) -> Iterator[tuple[str, NDArray[np.bool_] | NDArray[np.float16]]]:
    """Yield (name, prediction (n, n, n)) of each baseline of a task, for the pair of the task.

    Raises:
        PairError, ReleaseError: a pair cannot be read.
    """
    release, target = task.release, task.target
    where = str(release.pair_path(target))
    pair = checked_pair(PairInput, pair_values(release.pair_content(target), where), where)
    learns = any(name in LEARNED for name in task.names)
    training = _training(release, target.category) if learns else None
    inputs = Inputs(pair, task.base_rate, up_in_grid(release, target, pair), training)
    for name in task.names:
        yield name, BASELINES[name](inputs)


def write_baselines(
    release: Release,
    out: Path,
    names: Sequence[str] | None = None,
    jobs: int = 1,
    progress: Progress = no_progress,
) -> tuple[str, ...]:
    """Write `out/<name>/<recording>/<view>.npz` for every test and validation pair, and method.json.

    The same release gives the same bytes. Once all is predicted, method.json identifies the release.

    Args:
        release: the release that is predicted.
        out: a folder of methods.
        names: some of `BASELINES`; default: all that the release allows.
        jobs: number of processes.
        progress: called with (pairs done, pairs in all).

    Returns:
        The names written.

    Raises:
        SettingsError: no such baseline, one that this release does not allow, no pair to predict, or a folder
            `out/<name>` that is not empty and has no method.json of an earlier call.
        PairError, ReleaseError: a pair cannot be read.
        StorageError: the disk is full or read-only.
    """
    check_baseline_names(names or ())
    release.of_splits(SPLITS)  # raises an error if there is no pair to predict
    possible = possible_baselines(release)
    chosen = tuple(names or possible)
    blind = [name for name in chosen if name not in possible]
    if BASE_RATE in blind:
        raise SettingsError(
            f"{BASE_RATE}: needs truth of every category, and it is held back; leave it out",
            what="truth-held-back",
        )
    if blind:
        raise SettingsError(
            f"{', '.join(blind)}: needs training pairs of every category; leave it out",
            what="truth-held-back",
        )
    for name in chosen:
        _check_ours(out / name)
    tasks = baseline_tasks(release, chosen, base_rates(release, jobs))
    # If this run is stopped, no files of an earlier run, perhaps for another release, must be left.
    for name in chosen:
        _write_method(out, MethodFile(name=name, version=BY + __version__))
        for task in tasks:
            _remove(_path(out, name, task.target))
    run_tasks(partial(_write_predictions, out), tasks, jobs, progress)
    for name in chosen:
        sha256 = release.benchmark_sha256
        _write_method(out, MethodFile(name=name, version=BY + __version__, benchmark_sha256=sha256))
    return chosen


def _check_ours(folder: Path) -> None:
    """Refuse a folder of a baseline's name that is not empty, unless it has a method.json of `baseline`."""
    if not folder.is_dir() or all(path.name.startswith(".") for path in folder.iterdir()):
        return
    method = MethodFile.read(folder) if (folder / MethodFile.FILE).exists() else None
    by_baseline = method and (method.version or "").startswith(BY) and method.settings is None
    if not method or not by_baseline or method.name != folder.name:
        raise SettingsError(
            f"{folder}: has no {MethodFile.FILE} of `baseline`; remove or rename it, or choose another --out",
            what="other-content",
        )


def _write_method(out: Path, method: MethodFile) -> None:
    with replaced_file(out / method.name / MethodFile.FILE) as temporary:
        temporary.write_text(method.text(), encoding="utf-8")


def _remove(path: Path) -> None:
    if path.is_file() or path.is_symlink():
        with storage_errors(path):
            path.unlink()


def check_baseline_names(names: Sequence[str]) -> None:
    """Refuse unknown names of baselines.

    Raises:
        SettingsError: no such baseline.
    """
    unknown = [name for name in names if name not in BASELINES]
    if unknown:
        raise SettingsError(f"no baseline '{', '.join(unknown)}': choose among {', '.join(BASELINES)}")


def _write_predictions(out: Path, task: BaselineTask) -> None:
    for name, prediction in predicted(task):
        with replaced_file(_path(out, name, task.target)) as temporary:
            temporary.write_bytes(npz_bytes({"prediction": prediction}))


def _path(out: Path, name: str, target: Target) -> Path:
    return out / name / target.recording / f"{target.view}.npz"

"""Write the baselines' predictions for a release."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from kinectbench.baselines.registry import BASELINES
from kinectbench.errors import SettingsError
from kinectbench.release.release import Release, Target
from kinectbench.scoring.base_rate import base_rates
from kinectbench.scoring.workers import Progress, run_tasks
from kinectbench.voxels.pair_file import npz_bytes, read_pair
from kinectbench.workspace import replaced_file

SPLITS = ("test", "validation")


@dataclass(frozen=True)
class _Task:
    """One pair to be predicted by some baselines."""

    pair: Path
    target: Target
    base_rate: float
    names: tuple[str, ...]
    out: Path


def write_baselines(
    release: Release,
    out: Path,
    names: Sequence[str] = tuple(BASELINES),
    jobs: int = 1,
    progress: Progress | None = None,
) -> None:
    """Write `out/<name>/<recording>/<view>.npz` for every test and validation pair; same input, same bytes.

    Args:
        release: what is predicted.
        out: a folder of methods.
        names: some of `BASELINES`.
        jobs: number of processes.
        progress: called with (pairs done, pairs in all).

    Raises:
        SettingsError: no such baseline.
        PairError, ReleaseError: a pair cannot be read.
        StorageError: the disk is full or read-only.
    """
    unknown = [name for name in names if name not in BASELINES]
    if unknown:
        raise SettingsError(f"no baseline '{', '.join(unknown)}': choose among {', '.join(BASELINES)}")
    rates = base_rates(release, jobs)
    tasks = [
        _Task(release.pair_path(target), target, rates[target.category].value, tuple(names), out)
        for split in SPLITS
        for target in release.split(split)
    ]
    run_tasks(_write, tasks, jobs, progress)


def _write(task: _Task) -> None:
    """Write one pair's predictions."""
    pair = read_pair(task.pair)
    for name in task.names:
        prediction = BASELINES[name](pair, task.base_rate)
        path = task.out / name / task.target.recording / f"{task.target.view}.npz"
        with replaced_file(path) as temporary:
            temporary.write_bytes(npz_bytes({"prediction": prediction}))

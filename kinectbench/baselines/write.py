"""Write the baselines' predictions for a release."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path

from kinectbench.baselines.predict import BaselineTask, baseline_tasks, possible_baselines, predicted
from kinectbench.baselines.registry import BASE_RATE, BASELINES
from kinectbench.errors import SettingsError
from kinectbench.release.release import Release
from kinectbench.scoring.workers import Progress, run_tasks
from kinectbench.voxels.npz import npz_bytes
from kinectbench.workspace import replaced_file


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
    check_names(names or ())
    possible = possible_baselines(release)
    chosen = tuple(names or possible)
    blind = [name for name in chosen if name not in possible]
    if BASE_RATE in blind:
        raise SettingsError(f"{BASE_RATE}: needs truth of every category, and it is held back; leave it out")
    if blind:
        raise SettingsError(f"{', '.join(blind)}: needs training pairs of every category; leave it out")
    run_tasks(partial(_write, out), baseline_tasks(release, chosen, jobs), jobs, progress)
    return chosen


def check_names(names: Sequence[str]) -> None:
    """Refuse names of no baseline.

    Raises:
        SettingsError: no such baseline.
    """
    unknown = [name for name in names if name not in BASELINES]
    if unknown:
        raise SettingsError(f"no baseline '{', '.join(unknown)}': choose among {', '.join(BASELINES)}")


def _write(out: Path, task: BaselineTask) -> None:
    """Write one pair's predictions."""
    for name, prediction in predicted(task):
        path = out / name / task.target.recording / f"{task.target.view}.npz"
        with replaced_file(path) as temporary:
            temporary.write_bytes(npz_bytes({"prediction": prediction}))

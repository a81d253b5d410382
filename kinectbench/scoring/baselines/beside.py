"""Scores of the baselines that stand beside a method's: made in memory, kept beside the scores.

Voxel metrics only: a table needs no more to show what a method is worth, and surfaces take most of the time.
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from kinectbench.core.artefacts.counted import PairResult
from kinectbench.core.artefacts.scores import BASELINES_FOLDER, ScoreSettings, ScoreTable
from kinectbench.core.errors import StorageError
from kinectbench.core.types import Progress
from kinectbench.core.voxels.resample import HALF_PIXEL
from kinectbench.engine.artefact import VERSIONS
from kinectbench.release.release import Release
from kinectbench.scoring.assemble import describe, make_table
from kinectbench.scoring.baselines.predict import BaselineTask, baseline_tasks, possible_baselines, predicted
from kinectbench.scoring.pair_result import Counting, ceilings, count
from kinectbench.scoring.references import base_rates
from kinectbench.scoring.thresholds import searched_thresholds
from kinectbench.scoring.truth import read_truth
from kinectbench.scoring.workers import run_tasks


def baselines_beside(
    release: Release,
    out: Path,
    *,
    protocols: Sequence[str],
    upsampling: str = HALF_PIXEL,
    without: Collection[str] = (),
    jobs: int = 1,
    progress: Progress | None = None,
) -> list[ScoreTable]:
    """The scores of every baseline that the release allows, as `score` would give them for its files.

    They are kept in `out/baselines/<name>/scores.json` and read from there where release, settings and the
    versions of counting and of the baselines are the same. Thresholds are found on the validation split for
    each, else they are 0.5.

    Args:
        release: the truth.
        out: folder of the scores.
        protocols: some of "paper", "known", "occluded".
        upsampling: "half-pixel" or "corner-aligned".
        without: names that are left out.
        jobs: number of processes.
        progress: called with (pairs done, pairs in all), if any are to be counted.

    Raises:
        PairError, ReleaseError: a pair cannot be read.
        StorageError: the disk is full or read-only.
    """
    counting = Counting(tuple(protocols), upsampling, surface=False)
    names = [name for name in possible_baselines(release) if name not in without]
    folder = out / BASELINES_FOLDER
    kept = {name: _kept(folder / name, name, release, counting) for name in names}
    tables = {name: table for name, table in kept.items() if table is not None}
    wanted = tuple(name for name in names if name not in tables)
    if wanted:
        for table in _made(release, counting, wanted, jobs, progress):
            table.write(folder / table.method)
            tables[table.method] = table
    return [tables[name] for name in names]


def _kept(folder: Path, name: str, release: Release, counting: Counting) -> ScoreTable | None:
    """What was made before, if it would be the same again."""
    try:
        table = ScoreTable.read(folder)
    except StorageError:  # none there, or a damaged one
        return None
    made = (table.method, table.baseline, table.benchmark_sha256, table.settings)
    same = (name, True, release.benchmark_sha256, _settings(counting))
    return table if made == same and table.complete else None


def _settings(counting: Counting) -> ScoreSettings:
    """What the numbers of a baseline depend on, with the versions of what made them."""
    return describe(counting, "error").model_copy(update={"baseline_version": VERSIONS["baselines"]})


def _made(
    release: Release, counting: Counting, names: tuple[str, ...], jobs: int, progress: Progress | None
) -> list[ScoreTable]:
    """Predict and count every pair."""
    tasks = baseline_tasks(release, names, jobs)
    counted = run_tasks(partial(_count, counting), tasks, jobs, progress)
    rates = base_rates(release, jobs)
    tables = []
    for name in names:
        results = {task.target: of[name] for task, of in zip(tasks, counted, strict=True)}
        tallies = {t: result.tally for t, result in results.items() if t.split == "validation"}
        thresholds = searched_thresholds(release.targets, tallies)
        table = make_table(release, name, results, thresholds, rates, {}, _settings(counting))
        tables.append(table.model_copy(update={"baseline": True}))
    return tables


def _count(counting: Counting, task: BaselineTask) -> dict[str, PairResult]:
    """Every baseline's counts of one pair."""
    truth = read_truth(task.release.pair_path(task.target), task.target.sha256)
    reached: dict[int, Mapping[str, float]] = {}  # several baselines share a side
    results = {}
    for name, prediction in predicted(task):
        result = count(prediction, truth, counting, None)
        if task.target.split == "test":
            if result.cells not in reached:
                reached[result.cells] = ceilings(truth, result.cells, counting)
            result = replace(result, ceilings=reached[result.cells])
        results[name] = result
    return results

"""Score baselines in memory, as methods or beside a method; prediction files would give the same tables.

For comparison with a method, only voxel metrics are computed under the grid protocols: they suffice to judge
a method, and surface metrics take most of the time. If the method predicts in the camera frame, baselines are
scored only under `camera`.
"""

import contextlib
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

from kinectbench.core import SettingsError, StorageError
from kinectbench.core.artefacts.counted import PairResult
from kinectbench.core.artefacts.score_figures import ScoreRow, any_in_space
from kinectbench.core.artefacts.scores import BASELINES_FOLDER, BaseRate, ScoreTable
from kinectbench.core.artefacts.targets import check_names
from kinectbench.core.types import Progress, Split, no_progress
from kinectbench.core.voxels.resample import HALF_PIXEL
from kinectbench.release.release import Release, Target
from kinectbench.scoring.assemble import as_of_baseline, describe, make_table, rows_of
from kinectbench.scoring.base_rates import base_rates
from kinectbench.scoring.baselines.in_space import scored_again, space_baselines
from kinectbench.scoring.baselines.predict import BaselineTask, baseline_tasks, possible_baselines, predicted
from kinectbench.scoring.baselines.registry import WITHOUT_SURFACE
from kinectbench.scoring.baselines.reuse import Scoring, reusable_tables
from kinectbench.scoring.camera.score_camera_method import settings_in_space
from kinectbench.scoring.pair_result import Counting, ceilings, count, counting_of, surfaces
from kinectbench.scoring.protocols import space_alone
from kinectbench.scoring.read_table import read_table
from kinectbench.scoring.request import Request, check_words
from kinectbench.scoring.rounds import pairs_to_score
from kinectbench.scoring.thresholds import Thresholds, searched_thresholds, thresholds_for
from kinectbench.scoring.truth import read_packed_truth
from kinectbench.scoring.workers import run_tasks

# {name of a baseline: counts of one pair}
Counts = dict[str, PairResult]


def score_baselines(
    release: Release,
    out: Path,
    *,
    protocols: Sequence[str] | None = None,
    thresholds_file: Path | None = None,
    upsampling: str = HALF_PIXEL,
    surface: bool = True,
    jobs: int = 1,
    progress: Progress = no_progress,
) -> list[ScoreTable]:
    """Score every baseline that a release allows, write `out/<name>/scores.json`, and return the tables.

    Valid tables of an earlier run in `out` are reused (`reusable_tables`). No prediction files are written;
    `write_baselines` and `score_methods` would give the same tables, with hashes of such files.

    Args:
        release: the release that is predicted.
        out: folder for the results.
        protocols: names of `PROTOCOLS`; or `camera`, `aligned` or both; default: all that apply, except
            `shell`.
        thresholds_file: a threshold file (`read_thresholds`); then nothing is chosen on the validation split.
        upsampling: "half-pixel" or "corner-aligned".
        surface: whether surface metrics are computed.
        jobs: number of processes; the result does not depend on it.
        progress: called with (pairs done, pairs in all).

    Raises:
        PairError, ReleaseError: a pair cannot be read, there is no test pair, or its truth is held back.
        SettingsError: an unknown protocol or an unusable threshold file; or `out` has scores of another
            method of such a name.
        StorageError: the disk is full or read-only.
    """
    check_words(protocols, upsampling)
    check_names(release.targets, str(release.folder))
    pairs_to_score(release, validation=thresholds_file is None)
    names = possible_baselines(release)
    _refuse_to_replace([out / name / ScoreTable.FILE for name in names])
    in_space = space_alone(protocols, upsampling)
    scoring = scoring_of(in_space or counting_of(release, protocols, upsampling, surface), names)
    request = Request(thresholds_file=thresholds_file, jobs=jobs, progress=progress)
    return _tables(release, scoring, {name: out / name for name in scoring.names}, request)


def _tables(
    release: Release,
    scoring: Scoring,
    folders: Mapping[str, Path],
    request: Request,
    *,
    for_comparison: bool = False,
) -> list[ScoreTable]:
    """Return a table for each of `scoring.names`; make and write those that no earlier run left in `folders`.

    With a threshold file, no table is reused. `for_comparison` is as in `reusable_tables`.
    """
    earlier = {} if request.thresholds_file else folders
    tables = reusable_tables(earlier, release, scoring, request.here, for_comparison=for_comparison)
    if wanted := [name for name in scoring.names if name not in tables]:
        for table in scoring.make(release, wanted, request=request):
            made = table.model_copy(update={"baseline": True}) if for_comparison else table
            made.write(folders[table.method])
            tables[table.method] = made
    return [tables[name] for name in scoring.names]


def scoring_of(how: Counting | tuple[str, ...], names: Sequence[str]) -> Scoring:
    """Return how to score baselines: in grids, given options, or in space, given protocols."""
    if isinstance(how, Counting):
        make = partial(counted_baselines, counting=how)
        settings = as_of_baseline(describe(how, "error"))
        return Scoring(tuple(names), settings, make, partial(_counted_again, how))
    return Scoring(
        tuple(name for name in names if name not in WITHOUT_SURFACE),
        as_of_baseline(settings_in_space(how, "error")),
        partial(space_baselines, protocols=how),
        partial(scored_again, how),
    )


def _refuse_to_replace(paths: Sequence[Path]) -> None:
    """Refuse to overwrite the scores of methods that are named like baselines.

    Raises:
        SettingsError: a file has the scores of a method that is no baseline.
    """
    for path in paths:
        with contextlib.suppress(StorageError):  # there is none, or it is damaged
            table = read_table(path)
            if table.settings.baseline_version == 0:
                raise SettingsError(
                    f"{path}: has the scores of a method that is named like a baseline; give another folder "
                    "for those of the baselines: --out",
                    what="other-scores",
                )


def counted_baselines(
    release: Release, names: Sequence[str], counting: Counting, request: Request
) -> list[ScoreTable]:
    """Return the tables of the named baselines, in the order of `names`.

    Surface metrics are computed on the test split only. Without a threshold file in the request, thresholds
    are chosen per baseline on the validation split, or are 0.5 if it has no pairs.

    Raises:
        PairError, ReleaseError: a pair cannot be read.
        SettingsError: an unusable threshold file.
    """
    rates, file = base_rates(release, request.here), request.thresholds_file
    fixed = None if file is None else thresholds_for(file, release.split("test"))
    splits: tuple[Split, ...] = ("validation", "test") if fixed is None else ("test",)
    # Only surface metrics need the thresholds. Without them, one round suffices, and processes start only
    # once.
    rounds = [(split,) for split in splits] if counting.surface else [splits]
    pairs = sum(len(release.split(split)) for split in splits)
    thresholds = {} if fixed is None else dict.fromkeys(names, fixed)
    counted: dict[Target, Counts] = {}
    for together in rounds:
        tasks = baseline_tasks(release, names, rates, together)
        tell = partial(_tell, request.progress, len(counted), pairs)
        results = run_tasks(partial(_count, counting, thresholds), tasks, request.here, tell)
        counted |= {task.target: of for task, of in zip(tasks, results, strict=True)}
        if "validation" in together:
            thresholds = {name: _thresholds_on_validation(release, name, counted) for name in names}
    settings = as_of_baseline(describe(counting, "error"))
    return [
        make_table(
            release, name, {t: of[name] for t, of in counted.items()}, thresholds[name], rates, {}, settings
        )
        for name in names
    ]


def _counted_again(
    counting: Counting,
    tasks: Sequence[BaselineTask],
    thresholds: Mapping[str, Thresholds],
    rates: Mapping[str, BaseRate],
    jobs: int,
) -> Iterator[tuple[str, Sequence[ScoreRow]]]:
    """Yield (baseline, its rows for the tasks' pairs), as `Scoring.again` needs it."""
    counted = run_tasks(partial(_count, counting, thresholds), tasks, jobs)
    for name, of_category in thresholds.items():
        results = {task.target: of[name] for task, of in zip(tasks, counted, strict=True)}
        yield name, rows_of(results, counting.protocols, of_category, rates)


def _tell(progress: Progress, before: int, pairs: int, done: int, _total: int) -> None:
    """Report progress over all rounds: `before` pairs were done in earlier rounds, `done` in this one."""
    progress(before + done, pairs)


def _thresholds_on_validation(release: Release, name: str, counted: Mapping[Target, Counts]) -> Thresholds:
    tallies = {t: of[name].tally for t, of in counted.items() if t.split == "validation"}
    return searched_thresholds(release.targets, tallies)


def _count(counting: Counting, thresholds: Mapping[str, Thresholds], task: BaselineTask) -> Counts:
    """Return {baseline: voxel counts of its prediction for the task's pair}.

    For a test pair, the counts include the best IoU that a grid of the prediction's side can reach. If
    surface metrics are requested, they are included too, at the baseline's threshold for the category.
    """
    truth = read_packed_truth(task.release.pair_path(task.target), task.target.sha256, counting.further_grids)
    reached: dict[int, Mapping[str, float]] = {}  # several baselines share a side
    results = {}
    for name, prediction in predicted(task):
        result = count(prediction, truth, counting, None)
        if task.target.split == "test":
            if result.cells not in reached:
                reached[result.cells] = ceilings(truth, result.cells, counting)
            threshold = thresholds[name].of[task.target.category] if counting.surface else None
            surface = surfaces(prediction, truth, counting, threshold)
            result = replace(result, ceilings=reached[result.cells], surface=surface)
        results[name] = result
    return results


def comparison_baselines(
    release: Release,
    out: Path,
    *,
    protocols: Sequence[str],
    upsampling: str = HALF_PIXEL,
    without: Collection[str] = (),
    jobs: int = 1,
    progress: Progress = no_progress,
) -> list[ScoreTable]:
    """Score every baseline that the release allows, for comparison with a method; return their tables.

    Tables are stored in `out/baselines/<name>/scores.json`, or for the protocol `camera` in
    `out/baselines/<name>+camera/`. Valid tables of an earlier run are reused (`reusable_tables`). Thresholds
    are chosen per baseline on the validation split; without that split they are 0.5.

    Args:
        release: the release that is scored.
        out: folder of the scores.
        protocols: names of `PROTOCOLS` that the pairs allow; or `camera` and `aligned`, of which only
            `camera` is scored.
        upsampling: "half-pixel" or "corner-aligned".
        without: names of baselines that are left out.
        jobs: number of processes.
        progress: called with (pairs done, pairs in all); not called if all tables are reused.

    Raises:
        PairError, ReleaseError: a pair cannot be read.
        StorageError: the disk is full or read-only.
    """
    names = [name for name in possible_baselines(release) if name not in without]
    in_space = any_in_space(protocols)
    counting = Counting(tuple(protocols), upsampling, surface=False)
    scoring, sign = scoring_of(("camera",) if in_space else counting, names), "+camera" * in_space
    folders = {name: out / BASELINES_FOLDER / f"{name}{sign}" for name in scoring.names}
    request = Request(jobs=jobs, progress=progress)
    return _tables(release, scoring, folders, request, for_comparison=True)

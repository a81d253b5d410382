"""Score baselines in memory under the protocols camera and aligned; their occupied cells are the solid."""

from collections.abc import Iterator, Mapping, Sequence
from functools import partial

from kinectbench.core import PredictionError
from kinectbench.core.artefacts.counted import Tally
from kinectbench.core.artefacts.score_figures import ScoreRow
from kinectbench.core.artefacts.scores import BaseRate, ScoreTable
from kinectbench.core.voxels.resample import HALF_PIXEL
from kinectbench.release.release import Release, Target
from kinectbench.scoring.assemble import as_of_baseline
from kinectbench.scoring.base_rates import base_rates
from kinectbench.scoring.baselines.predict import BaselineTask, baseline_tasks, predicted
from kinectbench.scoring.baselines.registry import WITHOUT_SURFACE
from kinectbench.scoring.camera.score_camera_method import rows_of_view, settings_in_space, table_in_space
from kinectbench.scoring.camera.score_grid_view import grid_result
from kinectbench.scoring.camera.score_view import Asked, ViewResult, asked_rows
from kinectbench.scoring.camera.truth import files_of, read_space_truth
from kinectbench.scoring.counts import tally
from kinectbench.scoring.request import Request
from kinectbench.scoring.thresholds import Thresholds, searched_thresholds, thresholds_for
from kinectbench.scoring.truth import read_packed_truth
from kinectbench.scoring.workers import run_tasks

# {name of a baseline: tally of one pair}; {name: result of one view, or why it cannot be scored}.
Tallies = dict[str, Tally]
Results = dict[str, ViewResult | str]


def space_baselines(
    release: Release, names: Sequence[str], protocols: tuple[str, ...], request: Request
) -> list[ScoreTable]:
    """Return the tables of the named baselines, in this order, except baselines in `WITHOUT_SURFACE`.

    `protocols` are camera, aligned or both. Without a threshold file in the request, thresholds are
    chosen per baseline on the validation split, or are 0.5 if it has no pairs.

    Raises:
        PairError, ReleaseError: a pair cannot be read.
        SettingsError: an unusable threshold file.
    """
    names = [name for name in names if name not in WITHOUT_SURFACE]
    rates = base_rates(release, request.here)
    validation: dict[Target, str | None] = {}
    if request.thresholds_file is None:
        validation = dict.fromkeys(release.split("validation"))
        thresholds = thresholds_of_baselines(release, names, rates, request.here)
    else:
        thresholds = dict.fromkeys(names, thresholds_for(request.thresholds_file, release.split("test")))
    tasks = baseline_tasks(release, names, rates, ("test",))
    score = partial(_results, thresholds, tuple(asked_rows(protocols, "metric")))
    found = run_tasks(score, tasks, request.here, request.progress)
    results = {task.target: of for task, of in zip(tasks, found, strict=True)}
    settings = as_of_baseline(settings_in_space(protocols, "error"))
    return [
        table_in_space(
            release,
            name,
            {t: one for t, of in results.items() if isinstance(one := of[name], ViewResult)},
            {t: one for t, of in results.items() if isinstance(one := of[name], str)},
            settings,
            (),
            thresholds[name],
            validation,
        )
        for name in names
    ]


def thresholds_of_baselines(
    release: Release,
    names: Sequence[str],
    rates: Mapping[str, BaseRate],
    jobs: int = 1,
    upsampling: str = HALF_PIXEL,
) -> dict[str, Thresholds]:
    """Return {baseline: its thresholds, chosen on its predictions for all validation pairs}.

    `rates` are as `base_rates` returns them.

    Raises:
        PairError, ReleaseError: a pair cannot be read.
    """
    tasks = baseline_tasks(release, names, rates, ("validation",))
    tallies = run_tasks(partial(_tallies, upsampling), tasks, jobs)
    counted = {task.target: of for task, of in zip(tasks, tallies, strict=True)}
    return {
        name: searched_thresholds(release.targets, {t: of[name] for t, of in counted.items()})
        for name in names
    }


def scored_again(
    protocols: tuple[str, ...],
    tasks: Sequence[BaselineTask],
    thresholds: Mapping[str, Thresholds],
    rates: Mapping[str, BaseRate],
    jobs: int,
) -> Iterator[tuple[str, Sequence[ScoreRow]]]:
    """Yield (baseline, its rows for the tasks' views), as `Scoring.again` needs it."""
    found = run_tasks(partial(_results, thresholds, tuple(asked_rows(protocols, "metric"))), tasks, jobs)
    for name, of_category in thresholds.items():
        yield (
            name,
            [
                row
                for task, of in zip(tasks, found, strict=True)
                if isinstance(one := of[name], ViewResult)
                for row in rows_of_view(task.target, one, of_category.of[task.target.category])
            ],
        )


def _tallies(upsampling: str, task: BaselineTask) -> Tallies:
    """Return {baseline: its voxel counts of a validation pair}; they serve to choose the thresholds."""
    truth = read_packed_truth(task.release.pair_path(task.target), task.target.sha256)
    return {name: tally(prediction, truth, upsampling) for name, prediction in predicted(task)}


def _results(thresholds: Mapping[str, Thresholds], asked: tuple[Asked, ...], task: BaselineTask) -> Results:
    """Return {baseline: result of one view, or why it cannot be scored} for `asked_rows`."""
    truth = read_space_truth(files_of(task.release, task.target))
    category = task.target.category
    results: Results = {}
    for name, prediction in predicted(task):
        try:
            results[name] = grid_result(truth, prediction, thresholds[name].of[category], asked)
        except PredictionError as error:  # such as a surface of noise
            results[name] = f"{task.target.name}: {error}"
    return results

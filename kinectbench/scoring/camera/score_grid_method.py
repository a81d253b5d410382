"""Score a method under the protocols camera and aligned, if it predicts in the grids of the pairs."""

from kinectbench.core.artefacts.counted import PairResult
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.types import no_progress
from kinectbench.release.release import Release
from kinectbench.scoring.camera.score_camera_method import refuse_many_rows, settings_in_space, table_in_space
from kinectbench.scoring.camera.score_grid_view import GridJob, score_grid
from kinectbench.scoring.camera.score_view import ViewResult, asked_rows
from kinectbench.scoring.camera.truth import files_of
from kinectbench.scoring.pair_result import Counting, Journal
from kinectbench.scoring.request import Request, check_missing
from kinectbench.scoring.rounds import Plan, Rounds
from kinectbench.scoring.workers import run_tasks

# Thresholds are searched by the IoU over all cells, so surface metrics are not needed.
SEARCHING = Counting(("paper",), surface=False)


def score_grid_in_space(
    release: Release,
    asked: Plan,
    method: str,
    protocols: tuple[str, ...],
    request: Request,
) -> ScoreTable:
    """Score in space, on the test split, a method that predicts voxels in each pair's grid; return the table.

    Args:
        release: the release that was predicted.
        asked: the method's prediction files, and its thresholds or how to choose them.
        method: the method's name.
        protocols: camera, aligned or both.
        request: the options that `asked` was made with; progress is of the test views.

    Raises:
        ReleaseError: a pair file is missing or changed.
        SettingsError: the table would have too many rows.
    """
    rows = tuple(asked_rows(protocols, "metric"))
    refuse_many_rows(len(release.split("test")), rows)
    rounds = Rounds(release, SEARCHING, Journal(None), request.here, no_progress)
    searched = {target: file for target, file in asked.files.items() if target.split == "validation"}
    outcomes, thresholds = rounds.count(searched, asked.fixed, asked.own)
    validation = {t: found.digest for t, found in outcomes.items() if isinstance(found, PairResult)}
    tasks = [
        GridJob(t, files_of(release, t), asked.files[t], thresholds.of[t.category], rows)
        for t in sorted(asked.files)
        if t.split == "test"
    ]
    scored = run_tasks(score_grid, tasks, request.here, request.progress)
    found = {task.target: of for task, of in zip(tasks, scored, strict=True)}
    reasons = {t: of for t, of in (outcomes | found).items() if isinstance(of, str)}
    return table_in_space(
        release,
        method,
        {t: of for t, of in found.items() if isinstance(of, ViewResult)},
        asked.failures | reasons,
        settings_in_space(protocols, check_missing(request.missing)),
        [target for target, file in asked.files.items() if file is None],
        thresholds,
        validation,
    )

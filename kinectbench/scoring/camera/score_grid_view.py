"""Score views, and methods, with predictions in the pairs' grids under the protocols camera and aligned."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinectbench.core import PredictionError
from kinectbench.core.artefacts.counted import PairResult
from kinectbench.core.artefacts.scores import ScoreTable
from kinectbench.core.geometry import invert_rigid
from kinectbench.core.types import no_progress
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.release.release import Release, Target
from kinectbench.scoring.camera.score_camera_method import refuse_many_rows, settings_in_space, table_in_space
from kinectbench.scoring.camera.score_view import Asked, ViewResult, asked_rows, empty_rows, score_shape
from kinectbench.scoring.camera.truth import SpaceTruth, ViewFiles, files_of, read_space_truth
from kinectbench.scoring.camera_shape import CameraShape
from kinectbench.scoring.counts import Prediction, occupied
from kinectbench.scoring.pair_result import Counting, Journal
from kinectbench.scoring.prediction_file import load_hashed
from kinectbench.scoring.request import Request, check_missing
from kinectbench.scoring.rounds import Plan, Rounds
from kinectbench.scoring.workers import run_tasks


@dataclass(frozen=True)
class GridJob:
    """A view to score; its prediction is in the pair's grid.

    Attributes:
        target: the view.
        truth: the files that hold its truth.
        file: the prediction's file; None for an empty prediction.
        threshold: cells with a value above it are occupied.
        asked: the (protocol, kind of registration) pairs to score (`asked_rows`).
    """

    target: Target
    truth: ViewFiles
    file: Path | None
    threshold: float
    asked: tuple[Asked, ...]


def score_grid(job: GridJob) -> ViewResult | str:
    """Score a view; if its prediction cannot be scored, return the reason instead.

    Raises:
        ReleaseError: the truth is missing, or differs from the published one.
    """
    truth = read_space_truth(job.truth)
    if job.file is None:
        return ViewResult(empty_rows(truth, job.asked), truth.unknown_share, None, 0)
    try:
        loaded = load_hashed(job.file, job.target.name + job.file.suffix, truth.voxel_size_m)
        return grid_result(truth, loaded.prediction, job.threshold, job.asked, loaded.digest)
    except PredictionError as error:
        line, name = str(error), job.target.name
        return line if line.startswith(name) else f"{name}{job.file.suffix}: {line}"


def grid_result(
    truth: SpaceTruth,
    prediction: Prediction,
    threshold: float,
    asked: tuple[Asked, ...],
    digest: str | None = None,
) -> ViewResult:
    """Score a prediction (n, n, n) with values in [0, 1]; cells with a value above the threshold are solid.

    Unless n is 256, the prediction is upsampled as under the grid protocols. `digest` is that of its file.

    Raises:
        PredictionError: its surface has too many cell faces.
    """
    cells = unpack(occupied(prediction, threshold))
    if cells.any():
        none, T = np.zeros((0, 3)), invert_rigid(truth.T_grid_camera)
        shape = CameraShape("voxels", none, none.astype(np.int64), None, cells, T, truth.voxel_size_m)
        rows = score_shape(truth, shape, asked)
    else:
        rows = empty_rows(truth, asked)
    return ViewResult(rows, truth.unknown_share, digest, len(prediction))


# Thresholds are searched by the IoU over all cells, so surface metrics are not needed.
SEARCHING = Counting(("paper",), surface=False)


def score_grid_in_space(
    release: Release, asked: Plan, method: str, protocols: tuple[str, ...], request: Request
) -> ScoreTable:
    """Score in space, on the test split, a method that predicts voxels in each pair's grid; return the table.

    `asked`, made with `request`, has the prediction files, and thresholds or how to choose them. `protocols`
    are camera, aligned or both.

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

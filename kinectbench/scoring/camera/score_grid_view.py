"""Score a prediction in the pair's grid, taken as a solid, under the protocols camera and aligned."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kinectbench.core import PredictionError
from kinectbench.core.geometry import invert_rigid
from kinectbench.core.voxels.pair_file import unpack
from kinectbench.release.release import Target
from kinectbench.scoring.camera.score_view import Asked, ViewResult, empty_rows, score_shape
from kinectbench.scoring.camera.truth import SpaceTruth, ViewFiles, read_space_truth
from kinectbench.scoring.camera_shape import CameraShape
from kinectbench.scoring.counts import Prediction, occupied
from kinectbench.scoring.prediction_file import load_hashed


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

"""Score a trained network without writing predictions: each view is scored as soon as it is predicted."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from kinectbench.core import KinectBenchError
from kinectbench.core.artefacts.method import UnfinishedFile
from kinectbench.core.artefacts.scores import Failure, ScoreTable
from kinectbench.core.types import Progress, Split, no_progress
from kinectbench.core.voxels.resample import HALF_PIXEL, upsampled_planes
from kinectbench.networks.predict import SPLITS, completed_target, in_turn, method_of
from kinectbench.networks.trained import Trained
from kinectbench.release.release import Release, Target
from kinectbench.scoring.api import Scorer
from kinectbench.scoring.counts import Prediction
from kinectbench.scoring.dataset import Dataset
from kinectbench.scoring.method_json import method_lines
from kinectbench.scoring.prediction_file import CODES, LEVELS, packed, unpacked


def score_predicted(
    trained: Trained,
    release: Release,
    run: UnfinishedFile,
    *,
    splits: Sequence[Split] = SPLITS,
    surface: bool = True,
    progress: Progress = no_progress,
) -> ScoreTable:
    """Return the table that `score` would make from the files of `predict`, but without hashes.

    Nothing is written, so a stopped run cannot be resumed. A pair that cannot be read, or for which an output
    of the network is no probability, is listed as a failure in the table.

    Args:
        trained: the network.
        release: the release that is predicted and scored.
        run: how predictions would be written, as `run_of` returns it.
        splits: "validation", "test" or both. Without "validation", the threshold is the network's own, or
            else 0.5. Without "test", the table has no averages.
        surface: whether surface metrics are computed; they take most of the time.
        progress: called with (pairs done, pairs in all).

    Raises:
        ReleaseError: a file of the release has changed, or its truth is held back.
        PairError, PredictionError: all pairs fail; the error is that of the first pair.
    """
    method = method_of(trained, release, run, ())
    scorer = Scorer(
        Dataset(release, release.targets),
        method=trained.config.name,
        surface=surface,
        own_threshold=method.threshold,
    )
    targets = [target for split in SPLITS if split in splits for target in release.split(split)]
    errors = dict[str, KinectBenchError]()

    def count(target: Target, probability: NDArray[np.float16]) -> None:
        scorer.update(target.name, _read_again(probability, run))

    in_turn(trained, release, targets, count, lambda t, error: errors.update({t.name: error}), progress)
    if errors and len(errors) == len(targets):
        raise next(iter(errors.values()))
    table = scorer.result()
    warnings = (*table.warnings, *method_lines(release.folder, method, release))
    failures = tuple(_with_reason(failure, errors) for failure in table.failures)
    return table.model_copy(update={"warnings": warnings, "failures": failures, "run_sha256": run.sha256})


def _with_reason(failure: Failure, errors: Mapping[str, KinectBenchError]) -> Failure:
    """Return a failure with the error of its pair, if any, in place of the line about a missing file."""
    name = f"{failure.recording}/{failure.view}"
    return failure.model_copy(update={"reason": f"{name}: {errors[name]}"}) if name in errors else failure


def as_written(trained: Trained, release: Release, run: UnfinishedFile, target: Target) -> Prediction:
    """Predict a pair; return it as it would be read from its file. Errors as in `completed_target`."""
    return _read_again(completed_target(trained, release, target)[0], run)


def _read_again(probability: NDArray[np.float16], run: UnfinishedFile) -> Prediction:
    if run.threshold is not None:
        bits = [plane > run.threshold for plane in upsampled_planes(probability, convention=HALF_PIXEL)]
        return np.stack(bits)
    if run.precision == "packed" and (arrays := packed(probability)):
        return unpacked(arrays[LEVELS], arrays[CODES])
    return probability
